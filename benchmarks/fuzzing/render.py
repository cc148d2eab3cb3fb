"""Both renderers: pictures, losses, and their gradients."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch

from fuzzing.chance import SIZES, Chance
from warp_partdr.cameras import Camera, Perspective, WeakPerspective
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import draw_mesh, mesh_label_loss
from warp_partdr.render.part_mesh import PartMesh


def scene(chance: Chance) -> tuple[Ellipsoids, Camera, int, int]:
    """Ellipsoids and a camera, some of whose numbers may be wrong."""
    batch, parts = chance.one([0, 1, 1, 2, 3]), chance.one([1, 2, 5, 20])
    perspective = bool(chance.rng.random() < 0.5)
    ellipsoids = Ellipsoids(
        chance.maybe(chance.tensor(batch, parts, 3, scale=0.5, shift=2.0 * perspective)),
        chance.maybe(chance.turns(batch, parts)),
        chance.maybe(chance.tensor(batch, parts, 3, scale=0.3).abs() + 0.01),
    )
    return ellipsoids, camera(chance, batch, perspective), batch, parts


def camera(chance: Chance, batch: int, perspective: bool) -> Camera:
    """One a body."""
    middle = chance.maybe(chance.tensor(batch, 2, scale=4.0, shift=6.0))
    if perspective:
        focal = chance.maybe(chance.tensor(batch, 2, scale=5.0, shift=10.0))
        return Perspective(focal, middle, chance.number(0.01, 0.1, -5.0))
    scale = chance.maybe(chance.tensor(batch, scale=5.0, shift=10.0))
    return WeakPerspective(scale, middle, chance.number(-math.inf, 0.1, -5.0))


def target_of(chance: Chance, batch: int, labels: int) -> Any:
    """A label image."""
    size = (max(batch, 1) if chance.rng.random() < 0.3 else batch, *chance.one(SIZES))
    values = chance.rng.integers(0, labels + 1, size)
    values[chance.rng.random(size) < 0.1] = 255
    return chance.maybe(torch.from_numpy(values.astype(np.uint8)).to(chance.device))


def pull_options(chance: Chance) -> dict[str, Any]:
    """Of both renderers."""
    return {"max_distance": chance.number(math.inf, 3.0), "depth_weight": chance.number(1.0, 0.0)}


def ellipsoid_options(chance: Chance) -> dict[str, Any]:
    return {
        **pull_options(chance),
        "gradient": chance.one(["edges", "coverage", "partdr", *(["exact"] if chance.spoils() else [])]),
        "samples_per_pixel": chance.number(1.0, 4.0, 100.0),
    }


def part_labels(chance: Chance, parts: int) -> Any:
    kind = chance.rng.integers(4)
    if kind < 2:
        return None
    if kind == 2:
        return chance.rng.integers(1, 6, parts).tolist()
    return chance.one([[0] * parts, [1, 2], ["a"] * parts, [255] * parts, 5, [256] * parts, [1.5] * parts])


def backward(value: torch.Tensor | None, leaves: dict[str, torch.Tensor], weights: torch.Tensor | None) -> Any:
    """Gradients of what asks for one."""
    if value is None or weights is None or not value.requires_grad:
        return None
    wanted = [leaf for leaf in leaves.values() if leaf.requires_grad]
    if not wanted:
        return None
    return torch.autograd.grad((value * (1.0 + weights.detach())).sum(), wanted, allow_unused=True)


def try_draw_ellipsoids(chance: Chance) -> Any:
    ellipsoids, seen, _, parts = scene(chance)
    image = draw_ellipsoids(
        ellipsoids,
        seen,
        chance.size(),
        part_labels=part_labels(chance, parts),
        num_maps=chance.number(int(chance.rng.integers(0, 7)), 254, 300, -2),
        **ellipsoid_options(chance),
    )
    return image, backward(image.maps, vars(ellipsoids), image.maps)


def try_ellipsoid_label_loss(chance: Chance) -> Any:
    ellipsoids, seen, batch, parts = scene(chance)
    target = target_of(chance, batch, parts)
    loss, image = ellipsoid_label_loss(
        ellipsoids,
        seen,
        target,
        part_labels=part_labels(chance, parts),
        **ellipsoid_options(chance),
    )
    return loss, image, backward(loss, vars(ellipsoids), loss)


def mesh_scene(chance: Chance) -> tuple[Any, PartMesh, Camera, int]:
    """Vertices of triangles that don't touch, their mesh, a camera, and B."""
    batch, count = chance.one([0, 1, 1, 2]), chance.one([1, 3, 8])
    perspective = bool(chance.rng.random() < 0.5)
    vertices = chance.tensor(batch, 3 * count, 3, scale=0.5, shift=2.0 * perspective)
    faces, labels = np.arange(3 * count).reshape(-1, 3), chance.rng.integers(1, 5, count)
    mesh = PartMesh.from_faces(faces, labels, device=chance.device)
    return chance.maybe(vertices), mesh, camera(chance, batch, perspective), batch


def try_draw_mesh(chance: Chance) -> Any:
    vertices, mesh, seen, _ = mesh_scene(chance)
    maps = chance.number(int(chance.rng.integers(0, 6)), 254, 300, -2)
    image = draw_mesh(vertices, mesh, seen, chance.size(), num_maps=maps, **pull_options(chance))
    return image, backward(image.maps, {"vertices": vertices}, image.maps)


def try_mesh_label_loss(chance: Chance) -> Any:
    vertices, mesh, seen, batch = mesh_scene(chance)
    target = target_of(chance, batch, mesh.num_labels)
    loss, image = mesh_label_loss(vertices, mesh, seen, target, **pull_options(chance))
    return loss, image, backward(loss, {"vertices": vertices}, loss)


def try_part_mesh(chance: Chance) -> Any:
    count = chance.one([0, 1, 4])
    faces = chance.array(chance.rng.integers(0, 9, (count, 3)))
    mesh = PartMesh.from_faces(faces, chance.array(chance.rng.integers(1, 5, count)), device=chance.device)
    labels = {k: chance.number(int(chance.rng.integers(1, 9)), 255, 300) for k in range(1, 5)}
    return mesh.edges, mesh.num_labels, mesh.num_vertices, mesh.relabel(labels).face_labels
