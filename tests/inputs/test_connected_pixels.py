"""Pixels that are connected to seeds, as found by growing them."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from warp_partdr.inputs.connected_pixels import connected


@given(seed=st.integers(0, 10**6), density=st.floats(0.05, 0.95))
def test_connected_pixels_are_those_that_spreading_seeds_reach(seed: int, density: float) -> None:
    rng = np.random.default_rng(seed)
    mask, seeds = rng.random((9, 13)) < density, rng.random((9, 13)) < 0.03
    reached = seeds & mask
    while True:
        padded = np.pad(reached, 1)
        grown = mask & np.any(
            [padded[1 + dv : 10 + dv, 1 + du : 14 + du] for dv in (-1, 0, 1) for du in (-1, 0, 1)], axis=0
        )
        if (grown == reached).all():
            break
        reached = grown
    np.testing.assert_array_equal(connected(mask, seeds), reached)
