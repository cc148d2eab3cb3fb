"""Files of calibrated cameras: Pose2Sim's ``Calib.toml``, OpenCV's ``FileStorage``, and a JSON of the project's own.

World to camera, metres. The project's own form has pixel centres at + 0.5, as all its pictures; the others' principal
points are moved there::

    {"cameras": {"left": {"size": [1920, 1080], "focal": [1500, 1500], "principal": [960, 540],
                          "distortion": [k1, k2, p1, p2], "rotation": [rx, ry, rz], "translation": [x, y, z]}}}
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..body.rotations import rotation_from_axis_angle, rotation_to_axis_angle
from ..errors import InputError, shown
from ..files.opencv_files import is_matrix, read_opencv, to_matrix
from ..files.sections import check_keys, read_toml
from .calibrated_camera import CalibratedCamera

_EXPECTED = "calibrated cameras: Pose2Sim's .toml, or OpenCV's .yml, .yaml or .json, or a folder of these"
_KINDS = (".toml", ".yml", ".yaml", ".json")
_LARGEST_TURN = 2 * math.pi  # [rad], of Rodrigues' vectors
_STEREO = ("intrinsics", "extrinsics")  # files of OpenCV's stereo_calib, together two cameras
_OWN = ("size", "focal", "principal", "distortion", "rotation", "translation")
# Names that OpenCV's samples, ROS and Pose2Sim write, without capitals and underscores.
_MATRIX = ("cameramatrix", "matrix", "intrinsicmatrix", "k", "m", "mtx")
_DISTORTION = ("distortioncoefficients", "distcoeffs", "distortions", "distortion", "dist", "d")
_ROTATION = ("r", "rotation", "rotationmatrix", "rvec", "rot")
_TRANSLATION = ("t", "translation", "tvec", "tvecs")
_SIZE = ("size", "imagesize", "resolution")
_WIDTH, _HEIGHT = ("imagewidth", "width"), ("imageheight", "height")
_FISHEYE = ("fisheye", "fisheyemodel")
_MODEL = ("distortionmodel", "cameramodel")
_PLAIN_MODELS = ("plumb_bob", "rational_polynomial", "radtan", "pinhole", "brown", "brown_conrady", "opencv", "")


def read_cameras(path: str | Path) -> dict[str, CalibratedCamera]:
    """Read calibrated cameras by name, in the order of the file, or of the names of a folder's files.

    A file holds cameras by name, or one camera, which has the file's name. A stereo calibration of OpenCV (M1, D1, M2,
    D2, R, T; also as the files intrinsics and extrinsics of a folder) are the cameras "1" and "2", the world being the
    first one's frame.

    Raises:
        InputError: If a file can't be read, or a camera lacks something, is none, or has a fisheye lens.
    """
    path = Path(path)
    if not path.is_dir():
        return _cameras(_read(path), str(path), path.stem)
    files = sorted(each for each in path.iterdir() if each.suffix.lower() in _KINDS)
    if sorted(each.stem for each in files) == sorted(_STEREO):
        both: dict[str, Any] = {}
        for each in files:
            both |= _read(each)
        return _cameras(both, str(path), path.stem)
    found: dict[str, CalibratedCamera] = {}
    for each in files:
        for name, camera in _cameras(_read(each), str(each), each.stem).items():
            if name in found:
                raise InputError(f"{each}: camera {name} a second time in {path}; expected each once")
            found[name] = camera
    if not found:
        raise InputError(f"{path}: no camera in it; expected {_EXPECTED}")
    return found


def cameras_of_films(path: str | Path, films: Sequence[str | Path]) -> list[CalibratedCamera]:
    """Calibrated cameras of films, in the frame of the first: by the films' names, else in the order of the file.

    Raises:
        InputError: As of ``read_cameras``, or if it is not clear which camera took which film.
    """
    cameras = read_cameras(path)
    names = [Path(film).stem for film in films]
    if set(names) <= cameras.keys() and len(set(names)) == len(names):
        found = [cameras[name] for name in names]
    elif len(cameras) == len(films) and all(
        name == camera or name not in cameras for name, camera in zip(names, cameras, strict=True)
    ):
        found = list(cameras.values())
    else:
        raise InputError(
            f"{path}: cameras {', '.join(cameras)}; expected one a film: {', '.join(names)}, by name or in order"
        )
    return [camera.seen_from(found[0]) for camera in found]


def camera_data(cameras: Mapping[str, CalibratedCamera]) -> dict[str, Any]:
    """The project's own form of cameras by name, to be written as JSON."""
    nodes: dict[str, Any] = {}
    for name, camera in cameras.items():
        size = {} if camera.size is None else {"size": list(camera.size[::-1])}
        lens = {"focal": camera.focal, "principal": camera.principal, "distortion": camera.distortion}
        turn = rotation_to_axis_angle(torch.from_numpy(camera.rotation)).tolist()
        nodes[name] = {**size, **{key: list(values) for key, values in lens.items()}}
        nodes[name] |= {"rotation": turn, "translation": camera.translation.tolist()}
    return {"cameras": nodes}


