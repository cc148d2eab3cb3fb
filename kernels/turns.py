"""Numbers of rotations and cameras, in the forms that users have them, as matrices and intrinsics, and gradients back.

A rotation is 3 numbers (axis times angle), 6 (two columns) or 9 (a matrix, taken as it is).
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from .rotations import axis_angle_gradient, column, columns_gradient, matrix_from_6d, matrix_from_axis_angle

wp.set_module_options({"enable_backward": False})


@wp.struct
class Numbers:
    """Rotations and cameras of B bodies of P parts, or the gradient with respect to them."""

    orientation: wp.array2d[float]  # (B, 3, 6 or 9) of the whole body
    rotations: wp.array3d[float]  # (B, P, 3, 6 or 9) of each bone
    focal: wp.array2d[float]  # (B, 1 or 2) [px], or the logarithm of the crop's half-sides a metre; (0, 0): no camera
    centre: wp.array2d[float]  # (B, 2) [px], or in the crop, -1 to 1


@wp.struct
class Turns:
    """Rotations as matrices and cameras as intrinsics, as kernels take them, or the gradient with respect to them."""

    orientations: wp.array[wp.mat33]  # (B,)
    rotations: wp.array2d[wp.mat33]  # (B, P)
    cameras: wp.array2d[wp.vec4]  # (B, 1) f_x, f_y, c_x, c_y [px]; of gradients (B, M) shares


@wp.struct
class TurnRule:
    """Meaning of the numbers."""

    locked: int  # bit k: part k keeps its rest rotation
    half_size: float  # of the crop that the camera's numbers are of [px]; 0: they are in pixels


@wp.func
def get_vector(numbers: wp.array[float], first: int):
    return wp.vec3(numbers[first], numbers[first + 1], numbers[first + 2])


@wp.func
def set_vector(numbers: wp.array[float], first: int, v: wp.vec3):
    for i in range(3):
        numbers[first + i] = v[i]


@wp.func
def make_turn(numbers: wp.array[float]):
    """Rotation matrix."""
    if numbers.shape[0] == 3:
        return matrix_from_axis_angle(get_vector(numbers, 0))
    if numbers.shape[0] == 6:
        return matrix_from_6d(get_vector(numbers, 0), get_vector(numbers, 3))
    return wp.matrix_from_rows(get_vector(numbers, 0), get_vector(numbers, 3), get_vector(numbers, 6))


@wp.func
def gather_turn(numbers: wp.array[float], turn: wp.mat33, adjoint: wp.mat33, gradient: wp.array[float]):
    """Gradient with respect to a rotation's numbers from that with respect to its matrix."""
    if numbers.shape[0] == 9:
        for i in range(3):
            set_vector(gradient, 3 * i, adjoint[i])
        return
    torque = wp.vec3()
    for i in range(3):
        torque += wp.cross(column(turn, i), column(adjoint, i))
    if numbers.shape[0] == 3:
        set_vector(gradient, 0, axis_angle_gradient(get_vector(numbers, 0), wp.transpose(turn) * torque))
    else:
        first, second = columns_gradient(get_vector(numbers, 0), get_vector(numbers, 3), turn, torque)
        set_vector(gradient, 0, first)
        set_vector(gradient, 3, second)


@wp.func
def rest_turn(numbers: wp.array[float]):
    """Identity, whatever the numbers; NaN if one of them is not finite, for a locked part must not hide that."""
    one = float(1.0)
    for i in range(numbers.shape[0]):
        one += 0.0 * numbers[i]
    return one * wp.identity(n=3, dtype=float)


@wp.kernel
def turn_bodies(numbers: Numbers, rule: TurnRule, turns: Turns):
    """Fill ``turns``: a thread a rotation, the last of a body also its camera."""
    thread = wp.tid()
    parts = numbers.rotations.shape[1]
    b = thread // (parts + 1)
    k = thread - b * (parts + 1)
    if k < parts:
        if (rule.locked >> k) & 1 == 1:
            turns.rotations[b, k] = rest_turn(numbers.rotations[b, k])
        else:
            turns.rotations[b, k] = make_turn(numbers.rotations[b, k])
        return
    turns.orientations[b] = make_turn(numbers.orientation[b])
    if numbers.focal.shape[0] > 0:
        last = numbers.focal.shape[1] - 1
        focal = wp.vec2(numbers.focal[b, 0], numbers.focal[b, last])
        centre = wp.vec2(numbers.centre[b, 0], numbers.centre[b, 1])
        half = rule.half_size
        if half > 0.0:
            focal = half * wp.vec2(wp.exp(focal[0]), wp.exp(focal[1]))
            centre = half * (centre + wp.vec2(1.0))
        turns.cameras[b, 0] = wp.vec4(focal[0], focal[1], centre[0], centre[1])


@wp.kernel
def turn_bodies_adjoint(numbers: Numbers, rule: TurnRule, turns: Turns, adjoints: Turns, gradient: Numbers):
    """Fill ``gradient``; of ``turns`` it reads the rotations, and the camera's focal lengths if they are a crop's."""
    thread = wp.tid()
    parts = numbers.rotations.shape[1]
    b = thread // (parts + 1)
    k = thread - b * (parts + 1)
    if k < parts:
        if (rule.locked >> k) & 1 == 1:
            for i in range(gradient.rotations.shape[2]):
                gradient.rotations[b, k, i] = 0.0
        else:
            row = gradient.rotations[b, k]
            gather_turn(numbers.rotations[b, k], turns.rotations[b, k], adjoints.rotations[b, k], row)
        return
    gather_turn(numbers.orientation[b], turns.orientations[b], adjoints.orientations[b], gradient.orientation[b])
    if numbers.focal.shape[0] > 0:
        camera = wp.vec4()
        for i in range(adjoints.cameras.shape[1]):
            camera += adjoints.cameras[b, i]
        if rule.half_size > 0.0:
            focal = turns.cameras[b, 0]
            camera = wp.cw_mul(camera, wp.vec4(focal[0], focal[1], rule.half_size, rule.half_size))
        if gradient.focal.shape[1] == 1:
            gradient.focal[b, 0] = camera[0] + camera[1]
        else:
            gradient.focal[b, 0] = camera[0]
            gradient.focal[b, 1] = camera[1]
        gradient.centre[b, 0] = camera[2]
        gradient.centre[b, 1] = camera[3]


_BLOCK = 32


def _launch(kernel: wp.Kernel, inputs: Sequence[Any]) -> None:
    batch, parts = inputs[0].rotations.shape[:2]
    wp.launch(kernel, batch * (parts + 1), inputs, device=inputs[0].rotations.device, block_dim=_BLOCK)


def launch_turn(numbers: Any, rule: Any, turns: Any) -> None:
    """Fill ``turns`` from ``numbers``."""
    _launch(turn_bodies, [numbers, rule, turns])


def launch_turn_adjoint(numbers: Any, rule: Any, turns: Any, adjoints: Any, gradient: Any) -> None:
    """Fill the ``gradient`` with respect to ``numbers`` from the ``adjoints`` of what ``launch_turn`` filled."""
    _launch(turn_bodies_adjoint, [numbers, rule, turns, adjoints, gradient])
