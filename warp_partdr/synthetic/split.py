"""Clips and bodies that no network is trained on, fixed in ``split.json``: the kinds that PartBench's people have.

Bodies are told apart by the cells of a grid over the six phenotype values: all that lie in a cell with one of
PartBench's people are held out. ``python -m warp_partdr.synthetic.split MOCAP_FOLDER`` makes the file.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from .mocap import is_held_out
from .mocap_files import load_clips
from .partbench_people import NUM_PEOPLE, SEED
from .people import PHENOTYPE_RANGES

LEVELS = 4  # of each phenotype value
NUM_CELLS = LEVELS ** len(PHENOTYPE_RANGES)

_FILE = "split.json"


def cell_of(phenotypes: np.ndarray) -> np.ndarray:
    """The cell that people are in; those beyond ``PHENOTYPE_RANGES`` are in the outermost.

    Args:
        phenotypes: Values as ``anny_shape`` takes them, shape (..., 6).
    """
    low, high = PHENOTYPE_RANGES.T
    levels = np.floor((phenotypes - low) / (high - low) * LEVELS).clip(0, LEVELS - 1).astype(np.int64)
    return np.ravel_multi_index(np.moveaxis(levels, -1, 0), (LEVELS,) * len(PHENOTYPE_RANGES))


def held_out_cells() -> np.ndarray:
    """Cells that training leaves to PartBench, ascending, int64."""
    return np.array(_split()["cells"])


def held_out_clips() -> frozenset[str]:
    """Names of the clips that training leaves to tests."""
    return frozenset(_split()["clips"])


@lru_cache(maxsize=1)
def _split() -> dict[str, list[Any]]:
    split: dict[str, list[Any]] = json.loads(resources.files(__package__).joinpath(_FILE).read_text())
    return split


def make_split(clips: Sequence[str]) -> dict[str, list[Any]]:
    """Content of the file.

    Args:
        clips: Names of the clips that are held out.
    """
    # The first numbers that `make_person` draws.
    drawn = [np.random.default_rng([SEED, index]).uniform(*PHENOTYPE_RANGES.T) for index in range(NUM_PEOPLE)]
    return {"clips": sorted(clips), "cells": np.unique(cell_of(np.array(drawn))).tolist()}


if __name__ == "__main__":
    held_out = [clip.name for clip in load_clips(sys.argv[1]) if is_held_out(clip)]
    Path(__file__).with_name(_FILE).write_text(json.dumps(make_split(held_out), indent=1) + "\n")
