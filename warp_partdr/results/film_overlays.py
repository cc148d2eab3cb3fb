"""Bodies over the frames of a film: the people's meshes frame by frame, and their pictures in a view."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..body.template import PART_NAMES
from ..cameras import Perspective, zoomed
from ..inputs.calibrated_camera import CalibratedCamera
from ..inputs.films import scaled
from ..inputs.scene import View
from ..models.model import Detailed
from ..models.registration import Registered
from ..pipelines.film import Motion
from ..solve.confidence.limbs import guessed_parts
from .overlays import skin_over
from .shading import SKIN_COLOUR

_POSED = 16  # frames whose meshes are in memory at a time


class PosedMotions:
    """Meshes of a film's people, posed a few frames at a time, so that a long film needs no more memory."""

    def __init__(self, motions: Mapping[int, Motion]) -> None:
        self.motions = motions
        self._rows = {
            person: {int(frame): row for row, frame in enumerate(each.frames)} for person, each in motions.items()
        }
        self._posed: dict[int, tuple[int, Registered]] = {}

    def at(self, frame: int) -> dict[int, Detailed]:
        """Bodies (B = 1) of the people who have a pose in a frame of the film, in the frame of their motions [m]."""
        return {person: self._body(person, rows[frame]) for person, rows in self._rows.items() if frame in rows}

    def pale_at(self, frame: int) -> dict[int, np.ndarray]:
        """Flags of each person's part labels that are guessed in a frame, as ``skin_over`` takes them.

        They are all labels if the person was not found in the frame.
        """
        pale: dict[int, np.ndarray] = {}
        for person, rows in self._rows.items():
            confidence = self.motions[person].confidence
            if confidence is not None and frame in rows:
                row = rows[frame]
                found = bool(confidence.known[row])
                pale[person] = guessed_parts(confidence.guessed(row)) if found else np.ones(1 + len(PART_NAMES), bool)
        return pale

    def _body(self, person: int, row: int) -> Detailed:
        chunk, index = divmod(row, _POSED)
        if person not in self._posed or self._posed[person][0] != chunk:
            some = slice(chunk * _POSED, (chunk + 1) * _POSED)
            self._posed[person] = chunk, self.motions[person].bodies(some)
        return self._posed[person][1].detailed.select(slice(index, index + 1))


def zoomed_view(view: View, zoom: float, size: tuple[int, int]) -> View:
    """View whose picture has another size (H, W) [px]; ``zoom`` is the new size divided by the old one."""
    camera = zoomed(view.camera, zoom, size)
    assert isinstance(camera, Perspective)
    return replace(view, camera=camera)


def resized(picture: np.ndarray, size: tuple[int, int], lens: CalibratedCamera | None = None) -> np.ndarray:
    """Resize a picture, RGB, uint8, to (H, W) [px], and remove the distortion of its lens."""
    resampled = scaled(picture, size)
    return resampled if lens is None else lens.resized(size).undistort_picture(resampled)


def draw_bodies(
    picture: np.ndarray,
    bodies: Mapping[int, Detailed],
    motions: Mapping[int, Motion],
    view: View,
    colours: Mapping[int, np.ndarray] | None = None,
    pale: Mapping[int, np.ndarray] | None = None,
    *,
    bare: bool = False,
) -> np.ndarray:
    """Draw people over a picture, the farthest first.

    Args:
        picture: Picture, RGB, shape (H, W, 3), uint8.
        bodies: Bodies by person, in the world [m].
        motions: Motions by person.
        view: View whose picture has this size.
        colours: RGB of each person, shape (3,), uint8; None: ``SKIN_COLOUR``.
        pale: Flags of the part labels of each person that are drawn pale (``PosedMotions.pale_at``); None: no part is.
        bare: True draws the skin alone. By default people wear a plain T-shirt and shorts.
    """
    vertices = {person: view.to_camera(body.vertices) for person, body in bodies.items()}
    depths = {person: float(view.to_camera(body.joints[:, :1])[0, 0, 2]) for person, body in bodies.items()}
    for person in sorted(vertices, key=lambda one: -depths[one]):
        colour = SKIN_COLOUR if colours is None else colours[person]
        guessed = None if pale is None else pale.get(person)
        picture = skin_over(picture, vertices[person], motions[person].model, view.camera, colour, guessed, bare=bare)
    return picture
