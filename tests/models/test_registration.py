"""Registration of detailed bodies to EllipBody."""

from __future__ import annotations

from dataclasses import replace

import helpers.bodies
import numpy as np
import pytest
import torch
from helpers.bodies import ellipbodies
from helpers.quick import QUICK_REGISTRATION

from warp_partdr.body.posing import Posed
from warp_partdr.body.template import BONE_STARTS, JOINT_NAMES, NUM_PARTS
from warp_partdr.models.anny import anny, anny_shape
from warp_partdr.models.pose import pose_from_ellipbody
from warp_partdr.models.registration import (
    MATCHED_JOINTS,
    SCALE,
    Registered,
    RegistrationOptions,
    RegistrationWeights,
    _Loss,
    register,
    shape_from_lengths,
)
from warp_partdr.models.surfaces import BAND, registration_costs, skin_vertices, surface_samples, vertex_parts

registered = helpers.bodies.registered  # a fixture


def test_the_mean_body_is_anny_s_default_adult(registered: Registered, device: str) -> None:
    # mean_body.json was measured on it.
    model, posed = registered.model, ellipbodies(device)
    joints = model.landmarks(registered.detailed, MATCHED_JOINTS)
    wanted = posed.joints[:, [JOINT_NAMES.index(name) for name in MATCHED_JOINTS]]
    assert (joints - wanted).norm(dim=-1).mean() < 0.01
    # To what the silhouettes of the two say about thicknesses.
    adult = model.rest(anny_shape(torch.full((2, 6), 0.5, device=device))).vertices
    found = model.rest(registered.shape).vertices
    assert (adult - adult.mean(1, keepdim=True) - found + found.mean(1, keepdim=True)).norm(dim=-1).mean() < 0.015


def test_the_result_poses_the_model(registered: Registered) -> None:
    again = registered.model.pose(
        registered.shape, registered.rotations, registered.translation, stretches=registered.stretches
    )
    assert torch.equal(again.vertices, registered.detailed.vertices)
    identity = registered.rotations @ registered.rotations.mT
    assert (identity - torch.eye(3, device=identity.device)).abs().max() < 1e-5
    assert all(term.shape == (2,) and term.isfinite().all() for term in registered.losses.values())


def test_refinement_lowers_the_loss(registered: Registered, device: str) -> None:
    start = register(ellipbodies(device), registered.model, options=RegistrationOptions(iterations=0))
    before, after = (torch.stack(list(result.losses.values())).sum(0) for result in (start, registered))
    assert (after < 0.7 * before).all()


def test_bodies_of_a_batch_do_not_touch_each_other(registered: Registered, device: str) -> None:
    posed = ellipbodies(device)
    alone = register(
        Posed(*(tensor[1:] for tensor in vars(posed).values())), registered.model, options=QUICK_REGISTRATION
    )
    assert (alone.detailed.vertices[0] - registered.detailed.vertices[1]).norm(dim=-1).max() < 2e-3


def test_shape_from_lengths_is_exact_for_bodies_of_the_model(device: str) -> None:
    model = anny(torch.device(device))
    shape = anny_shape(torch.tensor([[0.2, 0.9, 0.4, 0.6, 0.5, 0.5]], device=device))

    def bones(shape: torch.Tensor) -> torch.Tensor:
        joints = model.landmarks(model.rest(shape), JOINT_NAMES)
        return (joints[:, 1:] - joints[:, BONE_STARTS]).norm(dim=-1)

    posed = ellipbodies(device, 1)
    semi_axes = posed.semi_axes.clone()
    semi_axes[..., 0] = bones(shape) / 2
    found = shape_from_lengths(model, replace(posed, semi_axes=semi_axes))
    assert (bones(found) - bones(shape)).abs().max() < 0.005


def test_vertex_costs_and_gradients_agree_with_torch(device: str) -> None:
    posed = ellipbodies(device, 2)
    vertices = (posed.centres[:, torch.arange(60) % 20] + 0.06 * torch.randn(2, 60, 3).to(device)).requires_grad_()
    parts = (torch.arange(60, device=device) % 20).int()
    areas = torch.rand(60).to(device)
    fit, inside = registration_costs(vertices, parts, areas, posed, 0.03)

    local = (vertices[:, :, None] - posed.centres[:, None])[..., None, :] @ posed.axes[:, None]
    unit = local[..., 0, :] / posed.semi_axes[:, None]
    e = unit.norm(dim=-1)
    expected_inside = (areas * (1 - e).clamp(min=0).square().sum(-1)).sum(-1)
    own = torch.arange(60), parts.long()
    unit, e = unit[:, *own], e[:, *own]
    steep = (unit / posed.semi_axes[:, parts.long()] / e[..., None]).norm(dim=-1)
    squares = ((e - 1) / steep).square() * (unit[..., 0].detach().abs() < 0.7)
    expected_fit = (areas * squares / (1 + squares / 0.03**2)).sum(-1)
    assert torch.allclose(fit, expected_fit, rtol=1e-4)
    assert torch.allclose(inside, expected_inside, rtol=1e-4)
    for value, expected in ((fit, expected_fit), (inside, expected_inside)):
        factors = torch.tensor([1.0, 3.0], device=device)
        got, wanted = (
            torch.autograd.grad((factors * term).sum(), vertices, retain_graph=True)[0] for term in (value, expected)
        )
        assert torch.allclose(got, wanted, rtol=1e-3, atol=1e-4 * float(wanted.abs().max()))


