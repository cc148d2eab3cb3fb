"""Products along a tree of joints against matrices multiplied one by one, and their gradient."""

from __future__ import annotations

import pytest
import torch
from helpers.bodies import random_turns

from warp_partdr.models.joint_chain import chain_joints

FORK = (-1, 0, 0, 1, 3, 3, 2, 5, 0)  # levels: 0 | 1 2 8 | 3 6 | 4 5 | 7


def slow_chain(parents: tuple[int, ...], rotations: torch.Tensor, bones: torch.Tensor) -> torch.Tensor:
    frames: list[torch.Tensor] = []
    for joint, parent in enumerate(parents):
        local = torch.zeros(len(bones), 4, 4, dtype=bones.dtype)
        local[:, :3, :3], local[:, :3, 3], local[:, 3, 3] = rotations[:, joint], bones[:, joint], 1
        frames.append(local if parent < 0 else frames[parent] @ local)
    return torch.stack(frames, dim=1)


@pytest.mark.parametrize(("dtype", "near"), [(torch.float32, 1e-5), (torch.float64, 1e-12)])
@pytest.mark.parametrize("parents", [(-1,), (-1, 0, 1, 2), FORK, (-1, *[0] * 40)])
def test_chains_are_products(parents, dtype, near, device):
    rotations = random_turns(3, len(parents), 0.7).to(dtype)
    bones = torch.randn(3, len(parents), 3, dtype=dtype)
    found = chain_joints(parents, rotations.to(device), bones.to(device))
    torch.testing.assert_close(found.cpu(), slow_chain(parents, rotations, bones), atol=near, rtol=near)


@pytest.mark.parametrize("parents", [FORK, (-1, 0, 1, 2, 3, 4)])
def test_the_gradient_is_that_of_the_products(parents, device):
    """The matrices are any, rotations or not, and have any strides."""
    rotations = torch.randn(2, len(parents), 3, 3, dtype=torch.float64).mT.requires_grad_()
    bones = torch.randn(2, len(parents), 3, dtype=torch.float64, requires_grad=True)
    pull = torch.randn(2, len(parents), 4, 4, dtype=torch.float64)
    wanted = torch.autograd.grad((slow_chain(parents, rotations, bones) * pull).sum(), (rotations, bones))
    moved = [each.detach().to(device).requires_grad_() for each in (rotations, bones)]
    found = torch.autograd.grad((chain_joints(parents, *moved) * pull.to(device)).sum(), moved)
    for one, other in zip(found, wanted, strict=True):
        torch.testing.assert_close(one.cpu(), other, atol=1e-10, rtol=1e-10)


def test_nobody_has_no_frames():
    assert chain_joints(FORK, torch.zeros(0, 9, 3, 3), torch.zeros(0, 9, 3)).shape == (0, 9, 4, 4)


def test_chains_are_differentiated_again():
    """Second derivatives and torch.func both go through torch."""
    rotations, bones = random_turns(1, 9, 0.7).requires_grad_(), torch.randn(1, 9, 3, dtype=torch.float64)
    bones.requires_grad_()
    assert torch.autograd.gradgradcheck(lambda *moved: chain_joints(FORK, *moved), (rotations, bones))
    mapped = torch.func.vmap(lambda *moved: chain_joints(FORK, *(each[None] for each in moved))[0])(rotations, bones)
    torch.testing.assert_close(mapped, chain_joints(FORK, rotations, bones))


def test_the_gradient_of_a_fixed_argument_is_not_asked_for():
    rotations, bones = random_turns(1, 9, 0.7), torch.randn(1, 9, 3, dtype=torch.float64, requires_grad=True)
    cost = chain_joints(FORK, rotations, bones).pow(3).sum()
    (first,) = torch.autograd.grad(cost, bones, create_graph=True)
    (plain,) = torch.autograd.grad(chain_joints(FORK, rotations, bones).pow(3).sum(), bones)
    torch.testing.assert_close(first, plain)
    (second,) = torch.autograd.grad(first.sum(), bones)
    assert second.abs().sum() > 0
