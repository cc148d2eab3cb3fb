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
        shown = np.asarray(self.image.point_data["rgb"])
        if picture.shape[1::-1] == self._size:
            shown[:] = picture[::-1].reshape(-1, 3)  # VTK's rows go up
        else:
            columns, rows = (
                ((np.arange(size) + 0.5) * (has / size)).astype(int)
                for size, has in zip(self._size, picture.shape[1::-1], strict=True)
            )
            shown[:] = picture[rows[::-1]][:, columns].reshape(-1, 3)
        self.image.GetPointData().GetScalars().Modified()
        self.image.Modified()


class Overlay:
    """A painted picture that fills a view; it is painted anew when the view has another size."""

    def __init__(self, renderer: Any) -> None:
        pv = import_module("pyvista")
        from vtkmodules.vtkRenderingCore import vtkCoordinate, vtkPolyDataMapper2D, vtkTexturedActor2D

        self._renderer = renderer
        corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=np.float32)
        quad = pv.PolyData(corners, faces=[4, 0, 1, 2, 3])
        quad.active_texture_coordinates = corners[:, :2]
        mapper, coordinate, self._actor = vtkPolyDataMapper2D(), vtkCoordinate(), vtkTexturedActor2D()
        coordinate.SetCoordinateSystemToNormalizedViewport()
        mapper.SetTransformCoordinate(coordinate)
        mapper.SetInputData(quad)
        self._actor.SetMapper(mapper)
        renderer.AddViewProp(self._actor)
        self.begin((1, 1), 8)

    def begin(self, size: tuple[int, int], letter: float) -> None:
        """Begin an empty picture of (width, height) pixels, which is that of the view, with letters of a size [px]."""
        self.size = size
        self._picture = Image.new("RGB", size, PAPER)
        self.draw, self.font = ImageDraw.Draw(self._picture), ImageFont.load_default(letter)
        self._texture = Texture(size)
        self._actor.SetTexture(self._texture.texture)

    def paste(self, picture: np.ndarray, corner: tuple[int, int]) -> None:
        """Paint a picture, RGB, shape (height, width, 3), uint8, whose upper left is at a place."""
        self._picture.paste(Image.fromarray(picture), corner)

    def show(self) -> None:
        """Show what is painted."""
        self._texture.show(np.asarray(self._picture))

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Column, and row from the top, of a place in the window [px, y up]."""
        left, bottom = self._renderer.GetOrigin()
        return x - left, self.size[1] - (y - bottom)
