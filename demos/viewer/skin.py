"""The detailed body around the ellipsoids: it only takes their pose while they move, and is registered at rest."""

from __future__ import annotations

import time

import numpy as np
import torch

from ..body.parameters import BodyParameters
from ..body.posing import Posed
from ..body.template import PARENTS
from ..models.anny import anny
from ..models.model import DetailedModel
from ..models.normals import vertex_normals
from ..models.pose import pose_from_ellipbody
from ..models.registration import (
    Registered,
    RegistrationOptions,
    RegistrationWeights,
    register,
    shape_from_lengths,
)
from ..models.suit import suit_of
from ..results.shading import SKIN_COLOUR, suit_tones

_ITERATIONS = 30  # of a registration; more change nothing that can be seen
_USUAL = 1.5  # [s] that a registration takes, until one was measured


class ShownSkin:
    """Detailed body of Anny around an EllipBody.

    Attributes:
        seconds: Time that the last registration took [s], or a usual one before the first.
        rests: True if the body was registered; False if it only has the ellipsoids' pose and size.
    """

    def __init__(self, options: RegistrationOptions | None = None) -> None:
        self._options = options or RegistrationOptions(iterations=_ITERATIONS)
        self._model = anny()
        self._mean: Registered | None = None  # the mean adult; what is an edit of it may grow beyond people
        self._posed: Posed | None = None  # the body that is clothed
        usual = BodyParameters.mean(1).posed()
        self._shape, self._size = shape_from_lengths(self._model, usual), _size(usual)  # of the last one registered
        self._vertices = self._model.rest_vertices.numpy()
        self.seconds, self.rests = _USUAL, False

    @property
    def name(self) -> str:
        """Name of the model."""
        return self._model.name

    @property
    def faces(self) -> np.ndarray:
        """Faces of the surface, shape (F, 3)."""
        return self._model.faces.numpy()

    @torch.no_grad()
    def follow(self, posed: Posed) -> None:
        """Take the pose and the size of a body, unless it is clothed yet; the shape is that of the last one registered.

        Shapes from the lengths of a body on its way are often those of nobody.
        """
        if self._posed is not None and _same(self._posed, posed):
            return
        rotations, translation = pose_from_ellipbody(self._model, posed, self._shape)
        vertices, pelvis = self._model.pose(self._shape, rotations, translation).vertices[0], posed.joints[0, 0]
        self._vertices = (pelvis + (vertices - pelvis) * _size(posed) / self._size).numpy()
        self._posed, self.rests = posed, False

    def register(self, posed: Posed, *, fitted: bool) -> None:
        """Register the detailed body to a body; ``fitted`` to a photo, where single thicknesses are rough."""
        began, start, options = time.perf_counter(), None, self._options
        if fitted:
            options = RegistrationOptions(RegistrationWeights.fitted(), options.iterations)
        else:
            if self._mean is None:
                self._mean = register(BodyParameters.mean(1).posed(), self._model, options=options)
            start = self._mean
        registered = register(posed, self._model, start=start, options=options)
        self._vertices = registered.detailed.vertices[0].numpy()
        self._shape, self._size = registered.shape, _size(posed)
        self._posed, self.rests, self.seconds = posed, True, time.perf_counter() - began

    @property
    def colours(self) -> np.ndarray:
        """Colours of the vertices, RGB, shape (V, 3), uint8."""
        return suit_colours(self._model, SKIN_COLOUR)

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices in a plain suit, as in all pictures (V, 3) [m], and their normals (V, 3)."""
        worn = suit_of(self._model).put_on(torch.from_numpy(self._vertices)).numpy()
        return worn, vertex_normals(worn, self.faces).astype(np.float32)


def suit_colours(model: DetailedModel, colour: np.ndarray) -> np.ndarray:
    """Colours of the vertices of a body in its suit, RGB, shape (V, 3), uint8; ``colour`` is that of the skin."""
    tones: np.ndarray = suit_tones(suit_of(model).cloth)
    return (tones[:, None] * colour).round().astype(np.uint8)


def _size(posed: Posed) -> float:
    """Length of all bones together [m]."""
    parents = [parent + 1 for parent in PARENTS]
    return float((posed.joints[0, 1:] - posed.joints[0, parents]).norm(dim=1).sum())


def _same(one: Posed, other: Posed) -> bool:
    return all(torch.equal(old, new) for old, new in zip(vars(one).values(), vars(other).values(), strict=True))
