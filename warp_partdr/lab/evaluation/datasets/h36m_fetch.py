"""Human3.6M as anibali/h36m-fetch writes it: ``S9/Directions/annot.h5`` and so on, HDF5 files of numbers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ....body.skeletons import skeleton
from ....errors import InputError, told_of
from .hdf5 import read_hdf5
from .lenses import find_lens
from .views import Views, concatenate_views

H36M_FILE = "annot.h5"
_H36M = skeleton("h36m17")
_PLACES = [0, 1, 2, 3, 6, 7, 8, 12, 13, 14, 15, 17, 18, 19, 25, 26, 27]  # of its joints among Human3.6M's 32
_JOINTS = 32
_LISTS = ("frame", "camera", "subject")  # whole numbers, one a row
_ARRAYS = ("pose/2d", *_LISTS)
_TRUTH = ("pose/3d", "pose/3d-univ")  # in the camera frame; the second one on a skeleton that all people share
_EXPECTED = f"{H36M_FILE} of anibali/h36m-fetch, with {', '.join(_ARRAYS)}, {' or '.join(_TRUTH)}"
_SIZE = (1002, 1000)  # (H, W) of its pictures [px]; two of its four cameras have 1000 rows


def read_human36m_hdf5(path: str | Path) -> Views:
    """Read the people of a folder of Human3.6M.

    Args:
        path: Folder that holds ``annot.h5``, or folders with it.

    Raises:
        InputError: If there is no such file, or it can't be read.
    """
    files = sorted(Path(path).rglob(H36M_FILE))
    if not files:
        raise InputError(f"{path}: no {H36M_FILE}; expected {_EXPECTED}")
    found = []
    for file in files:
        with told_of(file):
            found += list(_cameras(file))
    return concatenate_views(found)


def _cameras(file: Path) -> Iterator[Views]:
    """Views of an action, a camera each."""
    held = read_hdf5(file, _ARRAYS, _TRUTH, expected=_EXPECTED)
    truth = next((held[name] for name in _TRUTH if name in held), None)
    count = held["frame"].size
    if truth is None or truth.shape != (count, _JOINTS, 3) or held["pose/2d"].shape != (count, _JOINTS, 2):
        raise InputError(f"not {_JOINTS} joints of each of {count} frames; expected {_EXPECTED}")
    for name in _LISTS:
        if held[name].shape != (count,) or held[name].dtype.kind not in "iu" or not count:
            raise InputError(f"{name}: {held[name].dtype} {held[name].shape}; expected whole numbers, one a frame")
    for camera in np.unique(held["camera"]).tolist():
        rows = np.flatnonzero(held["camera"] == camera)
        joints = truth[rows][:, _PLACES].astype(np.float64) / 1000
        keypoints = held["pose/2d"][rows][:, _PLACES].astype(np.float64)
        focal, centre = find_lens(joints, keypoints)
        yield Views(
            joint_names=np.array(_H36M.landmarks),
            joints_camera=joints,
            keypoints=keypoints,
            person=np.array([f"S{subject}" for subject in held["subject"][rows].tolist()]),
            set=np.full(len(rows), "h36m"),
            frame=np.array([f"{file.parent.name}_{frame}" for frame in held["frame"][rows].tolist()]),
            camera=np.full(len(rows), str(camera)),
            focal=np.tile(focal, (len(rows), 1)),
            centre=np.tile(centre, (len(rows), 1)),
            picture_size=np.tile(_SIZE, (len(rows), 1)),
        )
