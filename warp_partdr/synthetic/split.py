"""Bodies that no network is trained on: those in a cell with one of PartBench's people, of a grid over phenotypes.

Clips that none is trained on are ``mocap.HELD_OUT``.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .partbench_people import NUM_PEOPLE, draw_phenotypes
from .people import PHENOTYPE_RANGES

LEVELS = 4  # of each phenotype value
NUM_CELLS = LEVELS ** len(PHENOTYPE_RANGES)


def cell_of(phenotypes: np.ndarray) -> np.ndarray:
    """Cells of phenotype values (..., 6), shape (...); those beyond ``PHENOTYPE_RANGES`` are in the outermost."""
    low, high = PHENOTYPE_RANGES.T
    levels = np.floor((phenotypes - low) / (high - low) * LEVELS).clip(0, LEVELS - 1).astype(np.int64)
    return np.ravel_multi_index(np.moveaxis(levels, -1, 0), (LEVELS,) * len(PHENOTYPE_RANGES))


@lru_cache(maxsize=1)
def held_out_cells() -> np.ndarray:
    """Cells that training leaves to PartBench, ascending, int64."""
    return np.unique(cell_of(np.array([draw_phenotypes(index)[0] for index in range(NUM_PEOPLE)])))
