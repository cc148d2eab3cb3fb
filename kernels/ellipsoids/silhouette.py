"""Ellipsoids in closed form: outline, coverage and depth of each, for weak-perspective and perspective cameras.

With X = c + A diag(a) u (u on the unit sphere) and the camera (f_x, f_y, c_x, c_y), every ellipsoid is seen as an
ellipse and a nearness, which is -z (weak perspective) or 1/z (perspective), so that larger is nearer:

    inside(p) = 1 - |factor (p - mean)|^2                               positive where the ellipsoid covers p
    nearness(p) = nearness + slope . (p - mean) + bulge sqrt(inside(p)) of its front surface

``factor`` is a triangular root of the outline's conic. Squares of it would cancel where an outline is thin and askew,
and leave float32 where it is far away: at a thickness of a thousandth of the length, or at 10 km.

Both cameras take this one form, so everything after ``see_ellipsoids`` is the same code.
"""

from collections.abc import Sequence
from typing import NamedTuple

import warp as wp

from ..lanes import sum_lanes

wp.set_module_options({"enable_backward": False})

_FEW = 32  # threads a block of small launches: more blocks use more of the GPU
_FAR = wp.constant(1.0e30)  # [px] an empty bounding box's bounds
_THIN = wp.constant(1.0e15)  # [1/px] whose square float32 can hold
BROKEN = wp.constant(-1)  # label of an ellipsoid that has a number that is not finite, or a length that is not positive


@wp.struct
class Silhouette:
    """One ellipsoid as a picture shows it."""

    mean: wp.vec2  # centre of the outline [px]
    low: wp.vec2  # bounding box of the outline [px]; low > high: not drawn
    high: wp.vec2
    factor: wp.vec3  # xx, yx, yy of the triangular matrix [1/px]
    bulge: float  # [nearness] of the front's middle over the outline's plane
    slope: wp.vec2  # [nearness/px]
    nearness: float
    farthest: float  # nearness of the farthest and of the closest point of the front surface
    closest: float
    label: int  # 1 to 254; 255 hides what is behind and has no map; 0, BROKEN: not drawn


@wp.func
def to_disc(s: Silhouette, dx: float, dy: float):
    """Point relative to the outline's centre, in coordinates in which the outline is the unit circle."""
    return wp.vec2(s.factor[0] * dx, s.factor[1] * dx + s.factor[2] * dy)


@wp.func
def inside_at(s: Silhouette, x: float, y: float):
    """Positive where the ellipsoid covers (x, y); 0 on its outline, 1 in its middle."""
    place = to_disc(s, x - s.mean[0], y - s.mean[1])
    return 1.0 - place[0] * place[0] - place[1] * place[1]


@wp.func
def along_row(s: Silhouette):
    """Squared norm of the first column of ``factor``: the divisor of a row's chord, from its middle to its ends."""
    return s.factor[0] * s.factor[0] + s.factor[1] * s.factor[1]


@wp.func
def row_root(s: Silhouette, dy: float):
    """Discriminant of the intersection of a row at ``dy`` from the centre with the outline; positive if they cross."""
    reach = s.factor[0] * s.factor[2] * dy
    return along_row(s) - reach * reach


@wp.func
def row_lean(s: Silhouette, dy: float):
    """Offset of a row's middle to the left of the outline's centre, times ``along_row``."""
    return s.factor[1] * s.factor[2] * dy


@wp.func
def middle_at(s: Silhouette, x: float, y: float):
    """Nearness without the root: of the outline, and of the plane through it that halves front and back."""
    return s.nearness + s.slope[0] * (x - s.mean[0]) + s.slope[1] * (y - s.mean[1])


@wp.func
def depth_of(nearness: float, perspective: bool):
    """Depth [m] of a nearness."""
    return wp.where(perspective, 1.0 / nearness, -nearness)


@wp.func
def in_box(s: Silhouette, x: float, y: float):
    """Test of the bounding box, cheaper than ``inside_at``."""
    return x > s.low[0] and x < s.high[0] and y > s.low[1] and y < s.high[1]


@wp.func
def pixel_box(s: Silhouette, height: int, width: int):
    """First and last column, first and last row of pixels whose centres the ellipsoid may cover; last < first: none."""
    # Clamped in float against overflow.
    left = int(wp.clamp(wp.ceil(s.low[0] - 0.5), 0.0, float(width)))
    right = int(wp.clamp(wp.floor(s.high[0] - 0.5), -1.0, float(width - 1)))
    top = int(wp.clamp(wp.ceil(s.low[1] - 0.5), 0.0, float(height)))
    bottom = int(wp.clamp(wp.floor(s.high[1] - 0.5), -1.0, float(height - 1)))
    return left, right, top, bottom


