"""Sizes of people by their joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_JOINTS = ("shoulder", "hip", "knee", "ankle")


def trunk_and_legs(joints: np.ndarray, names: Sequence[str]) -> float:
    """Length from the ankles by the knees to the hips, mean of both legs, and from there up to mid shoulder.

    Args:
        joints: Shape (J, 3) [m].
        names: Their landmarks.

    Returns:
        The length [m], which depends on the pose by a bent back alone; NaN if one of these joints is unknown.
    """
    sides = [[f"{side}_{joint}" for joint in _JOINTS] for side in ("left", "right")]
    if not {name for side in sides for name in side} <= set(names):
        return float("nan")
    left, right = (joints[[names.index(name) for name in side]] for side in sides)
    legs = [np.linalg.norm(side[1] - side[2]) + np.linalg.norm(side[2] - side[3]) for side in (left, right)]
    trunk = np.linalg.norm((left[0] + right[0]) / 2 - (left[1] + right[1]) / 2)
    return float(np.mean(legs) + trunk)
