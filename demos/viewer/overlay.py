"""A picture that lies over a part of the window, for what is easier painted than built: buttons and tables."""

from __future__ import annotations

from typing import Any

import numpy as np


class Overlay:
    """A picture in a box of one of the plotter's views; it grows with the window.

    Args:
        renderer: The view.
        box: (left, bottom, right, top), 0 to 1 of the view.
        size: (width, height) of the pictures [px].
    """

    def __init__(self, renderer: Any, box: tuple[float, float, float, float], size: tuple[int, int]) -> None:
        import pyvista
        from vtkmodules.vtkRenderingCore import vtkCoordinate, vtkPolyDataMapper2D, vtkTexturedActor2D

        pv: Any = pyvista
        self.renderer, self.box, self.size = renderer, box, size
        self._image = pv.ImageData(dimensions=(*size, 1))
        self._image.point_data["rgb"] = np.full((size[0] * size[1], 3), 255, dtype=np.uint8)
        self._image.set_active_scalars("rgb")
        left, bottom, right, top = box
        corners = np.array([(left, bottom, 0), (right, bottom, 0), (right, top, 0), (left, top, 0)], dtype=np.float32)
        quad = pv.PolyData(corners, faces=[4, 0, 1, 2, 3])
        quad.active_texture_coordinates = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=np.float32)
        mapper, place = vtkPolyDataMapper2D(), vtkCoordinate()
        place.SetCoordinateSystemToNormalizedViewport()
        mapper.SetTransformCoordinate(place)
        mapper.SetInputData(quad)
        actor = vtkTexturedActor2D()
        actor.SetMapper(mapper)
        actor.SetTexture(pv.Texture(self._image))
        renderer.AddViewProp(actor)

    def show(self, picture: np.ndarray) -> None:
        """Take another picture, RGB, shape (height, width, 3), uint8."""
        np.asarray(self._image.point_data["rgb"])[:] = picture[::-1].reshape(-1, 3)
        self._image.GetPointData().GetScalars().Modified()
        self._image.Modified()

    def pixel(self, x: float, y: float) -> tuple[float, float] | None:
        """The picture's pixel (column, row from the top) at a place of the window [px, y up]; None beside it."""
        width, height = self.renderer.GetRenderWindow().GetSize()
        first_x, first_y, last_x, last_y = self.renderer.GetViewport()
        left, bottom, right, top = self.box
        across = ((x / width - first_x) / (last_x - first_x) - left) / (right - left)
        up = ((y / height - first_y) / (last_y - first_y) - bottom) / (top - bottom)
        if not (0 <= across < 1 and 0 < up <= 1):
            return None
        return across * self.size[0], (1 - up) * self.size[1]

    def place(self, column: float, row: float) -> tuple[int, int]:
        """Place of the picture's pixel in the window [px, y up]: the inverse of ``pixel``."""
        width, height = self.renderer.GetRenderWindow().GetSize()
        first_x, first_y, last_x, last_y = self.renderer.GetViewport()
        left, bottom, right, top = self.box
        across = left + (right - left) * column / self.size[0]
        up = bottom + (top - bottom) * (1 - row / self.size[1])
        return round((first_x + across * (last_x - first_x)) * width), round(
            (first_y + up * (last_y - first_y)) * height
        )
