"""Clothes of many people at once: outfits drawn beforehand, worn by whoever a batch has.

As ``garments.py`` dresses one person, with less work: cloth is moved outward along the skin's normals at rest and then
carried by the skeleton; legs in tubes are as thick as a mean person's; and a tube is one for each leg, whose faces have
the same labels whoever wears it: of two, the outer one is of the nearer leg.
"""

from __future__ import annotations

import numpy as np
import torch

from ...interop.device_cache import device_cache
from ...models.anny import anny
from ...models.model import Detailed, detailed_mesh
from ...render.part_mesh import PartMesh
from .garments import around_legs, draw_outfit, offsets
from .skin import normals
from .skirt_tubes import CORNERS, LEVELS, leg_joints, leg_radii, ring_levels, tube, tube_faces, tube_labels

_SEED = 2_811  # of the outfits, other ones than PartBench's
_NUM_OUTFITS = 256
_LEGS = ((0.5, 1.0), (0.0, 0.5))  # shares of ``tube``, of the left leg's and of the right one's


class Wardrobe:
    """Outfits on a device.

    Attributes:
        outfits: Outfits that ``draw_outfit`` returned.
        mesh: Faces of the body and of a tube around each leg, with their labels.
    """

    size = _NUM_OUTFITS

    def __init__(self, device: torch.device) -> None:
        self.outfits = outfits = [draw_outfit(np.random.default_rng([_SEED, index])) for index in range(self.size)]
        hems, rooms = zip(*map(around_legs, outfits), strict=True)
        skin = anny().rest_vertices.numpy()

        def numbers(values: np.ndarray) -> torch.Tensor:
            return torch.from_numpy(values).to(device, torch.float32)

        self._distances = numbers(np.stack([offsets(outfit) for outfit in outfits]))
        self._outward = numbers(normals(skin))
        self._hems, self._rooms = numbers(np.array(hems)), numbers(np.stack(rooms))
        self._radii = numbers(leg_radii(torch.zeros(1, anny().num_shapes), LEVELS))
        body = detailed_mesh(anny())
        around, rings = tube_faces(), np.ones((len(LEVELS), CORNERS))
        faces = [body.faces.numpy(), around + len(skin), around + len(skin) + rings.size]
        labels = [body.face_labels.numpy(), tube_labels(rings), tube_labels(0.0 * rings)]
        self.mesh = PartMesh.from_faces(np.concatenate(faces), np.concatenate(labels), device=device)

    def offsets(self, worn: torch.Tensor) -> torch.Tensor:
        """Changes of the vertices of Anny at rest by outfits ``worn`` (B,), shape (B, V, 3) [m]."""
        return self._distances[worn, :, None] * self._outward

    def vertices(self, body: Detailed, worn: torch.Tensor) -> torch.Tensor:
        """Vertices of ``mesh`` [m], shape (B, V + 2 * 25 * 48, 3), of Annys that were posed with these ``offsets``."""
        legs = leg_joints(body)
        levels = ring_levels(legs, self._hems[worn])
        places = levels * ((len(LEVELS) - 1) / LEVELS[-1])
        before = places.long().clamp(max=len(LEVELS) - 2)
        thick = torch.lerp(self._radii[before], self._radii[before + 1], places - before)
        tubes, _ = tube(legs, levels, thick + self._rooms[worn], _LEGS)
        return torch.cat([body.vertices, tubes], dim=1)


@device_cache(2)
def wardrobe(device: torch.device) -> Wardrobe:
    """The wardrobe, made once a device: that takes seconds."""
    return Wardrobe(device)
