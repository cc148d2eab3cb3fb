"""The whole path of a fit, on bodies whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.bodies import PICTURE_SIZE, seen_by, walker
from helpers.quick import QUICK_SEARCH

from warp_partdr import metrics
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.skeletons import skeleton
from warp_partdr.errors import InputError
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.networks.regression.predict import ask_network
from warp_partdr.solve.ellipsoids import network_start
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.ellipsoids.options import FitOptions


def test_fit_finds_a_body_from_perfect_labels():
    """It finds the same one again."""
    body = walker()
    keypoints, parts = seen_by(body)
    result, again = (fit_body(keypoints, parts, options=QUICK_SEARCH) for _ in range(2))
    for name, tensor in result.parameters.tensors().items():
        assert torch.equal(tensor, again.parameters.tensors()[name]), name
    shown = result.draw(PICTURE_SIZE).labels[0].numpy()
    counts = metrics.confusion(shown, parts.groups, 21)
    assert metrics.part_f1(metrics.foreground_counts(counts)) > 0.94
    names = skeleton("lsp14").landmarks
    truth = LandmarkGather(names, "cpu")(body.posed())[0].numpy()
    assert metrics.pa_mpjpe(result.landmarks(names), truth) < 0.08
    assert list(result.stage_seconds) == [stage.name for stage in QUICK_SEARCH.stages]


@pytest.mark.parametrize("case", ["cut off", "missing limbs", "keypoints alone", "ignored half"])
def test_fit_takes_what_is_there(case):
    keypoints, parts = seen_by(walker())
    confidence, groups = keypoints.confidence.copy(), parts.groups.copy()
    if case == "cut off":  # the legs are beyond the picture's border
        confidence, groups = (keypoints.points[:, 1] < 110).astype(np.float32), groups[:110]
    elif case == "missing limbs":
        confidence[7:11] = 0
        groups[groups > 14] = 0
    elif case == "ignored half":
        groups[:, 80:] = 255
    keypoints = replace(keypoints, confidence=confidence)
    parts = None if case == "keypoints alone" else PartLabels(parts.label_set, groups)
    result = fit_body(keypoints, parts, options=QUICK_SEARCH)
    for tensor in result.parameters.tensors().values():
        assert torch.isfinite(tensor).all()
    seen = result.camera.project(torch.from_numpy(result.landmarks(keypoints.format.landmarks))[None])[0, :, :2]
    sure = keypoints.visible
    assert np.linalg.norm(seen.numpy() - keypoints.points, axis=1)[sure].mean() < 8


def test_fit_refuses_keypoints_that_say_nothing():
    keypoints, parts = seen_by(walker())
    with pytest.raises(InputError, match="none is visible"):
        fit_body(replace(keypoints, confidence=keypoints.confidence * 0), parts)
    with pytest.raises(InputError, match="one point"):
        fit_body(replace(keypoints, points=keypoints.points * 0 + 50), parts)


def test_stages_hold_the_networks_depth_as_hard_as_it_is_sure(monkeypatch):
    """Labels and keypoints of one body pull another one that leans from it, in the picture alone if told so."""
    keypoints, parts = seen_by(walker())
    lean = rotation_from_axis_angle(torch.tensor([0.4, 0.0, 0.0]))

    def said(observations, network, **how):
        found = ask_network(observations, network, **how)
        return replace(found, orientation=lean @ found.orientation)

    monkeypatch.setattr(network_start, "ask_network", said)
    options = replace(FitOptions.at("balanced"), search=(), guess_camera=False)
    *before, outline = options.with_outline().stages

    def fitted(*stages):
        return fit_body(keypoints, parts, options=replace(options, stages=stages))

    alone = fitted()
    start, spread = alone.posed.centres[0, :, 2], alone.uncertainty.centre_depths()[0]
    stages = *before, replace(outline, iterations=60, size=96)
    free = (replace(stage, weights=replace(stage.weights, depth=0.0)) for stage in stages)
    held, loose = ((fitted(*each).posed.centres[0, :, 2] - start).abs() / spread for each in (stages, free))
    assert held.max() < 1.5
    assert held.mean() < 0.6 * loose.mean()


@pytest.mark.parametrize("start", ["network", "search"])
def test_a_stage_that_follows_the_outlines_is_added(start):
    usual = replace(FitOptions.at("balanced", start), trust_background=True)
    assert "outline" not in {stage.name for stage in usual.stages + usual.search}
    usually, first = usual.with_outline(), usual.with_outline(labels_first=True)
    for options in (usually, first):
        assert options == replace(usual, stages=options.stages, search=options.search)
        assert (options.stages[:-1], options.search[:-1]) == (usual.stages, usual.search)
        assert (options.stages[-1].name, options.search[-1].name) == ("outline", "outline")
    assert usually.stages[-1] != first.stages[-1]
    assert replace(usual, search=()).with_outline().search == ()


def test_labels_first_fills_the_labels_better():
    keypoints, parts = seen_by(walker())
    options = FitOptions()
    options = replace(options, stages=tuple(replace(s, bodies=min(s.bodies, 4), iterations=20) for s in options.stages))

    def wrong(chosen):
        shown = fit_body(keypoints, parts, options=chosen).draw(parts.groups.shape).labels[0].numpy()
        return (shown != parts.groups).mean()

    last = options.with_outline(labels_first=True).stages[-1]
    quick = replace(options, stages=(*options.stages, replace(last, iterations=60)))
    assert wrong(quick) < wrong(options)
