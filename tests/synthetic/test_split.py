"""Clips and bodies that training must leave out are those of the file, and its script would write it again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scenes.bodies import clips

from warp_partdr.clothing.anny import PHENOTYPE_ANCHORS
from warp_partdr.synthetic import split
from warp_partdr.synthetic.mocap import is_held_out
from warp_partdr.synthetic.partbench_people import NUM_PEOPLE, SEED
from warp_partdr.synthetic.people import PHENOTYPE_RANGES, PHENOTYPES


def test_split_holds_out_the_cells_of_all_partbench_people() -> None:
    drawn = []
    for index in range(NUM_PEOPLE):
        rng = np.random.default_rng([SEED, index])
        drawn.append([rng.uniform(*PHENOTYPES[name]) for name in PHENOTYPE_ANCHORS])
    assert np.array_equal(np.unique(split.cell_of(np.array(drawn))), split.held_out_cells())
    assert len(split.held_out_cells()) < 0.1 * split.NUM_CELLS


def test_split_is_what_its_script_would_write(shared: Path) -> None:
    names = [clip.name for clip in clips(shared) if is_held_out(clip)]
    assert split.make_split(names) == split._split()
    assert split.held_out_clips() == set(names)


def test_cells_are_a_grid_and_the_outermost_reach_on() -> None:
    low, high = PHENOTYPE_RANGES.T
    assert split.cell_of(low) == 0
    assert split.cell_of(high) == split.NUM_CELLS - 1
    assert split.cell_of(low - 1) == 0
    steps = low + (high - low) * (np.arange(4)[:, None] + 0.5) / 4
    corners = np.stack(np.meshgrid(*steps.T, indexing="ij"), axis=-1).reshape(-1, 6)
    assert np.array_equal(split.cell_of(corners), np.arange(split.NUM_CELLS))
