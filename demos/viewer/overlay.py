"""Pictures in the window: textures that change, and painted boxes over a view, such as buttons and tables."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .style import PAPER


class Texture:
    """A texture of (width, height) pixels whose picture changes in place."""

    def __init__(self, size: tuple[int, int]) -> None:
        pv = import_module("pyvista")
        self._size, self._shown = size, np.zeros(0)
        self.image = pv.ImageData(dimensions=(*size, 1))
        self.image.point_data["rgb"] = np.full((size[0] * size[1], 3), 255, dtype=np.uint8)
        self.image.set_active_scalars("rgb")
        self.texture = pv.Texture(self.image)

    def show(self, picture: np.ndarray) -> None:
        """Take another picture of any size, RGB, shape (height, width, 3), uint8, unless it is there yet."""
        if picture is self._shown:
            return
        self._shown = picture
        columns, rows = (
            ((np.arange(size) + 0.5) * (has / size)).astype(int)
            for size, has in zip(self._size, picture.shape[1::-1], strict=True)
        )
        # VTK's rows go up.
        np.asarray(self.image.point_data["rgb"])[:] = picture[rows[::-1]][:, columns].reshape(-1, 3)
        self.image.GetPointData().GetScalars().Modified()
        self.image.Modified()


class Overlay:
    """A painted box over one of the plotter's views; it grows with the window.

    ``corner`` is the lower left one in a view of (width, height) ``view``, in a window of the usual size; the box is
    painted with letters of a size there [px].
    """

    def __init__(
        self, renderer: Any, view: tuple[int, int], corner: tuple[int, int], size: tuple[int, int], letter: int
    ) -> None:
        pv = import_module("pyvista")
        from vtkmodules.vtkRenderingCore import vtkCoordinate, vtkPolyDataMapper2D, vtkTexturedActor2D

        self._renderer, self._size = renderer, np.array(size)
        self._low, self._high = np.array(corner) / view, (np.array(corner) + size) / view
        self._picture = Image.new("RGB", size, PAPER)
        self.draw, self.font = ImageDraw.Draw(self._picture), ImageFont.load_default(letter)
        self._texture = Texture(size)
        (left, bottom), (right, top) = self._low, self._high
        corners = np.array([(left, bottom, 0), (right, bottom, 0), (right, top, 0), (left, top, 0)], dtype=np.float32)
        quad = pv.PolyData(corners, faces=[4, 0, 1, 2, 3])
        quad.active_texture_coordinates = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=np.float32)
        mapper, coordinate, actor = vtkPolyDataMapper2D(), vtkCoordinate(), vtkTexturedActor2D()
        coordinate.SetCoordinateSystemToNormalizedViewport()
        mapper.SetTransformCoordinate(coordinate)
        mapper.SetInputData(quad)
        actor.SetMapper(mapper)
        actor.SetTexture(self._texture.texture)
        renderer.AddViewProp(actor)

    def paste(self, picture: np.ndarray, corner: tuple[int, int]) -> None:
        """Paint a picture, RGB, shape (height, width, 3), uint8, whose upper left is at a place."""
        self._picture.paste(Image.fromarray(picture), corner)

    def show(self) -> None:
        """Show what is painted."""
        self._texture.show(np.asarray(self._picture))

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Column, and row from the top, of a place in the window [px, y up]."""
        position = (np.array([x, y]) - self._renderer.GetOrigin()) / self._renderer.GetSize()
        column, up = (position - self._low) / (self._high - self._low) * self._size
        return column, self._size[1] - up
