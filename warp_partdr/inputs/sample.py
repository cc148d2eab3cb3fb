"""Sample of a data set: one person's input to a fit, and the truth that the fit is compared with."""

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
    """One person of a data set. Only name and keypoints must be known; anything else may be None.

    Attributes:
        source: Group whose figures are pooled: a data set, or a level of difficulty.
        name: Name of the person within the source.
        keypoints: Input of a fit: the person's 2D keypoints [px].
        parts: Input of a fit: the picture's part labels.
        others: Other people's keypoints in the picture.
        target: True labels, group ids in ``target_set``, 255 = ignore, shape (H, W).
        mask: Silhouette of the person, if it is annotated apart from the parts, shape (H, W), bool.
        joints: True 3D joints, camera frame [m], shape (J, 3); NaN where unknown. The origin does not matter.
        joint_names: Landmarks of the joints. Both hips must be among them, because their middle is the pelvis.
        joint_marks: Points of the body (``LANDMARKS``) that the data set's joints mark; None: ``joint_names``.
        vertices: True vertices of a mesh, in the frame of ``joints`` [m], shape (V, 3).
        mirrored: Joints with one limb mirrored in depth, shape (J, 3). Keypoints alone can't tell them from the true
            ones.
        picture: File of the picture, picture of a film, or pixels, shape (H, W, 3), uint8.
        camera: Camera of the picture, if it is known, B = 1.
        label_set: Label set of ``target``; None: that of ``parts``.
        stature: Height of the person, standing [m].
        cluster: Name that all samples share that are not independent, such as several views of one person; None: the
            sample is independent.

    Examples:
        After ``parts = read_parts("parts.png", "cdcl14")`` and ``person = read_keypoints("keypoints.json")[0]``:

        >>> from warp_partdr.benchmark import Sample
        >>> sample = Sample("my data", "first person", person, parts, target=parts.groups)
        >>> sample.source, sample.name
        ('my data', 'first person')
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
        """Read the picture, RGB, shape (H, W, 3), uint8.

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
        """Label set of ``target``; None if it is not known."""
        return self.label_set or (None if self.parts is None else self.parts.label_set)
