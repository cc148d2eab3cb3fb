"""Pixels that are connected, found by runs instead of one by one."""

from __future__ import annotations

import numpy as np


def connected(mask: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Pixels of ``mask`` that are connected to a seed (8 neighbours), shape (H, W), bool."""
    pixels = np.zeros((mask.shape[0], mask.shape[1] + 1), dtype=bool)
    pixels[:, 1:] = mask
    spread = np.zeros_like(pixels)
    spread[:, 1:] = mask & seeds
    stride = pixels.shape[1]
    runs = Runs(np.append(pixels, False), np.array([1]), np.array([stride]))
    kept = runs.reached(np.flatnonzero(spread))
    pixels.reshape(-1)[runs.pixels(~kept)] = False
    return pixels[:, 1:]


def ranges(starts: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Whole numbers from each start (N,) on, so many of each, all one after another."""
    ends = np.cumsum(counts)
    return np.repeat(starts - (ends - counts), counts) + np.arange(ends[-1] if len(ends) else 0)


class Runs:
    """Runs of masks, the unbroken stretches of a row, of which there are few.

    Two runs of neighbouring rows touch if they overlap or meet at a corner, and those that touch one run are
    consecutive.

    Args:
        pixels: Masks in reading order, one after another, with a gap before each row and after the last, and before
            each mask but the first an empty row, shape (P,), bool.
        firsts: First pixels of the masks there, ascending, shape (N,).
        strides: Number of pixels from one to that below, shape (N,).

    Attributes:
        masks: Mask of each run, shape (R,).
        starts: First pixels of the runs, ascending.
        counts: Numbers of their pixels.
    """

    def __init__(self, pixels: np.ndarray, firsts: np.ndarray, strides: np.ndarray) -> None:
        edges = np.flatnonzero(pixels[1:] != pixels[:-1]) + 1  # of runs, starts and exclusive ends in turn
        self.starts, ends = edges[::2], edges[1::2]
        self.counts = ends - self.starts
        self.masks = np.searchsorted(firsts, self.starts, side="right") - 1
        self._roots = self._components(ends, strides[self.masks])

    def _components(self, ends: np.ndarray, strides: np.ndarray) -> np.ndarray:
        """One run of each component, the same for all its runs, shape (R,)."""
        first = np.searchsorted(ends, self.starts - strides, side="left")  # of those above that a run touches
        last = np.searchsorted(self.starts, ends - strides, side="right")
        roots = np.where(last > first, first, np.arange(len(first)))  # or what leads to one
        others = np.maximum(last - first - 1, 0)  # but for the first: few
        pairs = first.repeat(others), ranges(first + 1, others)
        while True:
            while ((above := roots[roots]) != roots).any():
                roots = above
            one, other = (roots[each] for each in pairs)
            if (one == other).all():
                return roots
            np.minimum.at(roots, np.maximum(one, other), np.minimum(one, other))

    def reached(self, seeds: np.ndarray) -> np.ndarray:
        """Runs that are connected to one of some pixels of the masks, shape (R,), bool."""
        reached = np.zeros(len(self.starts), dtype=bool)
        reached[self._roots[np.searchsorted(self.starts, seeds, side="right") - 1]] = True
        return reached[self._roots]

    def pixels(self, chosen: np.ndarray) -> np.ndarray:
        """Pixels of some runs (R,), bool."""
        return ranges(self.starts[chosen], self.counts[chosen])