@wp.func
def see_ellipsoid(
    centre: wp.vec3, axes: wp.mat33, semi_axes: wp.vec3, camera: wp.vec4, label: int, near: float, perspective: bool
):
    """Silhouette of one ellipsoid; not drawn with label 0, where it reaches the near plane, without an area, or BROKEN.

    In double, for a thin or far ellipsoid is a small difference of large numbers; and in forms that cancel little:
    determinants as cross products of the rows of A diag(a).
    """
    s = Silhouette()
    s.label = label
    s.low = wp.vec2(_FAR, _FAR)
    s.high = wp.vec2(-_FAR, -_FAR)
    s.bulge = -1.0
    sizes = wp.vec3d(semi_axes)
    rx = wp.cw_mul(wp.vec3d(axes[0]), sizes)  # rows of A diag(a)
    ry = wp.cw_mul(wp.vec3d(axes[1]), sizes)
    rz = wp.cw_mul(wp.vec3d(axes[2]), sizes)
    cx, cy, cz = wp.float64(centre[0]), wp.float64(centre[1]), wp.float64(centre[2])
    fx, fy = wp.float64(camera[0]), wp.float64(camera[1])
    one = wp.float64(1.0)
    # A sum of squares of float32 can't overflow: it is finite if all of them are.
    squares = wp.dot(rx, rx) + wp.dot(ry, ry) + wp.dot(rz, rz) + cx * cx + cy * cy + cz * cz
    squares += wp.length_sq(wp.vec4d(camera))
    sizes_are_positive = semi_axes[0] > 0.0 and semi_axes[1] > 0.0 and semi_axes[2] > 0.0
    if not (wp.isfinite(squares) and sizes_are_positive and camera[0] > 0.0 and camera[1] > 0.0):
        s.label = BROKEN
        return s
    volume = sizes[0] * sizes[1] * sizes[2]
    volume = volume * volume  # the determinant of A diag(a^2) A^T
    if label == 0 or not (volume > wp.float64(0.0) and cz - wp.length(rz) > wp.float64(near)):
        return s

    # Normalised image plane: mean (mx, my), covariance of the outline (vxx, vxy, vyy) and its determinant.
    mx = cx
    my = cy
    vxx = wp.dot(rx, rx)
    vxy = wp.dot(rx, ry)
    vyy = wp.dot(ry, ry)
    normal = wp.cross(rx, ry)
    det = wp.dot(normal, normal)
    nearness = -cz
    slope_x = wp.float64(0.0)
    slope_y = wp.float64(0.0)
    squared_bulge = wp.float64(0.0)
    if perspective:
        # The outline's dual conic is c c^T - Sigma. The camera is outside where e = c^T Sigma^-1 c - 1 is positive.
        d33 = cz * cz - wp.dot(rz, rz)
        gx = cz * rx - cx * rz
        gy = cz * ry - cy * rz
        hx = wp.cross(rx, rz)
        hy = wp.cross(ry, rz)
        mx = (cx * cz - wp.dot(rx, rz)) / d33
        my = (cy * cz - wp.dot(ry, rz)) / d33
        vxx = (wp.dot(gx, gx) - wp.dot(hx, hx)) / (d33 * d33)
        vxy = (wp.dot(gx, gy) - wp.dot(hx, hy)) / (d33 * d33)
        vyy = (wp.dot(gy, gy) - wp.dot(hy, hy)) / (d33 * d33)
        # Sigma^-1 c by Cramer's rule: columns of (A diag(a))^-1 are cross products of its rows over the determinant.
        inside = (cx * wp.cross(ry, rz) + cy * wp.cross(rz, rx) + cz * wp.cross(rx, ry)) / wp.sqrt(volume)
        e = wp.dot(inside, inside) - one
        if not e > wp.float64(0.0):
            return s
        det = volume * e / (d33 * d33 * d33)
        pull = wp.vec3d(
            wp.dot(wp.cross(ry, rz), inside), wp.dot(wp.cross(rz, rx), inside), wp.dot(wp.cross(rx, ry), inside)
        ) / wp.sqrt(volume)
        slope_x = pull[0] / e
        slope_y = pull[1] / e
        nearness = (pull[0] * mx + pull[1] * my + pull[2]) / e
        squared_bulge = one / (d33 * e)
    else:
        squared_bulge = volume / det
        rzx = wp.dot(rz, rx)
        rzy = wp.dot(rz, ry)
        slope_x = -(rzx * vyy - rzy * vxy) / det
        slope_y = -(rzy * vxx - rzx * vxy) / det
    deviation = wp.sqrt(vxx)
    factor_xx = one / (fx * deviation)
    factor_yy = deviation / (fy * wp.sqrt(det))
    factor_yx = -vxy / (fx * deviation * wp.sqrt(det))
    bulge = wp.sqrt(squared_bulge)
    # Too thin for float32, or not finite: it covers no pixel.
    if not (float(bulge) > 0.0 and float(wp.abs(factor_xx)) < _THIN and float(wp.abs(factor_yy)) < _THIN):
        return s
    s.mean = wp.vec2(float(fx * mx + wp.float64(camera[2])), float(fy * my + wp.float64(camera[3])))
    half = wp.vec2(float(wp.abs(fx) * wp.sqrt(vxx)), float(wp.abs(fy) * wp.sqrt(vyy)))
    s.low = s.mean - half
    s.high = s.mean + half
    s.factor = wp.vec3(float(factor_xx), float(factor_yx), float(factor_yy))
    s.bulge = float(bulge)
    s.slope = wp.vec2(float(slope_x / fx), float(slope_y / fy))
    s.nearness = float(nearness)
    # |C^1/2 slope|^2, with C the outline's covariance: how much the rim and the front differ from the middle.
    tilt = slope_x * slope_x * vxx + wp.float64(2.0) * slope_x * slope_y * vxy + slope_y * slope_y * vyy
    s.farthest = float(nearness - wp.sqrt(tilt))
    s.closest = float(nearness + wp.sqrt(tilt + squared_bulge))
    return s


