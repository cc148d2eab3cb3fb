"""Sample of a data set: one person's input of a fit, and the truth that the fit is scored against."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..body.labels import LabelSet
from ..body.skeletons import MPJPE_JOINTS
from ..cameras import Perspective
from ..errors import InputError
from .films import FilmPicture
from .keypoints import Keypoints2D
from .part_labels import PartLabels, read_photo


@dataclass(frozen=True)
class Sample:
    """One person of a data set. Nothing but name and keypoints need be known.

    Attributes:
        source: Group whose figures are pooled: a data set, or a level of difficulty.
        name: Name of the person within the source.
        keypoints: Input of a fit: the person's 2D keypoints [px].
        parts: Input of a fit: the picture's part labels.
        others: Other people's keypoints in the picture.
        target: True labels, group ids of ``target_set``, 255 = ignore, (H, W).
        mask: The person's silhouette, where it is annotated apart from the parts, shape (H, W), bool.
        joints: True 3D joints, camera frame [m], shape (J, 3); NaN where unknown. Where the origin is does not matter.
        joint_names: Their landmarks; both hips, which are the pelvis, must be among them.
        joint_marks: Points of the body (``LANDMARKS``) that the data set's joints mark; None: ``joint_names``.
        vertices: True vertices of a mesh, in the frame of ``joints`` [m], shape (V, 3).
        mirrored: Joints with a limb mirrored in depth, which keypoints don't tell from the true ones, as ``joints``.
        picture: File of the picture, its place in a film, or the picture, shape (H, W, 3), uint8.
        camera: The picture's, where it is known, B = 1.
        label_set: Of ``target``; None: that of ``parts``.
        stature: The person's height, standing [m].
        cluster: Name of the samples that are not independent of this one, such as the person's whom several views show;
            None: there are none.
    """

    source: str
    name: str
    keypoints: Keypoints2D
    parts: PartLabels | None = None
    others: tuple[Keypoints2D, ...] = ()
    target: np.ndarray | None = None
    mask: np.ndarray | None = None
    joints: np.ndarray | None = None
    joint_names: tuple[str, ...] = MPJPE_JOINTS
    joint_marks: tuple[str, ...] | None = None
    vertices: np.ndarray | None = None
    mirrored: np.ndarray | None = None
    picture: Path | FilmPicture | np.ndarray | None = None
    camera: Perspective | None = None
    label_set: LabelSet | None = None
    stature: float | None = None
    cluster: str | None = None

    def read_picture(self) -> np.ndarray:
        """The picture, RGB, shape (H, W, 3), uint8.

        Raises:
            InputError: If there is none, or its file can't be read.
        """
        if self.picture is None:
            raise InputError(f"{self.name}: no picture; expected one")
        if isinstance(self.picture, FilmPicture):
            return self.picture.read()
        return read_photo(self.picture) if isinstance(self.picture, Path) else self.picture

    @property
    def body_points(self) -> tuple[str, ...]:
        """Landmark of the body that each joint marks."""
        return self.joint_names if self.joint_marks is None else self.joint_marks

    @property
    def target_set(self) -> LabelSet | None:
        """Label set of ``target``; None if nothing says it."""
        return self.label_set or (None if self.parts is None else self.parts.label_set)
