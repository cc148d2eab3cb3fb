"""Volumes that bodies share, against boxes and balls of known size."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from warp_partdr.lab.evaluation.volumes import point_grid, shared_volume, windings


def test_boxes_share_what_their_sides_say() -> None:
    box = trimesh.creation.box((0.4, 0.5, 0.6))
    moved = box.vertices + np.array([0.3, 0.2, 0.4])
    assert shared_volume(np.stack([box.vertices, moved]), box.faces) == pytest.approx(1e6 * 0.1 * 0.3 * 0.2, rel=0.15)
    assert shared_volume(np.stack([moved, box.vertices]), box.faces) == pytest.approx(1e6 * 0.1 * 0.3 * 0.2, rel=0.15)
    assert shared_volume(np.stack([box.vertices, box.vertices + np.array([0.0, 0.0, 0.7])]), box.faces) == 0
    three = np.stack([box.vertices, box.vertices + np.array([5.0, 0, 0]), moved])
    assert shared_volume(three, box.faces) == shared_volume(three[[0, 2]], box.faces)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_ball_in_a_ball_is_shared_whole(axis: int) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4)
    off = np.zeros(3)
    off[axis] = 0.1
    both = np.stack([0.4 * ball.vertices, 0.2 * ball.vertices + off])
    assert shared_volume(both, ball.faces) == pytest.approx(1e6 * 4 / 3 * np.pi * 0.2**3, rel=0.01)


def test_a_grid_that_cuts_a_surface_knows_the_inside() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.3)
    low, count = point_grid(np.array([[0.0, 0.0, -0.05], [0.1, 0.1, 0.05]]))
    assert (windings(ball.vertices, ball.faces, low, count) == 1).all()
    low, count = point_grid(np.array([[0.0, 0.0, 0.31], [0.1, 0.1, 0.4]]))
    assert (windings(ball.vertices, ball.faces, low, count)[..., 1:] == 0).all()
