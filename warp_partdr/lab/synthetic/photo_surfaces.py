"""Surfaces that the pixels of people's pictures show: whose they are, their pieces of clothing, places and normals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F

from ...interop.device_cache import device_cache
from ...models.anny import anny
from ...render.mesh import PartImage
from .garments import GARMENTS, Worn, covered_by
from .shading import DARK_FACE, HAIR_FACE, face_features
from .skirt_tubes import CORNERS, LEVELS
from .training_people import DressedPeople
from .wardrobe import wardrobe

SKIN, UPPER, LOWER, HAIR, FEET, DARK = range(6)  # pieces; dark are eyes and mouth
NUM_PIECES = 6
_SLOTS = {"upper": UPPER, "lower": LOWER, "hair": HAIR, "feet": FEET}  # pieces of ``Garment.slot``
_OVER = 0.5  # share of a vertex from which on a garment covers it
_TUBE_RADIUS, _TUBE_STEP = 0.2, 0.04  # [m], of the tubes' places
_NEAREST = 1e-3  # [m], least depth that is divided by
_BEHIND = 0.3  # of a normal along the view: it looks away, by rounding


@dataclass(frozen=True)
class PixelSurface:
    """N pixels in which people of a batch are seen.

    Attributes:
        person: Index of the person, shape (N,), int64.
        row: Row of the pixel, shape (N,), int64.
        column: Column of the pixel, shape (N,), int64.
        piece: Piece of clothing, or skin, shape (N,), int64.
        place: Place on the body at rest, for textures [m], shape (N, 3).
        normal: Outward unit vector, in a frame that has the camera's axes, shape (N, 3).
    """

    person: torch.Tensor
    row: torch.Tensor
    column: torch.Tensor
    piece: torch.Tensor
    place: torch.Tensor
    normal: torch.Tensor

    def of_pieces(self, values: torch.Tensor) -> torch.Tensor:
        """Values of each person's pieces, shape (B, 6, ...), at the pixels, shape (N, ...)."""
        return values[self.person, self.piece]


@dataclass(frozen=True)
class ClothesTables:
    """Tables of the wardrobe's mesh."""

    faces: torch.Tensor  # (F, 3), int64
    pieces: torch.Tensor  # piece of each vertex of each outfit, (O, V), int64
    features: torch.Tensor  # ``HAIR`` and ``DARK`` of faces of the head, else 0, (F,), int64
    places: torch.Tensor  # of the vertices of a mean person at rest [m], (V, 3)


@device_cache(2)
def clothes_tables(device: torch.device) -> ClothesTables:
    """Tables of the wardrobe on a device, made once."""
    clothes, model = wardrobe(device), anny(device)
    found = face_features()
    features = torch.zeros(len(clothes.mesh.faces), dtype=torch.int64)
    features[: len(found)] = torch.from_numpy(np.select([found == HAIR_FACE, found == DARK_FACE], [HAIR, DARK], 0))
    rest = model.rest(torch.zeros(1, model.num_shapes, device=device)).vertices[0]
    places = torch.cat([rest, *[_tube_places().to(rest)] * 2])
    pieces = torch.from_numpy(np.stack([outfit_pieces(outfit) for outfit in clothes.outfits]))
    return ClothesTables(clothes.mesh.faces.long(), pieces.to(device), features.to(device), places)


def _tube_places() -> torch.Tensor:
    """Places of a tube's vertices for textures, those of an upright one [m]."""
    corner = torch.arange(CORNERS * len(LEVELS))
    angle = 2 * math.pi * (corner % CORNERS) / CORNERS
    down = -_TUBE_STEP * corner.div(CORNERS, rounding_mode="floor")
    return torch.stack([_TUBE_RADIUS * angle.cos(), down, _TUBE_RADIUS * angle.sin()], dim=-1)


def outfit_pieces(outfit: Sequence[Worn]) -> np.ndarray:
    """Piece of each vertex of the wardrobe's mesh under an outfit, shape (V,), int64.

    An upper garment lies over trousers and skirts, shoes over all. The tubes around the legs belong to the skirt, or to
    a coat without a skirt.
    """
    skin = np.full(anny().num_vertices, SKIN)
    for worn in outfit:
        piece = _SLOTS[GARMENTS[worn.name].slot]
        over = covered_by(worn) > _OVER
        skin[over & (skin == SKIN) if piece == LOWER else over] = piece
    names = {worn.name for worn in outfit}
    tubes = UPPER if "coat" in names and "skirt" not in names else LOWER
    return np.concatenate([skin, np.full(2 * CORNERS * len(LEVELS), tubes)])


def surface_of(
    tables: ClothesTables, people: DressedPeople, screen: torch.Tensor, drawn: PartImage, bald: torch.Tensor
) -> PixelSurface:
    """PixelSurface at each pixel of a picture that shows somebody.

    On CUDA, normals are sums in an order that varies, so they are equal up to rounding from run to run.

    Args:
        tables: Tables of the wardrobe that the people wear clothes of.
        people: People of the picture.
        screen: Vertices in the picture [px] and depth [m], shape (B, V, 3).
        drawn: Picture of them.
        bald: Flags of people whose heads are bald unless their outfit has hair, shape (B,), bool.
    """
    person, row, column = torch.nonzero(drawn.face_index >= 0, as_tuple=True)
    face = drawn.face_index[person, row, column].long()
    corners = tables.faces[face]
    middle = torch.stack([column, row], dim=-1) + 0.5
    shares = _corner_shares(screen[person[:, None], corners], middle)
    normals = _vertex_normals(people.vertices, tables.faces)
    normal = F.normalize((normals[person[:, None], corners] * shares[..., None]).sum(1), dim=-1)
    nearest = corners.gather(1, shares.argmax(1, keepdim=True))[:, 0]
    piece, feature = tables.pieces[people.worn[person], nearest], tables.features[face]
    grown = (feature == DARK) | ((feature == HAIR) & ~bald[person])
    piece = torch.where(grown & (piece == SKIN), feature, piece)
    place = (tables.places[corners] * shares[..., None]).sum(1)
    return PixelSurface(person, row, column, piece, place, normal)


def facing(normals: torch.Tensor) -> torch.Tensor:
    """Normals (N, 3), of which those that look away from the camera are turned toward it."""
    away = (normals[:, 2:] > _BEHIND) & (torch.arange(3, device=normals.device) == 2)
    return torch.where(away, -normals, normals)


def _corner_shares(corners: torch.Tensor, middle: torch.Tensor) -> torch.Tensor:
    """Shares of a face's corners (N, 3, 3) [px and m] at a pixel's middle (N, 2), in perspective, shape (N, 3)."""
    first, second, third = corners[..., :2].unbind(1)
    opposite = ((second, third), (third, first), (first, second))
    areas = torch.stack([_cross(one - middle, other - middle) for one, other in opposite], dim=-1)
    flat = areas / _cross(second - first, third - first)[:, None]
    near = flat.clamp(0, 1) / corners[..., 2].clamp_min(_NEAREST)
    return near / near.sum(-1, keepdim=True).clamp_min(1e-9)


def _cross(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


def _vertex_normals(vertices: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    """Normals of vertices (B, V, 3), weighted by the areas of the faces around them, unit vectors, shape (B, V, 3)."""
    first, second, third = vertices[:, faces].unbind(2)
    of_faces = torch.linalg.cross(second - first, third - first)
    normals = torch.zeros_like(vertices)
    for corner in range(3):
        normals.index_add_(1, faces[:, corner], of_faces)
    return F.normalize(normals, dim=-1)
