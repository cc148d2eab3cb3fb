"""Annotation arrays of SPIN (``spin``) as views: Human3.6M, 3DPW, MPI-INF-3DHP and others in its form."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

import numpy as np

from ....body.skeletons import skeleton
from ....errors import InputError, told_of
from .spin import SPIN_JOINTS, read_spin_arrays, select_joints
from .views import Views

_EXPECTED = "an .npz of SPIN's arrays imgname, center, scale, part or openpose, and S (docs/how_to/evaluate.md)"
_SUBJECT = re.compile(r"(?:^|/)(T?S\d+)[_/]")  # of Human3.6M and MPI-INF-3DHP


def read_spin_views(path: str | Path) -> Views:
    """Read the people of a file of SPIN's arrays that hold 3D joints and keypoints.

    Args:
        path: The ``.npz`` file, whose name is the set's.

    Raises:
        InputError: If the file can't be read, or holds no 3D joints or no keypoints.
    """
    arrays = read_spin_arrays(path, expected=_EXPECTED)
    if "S" not in arrays or not arrays.keys() & {"part", "openpose"}:
        raise InputError(f"{path}: no 3D joints S, or neither part nor openpose; expected {_EXPECTED}")
    if not len(arrays["imgname"]):
        raise InputError(f"{path}: imgname: nobody; expected at least one person")
    names = tuple(dict.fromkeys(SPIN_JOINTS))
    truth = np.stack([select_joints(each, names) for each in arrays["S"]])
    if "part" in arrays:
        keypoint_names, seen = None, np.stack([select_joints(each, names) for each in arrays["part"]])
    else:
        keypoint_names, seen = np.array(skeleton("body25").landmarks), arrays["openpose"]
    pictures = [str(each) for each in arrays["imgname"]]
    with told_of(path):
        return Views(
            joint_names=np.array(names),
            joints_camera=np.where(truth[..., 3:] > 0, truth[..., :3], np.nan),
            keypoints=np.where(seen[..., 2:] > 0, seen[..., :2], np.nan),
            confidence=np.clip(seen[..., 2], 0.0, 1.0),
            keypoint_names=keypoint_names,
            person=np.array([_person(each) for each in pictures]),
            set=np.full(len(pictures), Path(path).stem),
            frame=np.array([PurePosixPath(each).stem for each in pictures]),
        )


def _person(picture: str) -> str:
    """Subject that a picture's name tells, or else the film that it is from."""
    subject = _SUBJECT.search(picture)
    return subject[1] if subject else PurePosixPath(picture).parent.name