def _read(path: Path) -> dict[str, Any]:
    if path.suffix.lower() not in _KINDS:
        raise InputError(f"{path}: {path.suffix or 'no ending'}; expected {_EXPECTED}")
    if path.suffix.lower() == ".toml":
        return read_toml(path, str(path), _EXPECTED)
    return read_opencv(path, _EXPECTED)


def _cameras(data: Mapping[str, Any], where: str, name: str) -> dict[str, CalibratedCamera]:
    """Cameras in what a file holds."""
    if isinstance(own := data.get("cameras"), Mapping):
        return {str(key): _own_camera(node, f"{where}: cameras.{key}") for key, node in own.items()}
    if {"M1", "M2"} <= data.keys():
        return _stereo(data, where)
    if _find(data, _MATRIX) is not None:
        return {name: _camera(data, where, alone=True)}
    nodes = {key: node for key, node in data.items() if isinstance(node, Mapping) and not is_matrix(node)}
    nodes.pop("metadata", None)
    if not nodes:
        raise InputError(f"{where}: no camera in it, but {', '.join(data) or 'nothing'}; expected {_EXPECTED}")
    alone = len(nodes) == 1
    found = {str(key): _camera(node, f"{where}: {key}", alone=alone) for key, node in nodes.items()}
    names = {key: node.get("name") for key, node in nodes.items()}
    if all(isinstance(each, str) for each in names.values()) and len(set(names.values())) == len(names):
        return {str(names[key]): camera for key, camera in found.items()}
    return found


def _stereo(data: Mapping[str, Any], where: str) -> dict[str, CalibratedCamera]:
    size = {key: data[key] for key in data if _plain(key) in (*_SIZE, *_WIDTH, *_HEIGHT)}
    cameras = {}
    for number in ("1", "2"):
        node = {"M": data[f"M{number}"], "D": data.get(f"D{number}", [0.0]), **size}
        if number == "2":
            node |= {key: data[key] for key in ("R", "T") if key in data}
        cameras[number] = _camera(node, where, alone=number == "1")
    return cameras


def _plain(key: object) -> str:
    return str(key).replace("_", "").lower()


def _find(node: Mapping[str, Any], names: tuple[str, ...]) -> tuple[str, Any] | None:
    """Key and value of the first of these names that is there."""
    keys = {_plain(key): key for key in node}
    return next(((keys[name], node[keys[name]]) for name in names if name in keys), None)


