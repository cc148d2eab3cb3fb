"""Turned joints: kernels in float32 against torch in float64."""

from __future__ import annotations

import pytest
import torch
from helpers.bodies import random_turns

from warp_partdr.models.joint_turns import turn_joints

JOINTS = [0, 2, 5]  # of seven


def case(size: float, batch: int = 4) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Rotations, joints and turns of about a size [rad], one of them 0; float64."""
    turns = size * torch.randn(batch, len(JOINTS), 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    turns[:1, 1] = 0
    return random_turns(batch, 7, 0.7), torch.tensor(JOINTS), turns


@pytest.mark.parametrize("size", [0.0, 1e-5, 0.3, 3.0, 30.0])
def test_turns_and_their_gradient_are_torchs(size, device):
    rotations, joints, turns = case(size)
    wanted = turn_joints(rotations, joints, turns.requires_grad_())
    pull = torch.randn(wanted.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    (slope,) = torch.autograd.grad((wanted * pull).sum(), turns)
    moved = turns.detach().float().to(device).requires_grad_()
    found = turn_joints(rotations.float().to(device), joints.to(device), moved)
    (own,) = torch.autograd.grad((found * pull.to(found)).sum(), moved)
    torch.testing.assert_close(found.detach().cpu().double(), wanted.detach(), atol=2e-5, rtol=0)
    torch.testing.assert_close(own.cpu().double(), slope, atol=1e-4, rtol=0)


def test_other_joints_stay(device):
    rotations, joints, turns = (each.to(device) for each in case(0.5))
    found = turn_joints(rotations.float(), joints, turns.float())
    others = [joint for joint in range(7) if joint not in JOINTS]
    assert torch.equal(found[:, others], rotations.float()[:, others])
    assert not torch.isclose(found[1:, JOINTS], rotations.float()[1:, JOINTS]).all(dim=(2, 3)).any()


def test_turns_are_differentiated_again():
    """Second derivatives and torch.func both go through torch, as the gradient says."""
    rotations, joints, turns = case(0.5)
    seconds = []
    for dtype in (torch.float32, torch.float64):
        moved = turns.to(dtype).requires_grad_()
        (first,) = torch.autograd.grad(
            turn_joints(rotations.to(dtype), joints, moved).pow(3).sum(), moved, create_graph=True
        )
        seconds.append(torch.autograd.grad(first.square().sum(), moved)[0].double())
    torch.testing.assert_close(*seconds, atol=1e-3, rtol=1e-3)
    assert seconds[1].abs().max() > 0.1
    still = rotations.float(), joints
    mapped = torch.func.vmap(lambda own, each: turn_joints(own[None], joints, each[None])[0])(still[0], turns.float())
    torch.testing.assert_close(mapped, turn_joints(*still, turns.float()), atol=1e-5, rtol=0)


def test_rotations_that_move_have_a_gradient():
    rotations, joints, turns = (each.float() if each.is_floating_point() else each for each in case(0.5))
    turn_joints(rotations.requires_grad_(), joints, turns).sum().backward()
    assert rotations.grad is not None
    assert rotations.grad.abs().sum() > 0


def test_an_empty_batch_is_turned():
    rotations, joints, turns = case(0.5, batch=0)
    assert turn_joints(rotations.float(), joints, turns.float()).shape == (0, 7, 3, 3)
