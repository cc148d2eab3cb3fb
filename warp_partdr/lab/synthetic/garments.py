"""Clothes of PartBench's people: garments drawn at random, worn around Anny's mesh, labelled as the parts beneath.

Cloth is a copy of the body's mesh, moved outward along its normals, and a tube around both legs for skirts and coats.
The body stays inside, so that clothes only ever hide it. Cloth neither hangs nor folds under its weight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch

from ...models.anny import anny
from ...models.model import Detailed, detailed_mesh
from ...render.part_mesh import PartMesh
from .skin import ARM, LEG, anny_skin, normals, smooth
from .skirt_tubes import LEVELS, leg_joints, leg_radii, ring_levels, tube, tube_faces, tube_labels

_TRUNK = ("hip", "abdomen", "chest", "shoulder")

# Waves of cloth: their number, their lengths [m], and the share of the thickness that they take away at most.
_WAVES, _LENGTHS, _DEPTH = 6, (0.08, 0.4), 0.6

# Hair grows behind a plane from the hairline past the ears to the nape: its height before the ears [m] and depth there
# [m], its rise, and the height where short hair ends [m], all of ``anny_skin``.
_EAR, _RISE, _NAPE = (0.60, 0.03), 1.0, 0.58


@dataclass(frozen=True)
class Garment:
    """Kind of garment, whose values are drawn uniformly from ranges."""

    slot: str  # a person wears at most one garment of a slot
    chance: float
    thickness: tuple[float, float]  # [m], its largest distance from the skin
    sleeve: tuple[float, float] = (0.0, 0.0)  # where it ends: 0 shoulder, 1 elbow, 2 wrist
    hem: tuple[float, float] = (0.0, 0.0)  # where it ends: 0 hip, 1 knee, 2 ankle
    flare: tuple[float, float] | None = None  # [m] a thigh's length, by which a tube widens; None: no tube
    parts: tuple[str, ...] = ()  # that it covers whole


GARMENTS: dict[str, Garment] = {
    "top": Garment("upper", 0.65, (0.005, 0.035), sleeve=(0.3, 1.95), hem=(0.05, 0.35), parts=_TRUNK),
    "coat": Garment("upper", 0.25, (0.02, 0.06), sleeve=(1.6, 2.0), hem=(0.3, 1.4), flare=(0.0, 0.06), parts=_TRUNK),
    "trousers": Garment("lower", 0.65, (0.005, 0.04), hem=(0.4, 1.97), parts=("hip",)),
    "skirt": Garment("lower", 0.3, (0.01, 0.04), hem=(0.5, 1.7), flare=(0.0, 0.12), parts=("hip",)),
    "hair": Garment("hair", 0.5, (0.01, 0.04)),
    "long hair": Garment("hair", 0.4, (0.02, 0.05)),
    "shoes": Garment("feet", 0.85, (0.005, 0.03), parts=("foot",)),
}


@dataclass(frozen=True)
class Worn:
    """Garment that somebody wears."""

    name: str  # a key of ``GARMENTS``
    thickness: float  # [m]
    sleeve: float
    hem: float
    flare: float  # [m]
    waves: np.ndarray  # wave vectors [rad/m] and phases [rad], shape (6, 4)


def draw_outfit(rng: np.random.Generator) -> tuple[Worn, ...]:
    """Garments of a person, at most one of each slot."""
    lots = {slot: rng.random() for slot in dict.fromkeys(garment.slot for garment in GARMENTS.values())}
    outfit = []
    for name, garment in GARMENTS.items():
        ranges = (garment.thickness, garment.sleeve, garment.hem, garment.flare or (0.0, 0.0))
        thickness, sleeve, hem, flare = (rng.uniform(*between) for between in ranges)
        ways = rng.standard_normal((_WAVES, 3))
        lengths = rng.uniform(*_LENGTHS, _WAVES)
        ways *= 2.0 * np.pi / (lengths * np.linalg.norm(ways, axis=1))[:, None]
        waves = np.column_stack([ways, rng.uniform(0.0, 2.0 * np.pi, _WAVES)])
        if 0.0 <= lots[garment.slot] < garment.chance:
            outfit.append(Worn(name, thickness, sleeve, hem, flare, waves))
        lots[garment.slot] -= garment.chance
    return tuple(outfit)


def dress(body: Detailed, shape: torch.Tensor, outfit: tuple[Worn, ...]) -> tuple[np.ndarray, PartMesh]:
    """Mesh of a body and of the clothes around it.

    Args:
        body: Anny, B = 1, any frame [m].
        shape: Shape values of the body, shape (1, 20).
        outfit: Outfit that ``draw_outfit`` returned.

    Returns:
        Vertices [m], float32: the V of the body, the same moved out to the clothes, and those of a tube around the
        legs; and the faces with their labels.
    """
    skin = body.vertices[0].numpy()
    cloth = skin + offsets(outfit)[:, None] * normals(skin)
    hem, room = around_legs(outfit)
    legs = leg_joints(body).double()
    levels = ring_levels(legs, legs.new_tensor([hem]))
    around, of_left = tube(legs, levels, torch.from_numpy(leg_radii(shape, levels[0].numpy()) + room)[None])
    mesh, labels = _faces(), tube_labels(of_left[0].numpy())
    kept = mesh.face_labels[: -len(labels)]
    mesh = replace(mesh, face_labels=torch.cat([kept, torch.from_numpy(labels)]))
    return np.concatenate([skin, cloth, around[0].numpy()]).astype(np.float32), mesh


def around_legs(outfit: tuple[Worn, ...]) -> tuple[float, np.ndarray]:
    """Hem of the tube around both legs, 0 for none, and its distance from the legs at each of ``LEVELS``, (25,) [m]."""
    tubes = [worn for worn in outfit if GARMENTS[worn.name].flare is not None]
    hem = max((worn.hem for worn in tubes), default=0.0)
    room = np.zeros(len(LEVELS))
    for worn in tubes:
        room = np.maximum(room, (worn.thickness + worn.flare * np.minimum(LEVELS, hem)) * (worn.hem >= LEVELS))
    return hem, room


def offsets(outfit: tuple[Worn, ...]) -> np.ndarray:
    """Distances from Anny's skin to the outermost garment, shape (V,) [m]."""
    outermost = np.zeros(anny().num_vertices)
    for worn in outfit:
        outermost = np.maximum(outermost, worn.thickness * _waves(worn) * smooth(covered_by(worn)))
    return outermost


