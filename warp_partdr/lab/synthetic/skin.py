"""Anny's skin as cloth lies on it: parts of its vertices, places along limbs, smooth normals and smooth fields."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch

from ...body.landmarks import without_side
from ...body.template import PART_NAMES
from ...models.anny import anny
from ...models.model import Detailed
from ...models.normals import vertex_normals

Limb = tuple[str, str]  # its two parts
ARM, LEG = ("upper_arm", "forearm"), ("upper_leg", "lower_leg")
JOINTS: dict[Limb, tuple[str, str, str]] = {
    ARM: ("upperarm01.L", "lowerarm01.L", "wrist.L"),
    LEG: ("upperleg01.L", "lowerleg01.L", "foot.L"),
}
_ROUNDS = 12  # rows of vertices, about, over which fields and normals are averaged


@dataclass(frozen=True)
class Skin:
    """Anny's vertices at rest; right ones are moved to the left, so that whatever depends on these treats both alike.

    Attributes:
        points: Positions [m], shape (V, 3).
        shares: Share of each kind of part ("hand", of either side) among a vertex' faces, shape (V,) each.
        places: Place along ``ARM`` and ``LEG``, 0 to 2 from first to last joint, shape (V,) each.
    """

    points: np.ndarray
    shares: dict[str, np.ndarray]
    places: dict[Limb, np.ndarray]


@lru_cache(maxsize=1)
def anny_skin() -> Skin:
    """Skin of a mean Anny, found once."""
    model = anny()
    rest = model.rest(torch.zeros(1, model.num_shapes))
    points = rest.vertices[0].numpy().astype(np.float64)
    points[:, 0] = np.abs(points[:, 0])
    counts = np.zeros((len(points), len(PART_NAMES)))
    np.add.at(counts, (model.faces.numpy(), model.face_parts.numpy()[:, None] - 1), 1.0)
    counts /= counts.sum(1, keepdims=True)
    shares = {without_side(name): np.zeros(len(points)) for name in PART_NAMES}
    for column, name in zip(counts.T, PART_NAMES, strict=True):
        shares[without_side(name)] += column
    return Skin(points, shares, {limb: along(points, *joints(rest, limb)[0].numpy())[0] for limb in JOINTS})


def joints(body: Detailed, limb: Limb, side: str = "L") -> torch.Tensor:
    """Three joints of a limb, shape (B, 3, 3) [m]; ``side`` is "L" or "R"."""
    names = anny().joint_names
    return body.joints[:, [names.index(name[:-1] + side) for name in JOINTS[limb]]]


def along(points: np.ndarray, start: np.ndarray, middle: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places of points (N, 3) along a limb of three joints, 0 to 2, and distances from its axis [m], each (N,)."""
    first, second = (
        np.clip((points - base) @ bone / (bone @ bone), 0.0, 1.0)
        for base, bone in ((start, middle - start), (middle, end - middle))
    )
    axis = start + first[:, None] * (middle - start) + second[:, None] * (end - middle)
    return first + second, np.linalg.norm(points - axis, axis=1)


def normals(vertices: np.ndarray) -> np.ndarray:
    """Outward unit vectors of Anny's vertices (V, 3), averaged as ``smooth`` does, shape (V, 3)."""
    return _unit(smooth(vertex_normals(vertices, anny().faces.numpy())))


def smooth(values: np.ndarray) -> np.ndarray:
    """Values of Anny's vertices, (V,) or (V, N), averaged with their neighbours', again and again."""
    (one, other), size = _edges(), len(values)
    counts = np.bincount(one, minlength=size)
    columns = list(values.reshape(size, -1).T)
    for _ in range(_ROUNDS):
        columns = [np.bincount(one, column[other], size) / counts for column in columns]
    return np.column_stack(columns).reshape(values.shape)


@lru_cache(maxsize=1)
def _edges() -> np.ndarray:
    """Pairs of vertices that an edge of Anny joins, in both orders, and each with itself, shape (2, E)."""
    faces, size = anny().faces.numpy().astype(np.int64), anny().num_vertices
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    alone = np.repeat(np.arange(size), 2).reshape(-1, 2)
    return np.unique(np.concatenate([pairs, pairs[:, ::-1], alone]), axis=0).T


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True).clip(1e-12)
