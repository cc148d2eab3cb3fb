"""Histograms of numbers that stream by, against all numbers at once."""

from __future__ import annotations

import numpy as np
import pytest

from warp_partdr.bulk.histograms import Histogram, round_up


def counted(values: np.ndarray, parts: int = 7) -> Histogram:
    histogram = Histogram()
    for part in np.array_split(values, parts):
        histogram.add(part)
    return histogram


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.95, 1.0])
def test_quantiles_are_those_of_all_numbers(share: float) -> None:
    rng = np.random.default_rng(1)
    for values in (rng.lognormal(-4, 1, 5001), rng.uniform(0, 1, 5001), np.arange(5001) * 1e4, np.full(9, 3.0)):
        expected = np.quantile(values, share, method="inverted_cdf")
        assert counted(values).quantile(share) == pytest.approx(expected, rel=5e-4)


def test_extremes_are_exact_and_zeros_count() -> None:
    histogram = counted(np.array([0.0, -0.0, -1.0, 0.7, 1e20]))
    assert (histogram.total, histogram.low, histogram.high) == (5, 0.0, np.float32(1e20))
    assert histogram.quantile(0.6) == 0.0
    assert histogram.quantile(1.0) == np.float32(1e20)
    falling = counted(np.array([9.0, 5.0, 7.0]), parts=3)
    assert (falling.low, falling.high) == (5.0, 9.0)


@pytest.mark.parametrize("shift", [0.0, 5.0])
def test_bars_are_those_of_numpy(shift: float) -> None:
    values = np.random.default_rng(2).gamma(4, 0.1, 20_000) + shift
    bars = counted(values).bars()
    edges = bars.start + bars.step * np.arange(len(bars.counts) + 1)
    expected = np.histogram(values, edges)[0]
    assert np.abs(bars.counts - expected).max() <= 0.03 * expected.max()  # their edges cut bins
    assert bars.counts.sum() + bars.below + bars.above == len(values)
    assert (bars.start == 0) == (shift == 0)
    assert 20 <= len(bars.counts) <= 60
    assert bars.stop == pytest.approx(np.quantile(values, 0.995), abs=bars.step)


def test_a_single_outlier_does_not_squeeze_the_bars() -> None:
    bars = counted(np.append(np.linspace(1, 2, 10_000), 1e6)).bars()
    assert bars.stop < 2.1
    assert bars.below == 0
    assert 1 <= bars.above <= 51  # the half per cent at this end, and it


@pytest.mark.parametrize("values", [[1.0] * 5, [0.0] * 5, [0.8, 1.0], [*np.linspace(50, 99.9, 1000), 100.0]])
def test_the_largest_number_is_in_the_last_bar(values: list[float]) -> None:
    bars = counted(np.array(values)).bars()
    assert (bars.below, bars.above, bars.counts.sum()) == (0, 0, len(values))


def test_steps_are_round() -> None:
    assert [round_up(value) for value in (0.011, 0.02, 0.3, 1, 7, 600)] == pytest.approx([0.02, 0.02, 0.5, 1, 10, 1000])
