"""MPI-INF-3DHP (Mehta et al., 2017): ``annot.mat`` of people for training, ``annot_data.mat`` of those for tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, install_command
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
    read = [views for file in files for views in (_train(file) if file.name == TRAIN_FILE else [_test(file)])]
    return concatenate_views(read)


def _train(file: Path) -> list[Views]:
    """Views of a sequence, a camera each."""
    held = _read_matlab(file)
    found = []
    for camera in range(_CAMERAS):
        joints, keypoints = (_cell(held, name, camera, file) for name in ("annot3", "annot2"))
        joints, keypoints = joints.reshape(len(joints), -1, 3), keypoints.reshape(len(keypoints), -1, 2)
        person = file.parent.parent.name or file.parent.name
        frames = np.arange(0, len(joints))
        names = [f"{file.parent.name}_{frame}" for frame in frames]
        found.append(_views(joints, keypoints, _TRAIN_JOINTS, person, names, str(camera), _SQUARE, file))
    return found


def _test(file: Path) -> Views:
    """Views of a sequence, of the frames that count."""
    held = read_hdf5(file, ("annot2", "annot3", "valid_frame"), expected=_EXPECTED)
    joints, keypoints = (np.squeeze(held[name], axis=1) for name in ("annot3", "annot2"))
    frames = np.flatnonzero(held["valid_frame"].ravel())
    person = file.parent.name
    size = _WIDE if person in _OUTDOORS else _SQUARE
    names = [str(frame) for frame in frames]
    return _views(joints[frames], keypoints[frames], _TEST_JOINTS, person, names, "0", size, file)


def _views(
    joints: np.ndarray,
    keypoints: np.ndarray,
    landmarks: tuple[str, ...],
    person: str,
    frames: list[str],
    camera: str,
    size: tuple[int, int],
    file: Path,
) -> Views:
    count = len(frames)
    if joints.shape != (count, len(landmarks), 3) or keypoints.shape != (count, len(landmarks), 2):
        raise InputError(f"{file}: joints {joints.shape}, {keypoints.shape}; expected {len(landmarks)} of each frame")
    kept = [place for place, name in enumerate(landmarks) if name]
    joints, keypoints = joints[:, kept] / 1000, keypoints[:, kept].astype(np.float64)
    focal, centre = find_lens(joints, keypoints)
    return Views(
        joint_names=np.array([landmarks[place] for place in kept]),
        joints_camera=joints,
        keypoints=keypoints,
        person=np.full(count, person),
        set=np.full(count, "mpi_inf_3dhp"),
        frame=np.array(frames),
        camera=np.full(count, camera),
        focal=np.tile(focal, (count, 1)),
        centre=np.tile(centre, (count, 1)),
        picture_size=np.tile(size, (count, 1)),
    )


def _read_matlab(file: Path) -> dict[str, Any]:
    try:
        from scipy.io import loadmat
    except ImportError as error:
        raise InputError(f"{file}: MATLAB files need SciPy; expected it ({install_command('lsp')})") from error
    try:
        return dict(loadmat(file, variable_names=["annot2", "annot3"]))
    except Exception as error:  # of many kinds, for a damaged file
        raise InputError(f"{file}: not readable ({' '.join(str(error).split())}); expected {_EXPECTED}") from error


def _cell(held: dict[str, Any], name: str, camera: int, file: Path) -> np.ndarray:
    """Numbers of a camera, shape (T, ...), of a cell array."""
    cells = np.asarray(held.get(name, np.zeros(0, dtype=object))).ravel()
    if len(cells) != _CAMERAS or not isinstance(cells[camera], np.ndarray) or cells[camera].dtype.kind not in "fiu":
        raise InputError(f"{file}: {name}: {len(cells)} cells; expected numbers of {_CAMERAS} cameras")
    return np.asarray(cells[camera], dtype=np.float64)
