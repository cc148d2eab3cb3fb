"""Gradient "coverage" of exact ellipsoids: the derivative of each label's visible area, weighted by the pixels' costs.

The loss is the integral of cost(label(x), pixel of x) over the picture. Where a border of labels moves, it changes by
(cost inside - cost outside) times the motion along the normal. Borders are outlines of one ellipsoid (``outlines``) or
creases, where two ellipsoids that meet in space are equally near (``creases``). Both become chords shorter than a
pixel, whose costs are summed pixel by pixel. Every thread adds in a fixed order.
"""

from typing import Any

import warp as wp

from ..labels import overload_gradients
from .creases import walk_creases
from .forces import BLOCK, Sampling, SceneArrays, SurfaceForces, make_view, store_forces
from .outlines import walk_outline

wp.set_module_options({"enable_backward": False, "fast_math": True})


@wp.kernel(launch_bounds=(BLOCK, 8))
def coverage_forces(
    scene: SceneArrays,
    sampling: Sampling,
    gradient: Any,
    forces: wp.array4d[float],  # as ``spread_forces`` reads them  OUTPUT
):
    """Sums over the forces on each ellipsoid."""
    sums = SurfaceForces()
    view = make_view(scene, forces, gradient, wp.tid())
    s = view.own
    if s.low[0] < float(view.width) and s.low[1] < float(view.height) and s.high[0] > 0.0 and s.high[1] > 0.0:
        # Half of the shares take the outline and half the creases; a single share takes both.
        outlines = wp.max(view.shares // 2, 1)
        creases = wp.max(view.shares - outlines, 1)
        if view.share < outlines:
            sums = walk_outline(view, outlines, sampling, gradient)
        if view.share >= view.shares - creases:
            sums = walk_creases(sums, view, creases, sampling, gradient)
    store_forces(forces, view, sums)


overload_gradients(coverage_forces)
