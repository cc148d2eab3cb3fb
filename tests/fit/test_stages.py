"""Qualities of a fit: their stages, and options that override them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes.bodies import observation_of, random_bodies

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.fit.fitting import fit_body
from warp_partdr.fit.options import FitOptions
from warp_partdr.fit.result import FitResult
from warp_partdr.fit.stages import STAGES, Stage, Start
from warp_partdr.inputs.keypoints import Keypoints2D


def person(device: str) -> tuple[Keypoints2D, BodyParameters]:
    bodies = random_bodies(1, device)
    points = (observation_of(bodies).points.cpu().numpy() + 1) * 64
    return Keypoints2D("coco17", points.astype(np.float32), np.ones(len(points), dtype=np.float32)), bodies


def short(result: FitResult) -> list[tuple[str, int, int]]:
    return [(stage.name, stage.iterations, stage.size) for stage in result.stages]


def test_balanced_is_the_default(device: str) -> None:
    assert FitOptions() == FitOptions.at("balanced")
    keypoints, _ = person(device)
    assert short(fit_body(keypoints, device=device)) == short(fit_body(keypoints, quality="balanced", device=device))


def test_quality_chooses_the_stages_and_options_override_it(device: str) -> None:
    keypoints, _ = person(device)
    fast = fit_body(keypoints, quality="fast", device=device)
    assert fast.stages == tuple(replace(stage, size=0) for stage in STAGES["network"]["fast"])
    searched = fit_body(keypoints, options=FitOptions.at("fast", "search"), device=device)
    assert searched.stages == tuple(stage for stage in STAGES["search"]["fast"] if stage.size == 0)
    own = FitOptions(stages=(Stage("lift", 4, 2, 0.1),))
    assert fit_body(keypoints, quality="fast", options=own, device=device).stages == own.stages
    assert FitOptions.at("accurate").without_outline().stages == STAGES["network"]["accurate"][:-1]


def test_unknown_quality_is_said(device: str) -> None:
    keypoints, _ = person(device)
    with pytest.raises(ValueError, match="quality: 'best'; expected fast, balanced, accurate"):
        fit_body(keypoints, quality="best", device=device)  # type: ignore[arg-type]


@pytest.mark.parametrize("start", STAGES)
def test_qualities_are_in_order_of_work(start: Start) -> None:
    """Pixels drawn: bodies times iterations times the area of the picture."""
    work = {
        quality: sum(stage.bodies * stage.iterations * stage.size**2 for stage in stages)
        for quality, stages in STAGES[start].items()
    }
    assert 4 * work["fast"] < work["balanced"] < work["accurate"]
