"""Pixels that are connected, found by runs instead of one by one."""

from __future__ import annotations

import numpy as np


def connected(mask: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Pixels of ``mask`` that are connected to a seed (8 neighbours), shape (H, W), bool."""
    runs = Runs(mask)
    return runs.pixels(runs.reached(np.flatnonzero(mask & seeds)))


class Runs:
    """Runs of a mask (H, W), the unbroken stretches of a row, of which there are few.

    Two runs of neighbouring rows touch if they overlap or meet at a corner, and those that touch one run are
    consecutive.
    """

    def __init__(self, mask: np.ndarray) -> None:
        self._shape = mask.shape
        stride = mask.shape[1] + 2  # Positions in reading order, with a gap between rows.
        self._flat = np.zeros((mask.shape[0], stride), dtype=bool)
        self._flat[:, 1:-1] = mask
        flat = self._flat.ravel()
        edges = np.flatnonzero(flat[1:] != flat[:-1])  # of runs, starts and exclusive ends in turn
        self._starts, self._ends = edges[::2], edges[1::2]
        self._roots = self._components(stride)

    def _components(self, stride: int) -> np.ndarray:
        """One run of each component, the same for all its runs, shape (R,)."""
        first = np.searchsorted(self._ends, self._starts - stride, side="left")  # of those above that a run touches
        last = np.searchsorted(self._starts, self._ends - stride, side="right")
        roots = np.where(last > first, first, np.arange(len(first)))
        while ((above := roots[roots]) != roots).any():
            roots = above
        joined: dict[int, int] = {}  # roots that are none any more, for a run touches several: few

        def root(run: int) -> int:
            while run in joined:
                run = joined[run]
            return run

        for run in np.flatnonzero(last - first > 1).tolist():
            one, *others = {root(each) for each in roots[first[run] : last[run]].tolist()}
            joined |= dict.fromkeys(others, one)
        if joined:
            table = np.arange(len(roots))
            table[list(joined)] = [root(run) for run in joined]
            roots = table[roots]
        return roots

    def reached(self, seeds: np.ndarray) -> np.ndarray:
        """Runs that are connected to one of some pixels of the mask, by their ascending numbers in it; (R,), bool."""
        rows, columns = np.divmod(seeds, max(self._shape[1], 1))
        seed_keys = rows * self._flat.shape[1] + columns
        hit = np.searchsorted(seed_keys, self._ends) > np.searchsorted(seed_keys, self._starts)
        reached = np.zeros(len(hit), dtype=bool)
        reached[self._roots[hit]] = True
        return reached[self._roots]

    def pixels(self, chosen: np.ndarray) -> np.ndarray:
        """Pixels of some runs (R,), shape (H, W), bool."""
        if chosen.all():
            return self._flat[:, 1:-1]
        turns = np.zeros(self._flat.size, dtype=np.int8)
        turns[self._starts[chosen] + 1], turns[self._ends[chosen] + 1] = 1, -1
        return np.cumsum(turns, dtype=np.int8).view(bool).reshape(self._flat.shape)[:, 1:-1]
