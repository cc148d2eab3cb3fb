"""Gradient "coverage" of exact ellipsoids: the derivative of each label's visible area, weighted by the pixels' costs.

The loss is the integral of cost(label(x), pixel of x) over the picture. Where a border of labels moves, it changes by
(cost inside - cost outside) times the motion along the normal. Borders are outlines of one ellipsoid (``outlines``) or
creases, where two ellipsoids that meet in space are equally near (``creases``). Both become chords shorter than a
pixel, whose costs are summed pixel by pixel. Every thread adds in a fixed order.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from ..labels import DenseGradient, LabelTarget, target_of
from .creases import walk_creases
from .forces import (
    BLOCK,
    Forces,
    SceneArrays,
    SurfaceForces,
    Worker,
    launch_on_ellipsoids,
    make_scene,
    store_forces,
    view_ellipsoid,
    worker_of,
)
from .outlines import walk_outline
from .silhouette import Seen, launch_find_neighbours

wp.set_module_options({"enable_backward": False, "fast_math": True})


@wp.func
def push_coverage(
    scene: SceneArrays, forces: Forces, w: Worker, lanes: int, steps_per_pixel: float, halvings: int, gradient: Any
):
    """Share of one thread in the forces on an ellipsoid."""
    sums = SurfaceForces()
    s = scene.silhouettes[w.b, w.k]
    height = scene.parts.shape[1]
    width = scene.parts.shape[2]
    if s.low[0] < float(width) and s.low[1] < float(height) and s.high[0] > 0.0 and s.high[1] > 0.0:
        view = view_ellipsoid(scene, w.b, w.k, target_of(gradient, w.b))
        # Half of the shares take the outline and half the creases; a single share takes both.
        shares = forces.values.shape[2]
        outlines = wp.max(shares // 2, 1)
        creases = wp.max(shares - outlines, 1)
        if w.share < outlines:
            sums = walk_outline(scene, view, w.share, outlines, w.lane, lanes, steps_per_pixel, halvings, gradient)
        if w.share >= shares - creases:
            share = w.share - (shares - creases)
            cells = int(wp.ceil(steps_per_pixel))
            sums = walk_creases(sums, scene, view, share, creases, w.lane, lanes, cells, halvings, gradient)
    return sums


@wp.kernel(launch_bounds=(BLOCK, 8))
def coverage_forces(
    scene: SceneArrays,
    steps_per_pixel: float,
    halvings: int,
    gradient: Any,
    lanes: int,
    forces: Forces,  # OUTPUT
):
    """Sums over the forces on each ellipsoid."""
    w = worker_of(forces, lanes, wp.tid())
    store_forces(forces, w, push_coverage(scene, forces, w, lanes, steps_per_pixel, halvings, gradient))


for _gradient in (LabelTarget, DenseGradient):
    wp.overload(coverage_forces, {"gradient": _gradient})


def launch_coverage_forces(
    ellipsoids: Sequence[wp.array],  # centres, axes, semi-axes, camera
    seen: Seen,
    parts: wp.array,
    *,
    perspective: bool,
    steps_per_pixel: float,
    halvings: int,
    gradient: Any,  # LabelTarget or DenseGradient
    forces: Forces,
) -> None:
    """Fill the sums of forces on every ellipsoid."""
    launch_find_neighbours(seen)
    scene = make_scene(ellipsoids, seen, parts, perspective=perspective)
    launch_on_ellipsoids(coverage_forces, [scene, steps_per_pixel, halvings, gradient], forces)
