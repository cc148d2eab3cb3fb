"""Measure and print what it is worth to know a person's stature: network, fast fit and mesh stage with it and without.

    python scripts/measure_stature.py LEVEL [FIRST LAST]

PartBench's people, 200 to 299 unless told, whom nothing was chosen on. Intervals are of 95 %, over people.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import torch
import warp as wp
from measure_camera import interval

from warp_partdr import FitOptions, fit_body
from warp_partdr.clothing.anny import anny, anny_shape
from warp_partdr.clothing.measuring import statures
from warp_partdr.evaluation.partbench.samples import make_sample
from warp_partdr.evaluation.scoring import score_fit
from warp_partdr.fit.mesh_stage import refine_mesh
from warp_partdr.synthetic.partbench_people import draw_phenotypes

_FIGURES = ("pa_mpjpe", "mpjpe", "pve")


def main(level: str, first: str = "200", last: str = "299") -> None:
    wp.config.log_level = wp.LOG_WARNING
    model = anny()
    found: dict[tuple[str, bool], list[list[float]]] = {}
    for index in range(int(first), int(last) + 1):
        sample = make_sample(index, level)
        true = float(statures(model, anny_shape(torch.from_numpy(draw_phenotypes(index)[0])[None].float())))
        for known in (False, True):
            options = {"network": FitOptions(stages=()), "fast": FitOptions.at("fast")}
            if known:
                options = {name: replace(each, stature=true) for name, each in options.items()}
            fits = {
                name: fit_body(sample.keypoints, sample.parts, others=sample.others, options=each)
                for name, each in options.items()
            }
            scores = {name: score_fit(sample, name, fit, 0.0) for name, fit in fits.items()}
            mesh = refine_mesh(fits["fast"], model)
            scores["mesh"] = score_fit(sample, "mesh", mesh, 0.0, mesh.vertices)
            for name, score in scores.items():
                found.setdefault((name, known), []).append([getattr(score, figure) for figure in _FIGURES])
    for name in ("network", "fast", "mesh"):
        without, known = (np.array(found[name, given]).T for given in (False, True))
        for figure, before, after in zip(_FIGURES, without, known, strict=True):
            if np.isfinite(after).all():
                print(f"{name}, {figure} [mm]: {before.mean():.1f} -> {after.mean():.1f}, {interval(after - before)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
