"""The energy's weights, labels made smaller, and what is not known of maps; terms are the book's."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest
import torch
from helpers.bodies import observation_of, walker

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.inputs.observation import resize_nearest
from warp_partdr.solve.ellipsoids.energy import Energy, Weights


def off(body: BodyParameters) -> BodyParameters:
    """A body beside another one, of other sizes, and bent too far."""
    return replace(
        body,
        shift=body.shift + 0.05,
        lengths=body.lengths + 0.01,
        thicknesses=body.thicknesses + 0.01,
        rotations=body.rotations + 1.5,
    )


def test_smaller_labels_are_those_under_pixel_centres():
    fine = torch.arange(81).reshape(9, 9)
    assert torch.equal(resize_nearest(fine, 3), fine[1::3, 1::3])
    assert torch.equal(resize_nearest(fine, 27), fine.repeat_interleave(3, 0).repeat_interleave(3, 1))
    assert torch.equal(resize_nearest(fine, 9), fine)
    # no side is preferred
    for axis in (0, 1):
        assert torch.equal(resize_nearest(fine.flip(axis), 3), resize_nearest(fine, 3).flip(axis))
        assert torch.equal(resize_nearest(fine.flip(axis), 5), resize_nearest(fine, 5).flip(axis))


def test_landmarks_of_a_part_share_its_vote(device):
    """COCO's nose, eyes and ears are the head's: together they count as much as a knee."""
    seen = observation_of(walker(device))
    weights = dict(zip(seen.landmarks, Energy(seen).landmark_weights[0].tolist(), strict=True))
    face = ["nose", "left_eye", "right_eye", "left_ear", "right_ear"]
    assert [weights[name] for name in face] == pytest.approx([0.2] * 5)
    assert weights["left_knee"] == weights["right_wrist"] == 1
    # those that are hardly seen do not count for more than they are sure
    faint = replace(seen, confidence=0.1 * seen.confidence)
    assert Energy(faint).landmark_weights[0].tolist() == pytest.approx([0.1] * 17)


@pytest.mark.parametrize("name", [field.name for field in fields(Weights)])
def test_each_weight_weighs_its_own_term(device, name):
    body = walker(device)
    depths = body.posed().centres[0, :, 2]
    ones = Weights(**{field.name: 1.0 for field in fields(Weights)})
    seen = replace(observation_of(body), depths=depths)
    energy = Energy(seen, size=64, weights=ones, prior=PosePrior().to(device))
    terms = energy(off(body))
    assert terms.keys() == {field.name for field in fields(Weights)}
    assert all(term.item() > 1e-2 for term in terms.values())
    changed = replace(energy, weights=replace(ones, **{name: 3.0}))(off(body))
    for other, term in terms.items():
        torch.testing.assert_close(changed[other], term * (3.0 if other == name else 1.0))


def test_energy_of_the_truth_is_its_prior_alone(device):
    body = walker(device)
    energy = Energy(observation_of(body), prior=PosePrior().to(device))
    terms = energy(body)
    assert terms["seg"].item() == 0
    assert terms["proj"].item() == pytest.approx(0, abs=1e-2)
    assert terms["length"].item() == pytest.approx(0, abs=1e-6)
    assert terms["limits"].item() < 1e-3


def test_maps_cost_what_labels_do_where_they_are_known(device):
    body = walker(device)
    seen = observation_of(body)
    maps = (seen.labels[None] == torch.arange(1, 21, device=device)[:, None, None]).float()
    known = torch.ones(256, 256, device=device)
    moved = replace(body, shift=body.shift + 0.05).leaves()
    values, gradients = [], []
    for observation in (seen, replace(seen, maps=maps, known=known)):
        term = Energy(observation)(moved)["seg"]
        values.append(term.item())
        gradients.append(torch.autograd.grad(term.sum(), moved.shift)[0])
    assert values[0] == pytest.approx(values[1], rel=1e-4)
    torch.testing.assert_close(gradients[0], gradients[1], rtol=1e-3, atol=1e-2)
    known[:, 128:] = 0.0
    strange = torch.where(known > 0, maps, 0.7)
    costs = [Energy(replace(seen, maps=each, known=known))(moved)["seg"] for each in (maps, strange)]
    assert costs[0].item() > 1
    torch.testing.assert_close(costs[0], costs[1])
    half = Energy(replace(seen, maps=maps, known=0.5 * known))(moved)["seg"]
    torch.testing.assert_close(half, 0.5 * costs[0])