def covered_by(worn: Worn) -> np.ndarray:
    """Share of each vertex that a garment covers, before its borders are made smooth, shape (V,)."""
    skin, garment = anny_skin(), GARMENTS[worn.name]
    if garment.slot == "hair":
        behind = is_hairy(skin.points, -np.inf if worn.name == "long hair" else _NAPE)
        return behind * (skin.shares["head"] + skin.shares["neck"])
    covered = sum((skin.shares[part] for part in garment.parts), np.zeros(len(skin.points)))
    for limb, end in ((ARM, worn.sleeve), (LEG, worn.hem)):
        covered += sum(skin.shares[part] for part in limb) * (skin.places[limb] < end)
    return covered


def is_hairy(points: np.ndarray, lowest: float = _NAPE) -> np.ndarray:
    """True behind the hairline and above ``lowest`` [m], of points of Anny's head at rest (N, 3), shape (N,)."""
    _, height, depth = points.T
    return (height > lowest) & (depth - _EAR[1] < _RISE * (height - _EAR[0]))


def _waves(worn: Worn) -> np.ndarray:
    """Share of its thickness that a garment has at each vertex, 0.4 to 1, shape (V,)."""
    phases = anny_skin().points @ worn.waves[:, :3].T + worn.waves[:, 3]
    return 1.0 - _DEPTH * (0.5 + 0.5 * np.cos(phases).mean(1))


@lru_cache(maxsize=1)
def _faces() -> PartMesh:
    """Faces of ``dress``, whose last ones, the tube's, have labels of no meaning yet."""
    body, around = detailed_mesh(anny()), tube_faces()
    faces, parts, size = body.faces.numpy(), body.face_labels.numpy(), anny().num_vertices
    return PartMesh.from_faces(
        np.concatenate([faces, faces + size, around + 2 * size]),
        np.concatenate([parts, parts, np.ones(len(around), dtype=np.uint8)]),
    )
