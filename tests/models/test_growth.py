"""Edits of bodies and growth beyond the model: other parts stay, and nothing jumps."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import helpers.bodies
import pytest
import torch
from helpers.bodies import ellipbodies
from helpers.quick import QUICK_REGISTRATION

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.template import LENGTH_NAMES, NUM_PARTS, THICKNESS_NAMES
from warp_partdr.models.anny import anny, anny_shape
from warp_partdr.models.growth import MEASURES, UNGROWN, Growth
from warp_partdr.models.registration import Registered, RegistrationWeights, _MeasureLoss, register
from warp_partdr.models.surfaces import skin_vertices

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "demos"))

import edit_body

registered = helpers.bodies.registered  # a fixture


@pytest.fixture(scope="module")
def edits() -> tuple[list[BodyParameters], list[Registered]]:
    body = edit_body.mean_body()
    bodies = [edit_body.edited(body, name) for name in edit_body.EDITS]
    return bodies, edit_body.register_all(bodies)


def test_the_mesh_follows_edits_and_other_parts_stay(edits: tuple[list[BodyParameters], list[Registered]]) -> None:
    for followed, others in edit_body.following(*edits):
        assert all(0.8 < share < 1.25 for share in followed.values()), followed
        assert all(share < 0.2 for share in others.values()), others


def test_growth_turns_no_face_over_and_makes_no_steps(
    edits: tuple[list[BodyParameters], list[Registered]],
) -> None:
    first, *others = (result.rest().vertices[0] for result in edits[1])
    corners = edits[1][0].model.faces.long()
    skin = (skin_vertices(edits[1][0].model) > 0)[corners].all(1)

    def normals(vertices: torch.Tensor) -> torch.Tensor:
        edges = vertices[corners[:, 1:]] - vertices[corners[:, :1]]
        return torch.nn.functional.normalize(torch.linalg.cross(edges[:, 0], edges[:, 1]), dim=-1)

    starts, ends = corners.flatten(), corners.roll(-1, 1).flatten()
    for other in others:
        turned = (normals(first) * normals(other)).sum(-1)[skin]
        assert turned.min() > 0
        assert turned.mean() > 0.97
        # An edge is stretched by no more than the edit's factor and what is shared with the neighbours.
        ratios = (other[starts] - other[ends]).norm(dim=-1) / (first[starts] - first[ends]).norm(dim=-1)
        assert 0.55 < ratios.quantile(0.001) < ratios.quantile(0.999) < 1.8


def test_bodies_between_two_others_change_smoothly() -> None:
    body = edit_body.mean_body()
    other = edit_body.edited(body, *list(edit_body.EDITS)[1:4])
    shares = torch.linspace(0, 1, 5).tolist()
    results = edit_body.register_all([edit_body.between(body, other, share) for share in shares])
    vertices = torch.cat([result.detailed.vertices for result in results])
    steps = vertices.diff(dim=0)
    whole = (vertices[-1] - vertices[0]).norm(dim=-1)
    assert whole.max() > 0.08
    assert (steps.norm(dim=-1) < whole / len(steps) + 0.012).all()
    assert steps.diff(dim=0).norm(dim=-1).max() < 0.02


def test_growth_is_seen_on_any_device(registered: Registered, device: str) -> None:
    options = replace(QUICK_REGISTRATION, iterations=10)
    longer = ellipbodies(device, longer={"lower leg": 1.2}, thicker={"head thickness": 1.3})
    edited = register(longer, registered.model, start=registered, options=options)
    names = [list(MEASURES).index(name) for name in ("lower leg", "head thickness")]
    assert (edited.growth[:, names] > torch.tensor([1.1, 1.15], device=device)).all()
    still = [list(MEASURES).index(name) for name in ("upper arm", "hand", "upper arm thickness", *UNGROWN)]
    assert (edited.growth[:, still] / registered.growth[:, still] - 1).abs().max() < 0.04
    alone = register(longer, registered.model, options=options)
    assert torch.equal(alone.growth, torch.ones_like(alone.growth))
    asked = register(longer, registered.model, options=replace(options, growth=True))
    assert (asked.growth[:, names[1]] > 1.15).all()
    assert (asked.unexplained[:, names[1]].abs() < 0.1).all()  # what has grown is explained
    assert (alone.unexplained[:, names[1]] > 0.15).all()


def test_growth_takes_the_residual_that_a_robust_fit_leaves(registered: Registered, device: str) -> None:
    """A measure that is off by r grows by r³ / (r² + d²), where d is the usual difference of people."""
    model, shape = registered.model, registered.shape
    posed = ellipbodies(device, longer={"lower leg": 1.02}, thicker={"head thickness": 1.3, "foot width": 0.8})
    tailor = _MeasureLoss(model, posed, replace(QUICK_REGISTRATION, growth=True), shape, None)
    for _ in range(12):
        tailor.grow(shape)
    body = Growth(model, shape)
    off = body.demanded(posed.semi_axes) - body.measured(shape)
    wanted = off / (1 + (2 * body.spreads / off).square())
    got = body.measured(shape, tailor.stretches) - body.measured(shape)
    for name, low, high in (("lower leg", 0.0, 0.6), ("head thickness", 0.85, 1.0), ("foot width", 0.5, 0.95)):
        index = MEASURES.index(name)
        torch.testing.assert_close(got[:, index], wanted[:, index], rtol=0.02, atol=2e-3)
        shares = (wanted / off)[:, index]
        assert ((low < shares) & (shares < high)).all(), (name, shares)


def test_a_body_is_its_own_edit(registered: Registered, device: str) -> None:
    again = register(ellipbodies(device), registered.model, start=registered, options=QUICK_REGISTRATION)
    assert (again.detailed.vertices - registered.detailed.vertices).norm(dim=-1).mean() < 0.004
    assert (again.growth - 1).abs().max() < 0.02


def test_stretches_of_one_are_none_and_of_all_scale_the_body(device: str) -> None:
    model = anny(torch.device(device))
    shape = anny_shape(torch.tensor([[0.2, 0.9, 0.4, 0.6, 0.5, 0.5]], device=device))
    rest = model.rest(shape)
    whole = torch.eye(3, device=device).expand(1, NUM_PARTS, 3, 3)
    for factor in (1.0, 1.3):
        scaled = model.rest(shape, stretches=factor * whole)
        root = rest.joints[:, :1]
        assert (scaled.vertices - root - factor * (rest.vertices - root)).abs().max() < 1e-5
        assert (scaled.joints - root - factor * (rest.joints - root)).abs().max() < 1e-5
    # The measures of a body follow, to float32's rounding: lengths and thicknesses by the factor.
    body = Growth(model, shape)
    grown = body.stretches(torch.full((1, len(MEASURES)), 1.3, device=device))
    assert (body.measured(shape, grown) - body.measured(shape)).sub(math.log(1.3)).abs().max() < 6e-5


def test_inscribed_bodies_never_thin_the_person(device: str) -> None:
    thin = dict.fromkeys(THICKNESS_NAMES, 0.6)
    options = replace(QUICK_REGISTRATION, iterations=5, growth=True, weights=RegistrationWeights.inscribed())
    within = register(ellipbodies(device, thicker=thin), anny(torch.device(device)), options=options)
    assert (within.growth[:, len(LENGTH_NAMES) :] > 0.99).all()
    options = replace(options, weights=RegistrationWeights())
    fitted = register(ellipbodies(device, thicker=thin), within.model, options=options)
    assert (fitted.growth[:, len(LENGTH_NAMES) :].amin(1) < 0.9).all()
