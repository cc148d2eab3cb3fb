"""Distributions of numbers that stream by: histograms in memory that doesn't grow, quantiles, and bars to draw."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

# A bin holds floats whose first 20 bits are the same: 2,048 bins from each power of two to the next.
_CUT = 12
_BINS = 0x7F800000 >> _CUT  # infinity's, which is left out
_BARS = 40  # about so many are drawn
_TAIL = 0.005  # share at either end that bars may leave out: single outliers would squeeze the rest
_NICE = (1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True)
class Bars:
    """Bars of a histogram: counts (N,) of numbers from ``start`` on, each ``step`` wide, and those left out."""

    start: float
    step: float
    counts: np.ndarray
    below: int
    above: int

    @property
    def stop(self) -> float:
        """End of the last bar."""
        return self.start + self.step * len(self.counts)


@dataclass
class Histogram:
    """Counts of numbers of 0 or more, 0.05 % apart at most.

    Attributes:
        total: Count of the numbers that were added.
        low: Smallest number.
        high: Largest number.
    """

    total: int = 0
    low: float = math.inf
    high: float = -math.inf
    _counts: np.ndarray = field(default_factory=lambda: np.zeros(_BINS, dtype=np.int64))

    def add(self, values: np.ndarray) -> None:
        """Count finite numbers; negative ones count as 0."""
        if not len(values):
            return
        values = np.abs(np.maximum(values, 0)).astype(np.float32)  # no negative 0, whose bits are large
        bins, counts = np.unique(values.view(np.uint32) >> _CUT, return_counts=True)
        self._counts[bins] += counts
        self.total += len(values)
        self.low, self.high = min(self.low, float(values.min())), max(self.high, float(values.max()))

    def quantile(self, share: float) -> float:
        """The smallest number that so large a share does not exceed."""
        rank = min(max(math.ceil(share * self.total), 1), self.total)
        if rank == self.total:
            return self.high
        index = int(np.searchsorted(np.cumsum(self._counts), rank))
        return min(max(float(_middles()[index]), self.low), self.high)

    def bars(self) -> Bars:
        """Bars of round widths, from 0 on where numbers begin near it."""
        low, high = self.quantile(_TAIL), self.quantile(1 - _TAIL)
        low = 0.0 if low < 0.3 * high else low
        step = round_up(max(high - low, 1e-3 * abs(high), 1e-9) / _BARS)
        first = math.floor(low / step)
        number = math.floor(high / step) - first + 1
        there = np.flatnonzero(self._counts)
        numbers = np.clip(_middles()[there], self.low, self.high)
        bins = np.floor(numbers / step).astype(np.int64) - first
        bins[(bins == number) & (numbers <= (first + number) * step * (1 + 1e-9))] -= 1  # the end itself
        counts = self._counts[there]
        inside = (bins >= 0) & (bins < number)
        drawn = np.bincount(bins[inside], weights=counts[inside], minlength=number).astype(np.int64)
        return Bars(first * step, step, drawn, int(counts[bins < 0].sum()), int(counts[bins >= number].sum()))


def round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, 20, ... that is as large."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(digit * power for digit in _NICE if digit * power >= value * (1 - 1e-9))


def _middles() -> np.ndarray:
    """Middles of the bins; 0 of the first, which holds 0 itself."""
    middles = ((np.arange(_BINS, dtype=np.uint32) << _CUT) + (1 << (_CUT - 1))).view(np.float32).astype(np.float64)
    middles[0] = 0.0
    return middles
