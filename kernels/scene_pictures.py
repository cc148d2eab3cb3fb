"""Pelvises of a scene's bodies in the world, and their vertices in each of its pictures.

People who are not seen in a picture are behind its camera.

Body ``p T + t`` is person p in frame t. People who may hide one another are a cluster: picture ``(k T + t) V + v`` is
that of cluster k in frame t and view v, and holds its people in slots, one after another.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from .launch import launch_shared
from .mesh.screen import project_depth

wp.set_module_options({"enable_backward": False})


@wp.struct
class SceneViews:
    """V views of N bodies."""

    rotations: wp.array[wp.mat33]  # (V,) world to camera
    translations: wp.array[wp.vec3]  # (V,) the same [m]
    lenses: wp.array[wp.vec3]  # (K T V,) focal length and principal point of the pictures' crops, in half-sides
    shown: wp.array2d[wp.bool]  # (N, V)
    slots: wp.array2d[int]  # (K, C) who is in each, -1 where nobody is
    places: wp.array[wp.vec2i]  # (P,) cluster and slot of each person, -1 of those who are in none
    half_size: float  # of the pictures [px]


@wp.func
def camera_of(lens: wp.vec3, half_size: float):
    """Focal length and principal point [px]."""
    return half_size * wp.vec3(lens[0], lens[1] + 1.0, lens[2] + 1.0)


@wp.struct
class PelvisViews:
    """Views of the crops in which N pelvises are placed."""

    lenses: wp.array[wp.vec3]  # (N,)
    rotations: wp.array[wp.mat33]  # (N,) world to camera
    translations: wp.array[wp.vec3]  # (N,) the same [m]


@wp.func
def ray_to(shift: wp.vec2, lens: wp.vec3):
    """Ray through the pelvis, whose length is the distance times its scale."""
    return wp.vec3(shift[0] - lens[1], shift[1] - lens[2], lens[0])


@wp.kernel
def place_pelvises(
    log_scale: wp.array[float],  # (N,)
    shift: wp.array[wp.vec2],  # (N,)
    views: PelvisViews,
    pelvises: wp.array[wp.vec3],  # (N,) in the world [m]  OUTPUT
):
    """One thread a body."""
    i = wp.tid()
    seen = ray_to(shift[i], views.lenses[i]) / wp.exp(log_scale[i])
    pelvises[i] = wp.transpose(views.rotations[i]) * (seen - views.translations[i])


@wp.kernel
def place_pelvises_adjoint(
    log_scale: wp.array[float],
    shift: wp.array[wp.vec2],
    views: PelvisViews,
    adjoint: wp.array[wp.vec3],  # (N,)
    by_scale: wp.array[float],  # (N,)  OUTPUT
    by_shift: wp.array[wp.vec2],  # (N,)  OUTPUT
):
    """One thread a body."""
    i = wp.tid()
    pull = views.rotations[i] * adjoint[i] / wp.exp(log_scale[i])
    by_scale[i] = -wp.dot(ray_to(shift[i], views.lenses[i]), pull)
    by_shift[i] = wp.vec2(pull[0], pull[1])


@wp.kernel
def place_scene(
    vertices: wp.array2d[wp.vec3],  # (N, n) about the pelvis [m]
    pelvises: wp.array[wp.vec3],  # (N,) in the world [m]
    views: SceneViews,
    first: int,  # picture of the first thread
    screen: wp.array2d[wp.vec3],  # (K T V, C n) u [px], v [px], z [m]  OUTPUT
):
    """One thread a vertex of a picture."""
    picture, column = wp.tid()
    picture += first
    count, num_views = vertices.shape[1], views.rotations.shape[0]
    frames, row, slot = vertices.shape[0] // views.places.shape[0], picture // num_views, column // count
    view, cluster = picture - row * num_views, row // frames
    person = views.slots[cluster, slot]
    body = wp.max(person, 0) * frames + row - cluster * frames
    if person < 0 or not views.shown[body, view]:
        screen[picture, column] = wp.vec3(0.0, 0.0, -1.0)
        return
    world = vertices[body, column - slot * count] + pelvises[body]
    seen = views.rotations[view] * world + views.translations[view]
    camera, depth = camera_of(views.lenses[picture], views.half_size), project_depth(seen[2])
    screen[picture, column] = wp.vec3(
        camera[0] * seen[0] / depth + camera[1], camera[0] * seen[1] / depth + camera[2], seen[2]
    )


@wp.kernel
def place_scene_adjoint(
    vertices: wp.array2d[wp.vec3],
    pelvises: wp.array[wp.vec3],
    views: SceneViews,
    adj_screen: wp.array2d[wp.vec3],  # (K T V, C n)
    first: int,  # body of the first thread
    gradient: wp.array2d[wp.vec3],  # (N, n) of the vertices, whose sums are the pelvises'  OUTPUT
):
    """One thread a vertex of a body, which adds its pictures in their order."""
    body, i = wp.tid()
    body += first
    count, num_views = vertices.shape[1], views.rotations.shape[0]
    frames = vertices.shape[0] // views.places.shape[0]
    person = body // frames
    place = views.places[person]
    pictures = (place[0] * frames + body - person * frames) * num_views
    world = vertices[body, i] + pelvises[body]
    pull = wp.vec3()
    for view in range(num_views):
        if place[0] >= 0 and views.shown[body, view]:
            picture = pictures + view
            adjoint = adj_screen[picture, place[1] * count + i]
            seen = views.rotations[view] * world + views.translations[view]
            focal, depth = camera_of(views.lenses[picture], views.half_size)[0], project_depth(seen[2])
            along = wp.vec3(adjoint[0] * focal / depth, adjoint[1] * focal / depth, adjoint[2])
            if depth == seen[2]:
                along[2] -= (along[0] * seen[0] + along[1] * seen[1]) / depth
            pull += wp.transpose(views.rotations[view]) * along
    gradient[body, i] = pull


def gather_views(arrays: Sequence[wp.array], half_size: float) -> Any:
    """Views of arrays in their order."""
    views = SceneViews()
    for name, array in zip(("rotations", "translations", "lenses", "shown", "slots", "places"), arrays, strict=True):
        setattr(views, name, array)
    views.half_size = half_size
    return views


def launch_place(inputs: Sequence[Any], screen: wp.array) -> None:
    """Fill ``screen`` from vertices, pelvises and views."""
    launch_shared(place_scene, screen.shape, inputs, [screen])


def launch_place_adjoint(inputs: Sequence[Any], adjoint: wp.array, gradient: wp.array) -> None:
    """Fill the ``gradient`` with respect to vertices from the ``adjoint`` of what ``launch_place`` filled."""
    launch_shared(place_scene_adjoint, gradient.shape, [*inputs, adjoint], [gradient])


def launch_pelvises(numbers: Sequence[wp.array], views: Sequence[wp.array], pelvises: wp.array) -> None:
    """Fill ``pelvises`` from logarithms of scales and shifts, by lenses, rotations and translations."""
    wp.launch(place_pelvises, pelvises.shape, [*numbers, _pelvis_views(views), pelvises], device=pelvises.device)


def launch_pelvises_adjoint(
    numbers: Sequence[wp.array], views: Sequence[wp.array], adjoint: wp.array, gradients: Sequence[wp.array]
) -> None:
    """Fill ``gradients`` with respect to the numbers from the ``adjoint`` of what ``launch_pelvises`` filled."""
    inputs = [*numbers, _pelvis_views(views), adjoint, *gradients]
    wp.launch(place_pelvises_adjoint, adjoint.shape, inputs, device=adjoint.device)


def _pelvis_views(arrays: Sequence[wp.array]) -> Any:
    views = PelvisViews()
    views.lenses, views.rotations, views.translations = arrays
    return views
