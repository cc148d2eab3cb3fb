"""Bodies over the frames of a film: the people's meshes frame by frame, and how a view sees them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..cameras import Perspective, zoomed
from ..inputs.calibrated_camera import CalibratedCamera
from ..inputs.films import scaled
from ..inputs.scene import View
from ..models.model import Detailed
from ..models.registration import Registered
from ..pipelines.film import Motion
from .overlays import skin_over
from .shading import SKIN_COLOUR

_POSED = 16  # frames whose meshes are in memory at a time


class PosedMotions:
    """Meshes of a film's people, posed a few frames ahead: a long film takes no more memory than a short one."""

    def __init__(self, motions: Mapping[int, Motion]) -> None:
        self.motions = motions
        self._rows = {
            person: {int(frame): row for row, frame in enumerate(each.frames)} for person, each in motions.items()
        }
        self._posed: dict[int, tuple[int, Registered]] = {}

    def at(self, frame: int) -> dict[int, Detailed]:
        """Bodies (B = 1) of the people who are there in a frame of the film, in the frame of their motions [m]."""
        return {person: self._body(person, rows[frame]) for person, rows in self._rows.items() if frame in rows}

    def _body(self, person: int, row: int) -> Detailed:
        chunk, place = divmod(row, _POSED)
        if person not in self._posed or self._posed[person][0] != chunk:
            some = slice(chunk * _POSED, (chunk + 1) * _POSED)
            self._posed[person] = chunk, self.motions[person].bodies(some)
        return self._posed[person][1].detailed.select(slice(place, place + 1))


def zoomed_view(view: View, zoom: float, size: tuple[int, int]) -> View:
    """The view at another size of its picture, (H, W) [px], ``zoom`` pixels a pixel."""
    camera = zoomed(view.camera, zoom, size)
    assert isinstance(camera, Perspective)
    return replace(view, camera=camera)


def resized(picture: np.ndarray, size: tuple[int, int], lens: CalibratedCamera | None = None) -> np.ndarray:
    """A picture, RGB, uint8, at another size, (H, W) [px], without the distortion of the lens that took it."""
    shown = scaled(picture, size)
    return shown if lens is None else lens.resized(size).undistort_picture(shown)


def draw_bodies(
    picture: np.ndarray,
    bodies: Mapping[int, Detailed],
    motions: Mapping[int, Motion],
    view: View,
    colours: Mapping[int, np.ndarray] | None = None,
) -> np.ndarray:
    """People over a picture, the farthest first.

    Args:
        picture: RGB, shape (H, W, 3), uint8.
        bodies: By person, in the world.
        motions: Theirs.
        view: Of a picture of this size.
        colours: RGB of each person, shape (3,), uint8; default: that of skin.
    """
    seen = {person: view.to_camera(body.vertices) for person, body in bodies.items()}
    away = {person: float(view.to_camera(body.joints[:, :1])[0, 0, 2]) for person, body in bodies.items()}
    for person in sorted(seen, key=lambda one: -away[one]):
        colour = SKIN_COLOUR if colours is None else colours[person]
        picture = skin_over(picture, seen[person], motions[person].model, view.camera, colour)
    return picture
