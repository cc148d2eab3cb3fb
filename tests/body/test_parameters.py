"""Leaves for an optimiser: of sizes as they are, or as logarithms, which no step makes negative."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from warp_partdr.body.parameters import ROW, BodyParameters
from warp_partdr.render.renderers import RendererEllipsoids

THIN = 0.02  # [m], what the target's forearms have


def slim_target(device: str) -> tuple[torch.Tensor, BodyParameters]:
    """Labels of thin bodies, and usual bodies."""
    usual = BodyParameters.mean(2, device=device)
    thin = replace(usual, thicknesses=usual.thicknesses.clamp(max=THIN))
    labels = RendererEllipsoids().draw(thin.posed(), thin.camera(64), (64, 64)).labels
    return labels, usual


def test_leaves_with_logarithms_make_the_same_bodies(device):
    usual = BodyParameters.mean(3, device=device)
    bodies = usual.leaves(log_sizes=True).bodies()
    for name, tensor in usual.tensors().items():
        torch.testing.assert_close(bodies.tensors()[name], tensor)


def test_gradients_of_logarithms_are_sizes_times_those_of_sizes(device):
    labels, usual = slim_target(device)
    plain, logs = usual.leaves(), usual.leaves(log_sizes=True)
    renderer = RendererEllipsoids("coverage")
    renderer.crop_loss(plain, labels).sum().backward()
    renderer.crop_loss(logs.bodies(), labels).sum().backward()
    for name in ("lengths", "thicknesses"):
        want = plain.tensors()[name].grad * usual.tensors()[name]
        assert want.abs().max() > 0
        torch.testing.assert_close(logs.tensors()[f"log_{name}"].grad, want, rtol=5e-3, atol=1e-3)
    torch.testing.assert_close(logs.rotations.grad, plain.rotations.grad, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("rate", [0.01, 1.0])
def test_no_step_makes_a_logarithm_s_size_negative(device, rate):
    """Steps of sizes themselves end below 0, and then show NaN."""
    labels, usual = slim_target(device)
    plain, logs = usual.leaves(), usual.leaves(log_sizes=True)
    renderer = RendererEllipsoids("partdr")
    for leaves, bodies in ((plain, lambda: plain), (logs, logs.bodies)):
        optimizer = torch.optim.SGD(leaves.tensors().values(), lr=rate)
        for _ in range(3):
            optimizer.zero_grad()
            # All sizes are pulled down, whatever the picture says.
            (sum(bodies().tensors()[name].sum() for name in ("lengths", "thicknesses"))).backward()
            optimizer.step()
    assert (logs.bodies().lengths > 0).all()
    assert renderer.crop_loss(logs.bodies(), labels).isfinite().all()
    if rate == 1.0:
        assert (plain.lengths < 0).any()
        assert renderer.crop_loss(plain, labels).isnan().all()


def test_frozen_parameters_collect_no_gradient(device):
    leaves = BodyParameters.mean(1, device=device).leaves(("thicknesses", "shift"), log_sizes=True)
    wants = {name: tensor.requires_grad for name, tensor in leaves.tensors().items()}
    free = {"orientation", "rotations", "log_lengths", "log_scale"}
    assert wants == {name: name in free for name in (*free, "log_thicknesses", "shift")}
    assert all(tensor.is_leaf for tensor in leaves.tensors().values())


def test_leaves_are_copies(device):
    usual = BodyParameters.mean(1, device=device)
    leaves = usual.leaves(log_sizes=True)
    with torch.no_grad():
        for tensor in leaves.tensors().values():
            tensor.add_(1)
    for name, tensor in BodyParameters.mean(1, device=device).tensors().items():
        assert torch.equal(usual.tensors()[name], tensor)


@pytest.mark.parametrize("value", [0.0, -0.1, float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["lengths", "thicknesses"])
def test_sizes_without_a_logarithm_are_refused(device, name, value):
    bodies = BodyParameters.mean(2, device=device)
    bodies.tensors()[name][1, 3] = value
    with pytest.raises(ValueError, match=f"^{name}: "):
        bodies.leaves(log_sizes=True)


@pytest.mark.parametrize("frozen", ["lengths", ("length",), ("log_lengths",)])
@pytest.mark.parametrize("log_sizes", [False, True])
def test_frozen_takes_names_of_parameters_alone(frozen, log_sizes):
    with pytest.raises(ValueError, match=r"^frozen: .*expected some of"):
        BodyParameters.mean(1).leaves(frozen, log_sizes=log_sizes)
    assert set(BodyParameters.mean(1).leaves(tuple(ROW)).tensors()) == set(ROW)


def test_bodies_split_as_they_are_selected(device):
    bodies = replace(BodyParameters.mean(3, device=device), log_scale=torch.arange(3.0, device=device))
    for index, alone in enumerate(bodies.split()):
        selected = bodies.select(slice(index, index + 1))
        assert all(torch.equal(alone.tensors()[name], selected.tensors()[name]) for name in ROW)
