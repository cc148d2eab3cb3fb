"""Capsules: depths and gradients against the formula book, and where a body's are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.template import PART_NAMES
from warp_partdr.models.anny import anny
from warp_partdr.models.capsules import FLESH, Capsules, find_overlap, measure_capsules
from warp_partdr.models.model import Detailed, DetailedModel
from warp_partdr.models.surfaces import vertex_parts
from warp_partdr.reference import capsules as book

PEOPLE = 2  # that meet


@pytest.fixture(scope="module")
def crowd() -> tuple[torch.Tensor, torch.Tensor]:
    """Capsules of six bodies at three places, shape (6, 5, 7), many of which touch, and depths that are allowed."""
    random = torch.Generator().manual_seed(0)
    ends, radii = 0.12 * torch.randn(6, 5, 6, generator=random), 0.03 + 0.05 * torch.rand(6, 5, 1, generator=random)
    allowed = 0.04 * torch.rand(5, 5, generator=random)
    return torch.cat([ends, radii], dim=2), (allowed + allowed.mT).fill_diagonal_(torch.inf)


def reference(placed: torch.Tensor, allowed: torch.Tensor, people: int = PEOPLE) -> np.ndarray:
    """Costs of all bodies, shape (B,)."""
    places = np.arange(len(placed)) % (len(placed) // people)
    return book.body_overlap_costs(placed.double().numpy(), allowed.double().numpy(), FLESH, places)


def test_depths_are_the_books(crowd, device):
    placed, allowed = crowd
    costs = find_overlap(placed.to(device), allowed.to(device), PEOPLE).cpu()
    alone = find_overlap(placed.to(device), allowed.to(device)).cpu()
    np.testing.assert_allclose(costs, reference(placed, allowed), rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(alone, reference(placed, allowed, people=1), rtol=1e-4, atol=1e-3)
    assert (alone < costs).any()


@pytest.mark.parametrize("people", [2, 3])
@pytest.mark.parametrize("weights", ["one", "random", "of one body", "of its neighbour"])
def test_gradients_are_the_books(crowd, device, weights, people):
    """Gradients of ends and radii equal finite differences in float64, whatever each body's cost weighs."""
    placed, allowed = crowd
    of_bodies = {
        "one": torch.ones(6),
        "random": torch.randn(6, generator=torch.Generator().manual_seed(3)),
        "of one body": torch.eye(6)[0],
        "of its neighbour": torch.eye(6)[6 // people],
    }[weights]
    moving = placed.clone().to(device).requires_grad_()
    (find_overlap(moving, allowed.to(device), people) @ of_bodies.to(device)).backward()
    found, step = moving.grad.cpu(), 1e-6
    expected = torch.zeros_like(placed, dtype=torch.float64)
    for body, capsule, number in [(b, c, n) for b in (0, 4) for c in range(5) for n in range(7)]:
        ends = []
        for sign in (1, -1):
            moved = placed.double().clone()
            moved[body, capsule, number] += sign * step
            ends.append(reference(moved, allowed, people) @ of_bodies.double().numpy())
        expected[body, capsule, number] = (ends[0] - ends[1]) / (2 * step)
    scale = float(expected.abs().max())
    for body in (0, 4):
        torch.testing.assert_close(found[body].double(), expected[body], rtol=1e-3, atol=1e-4 * scale)
    if weights != "of one body":
        assert expected[0].abs().max() > 0


def test_people_at_other_places_and_people_apart_cost_nothing(crowd, device):
    placed, allowed = crowd
    none = torch.full_like(allowed, torch.inf)
    away = placed.clone()
    away[3:, :, [0, 3]] += 2.0
    moving = away.to(device).detach().requires_grad_()
    costs = find_overlap(moving, none.to(device), PEOPLE)
    costs.sum().backward()
    assert (costs == 0).all()
    assert (moving.grad == 0).all()
    assert (find_overlap(placed.to(device), none.to(device)) == 0).all()


def test_costs_and_gradients_repeat_to_the_bit(crowd, device):
    placed, allowed = crowd
    moving = placed.clone().to(device).requires_grad_()
    found = []
    for _ in range(2):
        cost = find_overlap(moving, allowed.to(device), PEOPLE)
        found.append((cost, *torch.autograd.grad(cost.sum(), moving)))
    assert all(torch.equal(one, other) for one, other in zip(*found, strict=True))


def two(*capsules: list[float]) -> torch.Tensor:
    return torch.tensor([capsules], dtype=torch.float32)


@pytest.mark.parametrize(
    "beside",
    [
        [0.0, -0.1, 0.01, 0.0, 0.1, 0.01],  # across
        [0.0, -0.1, 0.0, 0.0, 0.1, 0.0],  # across, through the middle
        [-0.1, 0.01, 0.01, 0.1, 0.01, 0.01],  # along
        [0.0, 0.01, 0.02, 0.0, 0.01, 0.02],  # a ball
    ],
)
def test_capsules_that_cross_are_pushed_apart_no_farther_than_needed(beside, device):
    capsules = two([-0.1, 0.0, 0.0, 0.1, 0.0, 0.0, 0.05], [*beside, 0.04]).to(device)
    allowed = torch.full((2, 2), 0.01, device=device).fill_diagonal_(torch.inf)
    moves = torch.zeros(2, 3, device=device, requires_grad=True)
    descent = torch.optim.SGD([moves], lr=1e-5)
    for _ in range(100):
        descent.zero_grad()
        moved = torch.cat([capsules[0, :, :6] + moves.repeat(1, 2), capsules[0, :, 6:]], dim=1)
        cost = find_overlap(moved[None], allowed)
        cost.sum().backward()
        descent.step()
    depth = book.penetration(*moved.detach().cpu().double().numpy())
    assert depth < 0.012
    assert depth > 0.005  # no farther than needed


def test_capsules_side_by_side_are_not_turned(device):
    """Each is pushed in the middle of where both lie beside each other."""
    capsules = two([-0.1, 0.0, 0.0, 0.1, 0.0, 0.0, 0.05], [0.1, 0.05, 0.0, -0.1, 0.05, 0.0, 0.05]).to(device)
    moving = capsules.requires_grad_()
    find_overlap(moving, torch.full((2, 2), 0.01, device=device).fill_diagonal_(torch.inf)).sum().backward()
    slope = moving.grad[0].cpu()
    assert slope[0, 1] > 0
    assert slope[1, 1] < 0
    for row in slope:
        torch.testing.assert_close(row[:3], row[3:6])


def posed_capsules(
    model: DetailedModel, turns: dict[str, list[float]], shape: torch.Tensor | None = None
) -> tuple[Capsules, torch.Tensor]:
    rotations = torch.eye(3).repeat(1, model.num_joints, 1, 1)
    for part, turn in turns.items():
        joint = model.part_joints[PART_NAMES.index(part)]
        rotations[0, joint] = rotation_from_axis_angle(torch.tensor([turn]))[0]
    shape = torch.zeros(1, model.num_shapes) if shape is None else shape
    capsules = measure_capsules(model)
    return capsules, capsules.of(model.pose(shape, rotations, torch.zeros(1, 3)), shape)


def test_joints_carry_capsules(device):
    """Kernels are compared with torch in float64, written out."""
    model = anny().to(device)
    capsules, random = measure_capsules(model), torch.Generator().manual_seed(6)
    shape, by = torch.randn(3, model.num_shapes, generator=random).to(device), torch.randn(3, 3, generator=random)
    frames = torch.randn(3, model.num_joints, 4, 4, generator=random)
    fast = [each.to(device).requires_grad_() for each in (shape, frames, by)]
    slow = [each.detach().cpu().double().requires_grad_() for each in fast]
    ends, moves, radii, changes = (
        each.cpu().double()
        for each in (capsules.ends, capsules.end_directions, capsules.radii, capsules.radius_directions)
    )
    own = slow[1][:, capsules.joints.cpu()]
    rest = ends + torch.einsum("bs,scex->bcex", slow[0], moves)
    placed = torch.einsum("bcij,bcej->bcei", own[..., :3, :3], rest) + own[..., None, :3, 3] + slow[2][:, None, None]
    wanted = torch.cat([placed.flatten(2), (radii + slow[0] @ changes)[..., None]], dim=2)
    body = Detailed(fast[2], fast[2], fast[1])
    pull = torch.randn(wanted.shape, dtype=torch.float64, generator=random)
    slopes = torch.autograd.grad((wanted * pull).sum(), slow)
    for _ in range(3):  # captured from the second time on
        found = capsules.of(body, fast[0], by=fast[2])
        torch.testing.assert_close(found.cpu().double(), wanted, atol=1e-5, rtol=1e-4)
        for one, other in zip(torch.autograd.grad((found * pull.to(found)).sum(), fast), slopes, strict=True):
            torch.testing.assert_close(one.cpu().double(), other, atol=1e-4, rtol=1e-3)


def test_neighbours_cost_nothing_at_rest_whatever_the_shape():
    model = anny()
    for sign in (-1, 1):
        for shape in sign * torch.eye(model.num_shapes)[:, None]:
            capsules, placed = posed_capsules(model, {}, shape)
            assert capsules.overlap(placed).item() < 1
    capsules, placed = posed_capsules(model, {})
    assert capsules.overlap(placed).item() == 0


def test_bent_limbs_cost_nothing():
    """Knees and elbows: their two parts are neighbours."""
    bent = {"left_lower_leg": [2.9, 0.0, 0.0], "right_forearm": [-2.0, 0.0, 0.0]}
    capsules, placed = posed_capsules(anny(), bent)
    assert capsules.overlap(placed).item() == 0


def test_legs_through_each_other_cost():
    turned = {"left_upper_leg": [0.0, 0.0, -0.4], "right_upper_leg": [0.0, 0.0, 0.4]}
    capsules, placed = posed_capsules(anny(), turned)
    assert capsules.overlap(placed).item() > 10


def test_capsules_lie_within_the_skin():
    """The skin about each line is about as far as its radius says, whatever the shape."""
    model = anny()
    capsules, (part_of, areas) = measure_capsules(model), vertex_parts(model)
    for shape in (torch.zeros(1, model.num_shapes), torch.eye(model.num_shapes)[:1]):
        body = model.rest(shape)
        placed = capsules.of(body, shape)[0]
        for part, (first, second, radius) in zip(
            capsules.parts, ((row[:3], row[3:6], row[6]) for row in placed), strict=True
        ):
            skin, along = body.vertices[0, (part_of == part) & (areas > 0)], second - first
            share = ((skin - first) @ along / along.square().sum()).clamp(0, 1)
            off = (skin - first - share[:, None] * along).norm(dim=1)
            near, middle = off.quantile(0.2), off.median()  # toes and fingers have skin between them
            assert 0.5 * radius < near < 1.1 * radius, PART_NAMES[part]
            assert 0.8 * radius < middle < 3.5 * radius, PART_NAMES[part]
    assert {PART_NAMES[part] for part in capsules.parts} == set(PART_NAMES) - {"right_hip"}


def test_capsules_of_a_stout_body_are_as_thick_as_measured_on_it():
    """Capsules that follow the shape are compared with those that are measured anew on that body."""
    model = anny()
    shape = torch.zeros(1, model.num_shapes)
    shape[0, 0] = 1.0
    capsules = measure_capsules(model)
    stout = replace(model, rest_vertices=model.rest(shape).vertices[0], rest_joints=model.rest(shape).joints[0])
    expected = measure_capsules(stout)
    found = capsules.of(model.rest(shape), shape)
    torch.testing.assert_close(found[0, :, 6], expected.radii, rtol=0.1, atol=2e-3)
    middle = expected.of(stout.rest(0 * shape), 0 * shape).unflatten(2, (-1, 1))[0, :, :6].view(-1, 2, 3).mean(1)
    torch.testing.assert_close(found[0, :, :6].view(-1, 2, 3).mean(1), middle, rtol=0, atol=0.01)


def test_left_capsules_mirror_right_ones():
    capsules, placed = posed_capsules(anny(), {})
    by_name = {}
    for part, row in zip(capsules.parts, placed[0], strict=True):
        by_name.setdefault(PART_NAMES[part], []).append(row)
    for kind in ("upper_leg", "forearm", "hand"):
        left, right = (sum(row[6] for row in by_name[f"{side}_{kind}"]) for side in ("left", "right"))
        assert float(left) == pytest.approx(float(right), rel=0.03)


@pytest.mark.parametrize("number", [0, 4, 6])
def test_capsules_that_are_nan_have_nan_costs(crowd, device, number):
    """Bodies that share their place with such a body have NaN, too, and no other body has."""
    placed, allowed = crowd
    moving = placed.clone()
    moving[1, 2, number] = torch.nan
    moving = moving.to(device).requires_grad_()
    costs = find_overlap(moving, allowed.to(device), PEOPLE)
    costs.sum().backward()
    assert costs.isnan().tolist() == [False, True, False, False, True, False]
    assert moving.grad[1, 2].isnan().any()
    assert not moving.grad[[0, 2, 3, 5]].isnan().any()


def test_allowed_depths_are_symmetric():
    """Neighbours, such as a thigh and a shin, may overlap, whichever of them asks; a thigh and the other one not."""
    capsules = measure_capsules(anny())
    assert torch.equal(capsules.allowed, capsules.allowed.mT)
    thigh, shin, other = (
        capsules.parts.index(PART_NAMES.index(name)) for name in ("left_upper_leg", "left_lower_leg", "right_lower_leg")
    )
    assert capsules.allowed[thigh, shin] == capsules.allowed[shin, thigh] == torch.inf
    assert capsules.allowed[thigh, other] == pytest.approx(FLESH)


def test_halves_of_a_limb_go_on_into_each_other():
    """Each half of a limb ends half of its radius before its skin does, a whole part its radius."""
    capsules = measure_capsules(anny())
    first, second = (k for k, part in enumerate(capsules.parts) if PART_NAMES[part] == "left_lower_leg")
    gap = (capsules.ends[second, 0] - capsules.ends[first, 1]).norm()
    share = float(gap / (capsules.radii[first] + capsules.radii[second]))
    assert 0.4 < share < 0.95


@pytest.mark.parametrize(
    ("change", "people", "says"),
    [
        (lambda placed: placed, 0, "people: 0; expected an integer of 1 or more"),
        (lambda placed: placed, 4, "people: 4; expected a divisor of the 6 bodies"),
        (lambda placed: placed, 12, "people: 12; expected a divisor"),
        (lambda placed: placed[..., :6], 2, r"placed: shape \(6, 5, 6\); expected \(\*, 5, 7\)"),
        (lambda placed: placed[:, :4], 2, r"placed: shape \(6, 4, 7\)"),
        (lambda placed: placed.double(), 2, "placed: torch.float64; expected torch.float32"),
    ],
)
def test_arrays_that_are_no_capsules_are_refused(crowd, change, people, says):
    placed, allowed = crowd
    with pytest.raises(ValueError, match=says):
        find_overlap(change(placed), allowed, people)
    assert find_overlap(placed[:0], allowed, 2).shape == (0,)
