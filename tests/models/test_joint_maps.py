"""Maps by which joints carry skin against products of matrices, and their gradient; by launches, and as captured."""

from __future__ import annotations

import pytest
import torch
from helpers.bodies import random_turns

from warp_partdr.models.joint_maps import map_joints

FORK = (-1, 0, 0, 1, 3, 3, 2, 5, 0)


def slow_maps(rotations: torch.Tensor, translation: torch.Tensor, rest: torch.Tensor) -> tuple[torch.Tensor, ...]:
    frames: list[torch.Tensor] = []
    for joint, parent in enumerate(FORK):
        bone = translation if parent < 0 else rest[:, joint] - rest[:, parent]
        local = torch.zeros(len(rest), 4, 4, dtype=rest.dtype)
        local[:, :3, :3], local[:, :3, 3], local[:, 3, 3] = rotations[:, joint], bone, 1
        frames.append(local if parent < 0 else frames[parent] @ local)
    transforms = torch.stack(frames, dim=1)
    back = torch.eye(4, dtype=rest.dtype).repeat(len(rest), len(FORK), 1, 1)
    back[..., :3, 3] = -rest
    maps = (transforms @ back)[..., :3, :]
    return transforms, transforms[..., :3, 3], maps.flatten(2).mT


def case(dtype: torch.dtype, batch: int = 2) -> list[torch.Tensor]:
    """Tensors have any strides, and some are not contiguous."""
    rotations = torch.randn(batch, len(FORK), 3, 3, dtype=dtype).mT
    return [rotations, torch.randn(batch, 3, dtype=dtype), torch.randn(batch, 3, len(FORK), dtype=dtype).mT]


@pytest.mark.parametrize(("dtype", "near"), [(torch.float32, 1e-4), (torch.float64, 1e-10)])
@pytest.mark.parametrize("used", [(0, 1, 2), (1, 2), (2,), (0,), (1,)])
def test_maps_and_their_gradient_agree_with_plain_torch(used, dtype, near, device):
    """Each runs three times, so that the last ones are captured; results that are not used have no adjoint."""
    for _ in range(3):
        inputs = [each.requires_grad_() for each in case(dtype)]
        moved = [each.detach().to(device).requires_grad_() for each in inputs]
        wanted, found = slow_maps(*inputs), map_joints(FORK, *moved)
        pulls = [torch.randn_like(each) for each in wanted]
        for one, other in zip(found, wanted, strict=True):
            torch.testing.assert_close(one.cpu(), other, atol=near, rtol=near)
        costs = [
            sum((results[place] * pulls[place].to(results[place].device)).sum() for place in used)
            for results in (wanted, found)
        ]
        gradients = [
            torch.autograd.grad(cost, each, materialize_grads=True, allow_unused=True)
            for cost, each in zip(costs, (inputs, moved), strict=True)
        ]
        for one, other in zip(*gradients, strict=True):
            torch.testing.assert_close(other.cpu(), one, atol=near, rtol=near)


def test_adjoints_stay_as_they_are(device):
    moved = [each.to(device).requires_grad_() for each in case(torch.float32)]
    found = map_joints(FORK, *moved)
    pulls = [torch.randn_like(each) for each in found]
    kept = [each.clone() for each in pulls]
    torch.autograd.grad(found, moved, pulls)
    assert all(map(torch.equal, pulls, kept))


def test_maps_are_differentiated_again():
    """Second derivatives and torch.func both go through torch."""
    rotations, (_, *others) = random_turns(1, len(FORK), 0.7), case(torch.float64, batch=1)
    moved = [each.requires_grad_() for each in (rotations, *others)]
    for used in ((0, 1, 2), (1, 2)):
        assert torch.autograd.gradgradcheck(lambda *own, used=used: [map_joints(FORK, *own)[k] for k in used], moved)
    mapped = torch.func.vmap(lambda *own: map_joints(FORK, *(each[None] for each in own))[2][0])(*moved)
    torch.testing.assert_close(mapped, map_joints(FORK, *moved)[2])


def test_nobody_has_no_maps():
    assert [each.shape for each in map_joints(FORK, *case(torch.float32, batch=0))] == [
        (0, 9, 4, 4),
        (0, 9, 3),
        (0, 12, 9),
    ]
