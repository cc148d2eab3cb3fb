"""Lens of a camera whose picture of known points is known."""

from __future__ import annotations

import numpy as np

from ....errors import InputError

_FEWEST = 6  # points that tell a camera
_MOST_OFF = 0.05  # root mean square distance to keypoints, in focal lengths; lens distortion takes up to 0.015


def find_lens(joints: np.ndarray, keypoints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pinhole camera that shows points where they are seen, by linear least squares.

    Args:
        joints: Joints in the camera frame, shape (..., 3).
        keypoints: Keypoints in its picture [px], shape (..., 2).

    Returns:
        Focal lengths (f_x, f_y) and principal point (u, v) [px], shape (2,) each.

    Raises:
        InputError: If fewer than 6 points are known in both, some lie behind the camera, or none shows them there.
    """
    joints, keypoints = joints.reshape(-1, 3), keypoints.reshape(-1, 2)
    known = np.isfinite(joints).all(axis=1) & np.isfinite(keypoints).all(axis=1)
    joints, keypoints = joints[known], keypoints[known]
    if len(joints) < _FEWEST or not (joints[:, 2] > 0).all():
        fault = f"{len(joints)} known in both, {np.count_nonzero(joints[:, 2] > 0)} before the camera"
        raise InputError(f"joints, keypoints: {fault}; expected {_FEWEST} or more, all before it")
    focal, centre, off = np.zeros(2), np.zeros(2), np.zeros(2)
    for axis in range(2):
        slopes = np.stack([joints[:, axis] / joints[:, 2], np.ones(len(joints))], axis=1)
        focal[axis], centre[axis] = np.linalg.lstsq(slopes, keypoints[:, axis])[0]
        off[axis] = np.sqrt(np.square(slopes @ (focal[axis], centre[axis]) - keypoints[:, axis]).mean())
    if not (off < _MOST_OFF * focal).all():  # nor if a focal length is not positive
        fault = f"a camera of focal lengths {focal[0]:.4g}, {focal[1]:.4g} px shows them {off.max():.3g} px off"
        raise InputError(f"joints, keypoints: {fault}; expected joints where the keypoints are")
    return focal, centre
