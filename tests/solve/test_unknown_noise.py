"""Costs of what was seen with noise that nobody knows."""

from __future__ import annotations

import pytest
import torch

from warp_partdr.solve.mesh.unknown_noise import blob_costs, border_lengths, noise_costs


def slopes(errors: torch.Tensor, counts: torch.Tensor, usual: float, costs=noise_costs) -> torch.Tensor:
    errors = errors.clone().requires_grad_()
    costs(errors, counts, usual).sum().backward()
    assert errors.grad is not None
    return errors.grad


def test_what_agrees_counts_more_and_what_is_noisy_less(device):
    counts = torch.tensor([12.0, 12.0, 12.0, 5.0], device=device)
    mean = torch.tensor([0.5, 3.0, 6.0, 3.0], device=device)
    found = slopes(mean * counts, counts, 3.0).cpu()
    torch.testing.assert_close(found, torch.tensor([1.02 / (1 / 6 + 0.02), 1.0, 1.02 / 2.02, 1.0]))


def test_precise_errors_count_some_fifty_times_at_most(device):
    found = slopes(torch.zeros(1, device=device), torch.full((1,), 9.0, device=device), 2.0)
    torch.testing.assert_close(found.cpu(), torch.tensor([51.0]))


def test_costs_are_the_logarithm_of_a_power_of_the_sum():
    # Laplace's density over all widths b, 1/b being as likely as any: the integral of b^-(n + 1) exp(-sum / b).
    widths = torch.logspace(-4, 4, 20_001, dtype=torch.float64)
    count, sums = 12, torch.tensor([20.0, 35.0, 70.0], dtype=torch.float64)
    densities = widths.pow(-count - 1) * (-sums[:, None] / widths).exp()
    expected = -torch.trapezoid(densities, widths).log()
    found = noise_costs(sums, torch.full((3,), float(count), dtype=torch.float64), 3.0) / 3.0
    torch.testing.assert_close(found.diff(), expected.diff(), rtol=0.03, atol=0)


def test_wide_blobs_count_the_less_the_fewer_of_them_there_are(device):
    counts = torch.tensor([12.0, 12.0, 12.0, 5.0], device=device)
    mean = torch.tensor([0.5, 3.0, 12.0, 3.0], device=device)
    found = slopes(mean * counts, counts, 3.0, blob_costs).cpu()
    small, large = 1 / 6, 4.0
    expected = [2 * 1.02 / ((small + 0.02) * (small + 1)), 1.0, 2 * 1.02 / ((large + 0.02) * (large + 1)), 1.0]
    torch.testing.assert_close(found, torch.tensor(expected))
    most = slopes(torch.zeros(1, device=device), counts[:1], 3.0, blob_costs)
    torch.testing.assert_close(most.cpu(), torch.tensor([102.0]))


@pytest.mark.parametrize("costs", [noise_costs, blob_costs])
def test_what_was_not_seen_costs_nothing(device, costs):
    nothing, something = torch.zeros(2, device=device), torch.full((2,), 1e4, device=device)
    for errors in (nothing, something):  # wrong pixels of labels without a border
        assert (costs(errors, nothing, 3.0) == 0).all()
        assert (slopes(errors, nothing, 3.0, costs) == 0).all()


@pytest.mark.parametrize("sort", [torch.uint8, torch.int32])
def test_borders_are_counted_between_labels_and_not_beside_ignored_pixels(device, sort):
    labels = torch.zeros(2, 6, 8, dtype=sort, device=device)
    labels[0, 2:4, 3:6] = 5  # 2 x 3 pixels: 10 long
    labels[1] = labels[0]
    labels[1, 3, 3] = 7  # two more
    labels[1, :, 6:] = 255  # its right side borders on ignored pixels
    assert border_lengths(labels).tolist() == [10.0, 10.0 + 2.0 - 2.0]
