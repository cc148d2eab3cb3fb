"""Gradient "coverage" of exact ellipsoids: the derivative of each label's visible area, weighted by the pixels' costs.

The loss is the integral of cost(label(x), pixel of x) over the picture. Where a border of labels moves, it changes by
(cost inside - cost outside) times the motion along the normal. Borders are outlines of one ellipsoid (``outlines``) or
creases, where two ellipsoids that meet in space are equally near (``creases``). Both become chords shorter than a
pixel, whose costs are summed pixel by pixel. Every thread adds in a fixed order.
"""

from typing import Any

import warp as wp

from ..labels import overload_gradients
from .creases import count_cells, walk_creases
from .forces import BLOCK, Sampling, SceneArrays, find_neighbours, make_view, store_forces, take_share
from .outlines import count_steps, walk_outline
from .picture_forces import PictureForces, on_surface

wp.set_module_options({"enable_backward": False, "fast_math": True})

FEWEST_SHARES = 4  # of an ellipsoid's work: three for its creases


@wp.kernel(launch_bounds=(BLOCK, 8))
def coverage_forces(
    scene: SceneArrays,
    sampling: Sampling,
    gradient: Any,
    forces: wp.array4d[float],  # as ``spread_forces`` reads them  OUTPUT
):
    """Sums over the forces on each ellipsoid."""
    forces_here = PictureForces()
    view = make_view(scene, forces, gradient, wp.tid())
    s = view.own
    if s.low[0] < float(view.width) and s.low[1] < float(view.height) and s.high[0] > 0.0 and s.high[1] > 0.0:
        # The first shares take the creases, which are more work, and the last quarter the outline; one takes both.
        outlines = (view.shares + 3) // 4
        creases = wp.max(view.shares - outlines, 1)
        find_neighbours(view)
        steps = count_steps(view, sampling)
        share = take_share(view, view.shares - outlines, outlines, steps, 2)
        if share.count > 0:
            forces_here = walk_outline(forces_here, view, share, steps, sampling, gradient)
        if view.share < creases:
            share = take_share(view, 0, creases, count_cells(view), 1)
            if share.count > 0:
                forces_here = walk_creases(forces_here, view, share, sampling, gradient)
    store_forces(forces, view, on_surface(view, forces_here), False)


overload_gradients(coverage_forces)
