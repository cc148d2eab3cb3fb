"""Augmentation: one similarity of the crop's plane moves picture, labels, keypoints, camera and 3D alike.

A mirrored picture shows a mirrored person: left and right change places in labels, keypoints, joints and rotations.
Turning the picture turns the person about the viewing axis; zoom and shift change the weak-perspective camera alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from PIL import Image

from ...body.labels import BACKGROUND, IGNORE, LabelSet
from ...body.landmarks import mirror_name, mirror_order
from ...body.parameters import BodyParameters
from ...body.rotations import rotation_from_6d, rotation_to_6d
from ...body.template import PART_NAMES
from ...inputs.person import Box

_GREYS = 255.0


@dataclass(frozen=True)
class Augmentation:
    """Bounds of the changes to examples."""

    flip: float = 0.5  # share of examples that are mirrored
    angle: float = 30.0  # the most they are turned, either way [degrees]
    zoom: float = 0.25  # the most they are enlarged or reduced, as a share
    shift: float = 0.1  # the most they are moved along each axis [half-sides of the crop]
    colour: float = 0.3  # the most by which each channel's gain, and the brightness, change, as a share

    def draw(self, rng: np.random.Generator) -> Similarity:
        """A random similarity."""
        return Similarity(
            mirrored=bool(rng.random() < self.flip),
            angle=math.radians(rng.uniform(-self.angle, self.angle)),
            zoom=(1 + self.zoom) ** rng.uniform(-1, 1),
            shift=(rng.uniform(-self.shift, self.shift), rng.uniform(-self.shift, self.shift)),
        )

    def recolour(self, picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Random gains of the channels and brightness, shape and dtype (uint8) as ``picture``, (H, W, 3)."""
        gains = 1 + rng.uniform(-self.colour, self.colour, 3)
        offset = _GREYS / 2 * rng.uniform(-self.colour, self.colour)
        return (picture * gains + offset).clip(0, _GREYS).astype(np.uint8)


@dataclass(frozen=True)
class Similarity:
    """Similarity transform of the crop's plane (coordinates -1 to 1): ``x' = zoom R(angle) F x + shift``.

    F mirrors the picture if ``mirrored``; otherwise it changes nothing.
    """

    mirrored: bool = False
    angle: float = 0.0  # from the x axis (right) towards the y axis (down) [rad]
    zoom: float = 1.0
    shift: tuple[float, float] = (0.0, 0.0)  # (x, y) [half-sides of the crop]

    @property
    def turn(self) -> np.ndarray:
        """R F in the camera frame, shape (3, 3)."""
        cosine, sine, side = math.cos(self.angle), math.sin(self.angle), -1.0 if self.mirrored else 1.0
        return np.array([[side * cosine, -sine, 0.0], [side * sine, cosine, 0.0], [0.0, 0.0, 1.0]])

    def points(self, points: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Points in the crop (L, 2), or (L, 3) with confidences, of landmarks in the same order."""
        moved = points[self._order(tuple(names))].copy()
        moved[:, :2] = self.zoom * moved[:, :2] @ self.turn[:2, :2].T + self.shift
        return moved.astype(points.dtype)

    def joints(self, joints: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Positions in the camera frame, relative to one of them [m], shape (L, 3); names as before."""
        return (joints[self._order(tuple(names))] @ self.turn.T).astype(joints.dtype)

    def body(self, parameters: BodyParameters) -> BodyParameters:
        """Bodies and their cameras."""
        like = parameters.orientation
        turn = torch.from_numpy(self.turn).to(like)
        orientation, rotations = rotation_from_6d(like), parameters.rotations
        if self.mirrored:
            # The mirror image of a rotation M R M, M = diag(-1, 1, 1): as a vector, its y and z change sign.
            rotations = rotations[:, self._order(PART_NAMES)] * rotations.new_tensor([1.0, -1.0, -1.0])
            orientation = orientation * orientation.new_tensor([-1.0, 1.0, 1.0])
        shift = self.zoom * parameters.shift @ turn[:2, :2].T + like.new_tensor(self.shift)
        return replace(
            parameters,
            orientation=rotation_to_6d(turn @ orientation),
            rotations=rotations,
            log_scale=parameters.log_scale + math.log(self.zoom),
            shift=shift,
        )

    def picture(self, picture: np.ndarray, box: Box, size: int) -> np.ndarray:
        """The crop of a picture (H, W, 3), uint8, smoothly, shape (size, size, 3).

        ``box`` is the crop before this similarity, a square; it may reach beyond the picture, where all is black.
        """
        reduced = max(int((box[2] - box[0]) / size / self.zoom), 1)  # so that no pixel is passed over
        image = Image.fromarray(picture)
        image = image.reduce(reduced) if reduced > 1 else image
        return self._warp(image, box, size, Image.Resampling.BILINEAR, 0, reduced)

    def labels(self, groups: np.ndarray, labels: LabelSet, box: Box, size: int) -> np.ndarray:
        """The crop of group ids (H, W), uint8, each pixel from the nearest one, shape (size, size).

        Beyond the picture, and where a mirrored group is none of the set's, 255.
        """
        warped = self._warp(Image.fromarray(groups), box, size, Image.Resampling.NEAREST, IGNORE)
        return mirror_groups(labels)[warped] if self.mirrored else warped

    def _order(self, names: tuple[str, ...]) -> np.ndarray:
        return mirror_order(names) if self.mirrored else np.arange(len(names))

    def _warp(
        self, image: Image.Image, box: Box, size: int, resample: Image.Resampling, fill: int, reduced: int = 1
    ) -> np.ndarray:
        half, middle = (box[2] - box[0]) / 2, np.array([box[0] + box[2], box[1] + box[3]]) / 2
        # From the result's pixels to crop coordinates, through the inverse, and to the picture's pixels.
        inverse = np.linalg.inv(self.zoom * self.turn[:2, :2])
        linear = half * inverse * (2 / size)
        offset = middle - half * inverse @ (1 + np.array(self.shift))
        # Pillow, too, has pixels' centres at a half.
        data = tuple((np.column_stack([linear, offset]) / reduced).ravel().tolist())
        return np.asarray(image.transform((size, size), Image.Transform.AFFINE, data, resample, fillcolor=fill))


def mirror_groups(labels: LabelSet) -> np.ndarray:
    """Group ids in a mirrored picture by those before, 255 where the set has no such group, shape (256,), uint8."""
    owners = {frozenset(parts): group for group, parts in enumerate(labels.groups.values(), start=1)}
    table = np.full(256, IGNORE, dtype=np.uint8)
    table[BACKGROUND] = BACKGROUND
    for group, parts in enumerate(labels.groups.values(), start=1):
        table[group] = owners.get(frozenset(map(mirror_name, parts)), IGNORE)
    return table
