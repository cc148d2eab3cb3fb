"""Measure and print what qualities of a fit and the mesh stage give, against the label network's body, on PartBench.

    python scripts/measure_stages.py LEVEL [FIRST LAST] [NETWORK]

People 0 to 199, and beyond by the same recipe; NETWORK is a file of `partdr train`. Intervals are of 95 %, over people.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import warp as wp
from measure_camera import interval

from warp_partdr import FitOptions, fit_body
from warp_partdr.evaluation.evaluate import all_parts, no_labels, silhouette
from warp_partdr.evaluation.partbench.samples import make_sample
from warp_partdr.evaluation.scoring import Score, score_fit, summarise
from warp_partdr.fit.mesh_options import MeshOptions
from warp_partdr.fit.mesh_stage import refine_mesh
from warp_partdr.fit.stages import Quality
from warp_partdr.inputs.part_labels import PartLabels

_ALONE = "network"
# The mesh stage from the fast quality on: what both are given, and the stage's own quality.
_MESH: dict[str, tuple[Callable[[PartLabels], PartLabels | None], Quality]] = {
    "mesh, accurate": (all_parts, "accurate"),
    "mesh": (all_parts, "balanced"),
    "mesh, silhouette alone": (silhouette, "balanced"),
    "mesh, keypoints alone": (no_labels, "balanced"),
}
_FITS = {_ALONE: FitOptions(stages=())} | {name: FitOptions.at(name) for name in ("fast", "balanced", "accurate")}


def main(level: str, first: int = 200, last: int = 299, network: str | None = None) -> None:
    wp.config.log_level = wp.LOG_WARNING
    scores: dict[str, list[Score]] = {name: [] for name in (*_FITS, *_MESH)}
    for index in range(first, last + 1):
        sample = make_sample(index, level)
        for name, options in _FITS.items():
            given = replace(options, network=network)
            result = fit_body(sample.keypoints, sample.parts, others=sample.others, options=given)
            scores[name].append(score_fit(sample, name, result, 0.0))
        for name, (see, quality) in _MESH.items():
            given = replace(_FITS["fast"], network=network)
            first = fit_body(sample.keypoints, see(sample.parts), others=sample.others, options=given)
            mesh = refine_mesh(first, options=MeshOptions.at(quality))
            seconds = mesh.ellipbody.stage_seconds["mesh"]
            scores[name].append(score_fit(sample, name, mesh, seconds, mesh.vertices))
    errors = {name: np.array([(each.pa_mpjpe, each.mpjpe) for each in those]).T for name, those in scores.items()}
    for name, those in scores.items():
        found = summarise(those)
        low, high = found["interval_95"]["part_f1"]
        print(f"{name}: part F1 {found['part_f1']:.3f} ({low:.3f} to {high:.3f})")
        for what, values, alone in zip(("PA-MPJPE", "MPJPE"), errors[name], errors[_ALONE], strict=True):
            print(f"  {what} {np.nanmean(values):.1f} mm, against the network alone {interval(values - alone)}")
        if name == _ALONE:
            print(f"  {100 * found['depth_within_spread']:.0f} % of depths within the 68 % that it states")
        if "pve_mm" in found:
            print(f"  PVE {found['pve_mm']:.1f} mm, {found['seconds']:.2f} s")
    for one, other in pairwise(_MESH):
        print(f"{one} minus {other}: PA-MPJPE {interval(errors[one][0] - errors[other][0])}")


if __name__ == "__main__":
    level, *rest = sys.argv[1:]
    main(level, *map(int, rest[:2]), *rest[2:])
