"""Measure and print what qualities of a fit and the mesh stage give, against the label network's body, on PartBench.

    python scripts/measure_stages.py LEVEL [FIRST LAST] [NETWORK]

People 0 to 199, and beyond by the same recipe; NETWORK is a file of `partdr train`. Intervals are of 95 %, over people.
The size of adults is that of their legs and trunk, over the truth's.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import torch
import warp as wp
from measure_camera import interval

from warp_partdr import FitOptions, FitResult, fit_body
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.lab.evaluation.evaluate import all_parts, no_labels, silhouette
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.lab.evaluation.scoring import Score, score_fit, summarise
from warp_partdr.lab.synthetic.partbench_people import draw_quantiles
from warp_partdr.lab.synthetic.population import population
from warp_partdr.solve.ellipsoids.stages import Quality
from warp_partdr.solve.mesh.mesh_options import MeshOptions
from warp_partdr.solve.mesh.mesh_stage import MeshFit, refine_mesh

_ALONE = "network"
# The mesh stage from the fast quality on: what both are given, and the stage's own quality.
_MESH: dict[str, tuple[Callable[[PartLabels], PartLabels | None], Quality]] = {
    "mesh, accurate": (all_parts, "accurate"),
    "mesh": (all_parts, "balanced"),
    "mesh, silhouette alone": (silhouette, "balanced"),
    "mesh, keypoints alone": (no_labels, "balanced"),
}
_FITS = {_ALONE: FitOptions(stages=())} | {name: FitOptions.at(name) for name in ("fast", "balanced", "accurate")}
_KEYPOINTS_ALONE = {f"{name}, keypoints alone": _FITS[name] for name in (_ALONE, "balanced")}
_LEGS = [
    (f"{side}_{start}", f"{side}_{end}")
    for side in ("left", "right")
    for start, end in (("hip", "knee"), ("knee", "ankle"))
]


def size(joints: np.ndarray, names: Sequence[str]) -> float:
    """Length of the legs, of both the mean, and of the trunk [m]."""
    places = dict(zip(names, joints, strict=True))
    hips, shoulders = (places[f"left_{name}"] + places[f"right_{name}"] for name in ("hip", "shoulder"))
    legs = sum(float(np.linalg.norm(places[start] - places[end])) for start, end in _LEGS)
    return (legs + float(np.linalg.norm(shoulders - hips))) / 2


def is_adult(index: int) -> bool:
    """True if a person is 18 years old or more."""
    quantiles = torch.from_numpy(draw_quantiles(index)[0])[None].float()
    return float(population().years(quantiles)) >= 18


def main(level: str, first: int = 200, last: int = 299, network: str | None = None) -> None:
    wp.config.log_level = wp.LOG_WARNING
    scores: dict[str, list[Score]] = {name: [] for name in (*_FITS, *_KEYPOINTS_ALONE, *_MESH)}
    sizes: dict[str, list[float]] = {name: [] for name in scores}
    for index in range(first, last + 1):
        sample = make_sample(index, level)
        found: dict[str, FitResult | MeshFit] = {}
        for name, options in (_FITS | _KEYPOINTS_ALONE).items():
            given = replace(options, network=network)
            parts = None if name in _KEYPOINTS_ALONE else sample.parts
            result = fit_body(sample.keypoints, parts, others=sample.others, options=given)
            scores[name].append(score_fit(sample, name, result, 0.0))
            found[name] = result
        for name, (see, quality) in _MESH.items():
            given = replace(_FITS["fast"], network=network)
            start = fit_body(sample.keypoints, see(sample.parts), others=sample.others, options=given)
            mesh = refine_mesh(start, options=MeshOptions.at(quality))
            seconds = mesh.ellipbody.stage_seconds["mesh"]
            scores[name].append(score_fit(sample, name, mesh, seconds, mesh.vertices))
            found[name] = mesh
        if is_adult(index):
            true = size(sample.joints, sample.joint_names)
            for name, body in found.items():
                sizes[name].append(size(body.landmarks(sample.joint_names), sample.joint_names) / true)
    errors = {name: np.array([(each.pa_mpjpe, each.mpjpe) for each in those]).T for name, those in scores.items()}
    for name, those in scores.items():
        pooled = summarise(those)
        low, high = pooled["interval_95"]["part_f1"]
        print(f"{name}: part F1 {pooled['part_f1']:.3f} ({low:.3f} to {high:.3f})")
        for what, values, alone in zip(("PA-MPJPE", "MPJPE"), errors[name], errors[_ALONE], strict=True):
            print(f"  {what} {np.nanmean(values):.1f} mm, against the network alone {interval(values - alone)}")
        print(f"  size of adults: {100 * np.mean(sizes[name]):.1f} %, deviation {100 * np.std(sizes[name]):.1f} %")
        if name == _ALONE:
            print(f"  {100 * pooled['depth_within_spread']:.0f} % of depths within the 68 % that it states")
        if "pve_mm" in pooled:
            print(f"  PVE {pooled['pve_mm']:.1f} mm, {pooled['seconds']:.2f} s")
    for one, other in pairwise(_MESH):
        print(f"{one} minus {other}: PA-MPJPE {interval(errors[one][0] - errors[other][0])}")


if __name__ == "__main__":
    level, *rest = sys.argv[1:]
    main(level, *map(int, rest[:2]), *rest[2:])
