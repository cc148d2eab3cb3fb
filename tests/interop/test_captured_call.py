"""Captured calls: each call has results of its own, of its own inputs, whatever was called before it."""

from __future__ import annotations

import torch

from warp_partdr.interop.captured_call import call_as_graph

calls: list[int] = []


def products(first: torch.Tensor, second: torch.Tensor, power: int) -> tuple[torch.Tensor, torch.Tensor]:
    calls.append(len(first))
    return (first @ second) ** power, first.sum(-1)


def test_each_call_computes_its_own_inputs(device: str) -> None:
    """On CUDA, the second call with the same shapes is captured; what a call returned stays."""
    generator = torch.Generator().manual_seed(0)
    found, expected = [], []
    for power in (1, 2):
        for count in (3, 3, 3, 5, 3):
            given = [torch.randn(count, 4, 4, generator=generator).to(device).mT for _ in range(2)]
            found.append(call_as_graph(products, (given[0], given[1]), power))
            expected.append(products(given[0], given[1], power))
    for own, others in zip(found, expected, strict=True):
        for values, right in zip(own, others, strict=True):
            torch.testing.assert_close(values, right)


def test_python_runs_a_captured_function_no_more(device: str) -> None:
    given = torch.rand(7, 4, 4, device=device)
    for _ in range(3):
        call_as_graph(products, (given, given), 3)
    calls.clear()
    call_as_graph(products, (given, given), 3)
    assert calls == ([] if device == "cuda" else [7])


def test_gradients_flow_as_if_it_was_called_alone(device: str) -> None:
    given = torch.rand(2, 4, 4, device=device)
    for _ in range(3):
        leaf = given.clone().requires_grad_()
        product, _ = call_as_graph(products, (leaf, given), 1)
        product.sum().backward()
        assert leaf.grad is not None
        torch.testing.assert_close(leaf.grad, given.sum(-1)[:, None].expand(2, 4, 4))
