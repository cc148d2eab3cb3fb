"""Flat arrows over a picture, whose colours tell the direction that it can't show."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..results.palette import DEPTH_COLOURS

_FACES = ((0, 1, 2), (0, 2, 3), (4, 5, 6))  # two triangles a shaft and one a head
_CORNERS = 7


class Arrows:
    """Arrows along x and y, coloured by z, in a picture that fills the square from -1 to 1 of the active view.

    Args:
        plotter: PyVista's.
        most: How many there can be; of more, the strongest are shown.
        longest: What the longest one measures, so that small forces at the end are seen, too.
        half_width: Of a shaft.
        strongest: Quantile of the forces that the longest arrow stands for; those beyond it are as long.
    """

    def __init__(self, plotter: Any, most: int, *, longest: float, half_width: float, strongest: float = 1.0) -> None:
        import pyvista

        pv: Any = pyvista
        self._most, self._longest, self._half_width, self._strongest = most, longest, half_width, strongest
        faces = [[3, *(_CORNERS * k + corner for corner in corners)] for k in range(most) for corners in _FACES]
        self._mesh = pv.PolyData(np.zeros((_CORNERS * most, 3)), faces=np.array(faces).ravel())
        self._mesh.cell_data["rgb"] = np.zeros((len(faces), 3), dtype=np.uint8)
        self.actor = plotter.add_mesh(self._mesh, scalars="rgb", rgb=True, lighting=False, render=False)

    def show(self, places: np.ndarray, forces: np.ndarray) -> None:
        """Point the arrows.

        Args:
            places: Where they begin, y down, shape (N, 2).
            forces: x to the right, y down and z away, shape (N, 3).
        """
        across = np.linalg.norm(forces[:, :2], axis=1)
        if len(forces) > self._most:
            chosen = np.argsort(across)[-self._most :]
            places, forces, across = places[chosen], forces[chosen], across[chosen]
        points = np.zeros((self._most, _CORNERS, 3))
        colours = np.zeros((self._most, 3))
        points[:, :, 2] = -1.0  # behind the picture: those that there is nothing for
        if count := len(forces):
            unit = max(float(np.quantile(across, self._strongest)), 1e-12)
            length = (self._longest * np.minimum(across / unit, 1.0))[:, None]
            direction = forces[:, :2] * [1, -1] / np.maximum(across, 1e-12)[:, None]
            points[:count, :, :2] = self._corners(places * [1, -1], direction, length)
            points[:count, :, 2] = 0.01
            depth = forces[:, 2:]
            share = np.clip(depth / max(float(np.quantile(np.abs(depth), self._strongest)), 1e-12), -1, 1)
            toward, across_only, away = DEPTH_COLOURS.astype(float)
            colours[:count] = np.where(share > 0, away, toward) * np.abs(share) + across_only * (1 - np.abs(share))
        self._mesh.points = points.reshape(-1, 3)
        np.asarray(self._mesh.cell_data["rgb"])[:] = np.repeat(colours, len(_FACES), axis=0)
        self._mesh.cell_data.GetScalars().Modified()

    def _corners(self, places: np.ndarray, direction: np.ndarray, length: np.ndarray) -> np.ndarray:
        """As wide as they look at any length, shape (N, 7, 2)."""
        half = self._half_width
        head, wing = np.minimum(5.5 * half, 0.6 * length), np.minimum(3.2 * half, 0.6 * length)
        side = direction[:, ::-1] * [-1, 1]
        neck, thin = places + direction * (length - head), np.minimum(half, wing)
        return np.stack(
            [
                places + side * thin, places - side * thin, neck - side * thin, neck + side * thin,
                neck - side * wing, places + direction * length, neck + side * wing,
            ],
            axis=1,
        )  # fmt: skip
