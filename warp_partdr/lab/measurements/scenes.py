"""Accuracy of fitted scenes of PartBench: pairs, groups, clips and people before several cameras.

Intervals of 95 % are over scenes.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from ...errors import InputError
from ..evaluation.evaluate import Report, evaluate, one_thread
from ..evaluation.partbench.report import compare_methods
from ..evaluation.partbench.samples import SCENES
from ..evaluation.partbench.scenes import SCENE_METHODS, partbench_scenes
from ..evaluation.scene_scoring import sliding_speed
from ..options import Device, Jobs, Names, People


def _check_levels(_: type, levels: tuple[str, ...]) -> None:
    if unknown := [level for level in levels if level not in SCENES]:
        raise InputError(f"level: {', '.join(unknown)}; expected {', '.join(SCENES)}")


def _check_methods(_: type, methods: tuple[str, ...]) -> None:
    if unknown := [name for name in methods if name not in SCENE_METHODS]:
        raise InputError(f"method: {', '.join(unknown)}; expected {', '.join(SCENE_METHODS)}")


def measure_scenes(
    *,
    levels: Annotated[tuple[str, ...], Parameter(validator=_check_levels)],
    people: People = range(100, 140),
    mocap: Path | None = None,
    methods: Annotated[Names, Parameter(validator=_check_methods)] = (),
    device: Device = "cpu",
    jobs: Jobs = 1,
) -> Iterator[Report | str]:
    """Fit scenes by each method.

    Args:
        levels: Kinds of scenes: pairs, groups, clip, views.
        people: First person of each scene.
        mocap: Folder of motion capture, for the level clip.
        methods: Names of methods; all by default.
        device: Device of the fits.
        jobs: Fits at a time.
    """
    one_thread()
    samples = partbench_scenes(people, levels, mocap)
    chosen = {name: SCENE_METHODS[name] for name in methods or SCENE_METHODS}
    report = evaluate(samples, chosen, device=device, jobs=jobs)
    yield report
    moving = [each for each in samples if each.scene.num_frames > 1]
    if moving:
        speeds = [sliding_speed(each.joints, each.joints, each.scene.frame_rate) for each in moving]
        yield f"Feet that stand slide by {1000 * np.nanmean(speeds):.0f} mm/s in the truth."
    yield from compare_methods(report)
    yield from map(str, report.failures)