def _camera(node: Mapping[str, Any], where: str, *, alone: bool) -> CalibratedCamera:
    """A camera of OpenCV's matrices; ``alone``, it may stand at the world's origin without saying so."""
    _refuse_fisheye(node, where)
    matrix = _numbers(node, _MATRIX, where, "a camera matrix", (3, 3))
    assert matrix is not None
    if matrix[2].tolist() != [0.0, 0.0, 1.0] or matrix[1, 0] != 0 or abs(matrix[0, 1]) > 1e-3 * matrix[0, 0]:
        raise InputError(
            f"{where}: camera matrix {shown(matrix.tolist())}; expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        )
    rotation, translation = _find(node, _ROTATION), _find(node, _TRANSLATION)
    placed = rotation is not None or translation is not None or not alone
    turn, move = np.eye(3), np.zeros(3)
    if placed:
        turn, move = _rotation(node, where), _vector(node, where)
    found = _find(node, _DISTORTION)
    coefficients = [] if found is None else to_matrix(found[1], f"{where}: {found[0]}").ravel().tolist()
    return _made(
        where,
        focal=(float(matrix[0, 0]), float(matrix[1, 1])),
        principal=(float(matrix[0, 2]) + 0.5, float(matrix[1, 2]) + 0.5),
        distortion=_distortion(coefficients, where),
        rotation=turn,
        translation=move,
        size=_size(node, where),
    )


def _own_camera(node: object, where: str) -> CalibratedCamera:
    if not isinstance(node, Mapping):
        raise InputError(f"{where}: {shown(node)}; expected {', '.join(_OWN)}")
    _refuse_fisheye(node, where)
    check_keys(node, _OWN, where)
    for key in ("focal", "principal", "rotation", "translation"):
        if key not in node:
            raise InputError(f"{where}: {key}: missing; expected {', '.join(_OWN)}")
    pairs = []
    for key in ("focal", "principal"):
        values = to_matrix(node[key], f"{where}: {key}")
        if values.shape != (2,):
            raise InputError(f"{where}: {key}: {shown(node[key])}; expected two numbers [px]")
        pairs.append((float(values[0]), float(values[1])))
    coefficients = to_matrix(node.get("distortion") or [0.0], f"{where}: distortion").ravel().tolist()
    return _made(
        where,
        focal=pairs[0],
        principal=pairs[1],
        distortion=_distortion(
            to_matrix(coefficients, f"{where}: distortion").ravel().tolist() if coefficients else [], where
        ),
        rotation=_rotation(node, where),
        translation=_vector(node, where),
        size=_size(node, where),
    )


def _made(where: str, **values: Any) -> CalibratedCamera:
    try:
        return CalibratedCamera(**values)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _numbers(
    node: Mapping[str, Any], names: tuple[str, ...], where: str, expected: str, *shapes: tuple[int, ...]
) -> np.ndarray:
    """Numbers under the first of these names that is there, in one of these shapes."""
    found = _find(node, names)
    if found is None:
        raise InputError(f"{where}: {names[0]}: missing, but {', '.join(map(str, node))}; expected {expected}")
    values = to_matrix(found[1], f"{where}: {found[0]}")
    if values.shape not in shapes:
        raise InputError(f"{where}: {found[0]}: shape {values.shape}; expected {expected}, {shapes[0]}")
    return values


def _rotation(node: Mapping[str, Any], where: str) -> np.ndarray:
    """R as a matrix or as Rodrigues' vector."""
    values = _numbers(node, _ROTATION, where, "a rotation, world to camera", (3, 3), (3,), (3, 1), (1, 3))
    if values.shape == (3, 3):
        return values
    if (angle := float(np.linalg.norm(values))) > _LARGEST_TURN:
        raise InputError(f"{where}: rotation by {angle:g} radians; expected {_LARGEST_TURN:g} at most, not degrees")
    return rotation_from_axis_angle(torch.from_numpy(values.reshape(3))).numpy()


def _vector(node: Mapping[str, Any], where: str) -> np.ndarray:
    return _numbers(node, _TRANSLATION, where, "a translation [m]", (3,), (3, 1), (1, 3)).reshape(3)


def _distortion(values: list[float], where: str) -> tuple[float, ...]:
    """OpenCV's coefficients without those of its thin prisms and tilted sensors, which must be 0."""
    if any(values[8:]):
        raise InputError(f"{where}: distortion: {len(values)} numbers; expected 0 after k1, k2, p1, p2, k3, k4, k5, k6")
    return tuple(values[:8])


def _size(node: Mapping[str, Any], where: str) -> tuple[int, int] | None:
    """(H, W) of the pictures, where it is said: files have width and height."""
    found = _find(node, _SIZE)
    if found is not None:
        values = to_matrix(found[1], f"{where}: {found[0]}").ravel().tolist()
    else:
        sides = [_find(node, names) for names in (_WIDTH, _HEIGHT)]
        if sides[0] is None or sides[1] is None:
            return None
        values = [side[1] for side in sides if side is not None]
    if len(values) != 2 or not all(isinstance(side, int | float) and side > 0 and side % 1 == 0 for side in values):
        raise InputError(f"{where}: size {shown(values)}; expected width and height [px]")
    return int(values[1]), int(values[0])


def _refuse_fisheye(node: Mapping[str, Any], where: str) -> None:
    found = _find(node, _FISHEYE)
    model = _find(node, _MODEL)
    if found is not None and found[1] not in (False, 0, None):
        raise InputError(f"{where}: {found[0]}: a fisheye lens is not supported; expected Brown's distortion")
    if model is not None and str(model[1]).lower() not in _PLAIN_MODELS:
        raise InputError(f"{where}: {model[0]}: {shown(model[1])} is not supported; expected Brown's distortion")
