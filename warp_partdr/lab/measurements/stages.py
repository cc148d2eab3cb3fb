"""Accuracy of the qualities of a fit and of the mesh stage, against the label network's body.

People 0 to 199 are PartBench's, and those beyond are drawn by the same recipe. The size of adults is that of their legs
and trunk, over the truth's. Intervals of 95 % are over people.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import torch

from ...inputs.part_labels import PartLabels
from ...inputs.sample import Sample
from ...solve.ellipsoids.fitting import fit_body
from ...solve.ellipsoids.options import FitOptions
from ...solve.ellipsoids.result import FitResult
from ...solve.ellipsoids.stages import Quality
from ...solve.mesh.mesh_options import MeshOptions
from ...solve.mesh.mesh_stage import MeshFit, refine_mesh
from ..evaluation.evaluate import all_parts, no_labels, silhouette
from ..evaluation.partbench.samples import make_sample
from ..evaluation.scoring import Score, score_fit, summarise
from ..options import Levels, NetworkFile, People, tracked
from ..synthetic.partbench_people import draw_quantiles
from ..synthetic.population import population
from ..tables import FigureTable, estimate_mean, pooled_estimate

_ALONE = "network"
# The mesh stage from the fast quality on: what both are given, and the stage's own quality.
_MESH: dict[str, tuple[Callable[[PartLabels], PartLabels | None], Quality]] = {
    "mesh, accurate": (all_parts, "accurate"),
    "mesh": (all_parts, "balanced"),
    "mesh, silhouette alone": (silhouette, "balanced"),
    "mesh, keypoints alone": (no_labels, "balanced"),
}
_FITS = {
    _ALONE: FitOptions(stages=()),
    "fast": FitOptions.at("fast"),
    "balanced": FitOptions.at("balanced"),
    "balanced, outline": FitOptions.at("balanced").with_outline(),
}
_KEYPOINTS_ALONE = {f"{name}, keypoints alone": _FITS[name] for name in (_ALONE, "balanced")}
_LEG_BONES = [
    (f"{side}_{start}", f"{side}_{end}")
    for side in ("left", "right")
    for start, end in (("hip", "knee"), ("knee", "ankle"))
]
_COLUMNS = {
    "fit": "",
    "part F1": ".3f",
    "PA-MPJPE [mm]": ".1f",
    "against the network": "+.1f",
    "MPJPE [mm]": ".1f",
    "likewise": "+.1f",
    "size of adults [%]": ".1f",
    "its deviation [%]": ".1f",
    "PVE [mm]": ".1f",
    "time [s]": ".2f",
}


def measure_stages(
    *, people: People = range(200, 300), levels: Levels = ("realistic",), network: NetworkFile = None
) -> Iterator[FigureTable | str]:
    """Fit people at each quality, and by the mesh stage from different inputs.

    Args:
        people: People to fit.
        levels: Levels to fit them at.
        network: Label network that the fits begin with.
    """
    for level in levels:
        found = _Found()
        for index in tracked(people):
            found.add(index, make_sample(index, level), network)
        yield found.table(f"{level}, {len(people)} people")
        yield from found.sentences()


@dataclass
class _Found:
    """Scores of fits by the name of their kind, and sizes of adults as shares of the true ones."""

    scores: dict[str, list[Score]] = field(default_factory=dict)
    sizes: dict[str, list[float]] = field(default_factory=dict)

    def add(self, index: int, sample: Sample, network: str | None) -> None:
        """Fit a person in every way."""
        found: dict[str, FitResult | MeshFit] = {}
        for name, options in (_FITS | _KEYPOINTS_ALONE).items():
            given = replace(options, network=network)
            parts = None if name in _KEYPOINTS_ALONE else sample.parts
            result = fit_body(sample.keypoints, parts, others=sample.others, options=given)
            self.scores.setdefault(name, []).append(score_fit(sample, name, result, 0.0))
            found[name] = result
        assert sample.parts is not None
        for name, (see, quality) in _MESH.items():
            given = replace(_FITS["fast"], network=network)
            start = fit_body(sample.keypoints, see(sample.parts), others=sample.others, options=given)
            mesh = refine_mesh(start, options=MeshOptions.at(quality))
            seconds = mesh.ellipbody.stage_seconds["mesh"]
            self.scores.setdefault(name, []).append(score_fit(sample, name, mesh, seconds, mesh.vertices))
            found[name] = mesh
        if _is_adult(index):
            assert sample.joints is not None
            true = _size(sample.joints, sample.joint_names)
            for name, body in found.items():
                size = _size(body.landmarks(sample.joint_names), sample.joint_names)
                self.sizes.setdefault(name, []).append(size / true)

    def errors(self, name: str) -> np.ndarray:
        """PA-MPJPE and MPJPE of a kind's fits [mm], shape (2, N)."""
        return np.array([(each.pa_mpjpe, each.mpjpe) for each in self.scores[name]]).T

    def table(self, title: str) -> FigureTable:
        """Table of all kinds."""
        table = FigureTable(title, _COLUMNS)
        for name, scores in self.scores.items():
            pooled, sizes = summarise(scores), 100 * np.array(self.sizes.get(name, [np.nan]))
            (aligned, plain), alone = self.errors(name), self.errors(_ALONE)
            table.add(
                name,
                pooled_estimate(pooled, "part_f1"),
                float(np.nanmean(aligned)),
                estimate_mean(aligned - alone[0]),
                float(np.nanmean(plain)),
                estimate_mean(plain - alone[1]),
                float(sizes.mean()),
                float(sizes.std()),
                pooled.get("pve_mm"),
                pooled["seconds"] if "pve_mm" in pooled else None,
            )
        return table

    def sentences(self) -> Iterator[str]:
        """Stated uncertainty of the network, and what less input costs the mesh."""
        within = 100 * summarise(self.scores[_ALONE])["depth_within_spread"]
        yield f"{within:.0f} % of the network's depths are within the 68 % that it states."
        for one, other in pairwise(_MESH):
            change = estimate_mean(self.errors(one)[0] - self.errors(other)[0])
            yield f"{one} minus {other}: PA-MPJPE {change:+.1f} mm"


def _size(joints: np.ndarray, names: Sequence[str]) -> float:
    """Length of the legs, the mean of both, and of the trunk [m]."""
    positions = dict(zip(names, joints, strict=True))
    hips, shoulders = (positions[f"left_{name}"] + positions[f"right_{name}"] for name in ("hip", "shoulder"))
    legs = sum(float(np.linalg.norm(positions[start] - positions[end])) for start, end in _LEG_BONES)
    return (legs + float(np.linalg.norm(shoulders - hips))) / 2


def _is_adult(index: int) -> bool:
    """True if a person is 18 years old or more."""
    quantiles = torch.from_numpy(draw_quantiles(index)[0])[None].float()
    return float(population().years(quantiles)) >= 18