def far_apart(device: str) -> Posed:
    """Spheroids of many sizes, 10 m from each other."""
    numbers = torch.arange(NUM_PARTS, device=device, dtype=torch.float32)
    centres = torch.stack([10 * numbers, 0 * numbers, 0 * numbers], dim=1)
    semi_axes = torch.stack([0.1 + 0.02 * numbers, 0.3 - 0.01 * numbers, 0.3 - 0.01 * numbers], dim=1)
    axes = torch.eye(3, device=device).expand(1, NUM_PARTS, 3, 3)
    joints = torch.zeros(1, len(JOINT_NAMES), 3, device=device)
    return Posed(joints, axes, centres[None], axes, semi_axes[None])


def test_samples_share_the_area(device: str) -> None:
    posed = far_apart(device)
    weights = surface_samples(posed)[1][0].cpu().double().numpy().reshape(NUM_PARTS, -1)
    assert weights.sum() == pytest.approx(1)
    assert (weights > 0).all()
    # The zone |x| < BAND a of a spheroid: 2 pi b times the integral of sqrt(a² (1 - u²) + b² u²).
    u = np.linspace(-BAND, BAND, 1001)
    a, b = posed.semi_axes[0, :, :2].cpu().double().numpy().T[..., None]
    zones = (b * np.sqrt(a**2 * (1 - u**2) + b**2 * u**2)).mean(1)
    np.testing.assert_allclose(weights.sum(1), zones / zones.sum(), rtol=0.02)


def terms_of(device: str, weights: RegistrationWeights) -> dict[str, torch.Tensor]:
    """The bodies are 4 cm beside their EllipBodies, have some shape, and are turned a little."""
    model, posed = anny(torch.device(device)), ellipbodies(device)
    generator = torch.Generator().manual_seed(1)
    shape = 0.1 * torch.randn(2, model.num_shapes, generator=generator).to(device)
    turns = 0.1 * torch.randn(2, 5, 3, generator=generator).to(device)
    pose_, translation = pose_from_ellipbody(model, posed, shape)
    detailed = model.pose(shape, pose_, translation + 0.04)
    loss = _Loss(model, posed, weights)
    loss.search(detailed.vertices)
    return loss(detailed, shape, turns)


@pytest.mark.parametrize("name", ["joints", "icp", "penetration", "shape", "pose"])
def test_weights_weigh_their_own_terms(name: str, device: str) -> None:
    even = RegistrationWeights(joints=1.0, icp=1.0, penetration=1.0, shape=1.0, pose=1.0)
    terms = terms_of(device, even)
    changed = terms_of(device, replace(even, **{name: 3.0}))
    for other, term in terms.items():
        assert (term.abs() > 0).any()
        torch.testing.assert_close(changed[other], term * (3.0 if other.split("_")[0] == name else 1.0))


def test_what_is_in_the_mouth_is_no_skin(device: str) -> None:
    skin = skin_vertices(anny(torch.device(device)))
    assert 0.85 < skin.mean() < 0.95
    hands = vertex_parts(anny(torch.device(device)))[0] >= 18
    assert skin[hands].mean() == 1


def test_an_empty_batch_is_registered(device: str) -> None:
    posed = Posed(*(tensor[:0] for tensor in vars(ellipbodies(device)).values()))
    result = register(posed, anny(torch.device(device)), options=QUICK_REGISTRATION)
    assert result.detailed.vertices.shape == (0, 13718, 3)


def test_bad_bodies_are_refused(device: str) -> None:
    model = anny(torch.device(device))
    posed = ellipbodies(device)
    broken = posed.joints.clone()
    broken[0, 3, 1] = float("nan")
    with pytest.raises(ValueError, match="joints: holds NaN"):
        register(replace(posed, joints=broken), model)
    with pytest.raises(ValueError, match=r"joints: torch\.float64; expected torch\.float32"):
        register(Posed(*(tensor.double() for tensor in vars(posed).values())), model)


def test_far_samples_count_less_and_less(registered: Registered, device: str) -> None:
    """The weight is Geman and McClure's, the square of 1 / (1 + d² / scale²)."""
    loss = _Loss(registered.model, ellipbodies(device), RegistrationWeights())
    loss.search(registered.detailed.vertices)
    batch = torch.arange(2, device=loss.corners.device)[:, None, None]
    nearest = (registered.detailed.vertices[batch, loss.corners] * loss.places[..., None]).sum(-2)
    squares = (nearest - loss.samples).square().sum(-1)
    wanted = loss.sample_weights / (1 + squares / SCALE**2) ** 2
    found = loss.icp_weights > 0
    assert found.float().mean() > 0.5
    torch.testing.assert_close(loss.icp_weights[found], wanted[found], rtol=1e-3, atol=1e-7)
    assert float((squares[found] / SCALE**2).max()) > 0.1


def test_the_term_of_joints_is_their_mean_square_in_centimetres(registered: Registered, device: str) -> None:
    joints = registered.model.landmarks(registered.detailed, MATCHED_JOINTS)
    wanted = ellipbodies(device).joints[:, [JOINT_NAMES.index(name) for name in MATCHED_JOINTS]]
    squares = (100 * (joints - wanted)).square().sum(-1)
    term = RegistrationWeights().joints * squares.mean(-1)
    torch.testing.assert_close(registered.losses["joints"], term, rtol=1e-3, atol=1e-3)
