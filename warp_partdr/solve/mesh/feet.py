"""Feet that stand in films, which do not slide.

One camera sees hardly how far away a foot is, so there a foot that stands slides to and fro. It sees very well whether
the foot moves across the view, and that says which feet stand.
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
POINTS = len(FEET) // 2  # of a foot
# Standard deviations of speeds across the view, along each of its axes [m/s], of feet that stand and of others: in fits
# of PartBench's clips 0 to 11 without this term they are 0.07 and 0.74, and large ones are commoner than normal.
_STANDS, _MOVES = 0.15, 0.75
# Logarithm of the odds that a point at rest stands, and how much of it each m^2/s^2 across the view takes.
_ODDS = 2 * math.log(_MOVES / _STANDS), (_STANDS**-2 - _MOVES**-2) / 2


def slides(seen: torch.Tensor, shown: torch.Tensor, rates: torch.Tensor) -> torch.Tensor:
    """Squared speeds of points in each frame since the one before [m^2/s^2], times how surely they stand.

    A point stands or moves, as likely before its speed is seen; speeds across the view are normal about 0. Of several
    views the one that sees it fastest counts. What tells is no part of the gradient: nothing is to move so as to count
    less.

    Args:
        seen: Points in each camera's frame [m], shape (P, T, V, F, 3), float32.
        shown: Who is seen where, shape (P, T, V), bool; where nobody sees a person, nothing stands.
        rates: 1 over the time from each frame to the next [1/s], shape (T - 1,), float32; they have no gradient. Where
            one is 0, nothing is known of feet between the frames, and nothing slides.

    Returns:
        Shape (P, T - 1, F).
    """
    return _Slides()(seen, shown, rates)[0]


class _Slides(Operation):
    name = "slides"

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        seen, shown, rates = inputs
        people, frames, _, points, _ = seen.shape
        shape = torch.Size((people, frames - 1, points))
        tensors = seen, shown, rates.expand(people, -1)
        costs, forces = call_captured(_prepare, tensors, (shape, torch.Size((*shape, 3))))
        return (costs,), (forces,)

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        seen, _, _, forces = saved
        return call_captured(_prepare_adjoint, (forces, *adjoints), (seen.shape,))


def _prepare(inputs: Tensors, outputs: Tensors) -> Launch:
    """Launch that fills costs and their forces from points, who is shown, and rates."""
    seen, shown, rates = inputs
    arrays = warp_array(seen, vec3), warp_array(shown), warp_array(rates)
    found = warp_array(outputs[0]), warp_array(outputs[1], vec3)
    return partial(kernels.launch_slides, arrays, vec2(*_ODDS), found)


def _prepare_adjoint(inputs: Tensors, outputs: Tensors) -> Launch:
    """Launch that fills the gradient of points from forces and the costs' adjoint."""
    arrays = warp_array(inputs[0], vec3), warp_array(inputs[1])
    return partial(kernels.launch_slides_adjoint, *arrays, warp_array(outputs[0], vec3))
