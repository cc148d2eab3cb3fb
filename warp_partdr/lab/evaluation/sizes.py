"""Sizes of people by their joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_JOINTS = ("shoulder", "hip", "knee", "ankle")


def trunk_and_legs(joints: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Length from the ankles by the knees to the hips, mean of both legs, and from there up to mid shoulder.

    Args:
        joints: Joints [m], shape (..., J, 3).
        names: Landmarks of the joints.

    Returns:
        The lengths [m], shape (...), which depend on the pose by a bent back alone; NaN if one of these joints is
        unknown.
    """
    sides = [[f"{side}_{joint}" for joint in _JOINTS] for side in ("left", "right")]
    if not {name for side in sides for name in side} <= set(names):
        return np.full(joints.shape[:-2], np.nan)
    left, right = (joints[..., [names.index(name) for name in side], :] for side in sides)
    legs = [np.linalg.norm(np.diff(side[..., 1:, :], axis=-2), axis=-1).sum(-1) for side in (left, right)]
    shoulders, hips = ((left[..., place, :] + right[..., place, :]) / 2 for place in (0, 1))
    return np.asarray((legs[0] + legs[1]) / 2 + np.linalg.norm(shoulders - hips, axis=-1))
