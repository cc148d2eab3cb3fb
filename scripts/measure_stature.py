"""Measure and print what it is worth to know a person's stature: network, fast fit and mesh stage with it and without.

    python scripts/measure_stature.py LEVEL [FIRST LAST]
    python scripts/measure_stature.py clip FIRST LAST MOCAP

PartBench's people, 200 to 299 unless told, whom nothing was chosen on; or its clips, of motion capture, where they
stand in the world. Intervals are of 95 %, over people.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import warp as wp
from measure_camera import interval

from warp_partdr import FitOptions, fit_body
from warp_partdr.lab.evaluation.partbench.samples import CLIP, make_sample
from warp_partdr.lab.evaluation.partbench.scenes import partbench_scenes
from warp_partdr.lab.evaluation.scene_scoring import SceneBodies, score_scene
from warp_partdr.lab.evaluation.scoring import Score, score_fit
from warp_partdr.lab.synthetic.partbench_people import draw_shape
from warp_partdr.models.anny import anny
from warp_partdr.models.measuring import statures
from warp_partdr.solve.mesh.mesh_stage import refine_mesh
from warp_partdr.solve.scene.fitting import fit_scene
from warp_partdr.solve.scene.options import SceneOptions

_FIGURES = ("pa_mpjpe", "mpjpe", "pve", "world_mpjpe")
Found = dict[tuple[str, bool], list[list[float]]]  # figures of each person, by what was fitted and if it was known


def main(level: str, first: str = "200", last: str = "299", mocap: str = "") -> None:
    wp.config.log_level = wp.LOG_WARNING
    people = range(int(first), int(last) + 1)
    found = of_clips(people, Path(mocap)) if level == CLIP else of_people(people, level)
    for name in dict.fromkeys(name for name, _ in found):
        without, known = (np.array(found[name, given]).T for given in (False, True))
        for figure, before, after in zip(_FIGURES, without, known, strict=True):
            if np.isfinite(after).all():
                print(f"{name}, {figure} [mm]: {before.mean():.1f} -> {after.mean():.1f}, {interval(after - before)}")


def figures_of(score: Score) -> list[float]:
    return [getattr(score, figure) for figure in _FIGURES]


def true_stature(index: int) -> float:
    """A person's [m]."""
    return float(statures(anny(), draw_shape(index)[0]))


def of_clips(people: range, mocap: Path) -> Found:
    found: Found = {}
    for index, sample in zip(people, partbench_scenes(people, (CLIP,), mocap), strict=True):
        for known in (False, True):
            options = replace(SceneOptions.film(), stature=true_stature(index) if known else None)
            bodies = SceneBodies([fit_scene(sample.scene, options=options)])
            found.setdefault((CLIP, known), []).append(figures_of(score_scene(sample, CLIP, bodies, 0.0)))
    return found


def of_people(people: range, level: str) -> Found:
    found: Found = {}
    for index in people:
        sample, true = make_sample(index, level), true_stature(index)
        for known in (False, True):
            options = {"network": FitOptions(stages=()), "fast": FitOptions.at("fast")}
            if known:
                options = {name: replace(each, stature=true) for name, each in options.items()}
            fits = {
                name: fit_body(sample.keypoints, sample.parts, others=sample.others, options=each)
                for name, each in options.items()
            }
            scores = {name: score_fit(sample, name, fit, 0.0) for name, fit in fits.items()}
            mesh = refine_mesh(fits["fast"])
            scores["mesh"] = score_fit(sample, "mesh", mesh, 0.0, mesh.vertices)
            for name, score in scores.items():
                found.setdefault((name, known), []).append(figures_of(score))
    return found


if __name__ == "__main__":
    main(*sys.argv[1:])
