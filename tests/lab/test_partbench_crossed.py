"""PartBench's level "crossed": keypoints do not tell the two bodies apart, and the figure tells which one was found."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from warp_partdr.body.posing import LandmarkGather
from warp_partdr.body.skeletons import skeleton
from warp_partdr.cli.evaluate import evaluate as command
from warp_partdr.lab.evaluation.evaluate import METHODS, Report
from warp_partdr.lab.evaluation.partbench.crossed import CROSSED_METHODS, CrossedMethod, CrossedSample, crossed_samples
from warp_partdr.lab.evaluation.partbench.report import compare_methods, draw_case
from warp_partdr.lab.evaluation.partbench.samples import make_sample, source_name
from warp_partdr.lab.evaluation.scoring import score_fit
from warp_partdr.render.ellipsoids import draw_ellipsoids
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.result import FitResult

FLIPS, ALONE = "mirrored start, depth flips", "mirrored start, 50 iterations"
UNREFINED = FitOptions(stages=(), search=())


@lru_cache(maxsize=1)
def cases() -> list[CrossedSample]:
    return crossed_samples(2)


def start_of(sample: CrossedSample, *, from_truth: bool) -> FitResult:
    return CrossedMethod(options=UNREFINED, from_truth=from_truth).fit_sample(sample, "cpu")


@pytest.mark.parametrize("index", [0, 1])
def test_keypoints_and_joints_look_the_same_and_labels_do_not(index: int) -> None:
    sample = cases()[index]
    names = skeleton("coco17").landmarks
    seen = [
        each.camera(512).project(LandmarkGather(names, "cpu")(each.posed()))[0, :, :2]
        for each in (sample.truth, sample.wrong)
    ]
    torch.testing.assert_close(seen[0], seen[1], atol=0.02, rtol=0)
    drawn = draw_ellipsoids(sample.wrong.posed(), sample.wrong.camera(512), (512, 512)).labels[0].numpy()
    assert (drawn != sample.parts.groups).sum() > 0.01 * (drawn > 0).sum()
    assert np.abs(sample.mirrored - sample.joints)[:, 2].max() > 0.05


def test_the_true_body_has_the_right_order_and_its_mirror_image_the_wrong_one() -> None:
    sample = cases()[0]
    right, wrong = (start_of(sample, from_truth=each) for each in (True, False))
    scores = [score_fit(sample, "", each, 0.0) for each in (right, wrong)]
    assert [score.order for score in scores] == [1, 0]
    assert scores[0].pa_mpjpe < 0.01 < 5 < scores[1].pa_mpjpe
    assert scores[0].keypoints.max() < 1e-4
    assert scores[0].pixels.parts.trace() > 0.995 * scores[0].pixels.parts.sum()
    assert draw_case(sample, wrong).size == (4 * 512, 512)


def test_flips_repair_what_iterations_do_not() -> None:
    samples = cases()
    methods = {name: CROSSED_METHODS[name] for name in (FLIPS, ALONE)}
    scores = [
        method.score(sample, name, method.fit_sample(sample, "cpu"), 0.0)
        for name, method in methods.items()
        for sample in samples
    ]
    assert [score.order for score in scores] == [1, 1, 0, 0]
    assert not methods[FLIPS].serves(make_sample(0, "clean"))
    assert METHODS["parts"].serves(samples[0])


def test_depths_within_what_the_network_states_are_counted() -> None:
    sample = cases()[0]
    fit = start_of(sample, from_truth=True)
    assert fit.uncertainty is not None
    for spread, share in ((1e-9, 0.0), (1.0, 1.0)):
        depths = torch.full_like(fit.uncertainty.depths, spread)
        moved = replace(sample, joints=sample.joints + np.linspace(0.0, 0.1, len(sample.joints))[:, None])
        sure = replace(fit, uncertainty=replace(fit.uncertainty, depths=depths))
        assert score_fit(moved, "", sure, 0.0).depth_within == share
    narrow, wide = (
        score_fit(moved, "", replace(fit, uncertainty=replace(fit.uncertainty, depths=spread * depths)), 0.0)
        for spread in (0.015, 0.03)
    )
    assert narrow.depth_within < narrow.depth_within_two == wide.depth_within < wide.depth_within_two
    assert np.isnan(score_fit(sample, "", replace(fit, uncertainty=None), 0.0).depth_within)


def test_the_command_tells_the_depth_order(tmp_path: Path) -> None:
    arguments = ["partbench", "--level", "crossed", "--people", "1", "--method", FLIPS, "--method", ALONE]
    result = CliRunner().invoke(command, [*arguments, "--jobs", "1", "--device", "cpu", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    pooled = json.loads((tmp_path / "partbench.json").read_text())["pooled"][source_name("crossed")]
    assert {name: row["order_right"] for name, row in pooled.items()} == {FLIPS: 1.0, ALONE: 0.0}
    assert 0 <= pooled[FLIPS]["depth_within_spread"] <= 1


def test_differences_tell_the_depth_order_in_percent() -> None:
    sample = cases()[0]
    scores = [
        score_fit(sample, name, start_of(sample, from_truth=right), 0.0)
        for name, right in (("parts", True), ("parts, no depth flips", False))
    ]
    (found,) = compare_methods(Report(tuple(scores)))
    assert "depth order right +100.0 (+100.0 to +100.0) %" in found