@wp.func
def find_fault(silhouettes: wp.array[Silhouette], lane: int, lanes: int):
    """NaN if one of a body's ellipsoids is BROKEN, else 0, for all threads of a warp."""
    fault = float(0.0)
    for k in range(lane, silhouettes.shape[0], lanes):
        if silhouettes[k].label == BROKEN:
            fault = wp.nan
    return sum_lanes(fault)


@wp.kernel
def see_ellipsoids(
    centres: wp.array2d[wp.vec3],  # (B, P) camera frame [m]
    axes: wp.array2d[wp.mat33],  # (B, P), columns
    semi_axes: wp.array2d[wp.vec3],  # (B, P) [m]
    camera: wp.array[wp.vec4],  # (B,) f_x, f_y, c_x, c_y
    part_labels: wp.array[wp.uint8],  # (P,)
    near: float,  # [m]
    perspective: bool,
    silhouettes: wp.array2d[Silhouette],  # (B, P)  OUTPUT
    extents: wp.array3d[
        wp.vec4i
    ],  # (B, 3, L) of a ``LabelTarget``, set to 0 for the picture's kernel; or empty  OUTPUT
):
    """Silhouettes of all ellipsoids."""
    b, k = wp.tid()
    silhouettes[b, k] = see_ellipsoid(
        centres[b, k], axes[b, k], semi_axes[b, k], camera[b], int(part_labels[k]), near, perspective
    )
    if extents.shape[0] > 0:
        for i in range(k, extents.shape[1] * extents.shape[2], centres.shape[1]):
            extents[b, i // extents.shape[2], i % extents.shape[2]] = wp.vec4i()


class Seen(NamedTuple):
    """B bodies of P ellipsoids as their cameras see them.

    Attributes:
        silhouettes: Silhouettes, which ``launch_see`` fills, shape (B, P).
        neighbours: Sets of ellipsoids that may hide each ellipsoid or be hidden by it, with a bit for each, shape
            (B, P, N), uint32. The gradient "coverage" fills them; for others they are empty.
        creases: Sets of ellipsoids that may meet each ellipsoid, like ``neighbours``.
    """

    silhouettes: wp.array
    neighbours: wp.array
    creases: wp.array

    @classmethod
    def empty(cls, batch: int, parts: int, device: wp.DeviceLike, *, neighbours: bool) -> "Seen":
        """Allocate for a batch, with or without the sets."""
        sets = (batch, parts, (parts + 31) // 32) if neighbours else (0, 0, 0)
        return cls(
            wp.empty((batch, parts), dtype=Silhouette, device=device),
            wp.empty(sets, dtype=wp.uint32, device=device),
            wp.empty(sets, dtype=wp.uint32, device=device),
        )


def launch_see(
    ellipsoids: Sequence[wp.array],
    part_labels: wp.array,
    *,
    near: float,
    perspective: bool,
    seen: Seen,
    extents: wp.array,
) -> None:
    """Fill the silhouettes of ``seen`` from centres, axes, semi-axes and camera; set ``extents``, if any, to 0."""
    device, shape = part_labels.device, seen.silhouettes.shape
    inputs = [*ellipsoids, part_labels, near, perspective]
    wp.launch(see_ellipsoids, shape, inputs, [seen.silhouettes, extents], device=device, block_dim=_FEW)
