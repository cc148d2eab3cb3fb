"""Costs of bits of a label's border, against sums over many places along it; and where borders are looked for."""

from itertools import product

import numpy as np
import warp as wp

from warp_partdr.kernels.ellipsoids.borders import chord_shares
from warp_partdr.kernels.ellipsoids.creases import radicand_range
from warp_partdr.kernels.ellipsoids.forces import EllipsoidView
from warp_partdr.kernels.ellipsoids.silhouette import Silhouette
from warp_partdr.kernels.labels import DenseGradient

HEIGHT, WIDTH = 6, 9


@wp.kernel
def share_chords(
    view: EllipsoidView,
    gradient: DenseGradient,
    starts: wp.array[wp.vec2],
    ends: wp.array[wp.vec2],
    shares: wp.array[wp.vec2],
):
    i = wp.tid()
    shares[i] = chord_shares(view, starts[i], ends[i], 1, 0, gradient)


def chord_costs(maps: np.ndarray, starts: np.ndarray, ends: np.ndarray, device: str) -> np.ndarray:
    view, gradient = EllipsoidView(), DenseGradient()
    view.height, view.width = HEIGHT, WIDTH
    gradient.maps = wp.array(maps[None, None], dtype=float, device=device)
    points = [wp.array(each, dtype=wp.vec2, device=device) for each in (starts, ends)]
    shares = wp.empty(len(starts), dtype=wp.vec2, device=device)
    wp.launch(share_chords, len(starts), [view, gradient, *points], [shares], device=device)
    return shares.numpy()


def test_a_chords_ends_share_what_lies_along_it(device, rng):
    """Linear interpolation weighs each point, whichever way it is walked; beyond the picture nothing costs.

    Chords are short and long, in the picture, across its border and beside it, and along the axes.
    """
    maps = rng.normal(size=(HEIGHT, WIDTH)).astype(np.float32)
    starts = rng.uniform([-3, -3], [WIDTH + 3, HEIGHT + 3], (200, 2)).astype(np.float32)
    ends = (starts + rng.normal(size=(200, 2)) * rng.choice([0.3, 2.0, 8.0], (200, 1))).astype(np.float32)
    ends[:20, 0], ends[20:40, 1] = starts[:20, 0], starts[20:40, 1]
    along = (np.arange(20_000) + 0.5) / 20_000
    places = starts[:, None] + along[:, None] * (ends - starts)[:, None].astype(np.float64)
    columns, rows = np.floor(places).astype(int).transpose(2, 0, 1)
    inside = (columns >= 0) & (columns < WIDTH) & (rows >= 0) & (rows < HEIGHT)
    costs = np.where(inside, maps[rows.clip(0, HEIGHT - 1), columns.clip(0, WIDTH - 1)], 0.0)
    wanted = np.stack([(costs * (1 - along)).mean(1), (costs * along).mean(1)], axis=1)
    assert 20 < (inside.any(1) & ~inside.all(1)).sum() < 180
    there, back = chord_costs(maps, starts, ends, device), chord_costs(maps, ends, starts, device)
    np.testing.assert_allclose(there, wanted, atol=1e-3)
    np.testing.assert_allclose(back[:, ::-1], there, atol=1e-5)
    assert np.abs(there).max() > 0.1


@wp.kernel
def bound_rooms(
    silhouettes: wp.array[Silhouette], places: wp.array[wp.vec2], halves: wp.array[float], ranges: wp.array[wp.vec2]
):
    i = wp.tid()
    ranges[i] = radicand_range(silhouettes[i], places[i][0], places[i][1], halves[i])


def test_bounds_of_an_ellipsoid_hold_all_over_a_cell(device, rng):
    """Or a crease in the cell would be passed over: of outlines from a pixel to a hundred across, askew and thin."""
    count = 300
    factors = rng.normal(size=(count, 3)) * rng.choice([0.02, 0.2, 1.0], (count, 1))
    bulges, halves = rng.uniform(0.05, 1.0, count), rng.choice([0.5, 0.125], count)
    places = rng.normal(size=(count, 2)) * 0.5 / np.abs(factors[:, [0, 2]]).max(1, keepdims=True)
    rows = np.zeros(count, dtype=Silhouette.numpy_dtype())
    rows["factor"], rows["bulge"] = factors, bulges
    ranges = wp.empty(count, dtype=wp.vec2, device=device)
    inputs = [
        wp.array(rows, dtype=Silhouette, device=device),
        wp.array(places.astype(np.float32), dtype=wp.vec2, device=device),
        wp.array(halves.astype(np.float32), dtype=float, device=device),
    ]
    wp.launch(bound_rooms, count, inputs, [ranges], device=device)
    low, high = ranges.numpy().T

    steps = np.array(list(product(np.linspace(-1, 1, 21), repeat=2)))
    x, y = (places[:, None] + halves[:, None, None] * steps).transpose(2, 0, 1)
    across, down = factors[:, :1] * x, factors[:, 1:2] * x + factors[:, 2:] * y
    rooms = bulges[:, None] ** 2 * (1 - across**2 - down**2)
    slack = 1e-4 * np.abs(rooms).max(1)
    assert (low <= rooms.min(1) + slack).all()
    assert (high >= rooms.max(1) - slack).all()
    # and not much wider than that
    assert np.median((high - low) / (rooms.max(1) - rooms.min(1))) < 1.6
