"""Limbs whose confidence is stated, with the keypoints that show them and the parts that they consist of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ...body.template import JOINT_NAMES, PART_NAMES


@dataclass(frozen=True)
class BodyLimb:
    """Limb of a body.

    Attributes:
        name: Name, such as "left arm".
        kind: Kind of limb, which both sides share: "head", "arm" or "leg".
        landmarks: Names of keypoints that show where the limb is.
        joints: Names of its joints in ``JOINT_NAMES``, which follow the pelvis.
        parts: Names of its parts in ``PART_NAMES``.
    """

    name: str
    kind: str
    landmarks: tuple[str, ...]
    joints: tuple[str, ...]
    parts: tuple[str, ...]

    def rows(self, names: tuple[str, ...]) -> list[int]:
        """Rows of the limb's landmarks among the names of a keypoint format; other names are left out."""
        return [names.index(name) for name in self.landmarks if name in names]


def _side(side: str) -> tuple[BodyLimb, BodyLimb]:
    def named(*names: str) -> tuple[str, ...]:
        return tuple(f"{side}_{name}" for name in names)

    arm, leg = named("elbow", "wrist"), named("knee", "ankle")
    return (
        BodyLimb(f"{side} arm", "arm", arm, arm, named("upper_arm", "forearm", "hand")),
        BodyLimb(f"{side} leg", "leg", leg, leg, named("upper_leg", "lower_leg", "foot")),
    )


_FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear", "head", "head_top")
LIMBS = (BodyLimb("head", "head", _FACE, ("head", "head_top"), ("neck", "head")), *_side("left"), *_side("right"))


def limb_columns() -> list[list[int]]:
    """Columns of each limb's joints among joints without the pelvis, as ``Uncertainty.depths`` has them."""
    return [[JOINT_NAMES.index(name) - 1 for name in limb.joints] for limb in LIMBS]


def guessed_parts(limbs: tuple[str, ...]) -> np.ndarray:
    """Flags of the part labels that belong to these limbs, shape (21,), bool; label 0 is background."""
    parts = {part for limb in LIMBS if limb.name in limbs for part in limb.parts}
    return np.array([False, *(name in parts for name in PART_NAMES)])


def mean_over(values: torch.Tensor, columns: list[list[int]]) -> torch.Tensor:
    """Means of values (N, J) over groups of columns, shape (N, L)."""
    return torch.stack([values[:, each].mean(1) for each in columns], dim=1)
