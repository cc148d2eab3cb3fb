"""Qualities and starts of a fit: the label network's body, or a search, and when the one gives way to the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.bodies import seen_by, walker
from helpers.quick import QUICK_SEARCH

from warp_partdr.inputs.observation import observe
from warp_partdr.networks.regression.checkpoint import packaged_network, save_label_network
from warp_partdr.networks.regression.label_network import LabelNetwork, LabelNetworkConfig
from warp_partdr.networks.regression.predict import predict_bodies
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.ellipsoids.options import FitOptions, stages_of
from warp_partdr.solve.ellipsoids.stages import STAGES, Stage


@pytest.fixture
def astray(tmp_path):
    """A network that has learned nothing."""
    torch.manual_seed(0)
    config = LabelNetworkConfig()
    network = LabelNetwork(config)
    for head in network.regressor.heads.values():
        torch.nn.init.normal_(head.weight, std=0.3)
    path = tmp_path / "astray.safetensors"
    save_label_network(path, network.state_dict(), config, {})
    return str(path)


def test_a_fit_starts_from_the_network(device):
    """It finds somebody it never saw; without stages, its body stays as it is."""
    body = walker(device)
    keypoints, parts = seen_by(body)
    found = fit_body(keypoints, parts, options=FitOptions(stages=(), search=()), device=device)
    seen, _ = observe(keypoints, parts, device=device)
    seen = replace(seen, lens=found.observation.lens)  # the walker is drawn without perspective, so the lens is long
    said = predict_bodies([seen], packaged_network(str(seen.points.device)))
    assert torch.equal(found.parameters.rotations, said.rotations)
    assert (found.energy, found.history) == ({}, [])
    joints = found.posed.joints - found.posed.joints[:, :1]
    assert float((joints - body.posed().joints).norm(dim=-1).mean()) < 0.12  # [m]
    refined = fit_body(keypoints, parts, quality="fast", device=device)
    assert (refined.start, refined.hypotheses) == ("network", 1)
    assert list(refined.stage_seconds) == ["network", "depth order", "labels"]
    size = parts.groups.shape
    wrong = [float((each.draw(size).labels[0].cpu().numpy() != parts.groups).sum()) for each in (found, refined)]
    assert wrong[1] < 0.8 * wrong[0]


def test_a_search_takes_over_from_a_network_gone_astray(device, astray):
    keypoints, parts = seen_by(walker(device))
    lost = FitOptions(stages=(), search=(), network=astray)
    options = replace(lost, search=QUICK_SEARCH.stages)
    found, again = (fit_body(keypoints, parts, options=each, device=device) for each in (lost, options))
    assert found.start == "network"
    assert again.start == "search"
    assert again.hypotheses > 2
    searched = {f"{stage.name}, search" for stage in QUICK_SEARCH.stages}
    assert {"network, network"} | searched == set(again.stage_seconds)
    alone = fit_body(keypoints, parts, options=FitOptions(stages=QUICK_SEARCH.stages, start="search"), device=device)
    assert torch.equal(again.parameters.rotations, alone.parameters.rotations)


def test_the_better_of_both_wins(device, monkeypatch):
    """The network's body stays if a search finds nothing better."""
    monkeypatch.setattr("warp_partdr.solve.ellipsoids.plausibility.MOST_OFF", 0.0)
    keypoints, parts = seen_by(walker(device))
    options = replace(FitOptions.at("fast"), search=(Stage("lift", 1, 1, 0.01), Stage("labels", 1, 1, 0.01, 32)))
    result = fit_body(keypoints, parts, options=options, device=device)
    assert result.start == "network"
    assert result.hypotheses == 2


def test_the_quality_chooses_the_stages_and_options_override_it(device):
    keypoints, _ = seen_by(walker(device))
    assert FitOptions() == FitOptions.at("balanced")
    searched = FitOptions.at("fast", "search")
    own = FitOptions(stages=(Stage("lift", 4, 2, 0.1),))
    for given, expected in (
        ({}, [replace(stage, size=0) for stage in STAGES["network"]["balanced"]]),
        ({"options": FitOptions().with_outline()}, [replace(stage, size=0) for stage in STAGES["network"]["balanced"]]),
        ({"quality": "fast"}, [replace(stage, size=0) for stage in STAGES["network"]["fast"]]),
        ({"options": searched}, [stage for stage in STAGES["search"]["fast"] if stage.size == 0]),
        ({"quality": "fast", "options": own}, own.stages),
    ):
        result = fit_body(keypoints, device=device, **given)
        assert result.stages == tuple(expected)
        assert result.start == ("search" if given.get("options") is searched else "network")


@pytest.mark.parametrize("start", STAGES)
def test_qualities_are_in_order_of_work(start):
    """Pixels drawn: bodies times iterations times the area of the picture."""
    work = {
        quality: sum(stage.bodies * stage.iterations * stage.size**2 for stage in stages)
        for quality, stages in STAGES[start].items()
    }
    assert work["fast"] < work["balanced"] <= work["accurate"]
    meshes = [FitOptions.at(quality, start).mesh for quality in STAGES[start]]
    drawn = [mesh.iterations * mesh.size**2 for mesh in meshes]
    assert drawn[0] == drawn[1] < drawn[2]


def test_starts_are_checked():
    keypoints, _ = seen_by(walker())
    for call, message in (
        (lambda: FitOptions(start="guess"), "start: 'guess'; expected network, search"),
        (lambda: FitOptions.at("fast", "guess"), "start: 'guess'"),
        (lambda: fit_body(keypoints, quality="best"), "quality: 'best'; expected fast, balanced, accurate"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
    drawn = replace(FitOptions.at("fast", "search"), stages=STAGES["search"]["fast"][2:])
    with pytest.raises(ValueError, match="none without labels"):
        stages_of(drawn, None)
    assert np.isfinite(fit_body(keypoints, options=replace(drawn, start="network")).posed.joints.numpy()).all()
