"""Sums of vertices and joints by kernels against torch in float64."""

from __future__ import annotations

import pytest
import torch

from warp_partdr.models.point_sums import sum_points


def case(batch: int = 3) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Weights of 5 sums, one of nothing, 7 vertices of longer rows, and 4 joints."""
    random = torch.Generator().manual_seed(2)
    weights = torch.randn(5, 11, generator=random) * (torch.rand(5, 11, generator=random) < 0.3)
    weights[3] = 0
    vertices, joints = (torch.randn(batch, count, 3, generator=random) for count in (9, 4))
    return weights, vertices[:, 2:], joints


def test_sums_and_their_gradients_agree_with_a_matrix_product(device):
    weights, *moving = case()
    slow, fast = ([each.to(where, kind).requires_grad_() for each in moving] for where, kind in (
        ("cpu", torch.float64), (device, torch.float32)
    ))  # fmt: skip
    wanted, own = weights.double() @ torch.cat(slow, dim=1), weights.to(device)
    pull = torch.randn(wanted.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    slopes = torch.autograd.grad((wanted * pull).sum(), slow)
    for _ in range(3):  # captured from the second time on
        found = sum_points(own, *fast)
        torch.testing.assert_close(found.cpu().double(), wanted, atol=1e-5, rtol=1e-5)
        for one, other in zip(torch.autograd.grad((found * pull.to(found)).sum(), fast), slopes, strict=True):
            torch.testing.assert_close(one.cpu().double(), other, atol=1e-5, rtol=1e-5)


def test_the_gradient_has_no_derivative():
    weights, vertices, joints = case()
    moving = vertices.requires_grad_()
    (slope,) = torch.autograd.grad(sum_points(weights, moving, joints).sum(), moving, create_graph=True)
    with pytest.raises(NotImplementedError, match="sum_points"):
        slope.sum().backward()


def test_nobody_has_no_sums():
    assert sum_points(*case(0)).shape == (0, 5, 3)
