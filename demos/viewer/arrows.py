"""Flat arrows over a picture, whose colours tell the direction that it can't show."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from ..results.palette import DEPTH_COLOURS

_FACES = np.array([(0, 1, 2), (0, 2, 3), (4, 5, 6)])  # two triangles a shaft and one a head
_CORNERS = 7


class Arrows:
    """Arrows along x and y, coloured by z, in a picture that fills the square from -1 to 1 of the active view.

    At most ``most`` are shown, the strongest. The length ``longest`` stands for the quantile ``strongest`` of the
    forces that were measured last, and stronger ones are as long. So arrows shrink as a pull shrinks.
    """

    def __init__(self, plotter: Any, most: int, *, longest: float, half_width: float, strongest: float = 1.0) -> None:
        self._most, self._longest, self._half_width, self._strongest = most, longest, half_width, strongest
        faces = (_FACES + _CORNERS * np.arange(most)[:, None, None]).reshape(-1, 3)
        self._units = 1.0, 1.0  # forces, in the picture and along z, that the longest arrow and full colours stand for
        self._mesh = import_module("pyvista").PolyData.from_regular_faces(np.zeros((_CORNERS * most, 3)), faces)
        self._mesh.cell_data["rgb"] = np.zeros((len(faces), 3), dtype=np.uint8)
        self.actor = plotter.add_mesh(self._mesh, scalars="rgb", rgb=True, lighting=False, render=False)

    def measure(self, forces: np.ndarray) -> None:
        """Take forces (N, 3) as the scale of those that are shown from now on."""
        if len(forces):
            self._units = self._unit(np.linalg.norm(forces[:, :2], axis=1)), self._unit(np.abs(forces[:, 2]))

    def show(self, places: np.ndarray, forces: np.ndarray) -> None:
        """Point the arrows from places (N, 2), y down, along forces (N, 3), y down and z away."""
        across = np.linalg.norm(forces[:, :2], axis=1)
        chosen = np.argsort(across)[-self._most :]
        places, forces, across = places[chosen], forces[chosen], across[chosen]
        points = np.full((self._most, _CORNERS, 3), -1.0)  # behind the picture: those that there is nothing for
        colours = np.zeros((self._most, 3))
        if count := len(forces):
            length = self._longest * np.minimum(across / self._units[0], 1.0)
            direction = forces[:, :2] * [1, -1] / np.maximum(across, 1e-12)[:, None]
            points[:count, :, :2] = self._corners(places * [1, -1], direction, length)
            points[:count, :, 2] = 0.01
            share = np.clip(forces[:, 2] / self._units[1], -1, 1)
            colours[:count] = np.stack([np.interp(share, (-1, 0, 1), channel) for channel in DEPTH_COLOURS.T], axis=1)
        self._mesh.points = points.reshape(-1, 3)
        np.asarray(self._mesh.cell_data["rgb"])[:] = np.repeat(colours, len(_FACES), axis=0)
        self._mesh.cell_data.GetScalars().Modified()

    def _unit(self, sizes: np.ndarray) -> float:
        return max(float(np.quantile(sizes, self._strongest)), 1e-12)

    def _corners(self, places: np.ndarray, direction: np.ndarray, length: np.ndarray) -> np.ndarray:
        """Corners of arrows, shape (N, 7, 2); they are as wide at any length, except the shortest."""
        half, zero = self._half_width, np.zeros_like(length)
        head, wing = np.minimum(5.5 * half, 0.6 * length), np.minimum(3.2 * half, 0.6 * length)
        neck, thin = length - head, np.minimum(half, wing)
        along = np.stack([zero, zero, neck, neck, neck, length, neck], axis=1)[..., None]
        aside = np.stack([thin, -thin, -thin, thin, -wing, zero, wing], axis=1)[..., None]
        return places[:, None] + along * direction[:, None] + aside * (direction[:, ::-1] * [-1, 1])[:, None]
