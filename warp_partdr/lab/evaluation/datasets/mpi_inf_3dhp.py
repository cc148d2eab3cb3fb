"""MPI-INF-3DHP (Mehta et al., 2017): ``annot.mat`` of people for training, ``annot_data.mat`` of those for tests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import InputError, install_command, told_of
from .hdf5 import read_hdf5
from .lenses import find_lens
from .views import Views, concatenate_views

TRAIN_FILE, TEST_FILE = "annot.mat", "annot_data.mat"
_CAMERAS = 14
# Landmarks of the 28 joints of ``annot.mat`` and the 17 of ``annot_data.mat``; "" for joints that are none here. Its
# neck is the throat, between the base of the neck and that of the skull.
_NONE = ""
_TRAIN_JOINTS = (
    *(_NONE, _NONE, _NONE, "spine", "mid_hip", "neck", "head", "head_top"),
    *(_NONE, "left_shoulder", "left_elbow", "left_wrist", _NONE),
    *(_NONE, "right_shoulder", "right_elbow", "right_wrist", _NONE),
    *("left_hip", "left_knee", "left_ankle", _NONE, "left_toe"),
    *("right_hip", "right_knee", "right_ankle", _NONE, "right_toe"),
)
_TEST_JOINTS = (
    *("head_top", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist"),
    *("right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "mid_hip", "spine", "head"),
)
_SQUARE, _WIDE = (2048, 2048), (1080, 1920)  # (H, W) of pictures [px]; of TS5 and TS6 the latter
_OUTDOORS = ("TS5", "TS6")
_EXPECTED = "MPI-INF-3DHP: a folder with S1/Seq1/annot.mat or the like, or TS1/annot_data.mat"


def read_mpi_inf_3dhp(path: str | Path) -> Views:
    """Read the people of a folder of MPI-INF-3DHP.

    Args:
        path: Folder that holds ``annot.mat`` or ``annot_data.mat``, or folders with them.

    Raises:
        InputError: If there is no such file, or it can't be read.
    """
    folder = Path(path)
    files = sorted([*folder.rglob(TRAIN_FILE), *folder.rglob(TEST_FILE)])
    if not files:
        raise InputError(f"{folder}: no {TRAIN_FILE} or {TEST_FILE}; expected {_EXPECTED}")
    found = []
    for file in files:
        with told_of(file):
            found += _train(file) if file.name == TRAIN_FILE else [_test(file)]
    return concatenate_views(found)


@dataclass(frozen=True)
class _Recording:
    """Recording of one person by one camera."""

    person: str
    camera: str
    picture_size: tuple[int, int]  # (H, W) [px]
    landmarks: tuple[str, ...]  # of the joints of the file

    def views(self, joints: np.ndarray, keypoints: np.ndarray, frames: list[str]) -> Views:
        """Views of each frame, of joints (T, J, 3) [mm] and keypoints (T, J, 2) [px]."""
        count = len(frames)
        kept = [index for index, name in enumerate(self.landmarks) if name]
        joints, keypoints = joints[:, kept] / 1000, keypoints[:, kept].astype(np.float64)
        focal, centre = find_lens(joints, keypoints)
        return Views(
            joint_names=np.array([self.landmarks[index] for index in kept]),
            joints_camera=joints,
            keypoints=keypoints,
            person=np.full(count, self.person),
            set=np.full(count, "mpi_inf_3dhp"),
            frame=np.array(frames),
            camera=np.full(count, self.camera),
            focal=np.tile(focal, (count, 1)),
            centre=np.tile(centre, (count, 1)),
            picture_size=np.tile(self.picture_size, (count, 1)),
        )


def _train(file: Path) -> list[Views]:
    """Views of a sequence, a camera each."""
    held, found = _read_matlab(file), []
    person = file.parent.parent.name or file.parent.name
    for camera in range(_CAMERAS):
        joints, keypoints = _cell(held, "annot3", camera, 3), _cell(held, "annot2", camera, 2)
        if len(joints) != len(keypoints):
            raise InputError(f"annot2, annot3: {len(keypoints)} and {len(joints)} frames; expected as many")
        names = [f"{file.parent.name}_{frame}" for frame in range(len(joints))]
        found.append(_Recording(person, str(camera), _SQUARE, _TRAIN_JOINTS).views(joints, keypoints, names))
    return found


def _test(file: Path) -> Views:
    """Views of a sequence, of the frames that count."""
    held = read_hdf5(file, ("annot2", "annot3", "valid_frame"), expected=_EXPECTED)
    valid = held["valid_frame"].ravel() > 0
    for name, numbers in (("annot3", 3), ("annot2", 2)):
        expected = (len(valid), 1, len(_TEST_JOINTS), numbers)
        if held[name].shape != expected:
            raise InputError(f"{name}: shape {held[name].shape}; expected {expected}")
    if not valid.any():
        raise InputError("valid_frame: none of them is; expected at least one")
    person = file.parent.name
    size = _WIDE if person in _OUTDOORS else _SQUARE
    names = [str(frame) for frame in np.flatnonzero(valid).tolist()]
    recording = _Recording(person, "0", size, _TEST_JOINTS)
    return recording.views(held["annot3"][valid, 0], held["annot2"][valid, 0], names)


def _read_matlab(file: Path) -> dict[str, Any]:
    try:
        from scipy.io import loadmat
    except ImportError as error:
        raise InputError(f"MATLAB files need SciPy; expected it ({install_command('lsp')})") from error
    try:
        return dict(loadmat(file, variable_names=["annot2", "annot3"]))
    except Exception as error:  # of many kinds, for a damaged file
        raise InputError(f"not readable ({' '.join(str(error).split())}); expected {_EXPECTED}") from error


def _cell(held: dict[str, Any], name: str, camera: int, size: int) -> np.ndarray:
    """Numbers of a camera out of a cell array, ``size`` of each joint, shape (T, 28, size)."""
    cells = np.asarray(held.get(name, np.zeros(0, dtype=object))).ravel()
    if len(cells) != _CAMERAS or not isinstance(cells[camera], np.ndarray) or cells[camera].dtype.kind not in "fiu":
        raise InputError(f"{name}: {len(cells)} cells; expected numbers of {_CAMERAS} cameras")
    values = np.asarray(cells[camera], dtype=np.float64)
    width = size * len(_TRAIN_JOINTS)
    if values.ndim != 2 or values.shape[1] != width or not len(values):
        raise InputError(f"{name}: camera {camera}: shape {values.shape}; expected (frames, {width})")
    return values.reshape(-1, len(_TRAIN_JOINTS), size)
