"""People who lean are turned upright before the network looks, and their bodies are turned back."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from helpers.bodies import seen_by, walker

from warp_partdr.inputs.observation import observe, resize_nearest
from warp_partdr.inputs.observations import Observations
from warp_partdr.networks.regression import predict
from warp_partdr.networks.regression.checkpoint import load_label_network
from warp_partdr.networks.regression.landmarks import LANDMARKS
from warp_partdr.networks.regression.predict import ask_network
from warp_partdr.networks.regression.upright import leans, turn_inputs, turn_predicted

QUARTER = math.pi / 2


def person(**points: tuple[float, float]) -> torch.Tensor:
    """Keypoints as networks see them, (1, 24, 3), of landmarks' places."""
    keypoints = torch.zeros(1, len(LANDMARKS), 3)
    for name, place in points.items():
        keypoints[0, LANDMARKS.index(name)] = torch.tensor([*place, 1.0])
    return keypoints


@pytest.mark.parametrize(
    ("points", "degrees"),
    [
        ({"left_shoulder": (0.1, -0.5), "right_shoulder": (-0.1, -0.5), "left_ankle": (0.0, 0.5)}, 0),
        ({"left_shoulder": (0.5, 0.0), "left_ankle": (-0.5, 0.0)}, 90),
        ({"left_shoulder": (-0.5, 0.0), "right_knee": (0.5, 0.0)}, -90),
        ({"right_shoulder": (0.0, 0.5), "right_hip": (0.001, -0.5), "left_wrist": (0.9, 0.9)}, -179.94),
        ({"left_shoulder": (0.3, -0.5), "left_ankle": (0.0, 0.5), "left_hip": (0.3, 0.5)}, 0),  # 17 degrees
        ({"left_shoulder": (0.7, -0.5), "left_ankle": (0.0, 0.5), "left_hip": (0.7, 0.5)}, 35),
        ({"left_shoulder": (0.5, 0.0)}, 0),
        ({"left_ankle": (0.5, 0.0), "left_wrist": (0.0, 0.5)}, 0),
    ],
)
def test_people_lean_as_the_line_from_feet_to_shoulders_does(points, degrees):
    (angle,) = torch.rad2deg(leans(person(**points))).tolist()
    assert angle == pytest.approx(degrees, abs=0.05)


def test_inputs_turn_together_and_those_of_others_stay():
    shares, keypoints = torch.rand(3, 22, 16, 16), torch.rand(3, len(LANDMARKS), 3)
    conditions = torch.tensor([[1.0, 0.5, 0.25, -0.5, 1.0, 0.3]]).repeat(3, 1)
    turned = turn_inputs(shares, keypoints, conditions, torch.tensor([0.0, QUARTER, math.pi]))
    assert all(torch.equal(new[0], old[0]) for new, old in zip(turned, (shares, keypoints, conditions), strict=True))
    assert torch.equal(turned[0][1], shares[1].rot90(-1, (1, 2)))  # clockwise
    assert torch.equal(turned[0][2], shares[2].rot90(2, (1, 2)))
    x, y = keypoints[1, :, :2].unbind(1)
    assert torch.allclose(turned[1][1, :, :2], torch.stack([-y, x], dim=1), atol=1e-6)
    assert torch.equal(turned[1][..., 2], keypoints[..., 2])
    assert torch.allclose(turned[2][1], torch.tensor([1.0, 0.5, 0.5, 0.25, 1.0, 0.3]), atol=1e-6)
    assert turn_inputs(shares, keypoints, conditions, torch.zeros(3))[0] is shares


def test_a_body_is_the_same_however_its_picture_is_turned(monkeypatch):
    network = load_label_network()
    seen, _ = observe(*seen_by(walker()))
    labels = resize_nearest(seen.labels, network.config.size)
    lens = torch.tensor([3.0, 0.4, -0.1])

    def quarters(count: int):
        turn = torch.tensor([[0.0, -1.0], [1.0, 0.0]]).matrix_power(count)
        centre = (turn @ lens[1:, None])[:, 0]
        return replace(
            seen,
            points=seen.points @ turn.mT,
            labels=labels.rot90(-count, (0, 1)).contiguous(),
            lens=torch.cat([lens[:1], centre]),
        )

    def ask(count: int):
        return turn_predicted(
            ask_network(Observations.of([quarters(count)]), network), torch.tensor([-count * QUARTER])
        )

    upright, *turned = map(ask, range(4))
    for each in turned[1:]:
        assert torch.allclose(each.posed().joints, turned[0].posed().joints, atol=5e-3)
        assert torch.allclose(each.shift, turned[0].shift, atol=5e-3)
    near = (turned[0].posed().joints - upright.posed().joints).norm(dim=-1).mean()
    assert near < 0.03  # this one leans by a few degrees, and was not turned
    monkeypatch.setattr(predict, "leans", lambda keypoints: torch.zeros(len(keypoints)))
    assert (ask(2).posed().joints - upright.posed().joints).norm(dim=-1).mean() > 2 * near
