"""Quality of fits, and what part labels add: keypoints alone, full silhouette, and parts, by the same fit.

There is a table for each of two sources. The packaged example has exact labels and keypoints, and true 3D joints. With
`--people`, photos N.jpg with N.parts.png (ids of cdcl14) and N.keypoints.json are scored against the labels that were
fitted, for there are no others. With labels as input, that says how well a body can follow them.

Figures: PA-MPJPE and MPJPE (pelvis-centred) over the 14 LSP joints; F1 after grouping into LSP's six parts, counts
pooled over pictures of original size, pixels to be ignored left out: foreground (mean of background and person), parts
(mean of 7 classes); distance of the confident keypoints as a share of the person's height. Times are of single fits,
kernels compiled; with `--jobs` above 1, fits slow each other down.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...body.labels import label_set
from ...body.skeletons import MPJPE_JOINTS, MPJPE_SKELETON
from ...errors import InputError
from ...inputs.keypoint_files import read_keypoints
from ...inputs.keypoints import choose_person
from ...inputs.part_labels import read_parts
from ...inputs.sample import Sample
from ...solve.ellipsoids.options import FitOptions
from ...solve.mesh.mesh_options import MeshOptions
from ..evaluation.datasets import read_folder
from ..evaluation.evaluate import Method, evaluate, no_labels, one_thread, silhouette
from ..evaluation.partbench.methods import fit_anny
from ..evaluation.scoring import summarise
from ..options import Jobs
from ..tables import Cell, FigureTable

_LABELS = label_set("cdcl14")

# What a fit gets to see, and how it goes. Joints are compared without the outline stage, which costs some accuracy.
_OUTLINE = FitOptions().with_outline()
_LABELS_FIRST = FitOptions().with_outline(labels_first=True)
SUPERVISIONS: dict[str, Method] = {
    "keypoints only": Method(no_labels),
    "silhouette": Method(silhouette),
    "parts": Method(),
    "silhouette, outline": Method(silhouette, _OUTLINE),
    "parts, outline, background trusted": Method(options=replace(_OUTLINE, trust_background=True)),
    "parts, labels first": Method(options=_LABELS_FIRST),
    "the same, background trusted": Method(options=replace(_LABELS_FIRST, trust_background=True)),
    "parts, outline": Method(options=_OUTLINE),
    "mesh": Method(fit=fit_anny),
    "mesh, labels first": Method(fit=partial(fit_anny, mesh=MeshOptions(seg=1.0, iterations=150))),
}


def read_example() -> Sample:
    """Packaged example, whose labels, keypoints and joints are the true ones."""
    folder = Path(__file__).resolve().parents[2] / "assets" / "example"
    parts = read_parts(folder / "parts.png", _LABELS)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["joints"][MPJPE_SKELETON]
    positions = dict(zip(truth["names"], truth["points_m"], strict=True))
    return Sample(
        source="example",
        name="example",
        keypoints=choose_person(read_keypoints(folder / "keypoints.json"), parts.groups),
        parts=parts,
        target=parts.groups,
        joints=np.array([positions[name] for name in MPJPE_JOINTS]),
        picture=folder / "photo.png",
    )


_FIGURES = {  # heading: a figure's name and its format
    "PA-MPJPE [mm]": ("pa_mpjpe_mm", ".1f"),
    "MPJPE [mm]": ("mpjpe_mm", ".0f"),
    "foreground F1": ("foreground_f1", ".3f"),
    "part F1": ("part_f1", ".3f"),
    "undisputed: foreground": ("undisputed_foreground_f1", ".3f"),
    "part": ("undisputed_part_f1", ".3f"),
    "keypoints off [% of height]": ("keypoint_distance", ".1%"),
    "time [s]": ("seconds", ".1f"),
}
_COLUMNS = {"person": "", "fitted to": ""} | {heading: form for heading, (_, form) in _FIGURES.items()}


def measure_accuracy(*, people: Path | None = None, jobs: Jobs = 1) -> Iterator[FigureTable | str]:
    """Fit everybody with each supervision.

    Args:
        people: Folder of photos with labels and keypoints.
        jobs: Fits at a time.

    Raises:
        InputError: If nobody is in the folder.
    """
    os.environ["OMP_NUM_THREADS"] = "1"  # for the processes to come
    one_thread()
    samples = {"The packaged example": [read_example()]}
    if people is not None:
        samples["Photos, against the labels given"] = found = list(read_folder(people, _LABELS))
        if not found:
            raise InputError(f"{people}: nobody; expected photos with labels and keypoints")
    report = evaluate([sample for group in samples.values() for sample in group], SUPERVISIONS, jobs=jobs)
    for failure in report.failures:
        yield f"{failure.source}: {failure.sample}: {failure.method}: {failure.reason}"
    pooled = report.pooled()
    for title, group in samples.items():
        source, table = group[0].source, FigureTable(title, _COLUMNS)
        single = [score for score in report.scores if score.source == source] if len(group) > 1 else []
        for score in single:
            table.add(score.sample, score.method, *_cells(summarise([score])))
        for method, figures in pooled[source].items():
            table.add("all" if single else "", method, *_cells(figures))
        yield table


def _cells(figures: Mapping[str, Any]) -> list[Cell]:
    return [figures.get(name) for name, _ in _FIGURES.values()]
