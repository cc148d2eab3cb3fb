"""Linear blend skinning by kernels against sums written out."""

from __future__ import annotations

import pytest
import torch
from helpers.bodies import random_turns

from warp_partdr.models.skinning import blend_skin, carry_skin, carry_sparsely, map_rows

VERTICES, JOINTS = 11, 4


def case(dtype: torch.dtype, batch: int = 3) -> tuple[torch.Tensor, ...]:
    """Weights, maps, places, rest and vertices."""
    random = torch.Generator().manual_seed(5)
    weights = torch.rand(VERTICES, JOINTS, generator=random).softmax(1)
    places, rest = (torch.randn(batch, JOINTS, 3, generator=random) for _ in range(2))
    vertices = torch.randn(batch, VERTICES, 3, generator=random)
    maps = random_turns(batch, JOINTS, 0.8) * torch.tensor([1.0, 1.3, 0.7])  # not rotations alone
    return tuple(each.to(dtype) for each in (weights, maps, places, rest, vertices))


def slow_skin(
    weights: torch.Tensor, maps: torch.Tensor, places: torch.Tensor, rest: torch.Tensor, vertices: torch.Tensor
) -> torch.Tensor:
    about = vertices[:, :, None] - rest[:, None]  # (B, V, N, 3)
    return torch.einsum("vn,bnij,bvnj->bvi", weights, maps, about) + torch.einsum("vn,bni->bvi", weights, places)


@pytest.mark.parametrize(("dtype", "near"), [(torch.float32, 1e-5), (torch.float64, 1e-12)])
def test_skin_and_its_gradient_agree_with_plain_torch(dtype, near, device):
    weights, *moving = case(dtype)
    slow = [each.double().requires_grad_() for each in moving]
    wanted = slow_skin(weights.double(), *slow)
    pull = torch.randn(wanted.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    fast = [each.to(device).requires_grad_() for each in moving]
    found = blend_skin(weights.to(device), *fast)
    torch.testing.assert_close(found.cpu().double(), wanted, atol=near, rtol=near)
    slopes = torch.autograd.grad((found * pull.to(found)).sum(), fast)
    for one, other in zip(slopes, torch.autograd.grad((wanted * pull).sum(), slow), strict=True):
        torch.testing.assert_close(one.cpu().double(), other, atol=10 * near, rtol=10 * near)


def test_sparse_skin_and_its_gradients_agree_with_dense_skin(device):
    weights, *moving = case(torch.float32)
    weights = weights * (torch.rand(weights.shape, generator=torch.Generator().manual_seed(2)) < 0.4)
    slow = [map_rows(*moving[:3]).double().requires_grad_(), moving[3].double().requires_grad_()]
    wanted = carry_skin(weights.double(), *slow)
    pull = torch.randn(wanted.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    slopes = torch.autograd.grad((wanted * pull).sum(), slow)
    fast, own = [each.detach().to(device, torch.float32).requires_grad_() for each in slow], weights.to(device)
    for _ in range(3):  # captured from the second time on
        found = carry_sparsely(own, *fast)
        torch.testing.assert_close(found.cpu().double(), wanted, atol=1e-5, rtol=1e-5)
        for one, other in zip(torch.autograd.grad((found * pull.to(found)).sum(), fast), slopes, strict=True):
            torch.testing.assert_close(one.cpu().double(), other, atol=1e-4, rtol=1e-4)
    found = carry_sparsely(own, *fast)
    (slope,) = torch.autograd.grad((found * pull.to(found)).sum(), fast[1], create_graph=True)
    (again,) = torch.autograd.grad(slope.square().sum(), fast[0])
    (wanted_slope,) = torch.autograd.grad(
        (carry_skin(weights.double(), *slow) * pull).sum(), slow[1], create_graph=True
    )
    (wanted_again,) = torch.autograd.grad(wanted_slope.square().sum(), slow[0])
    torch.testing.assert_close(again.cpu().double(), wanted_again, atol=1e-3, rtol=1e-4)


def test_skin_is_differentiated_again():
    """Second derivatives and torch.func both go through torch."""
    weights, *moving = case(torch.float64, batch=1)
    moving = [each.requires_grad_() for each in moving]
    assert torch.autograd.gradgradcheck(lambda *own: blend_skin(weights, *own), moving)
    each = torch.func.vmap(lambda *own: blend_skin(weights, *(one[None] for one in own))[0])(*moving)
    torch.testing.assert_close(each, blend_skin(weights, *moving))


def test_nobody_has_no_skin():
    assert blend_skin(*case(torch.float32, batch=0)).shape == (0, VERTICES, 3)
