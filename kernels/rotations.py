"""Device functions on rotations: axis-angle and 6D numbers to matrices, and torques back to gradients of those numbers.

A change of a rotation matrix is ``[w]x R`` for a small rotation w. The gradient of anything with respect to w is the
torque of its forces, so one torque replaces nine adjoints of matrix entries.
"""

import warp as wp

_TINY_SQUARE = wp.constant(1.0e-8)  # [rad^2]; below it the series are exact to float32 and need no division
_SMALL_SQUARE = wp.constant(0.25)  # [rad^2]; below it angle - sin(angle) cancels too much
_COLLINEAR = wp.constant(1.0e-6)  # a column this much shorter after projection was rounding


@wp.func
def column(m: wp.mat33, index: int):
    return wp.vec3(m[0, index], m[1, index], m[2, index])


@wp.func
def one_minus_cosine(square: float):
    """Value of (1 - cos a) / a^2 for an angle a, given a^2."""
    if square < _TINY_SQUARE:
        return 0.5 - square / 24.0
    half_sine = wp.sin(0.5 * wp.sqrt(square))
    return 2.0 * half_sine * half_sine / square


@wp.func
def matrix_from_axis_angle(v: wp.vec3):
    """Rodrigues' formula; any length of ``v``, zero is the identity."""
    square = wp.dot(v, v)
    first = 1.0 - square / 6.0
    if square >= _TINY_SQUARE:
        angle = wp.sqrt(square)
        first = wp.sin(angle) / angle
    cross = wp.skew(v)
    return wp.identity(n=3, dtype=float) + first * cross + one_minus_cosine(square) * (cross * cross)


@wp.func
def axis_angle_gradient(v: wp.vec3, torque: wp.vec3):
    """Gradient with respect to ``v`` from a torque in the turned frame: the left Jacobian times it."""
    square = wp.dot(v, v)
    third = 1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0 - square / 362880.0))
    if square >= _SMALL_SQUARE:
        angle = wp.sqrt(square)
        third = (angle - wp.sin(angle)) / (angle * square)
    across = wp.cross(v, torque)
    return torque + one_minus_cosine(square) * across + third * wp.cross(v, across)


@wp.func
def largest(v: wp.vec3):
    """Largest magnitude of a component."""
    return wp.max(wp.abs(v))


@wp.func
def unit(v: wp.vec3):
    """Direction of a vector that is not 0, though its square may leave float32; NaN where a component is not finite.

    ``wp.normalize`` would make 0 of NaN.
    """
    scaled = v / largest(v)
    return scaled / wp.length(scaled)


@wp.func
def unit_or(v: wp.vec3, other: wp.vec3):
    """Direction of a vector, or ``other`` where it has none."""
    if v[0] == 0.0 and v[1] == 0.0 and v[2] == 0.0:  # not by ``largest``, which passes over NaN
        return other
    return unit(v)


@wp.func
def is_collinear(first: wp.vec3, second: wp.vec3):
    """True if ``second`` is parallel to the unit vector ``first`` or has no direction; False if it is not finite."""
    size = largest(second)
    return largest(second - wp.dot(first, second) * first) <= _COLLINEAR * size and size < wp.inf


@wp.func
def least_axis(v: wp.vec3):
    """The coordinate axis that a vector points along least."""
    size = wp.abs(v)
    if size[0] <= size[1] and size[0] <= size[2]:
        return wp.vec3(1.0, 0.0, 0.0)
    if size[1] <= size[2]:
        return wp.vec3(0.0, 1.0, 0.0)
    return wp.vec3(0.0, 0.0, 1.0)


@wp.func
def matrix_from_6d(first: wp.vec3, second: wp.vec3):
    """Gram-Schmidt of two columns; a column without a direction of its own is replaced by a fixed other one.

    NaN and infinity give a matrix of NaN.
    """
    x = unit_or(first, wp.vec3(1.0, 0.0, 0.0))
    y = second
    if is_collinear(x, second):
        y = least_axis(x)
    for _ in range(2):  # the first leaves rounding of the order of a nearly collinear column
        y = unit(y - wp.dot(x, y) * x)
    return wp.matrix_from_cols(x, y, wp.cross(x, y))


@wp.func
def columns_gradient(first: wp.vec3, second: wp.vec3, rotation: wp.mat33, torque: wp.vec3):
    """Gradient with respect to the two columns that became ``rotation``; 0 for a column that was replaced."""
    x, y, z = column(rotation, 0), column(rotation, 1), column(rotation, 2)
    grad_first = wp.vec3(0.0)
    grad_second = wp.vec3(0.0)
    used = second
    if is_collinear(x, second):
        used = least_axis(x)
    else:
        grad_second = z * (wp.dot(torque, x) / wp.dot(y, second))
    if wp.dot(x, first) != 0.0:  # NaN goes on as NaN
        shear = wp.dot(torque, y) + wp.dot(torque, x) * wp.dot(x, used) / wp.dot(y, used)
        grad_first = (wp.dot(torque, z) * y - shear * z) / wp.dot(x, first)
    return grad_first, grad_second
