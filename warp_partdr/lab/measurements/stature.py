"""Gain of a known stature: network, fast fit and mesh stage with it and without.

The people are PartBench's, on whom nothing was chosen by default. At the level "clip", which needs motion capture, they
move where they stand in the world. Intervals of 95 % are over people.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from ...models.anny import anny
from ...models.measuring import statures
from ...solve.ellipsoids.fitting import fit_body
from ...solve.ellipsoids.options import FitOptions
from ...solve.mesh.mesh_stage import refine_mesh
from ...solve.scene.fitting import fit_scene
from ...solve.scene.options import SceneOptions
from ..evaluation.partbench.samples import CLIP, check_levels, make_sample
from ..evaluation.partbench.scenes import partbench_scenes
from ..evaluation.scene_scoring import SceneBodies, score_scene
from ..evaluation.scoring import Score, score_fit
from ..options import People, tracked
from ..synthetic.partbench_people import draw_shape
from ..tables import FigureTable, estimate_mean

_FIGURES = ("pa_mpjpe", "mpjpe", "pve", "world_mpjpe")
_Found = dict[tuple[str, bool], list[list[float]]]  # figures of each person, by what was fitted and if it was known


def _check_levels(_: type, levels: tuple[str, ...]) -> None:
    check_levels([level for level in levels if level != CLIP])


def measure_stature(
    *,
    people: People = range(200, 300),
    levels: Annotated[tuple[str, ...], Parameter(validator=_check_levels)] = ("realistic",),
    mocap: Path | None = None,
) -> Iterator[FigureTable]:
    """Fit people with their stature and without.

    Args:
        people: People to fit.
        levels: Levels of single people, or clip.
        mocap: Folder of motion capture, for the level clip.
    """
    for level in levels:
        found = _found_of_clips(people, mocap) if level == CLIP else _found_of_people(people, level)
        columns = {"fit": "", "figure [mm]": "", "without": ".1f", "known": ".1f", "change": "+.1f"}
        table = FigureTable(f"{level}, {len(people)} people", columns)
        for name in dict.fromkeys(name for name, _ in found):
            without, known = (np.array(found[name, given]).T for given in (False, True))
            for figure, before, after in zip(_FIGURES, without, known, strict=True):
                if np.isfinite(after).all():
                    means = float(before.mean()), float(after.mean())
                    table.add(name, figure, *means, estimate_mean(after - before))
        yield table


def _figures_of(score: Score) -> list[float]:
    return [getattr(score, figure) for figure in _FIGURES]


def _true_stature(index: int) -> float:
    """Stature of a person [m]."""
    return float(statures(anny(), draw_shape(index)[0]))


def _found_of_clips(people: range, mocap: Path | None) -> _Found:
    found: _Found = {}
    for index, sample in zip(people, partbench_scenes(people, (CLIP,), mocap), strict=True):
        for known in (False, True):
            options = replace(SceneOptions.film(), stature=_true_stature(index) if known else None)
            bodies = SceneBodies([fit_scene(sample.scene, options=options)])
            found.setdefault((CLIP, known), []).append(_figures_of(score_scene(sample, CLIP, bodies, 0.0)))
    return found


def _found_of_people(people: range, level: str) -> _Found:
    found: _Found = {}
    for index in tracked(people):
        sample, true = make_sample(index, level), _true_stature(index)
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
                found.setdefault((name, known), []).append(_figures_of(score))
    return found
