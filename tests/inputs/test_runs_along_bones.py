"""Runs of pixels along bones: the few pixels that are looked at tell the same as all of them."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from warp_partdr.inputs.body_lines import _bone_rows
from warp_partdr.kernels.own_pixels import BodyArrays, Bone, run_lies_along


@wp.kernel
def judge_runs(
    bodies: BodyArrays,
    firsts: wp.array[wp.float64],
    counts: wp.array[int],
    heights: wp.array[wp.float64],
    found: wp.array[int],
):
    n = wp.tid()
    found[n] = wp.where(run_lies_along(bodies, n, firsts[n], counts[n], heights[n]), 1, 0)


def distances(points: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Distances of points (N, K, 2) from segments (N, 2, 2), shape (N, K)."""
    ways = (ends[:, 1] - ends[:, 0])[:, None]
    shares = ((points - ends[:, :1]) * ways).sum(-1) / np.maximum((ways**2).sum(-1), 1e-12)
    return np.linalg.norm(points - ends[:, :1] - np.clip(shares, 0, 1)[..., None] * ways, axis=-1)


@pytest.mark.parametrize("kind", ["any", "level", "upright", "a point"])
def test_a_run_lies_along_a_bone_where_any_of_its_pixels_does(kind: str, device: str, rng: np.random.Generator) -> None:
    """Small radii: the nearest place lies between two pixels, of which one or none is near enough."""
    count = 4000
    ends = (rng.random((count, 2, 2)) * 30).astype(np.float32)
    if kind == "level":
        ends[:, 1, 1] = ends[:, 0, 1]
    if kind == "upright":
        ends[:, 1, 0] = ends[:, 0, 0]
    if kind == "a point":
        ends[:, 1] = ends[:, 0]
    radii = rng.random((count, 1)) * 3
    firsts, counts = rng.integers(0, 30, count) + 0.5, rng.integers(1, 12, count)
    heights = rng.integers(0, 30, count) + 0.5
    bodies = BodyArrays()
    bodies.bones = wp.array(_bone_rows(ends[:, None], radii + 10, radii), dtype=Bone, device=device)
    bodies.num_bones = wp.full(count, 1, dtype=int, device=device)
    runs = [wp.array(each, device=device) for each in (firsts, counts.astype(np.int32), heights)]
    found = wp.empty(count, dtype=int, device=device)
    wp.launch(judge_runs, count, [bodies, *runs, found], device=device)
    columns = firsts[:, None] + np.minimum(np.arange(12), counts[:, None] - 1)
    pixels = np.stack([columns, np.broadcast_to(heights[:, None], columns.shape)], axis=2)
    expected = (distances(pixels, ends.astype(np.float64)) <= radii).any(axis=1)
    np.testing.assert_array_equal(found.numpy() > 0, expected)
    assert 40 < expected.sum() < count - 40
