"""Volume that pairs of people share, and their accuracy, by how much they are kept apart.

The people are PartBench's pairs, half of which start in the wrong depth order. The volume that lies in both bodies is
measured on a grid of 1 cm. Intervals of 95 % are over pairs.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from ...models.anny import anny
from ...solve.scene.options import SceneOptions
from ..evaluation.evaluate import Fitting, Report, evaluate
from ..evaluation.partbench.samples import PAIRS
from ..evaluation.partbench.scenes import SCENE_METHODS, SceneMethod, fit_all_together, partbench_scenes
from ..evaluation.volumes import shared_volume
from ..options import Numbers, People


def measure_apart(
    *,
    people: People = range(100, 130),
    weights: Numbers = (0.0, 0.1),
) -> Iterator[Report | str]:
    """Fit pairs, each person alone and together with each weight.

    Args:
        people: First person of each pair.
        weights: Weights of the term that keeps people apart (``SceneOptions.apart``).
    """
    samples = partbench_scenes(people, [PAIRS])
    methods: dict[str, Fitting] = {"each alone": SCENE_METHODS["each alone"]}
    for weight in weights:
        methods[f"weight {weight:g}"] = SceneMethod(partial(fit_all_together, options=SceneOptions(apart=weight)))
    report = evaluate(samples, methods)
    faces = anny().faces.numpy()
    true = [shared_volume(sample.vertices[:, 0], faces) for sample in samples]
    yield f"The true bodies share {np.mean(true):.0f} cm³."
    yield report
