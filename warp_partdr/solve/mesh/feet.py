"""Cost of feet that slide while they stand, in films.

One camera tells little about the distance of a foot, so in a fit a standing foot slides along the view. The camera
shows very well if the foot moves across the view, and that tells which feet stand.
"""

from __future__ import annotations

import math
from functools import partial

import torch
from warp import vec2, vec3

from ...interop.arrays import warp_array
from ...interop.captured_function import call_captured
from ...interop.graph_cache import Launch
from ...interop.layouts import Tensors
from ...interop.operation import Gradients, Operation
from ...kernels import feet as kernels

FEET = ("left_heel", "left_big_toe", "left_small_toe", "right_heel", "right_big_toe", "right_small_toe")
POINTS = len(FEET) // 2  # number of points of one foot
# Standard deviations of the speed across the view, along each of its two axes, for feet that stand and for feet that
# move [m/s]. In fits of PartBench's clips 0 to 11 without this term, they are 0.07 and 0.74, and large speeds occur
# more often than in a normal distribution.
_STANDS, _MOVES = 0.15, 0.75
# Logarithm of the odds that a point at rest stands, and the decrease of this logarithm for each m^2/s^2 across the
# view.
_ODDS = 2 * math.log(_MOVES / _STANDS), (_STANDS**-2 - _MOVES**-2) / 2


def slides(points: torch.Tensor, observed: torch.Tensor, rates: torch.Tensor) -> torch.Tensor:
    """Squared speeds of points between frames, times the probability that the points stand.

    A point stands or moves; both are equally likely before its speed is known. Speeds across the view have normal
    distributions about 0. Of several views, the one with the highest speed counts. The probability has no gradient:
    otherwise points would move so that they seem to stand less.

    Args:
        points: Points in each camera's frame [m], shape (P, T, V, F, 3), float32.
        observed: True if a view shows a person in a frame, shape (P, T, V), bool. If no view does, no point stands.
        rates: Inverse of the time from each frame to the next [1/s], shape (T - 1,), float32; they have no gradient. A
            rate of 0 says that nothing is known of feet between the two frames, and its cost is 0.

    Returns:
        Costs [m^2/s^2], shape (P, T - 1, F).
    """
    return _Slides()(points, observed, rates)[0]


class _Slides(Operation):
    name = "slides"

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        points, observed, rates = inputs
        people, frames, _, num_points, _ = points.shape
        shape = torch.Size((people, frames - 1, num_points))
        tensors = points, observed, rates.expand(people, -1)
        costs, forces = call_captured(_prepare, tensors, (shape, torch.Size((*shape, 3))))
        return (costs,), (forces,)

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        points, _, _, forces = saved
        return call_captured(_prepare_adjoint, (forces, *adjoints), (points.shape,))


def _prepare(inputs: Tensors, outputs: Tensors) -> Launch:
    """Launch that fills costs and their forces from points, from the people observed, and from rates."""
    points, observed, rates = inputs
    arrays = warp_array(points, vec3), warp_array(observed), warp_array(rates)
    found = warp_array(outputs[0]), warp_array(outputs[1], vec3)
    return partial(kernels.launch_slides, arrays, vec2(*_ODDS), found)


def _prepare_adjoint(inputs: Tensors, outputs: Tensors) -> Launch:
    """Launch that fills the gradient of points from forces and the adjoint of costs."""
    arrays = warp_array(inputs[0], vec3), warp_array(inputs[1])
    return partial(kernels.launch_slides_adjoint, *arrays, warp_array(outputs[0], vec3))
