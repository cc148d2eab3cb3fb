"""Costs of landmarks before cameras: distances to their keypoints, and depths relative to the first of the joints."""

from collections.abc import Sequence
from typing import Any

import warp as wp

from .mesh.screen import project_depth

wp.set_module_options({"enable_backward": False})


@wp.struct
class AimArrays:
    """Places where landmarks of M views of bodies should be."""

    places: wp.array2d[wp.int64]  # (M, K) landmark of each keypoint
    points: wp.array2d[wp.vec2]  # (M, K) keypoints in the crop, from -1 to 1
    votes: wp.array2d[float]  # (M, K) their weights
    ends: wp.array[wp.int64]  # (E + 1,) landmarks at the joints, the first one that of the pelvis
    depths: wp.array2d[float]  # (M, E) of the others relative to it [m]
    depth_weights: wp.array2d[float]  # (M, E) of their squares [1/m^2]
    half_size: float  # of the crop [px]
    perspective: int  # 0: places are not divided by depths


@wp.func
def divisor(point: wp.vec3, aims: AimArrays):
    """Depth that a point's place is divided by."""
    if aims.perspective == 0:
        return 1.0
    return project_depth(point[2])


@wp.func
def miss(ray: wp.vec2, camera: wp.vec4, aim: wp.vec2, half_size: float):
    """Vector from a keypoint to the picture of its landmark [px]."""
    return wp.vec2(
        camera[0] * ray[0] + camera[2] - (aim[0] + 1.0) * half_size,
        camera[1] * ray[1] + camera[3] - (aim[1] + 1.0) * half_size,
    )


@wp.kernel
def weigh_landmarks(
    landmarks: wp.array2d[wp.vec3],  # (M, L) before the cameras [m]
    cameras: wp.array[wp.vec4],  # (M,) f_x, f_y, c_x, c_y [px]
    aims: AimArrays,
    costs: wp.array2d[wp.vec2],  # (M, L) of keypoints [px], of depths  OUTPUT
):
    """One thread a landmark of a view."""
    m, place = wp.tid()
    point, camera = landmarks[m, place], cameras[m]
    ray = wp.vec2(point[0], point[1]) / divisor(point, aims)
    seen, deep = float(0.0), float(0.0)
    for k in range(aims.places.shape[1]):
        if int(aims.places[m, k]) == place:
            apart = miss(ray, camera, aims.points[m, k], aims.half_size)
            seen += aims.votes[m, k] * (wp.abs(apart[0]) + wp.abs(apart[1]))
    pelvis = landmarks[m, int(aims.ends[0])][2]
    for e in range(aims.depths.shape[1]):
        if int(aims.ends[e + 1]) == place:
            moved = point[2] - pelvis - aims.depths[m, e]
            deep += aims.depth_weights[m, e] * moved * moved
    costs[m, place] = wp.vec2(seen, deep)


@wp.kernel
def weigh_landmarks_adjoint(
    landmarks: wp.array2d[wp.vec3],
    cameras: wp.array[wp.vec4],
    aims: AimArrays,
    adjoints: wp.array[wp.vec2],  # (M,) of both costs
    by_landmark: wp.array2d[wp.vec3],  # (M, L)  OUTPUT
    by_camera: wp.array2d[wp.vec4],  # (M, L) shares of the cameras' gradients  OUTPUT
):
    """One thread a landmark of a view."""
    m, place = wp.tid()
    point, camera, adjoint = landmarks[m, place], cameras[m], adjoints[m]
    depth = divisor(point, aims)
    ray = wp.vec2(point[0], point[1]) / depth
    gradient, lens = wp.vec3(), wp.vec4()
    for k in range(aims.places.shape[1]):
        if int(aims.places[m, k]) == place:
            apart = miss(ray, camera, aims.points[m, k], aims.half_size)
            weight = adjoint[0] * aims.votes[m, k]
            pull = wp.vec2(slope_of(apart[0]), slope_of(apart[1])) * weight
            lens += wp.vec4(pull[0] * ray[0], pull[1] * ray[1], pull[0], pull[1])
            along = wp.cw_mul(pull, wp.vec2(camera[0], camera[1])) / depth
            back = float(0.0)
            if aims.perspective == 1 and depth == point[2]:
                back = wp.dot(along, ray)
            gradient += wp.vec3(along[0], along[1], -back)
    pelvis = int(aims.ends[0])
    for e in range(aims.depths.shape[1]):
        end = int(aims.ends[e + 1])
        if end == place or pelvis == place:
            moved = landmarks[m, end][2] - landmarks[m, pelvis][2] - aims.depths[m, e]
            force = 2.0 * adjoint[1] * aims.depth_weights[m, e] * moved
            if end == place:
                gradient += wp.vec3(0.0, 0.0, force)
            if pelvis == place:
                gradient -= wp.vec3(0.0, 0.0, force)
    by_landmark[m, place] = gradient
    by_camera[m, place] = lens


@wp.func
def slope_of(value: float):
    """Derivative of a number's magnitude, 0 at 0, NaN of NaN."""
    if value == 0.0:
        return 0.0
    return wp.sign(value) + 0.0 * value


def make_aims(arrays: Sequence[wp.array], half_size: float, perspective: bool) -> Any:
    """Aims of arrays in their order."""
    aims = AimArrays()
    names = "places", "points", "votes", "ends", "depths", "depth_weights"
    for name, array in zip(names, arrays, strict=True):
        setattr(aims, name, array)
    aims.half_size, aims.perspective = half_size, int(perspective)
    return aims


def launch_landmark_costs(inputs: Sequence[Any], costs: wp.array) -> None:
    """Fill ``costs`` from landmarks, cameras and aims."""
    wp.launch(weigh_landmarks, costs.shape, [*inputs, costs], device=costs.device)


def launch_landmark_costs_adjoint(inputs: Sequence[Any], adjoints: wp.array, gradients: Sequence[wp.array]) -> None:
    """Fill ``gradients`` with respect to landmarks and cameras."""
    wp.launch(
        weigh_landmarks_adjoint,
        gradients[0].shape,
        [*inputs, adjoints, *gradients],
        device=gradients[0].device,
    )
