"""Costs pull by their weights."""

from __future__ import annotations

import torch

from warp_partdr.interop.weighted_costs import backward_weighted


def test_a_cost_pulls_as_much_as_its_weight() -> None:
    moves = torch.linspace(-1, 1, 6).requires_grad_()
    costs = [moves.square(), (moves - 0.5).abs().reshape(2, 3)]
    weights = [torch.full_like(costs[0], 3.0), torch.full_like(costs[1], 0.25)]
    (expected,) = torch.autograd.grad(costs, moves, weights, retain_graph=True)
    backward_weighted(costs, weights)
    torch.testing.assert_close(moves.grad, expected, rtol=0, atol=0)
