"""Both renderers: pictures, losses, and their gradients."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch

from fuzzing.case import SIZES, Case
from warp_partdr.cameras import Camera, Perspective, WeakPerspective
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import draw_mesh, mesh_label_loss
from warp_partdr.render.part_mesh import PartMesh


def ellipsoids_and_camera(case: Case) -> tuple[Ellipsoids, Camera, int, int]:
    """Some of their numbers may be wrong; with B and the number of parts."""
    batch, parts = case.one([0, 1, 1, 2, 3]), case.one([1, 2, 5, 20])
    perspective = case.happens(5)
    ellipsoids = Ellipsoids(
        case.maybe(case.tensor(batch, parts, 3, scale=0.5, shift=2.0 * perspective)),
        case.maybe(case.turns(batch, parts)),
        case.maybe(case.tensor(batch, parts, 3, scale=0.3).abs() + 0.01),
    )
    return ellipsoids, camera(case, batch, perspective), batch, parts


def mesh_and_camera(case: Case) -> tuple[Any, PartMesh, Camera, int]:
    """Vertices of triangles that don't touch, their mesh, a camera, and B."""
    batch, count = case.one([0, 1, 1, 2]), case.one([1, 3, 8])
    perspective = case.happens(5)
    vertices = case.maybe(case.tensor(batch, 3 * count, 3, scale=0.5, shift=2.0 * perspective))
    faces, labels = np.arange(3 * count).reshape(-1, 3), case.rng.integers(1, 5, count)
    mesh = PartMesh.from_faces(faces, labels, device=case.device)
    return vertices, mesh, camera(case, batch, perspective), batch


def camera(case: Case, batch: int, perspective: bool) -> Camera:
    middle = case.maybe(case.tensor(batch, 2, scale=4.0, shift=6.0))
    if perspective:
        focal = case.maybe(case.tensor(batch, 2, scale=5.0, shift=10.0))
        return Perspective(focal, middle, case.number(0.01, 0.1, -5.0))
    scale = case.maybe(case.tensor(batch, scale=5.0, shift=10.0))
    return WeakPerspective(scale, middle, case.number(-math.inf, 0.1, -5.0))


def target_labels(case: Case, batch: int, labels: int) -> Any:
    size = (max(batch, 1) if case.happens(3) else batch, *case.one(SIZES))
    values = case.rng.integers(0, labels + 1, size)
    values[case.rng.random(size) < 0.1] = 255
    return case.maybe(torch.from_numpy(values.astype(np.uint8)).to(case.device))


def num_maps(case: Case) -> Any:
    return case.number(case.one(range(7)), 254, 300, -2)


def mesh_options(case: Case) -> dict[str, Any]:
    return {"max_distance": case.number(math.inf, 3.0), "depth_weight": case.number(1.0, 0.0)}


def ellipsoid_options(case: Case, parts: int) -> dict[str, Any]:
    labels = [[0] * parts, [1, 2], ["a"] * parts, [255] * parts, 5, [256] * parts, [1.5] * parts]
    return {
        **mesh_options(case),
        "part_labels": case.one([None, None, case.rng.integers(1, 6, parts).tolist(), case.one(labels)]),
        "gradient": case.one(["edges", "coverage", "partdr", *(["exact"] if case.spoils() else [])]),
        "samples_per_pixel": case.number(1.0, 4.0, 100.0),
    }


def backward(value: torch.Tensor | None, *tensors: Any) -> Any:
    """Gradients of what asks for one."""
    leaves = [tensor for tensor in tensors if isinstance(tensor, torch.Tensor) and tensor.requires_grad]
    if value is None or not value.requires_grad or not leaves:
        return None
    return torch.autograd.grad((value * (1.0 + value.detach())).sum(), leaves, allow_unused=True)


def try_draw_ellipsoids(case: Case) -> Any:
    ellipsoids, seen, _, parts = ellipsoids_and_camera(case)
    image = draw_ellipsoids(ellipsoids, seen, case.size(), num_maps=num_maps(case), **ellipsoid_options(case, parts))
    return image, backward(image.maps, *vars(ellipsoids).values())


def try_ellipsoid_label_loss(case: Case) -> Any:
    ellipsoids, seen, batch, parts = ellipsoids_and_camera(case)
    target = target_labels(case, batch, parts)
    loss, image = ellipsoid_label_loss(ellipsoids, seen, target, **ellipsoid_options(case, parts))
    return loss, image, backward(loss, *vars(ellipsoids).values())


def try_draw_mesh(case: Case) -> Any:
    vertices, mesh, seen, _ = mesh_and_camera(case)
    image = draw_mesh(vertices, mesh, seen, case.size(), num_maps=num_maps(case), **mesh_options(case))
    return image, backward(image.maps, vertices)


def try_mesh_label_loss(case: Case) -> Any:
    vertices, mesh, seen, batch = mesh_and_camera(case)
    loss, image = mesh_label_loss(
        vertices, mesh, seen, target_labels(case, batch, mesh.num_labels), **mesh_options(case)
    )
    return loss, image, backward(loss, vertices)


def try_part_mesh(case: Case) -> Any:
    count = case.one([0, 1, 4])
    faces = case.array(case.rng.integers(0, 9, (count, 3)))
    mesh = PartMesh.from_faces(faces, case.array(case.rng.integers(1, 5, count)), device=case.device)
    labels = {k: case.number(case.one(range(1, 9)), 255, 300) for k in range(1, 5)}
    return mesh.edges, mesh.num_labels, mesh.num_vertices, mesh.relabel(labels).face_labels
