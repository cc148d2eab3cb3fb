"""Clothes: skin moved outward, the same left and right, nowhere inward, nothing on hands and feet."""

from __future__ import annotations

import torch

from warp_partdr.body.template import PART_NAMES
from warp_partdr.models.anny import anny
from warp_partdr.models.clothes import (
    CLOTHED,
    THICKEST,
    _hair,
    bounded,
    clothes_basis,
    clothes_costs,
    clothes_offsets,
)
from warp_partdr.models.registration import ungrown
from warp_partdr.models.surfaces import vertex_parts


def moved(kind: str, thickness: float, device: str) -> torch.Tensor:
    """Distances that Anny's vertices move, shape (V,) [m]."""
    thick = torch.tensor([[thickness * (name == kind) for name in CLOTHED]], device=device)
    return clothes_offsets(clothes_basis(anny(torch.device(device))), thick)[0].norm(dim=-1)


def test_each_kind_of_part_has_its_own_on_both_sides(device: str) -> None:
    part, _ = vertex_parts(anny(torch.device(device)))
    far = moved("upper_leg", 0.03, device)
    means = {name: float(far[part == place].mean()) for place, name in enumerate(PART_NAMES)}
    assert means["left_upper_leg"] > 0.02
    assert abs(means["left_upper_leg"] - means["right_upper_leg"]) < 5e-4
    assert max(means[name] for name in ("left_hand", "right_foot", "head", "left_forearm")) < 1e-4


def test_hands_and_feet_are_bare(device: str) -> None:
    part, _ = vertex_parts(anny(torch.device(device)))
    everywhere = clothes_offsets(
        clothes_basis(anny(torch.device(device))), torch.full((1, len(CLOTHED)), 0.03, device=device)
    )[0].norm(dim=-1)
    assert everywhere.max() < 0.03 + 1e-5
    for name in ("left_hand", "right_hand", "left_foot", "right_foot"):
        assert everywhere[part == PART_NAMES.index(name)].mean() < 0.006  # but for the borders


def test_clothes_are_never_inward_nor_thicker_than_coats(device: str) -> None:
    thick = torch.tensor([-0.1, 0.02, 1.0], device=device)
    assert bounded(thick).tolist() == [0.0, thick[1].item(), torch.tensor(THICKEST).item()]


def test_every_bit_of_thickness_costs_as_much(device: str) -> None:
    """The first bit does, too, where a square would cost nothing: bare skin stays bare."""
    thick = torch.tensor([-0.01, 0.0, 0.01, 0.02, 0.04], device=device, requires_grad=True)
    costs = clothes_costs(thick)
    torch.testing.assert_close(costs.cpu().detach(), torch.tensor([1.0, 0.0, 1.0, 2.0, 4.0]))
    (slopes,) = torch.autograd.grad(costs.sum(), thick)
    assert slopes[2:].unique().tolist() == [100.0]
    assert slopes[0] == -100.0  # back to where a thickness begins


def test_the_body_beneath_stays(device: str) -> None:
    model = anny(torch.device(device))
    shape = torch.zeros(1, model.num_shapes, device=device)
    eye = torch.eye(3, device=device).expand(1, model.num_joints, 3, 3)
    body = ungrown(model, shape, eye, torch.zeros(1, 3, device=device), {})
    clothed = body.clothed(torch.full((1, len(CLOTHED)), 0.02, device=device))
    assert (clothed.joints - body.detailed.joints).abs().max() < 1e-6
    middle = body.detailed.vertices.mean(1, keepdim=True)
    assert (clothed.vertices - middle).norm(dim=-1).mean() > (body.detailed.vertices - middle).norm(dim=-1).mean()


def test_hair_grows_behind_the_face_and_away_from_the_head(device: str) -> None:
    model = anny(torch.device(device))
    part, _ = vertex_parts(model)
    head = part == PART_NAMES.index("head")
    far, at = moved("head", 0.03, device)[head], model.rest_vertices[head]
    assert far[at[:, 2].argmax()] < 1e-6  # the nose
    for outermost in (at[:, 1].argmax(), at[:, 2].argmin()):  # the crown and the back of the head
        assert far[outermost] > 0.025
    middle = (at.amin(0) + at.amax(0)) / 2
    moves = clothes_basis(model)[CLOTHED.index("head"), head]
    assert ((moves * (at - middle)).sum(1) >= -1e-6).all()


def test_hair_is_half_as_thick_at_the_hairline() -> None:
    """It grows over 4 cm, in whose middle as much is above the head's middle as before it."""
    corners = torch.tensor([[-0.1, -0.1, -0.1], [0.1, 0.1, 0.1]])  # the head's
    behind = torch.tensor([-0.05, -0.02, -0.01, 0.0, 0.01, 0.02, 0.05])
    places = torch.stack([torch.full_like(behind, 0.03), behind, torch.zeros_like(behind)], dim=1)
    leaning = torch.stack([torch.full_like(behind, 0.03), 0.04 + behind, torch.full_like(behind, 0.04)], dim=1)
    for rows in (places, leaning):
        vertices = torch.cat([corners, rows])
        moves = _hair(vertices + 1.5, torch.arange(len(vertices)) < 2)[2:]
        torch.testing.assert_close(moves.norm(dim=1), torch.tensor([0.0, 0.0, 0.25, 0.5, 0.75, 1.0, 1.0]))
        away = torch.nn.functional.normalize(rows[2:], dim=1)  # from the head's middle
        torch.testing.assert_close(torch.nn.functional.normalize(moves[2:], dim=1), away)
