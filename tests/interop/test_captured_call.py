"""A captured call gives what the function gives, whatever was called before it."""

from __future__ import annotations

import torch

from warp_partdr.interop.captured_call import call_as_graph


def scaled_sums(factor: float, values: torch.Tensor, weights: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """A function of an option and two tensors."""
    return factor * (values * weights).sum(1), values + weights


def test_each_call_has_results_of_its_own_tensors_and_options(device: str) -> None:
    """On CUDA, the first call of each kind is not captured, the second one is, and the third one is replayed."""
    generator = torch.Generator().manual_seed(5)
    given, found = [], []
    for batch, factor in ((3, 2.0), (3, 2.0), (4, 2.0), (3, 2.0), (3, -1.0), (4, 2.0), (3, 2.0)):
        tensors = tuple(torch.randn(batch, 5, generator=generator).to(device) for _ in range(2))
        given.append((factor, tensors))
        found.append(call_as_graph(scaled_sums, (factor,), tensors))
    for (factor, tensors), results in zip(given, found, strict=True):  # in the end, so that no call may change them
        for have, want in zip(results, scaled_sums(factor, *tensors), strict=True):
            assert torch.equal(have, want)


def test_a_call_that_is_differentiated_is_differentiable_each_time(device: str) -> None:
    for _ in range(3):
        values = torch.ones(2, 3, device=device, requires_grad=True)
        sums, _ = call_as_graph(scaled_sums, (3.0,), (values, torch.full_like(values, 2.0)))
        sums.sum().backward()
        assert values.grad is not None
        assert (values.grad == 6.0).all()
