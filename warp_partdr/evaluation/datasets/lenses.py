"""Lens of a camera whose picture of known points is known."""

from __future__ import annotations

import numpy as np


def find_lens(joints: np.ndarray, keypoints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pinhole camera that shows points where they are seen, by linear least squares.

    Args:
        joints: In the camera frame, shape (..., 3).
        keypoints: In its picture [px], shape (..., 2).

    Returns:
        Focal lengths (f_x, f_y) and principal point (u, v) [px], shape (2,) each.
    """
    joints, keypoints = joints.reshape(-1, 3), keypoints.reshape(-1, 2)
    known = np.isfinite(joints).all(axis=1) & np.isfinite(keypoints).all(axis=1)
    joints, keypoints = joints[known], keypoints[known]
    found = [
        np.linalg.lstsq(np.stack([joints[:, axis] / joints[:, 2], np.ones(len(joints))], axis=1), keypoints[:, axis])[0]
        for axis in range(2)
    ]
    return np.array([found[0][0], found[1][0]]), np.array([found[0][1], found[1][1]])
