"""Files of calibrated cameras, written by many programs or in the project's own JSON.

Poses are from world to camera, in metres. The project's own form has pixel centres at + 0.5, like all its pictures, and
0.5 px are added to the principal points of other programs::

    {"cameras": {"left": {"size": [1920, 1080], "focal": [1500, 1500], "principal": [960, 540],
                          "distortion": [k1, k2, p1, p2], "rotation": [rx, ry, rz], "translation": [x, y, z]}}}
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..body.rotations import rotation_from_axis_angle, rotation_to_axis_angle
from ..errors import InputError, shown
from ..files.json_files import rounded
from ..files.opencv_files import is_matrix, read_opencv, to_matrix
from ..files.sections import check_keys, read_toml
from .calibrated_camera import CalibratedCamera
from .camera_names import assign_cameras, film_names, is_camera_s, natural_key
from .qualisys import QUALISYS, read_qualisys

_EXPECTED = (
    "calibrated cameras: .toml of Pose2Sim, Anipose, FreeMoCap or Caliscope; .yml, .yaml or .json of OpenCV, MC-Calib, "
    "Kalibr or CMU Panoptic; Qualisys' .qca.txt; or a folder of these, or of EasyMocap's intri.yml and extri.yml"
)
_KINDS = (".toml", ".yml", ".yaml", ".json", *QUALISYS)
_LARGEST_TURN = 2 * math.pi  # [rad], of Rodrigues' vectors
_TENTHS = 10  # a vector of more than half a turn that is given in tenths is in degrees
_STEREO = ("intrinsics", "extrinsics")  # two files of OpenCV's stereo_calib, which hold two cameras
_EASYMOCAP = ("intri", "extri")  # two files of EasyMocap, which hold all cameras
_ALL = ("camera_array.toml", "calibrated_cameras_data.yml")  # Caliscope and MC-Calib write these beside other files
_CALISCOPE = ("port", "camid")  # keys of its cameras
# The two cameras of a stereo calibration, and the endings of their matrices' names.
_PAIRS = ((("1", "1"), ("2", "2")), (("left", "l"), ("right", "r")), (("left", "left"), ("right", "right")))
_OWN = ("size", "focal", "principal", "distortion", "rotation", "translation")
# Names that OpenCV's samples, ROS, Pose2Sim and other programs write, here without capitals and underscores.
_MATRIX = ("cameramatrix", "matrix", "intrinsicmatrix", "k", "m", "mtx", "intrinsics")
_DISTORTION = (
    *("distortioncoefficients", "distortioncoeffs", "distcoeffs", "distcoef", "distortionvector"),
    *("distortions", "distortion", "dist", "d"),
)
_ROTATION = ("r", "rotation", "rotationmatrix", "rvec", "rot")
_TRANSLATION = ("t", "translation", "tvec", "tvecs")
_POSE = ("cameraposematrix",)  # MC-Calib's, camera to reference
_CHAIN = ("tcncnm1",)  # Kalibr's, camera before to camera
_SIZE = ("size", "imagesize", "resolution")
_WIDTH, _HEIGHT = ("imagewidth", "imgwidth", "width", "w"), ("imageheight", "imgheight", "height", "h")
_NAME = ("name", "id", "camid", "cameraid", "serial")
_FISHEYE = ("fisheye", "fisheyemodel", "isfisheye", "omnidirectional", "xi")
_MODEL = ("distortionmodel", "cameramodel", "cameratype", "lenstype", "projection")
_PLAIN_MODELS = (
    *("plumb_bob", "rational_polynomial", "radtan", "pinhole", "brown", "brown_conrady", "opencv", "perspective"),
    *("none", ""),
)
_NOTHING = ("null", "none", "nan", "")  # rotations and translations of cameras whose position is not known
_MILLIMETRES = 10.0  # the side of a board's square is in millimetres if it is at least this number

Warn = Callable[[str], None]


def read_cameras(path: str | Path, *, warn: Warn | None = None) -> dict[str, CalibratedCamera]:
    """Read calibrated cameras by name, in the order of the file, or of the names of a folder's files.

    A file holds cameras by name, or one camera, which takes the file's name. A stereo calibration of OpenCV (M1, D1,
    M2, D2, R, T, or cameraMatrix1, K1, ...; also in a folder's two files, intrinsics and extrinsics) holds the cameras
    "1" and "2", or "left" and "right" if its names end in L and R. The first one's frame is then the world. A folder's
    files without a camera are left out if other files hold one. Translations are in metres; those of Qualisys and
    FreeMoCap are converted from millimetres.

    Args:
        path: File or folder.
        warn: Function that gets a sentence about each thing that was left out or converted.

    Raises:
        InputError: If a file can't be read, or if a camera is incomplete, invalid, or has a fisheye lens.

    Examples:
        >>> from warp_partdr import read_cameras
        >>> cameras = read_cameras("cameras.toml")
        >>> list(cameras), cameras["left"].size
        (['left', 'right'], (480, 640))
        >>> cameras["left"].focal
        (600.0, 600.0)
    """
    path = Path(path)
    warn = warn or (lambda sentence: None)
    if path.is_file() and path.stem in _EASYMOCAP and all(_sibling(path, name).is_file() for name in _EASYMOCAP):
        path = path.parent
    if not path.is_dir():
        return _cameras(_read(path), str(path), _stem(path), warn)
    files = [each for each in path.iterdir() if each.name.lower().endswith(_KINDS) and each.is_file()]
    files = [each for each in files if each.name in _ALL][:1] or files
    files.sort(key=lambda each: natural_key(each.name))
    for pair in (_STEREO, _EASYMOCAP):
        both = [each for each in files if each.stem in pair and each.suffix.lower() in (".yml", ".yaml", ".json")]
        if sorted(each.stem for each in both) == sorted(pair) and (pair == _EASYMOCAP or both == files):
            return _cameras({key: value for each in both for key, value in _read(each).items()}, str(path), "", warn)
    found: dict[str, CalibratedCamera] = {}
    held = {each: _read(each) for each in files}
    without = [each for each in files if not _has_lens(held[each])]
    for each in without if len(without) < len(files) else []:
        warn(f"{each}: left out, for it holds no camera")
        del held[each]
    for each, data in held.items():
        for name, camera in _cameras(data, str(each), _stem(each), warn).items():
            if name in found:
                raise InputError(f"{each}: camera {name} a second time in {path}; expected each once")
            found[name] = camera
    if not found:
        raise InputError(f"{path}: no camera in it; expected {_EXPECTED}")
    return found


def cameras_of_films(
    path: str | Path, films: Sequence[str | Path], *, warn: Warn | None = None
) -> list[CalibratedCamera]:
    """Calibrated cameras of films, one a film, in the frame of the first one. ``assign_cameras`` pairs them.

    Args:
        path: File or folder, as for ``read_cameras``.
        films: The films' files, or their names.
        warn: Function that gets a sentence about each thing that was left out or converted. If only their order, or a
            number that may mean something else, pairs films with cameras, it gets a sentence about that, too.

    Raises:
        InputError: If a camera can't be read, or it is not clear which camera took which film.
    """
    cameras = read_cameras(path, warn=warn)
    names = list(cameras)
    try:
        assigned = assign_cameras(films, names)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    if (assigned.by_order or assigned.by_number) and warn is not None:
        pairs = zip(film_names(films), assigned.cameras, strict=True)
        listed = ", ".join(f"{film} of {names[index]}" for film, index in pairs)
        reason = (
            "in the order of cameras, for no name says otherwise"
            if assigned.by_order
            else "by numbers or letters in their names, which no word for a camera precedes"
        )
        warn(f"{path}: films are taken {reason}: {listed}")
    found = [cameras[names[index]] for index in assigned.cameras]
    return [camera.in_frame_of(found[0]) for camera in found]


def camera_data(cameras: Mapping[str, CalibratedCamera]) -> dict[str, Any]:
    """Return cameras by name in the project's own form, to be written as JSON."""
    nodes: dict[str, Any] = {}
    for name, camera in cameras.items():
        size = {} if camera.size is None else {"size": list(camera.size[::-1])}
        lens = {"focal": rounded(camera.focal, 3), "principal": rounded(camera.principal, 3)}
        turn = rotation_to_axis_angle(torch.from_numpy(camera.rotation)).numpy()
        nodes[name] = {**size, **lens, "distortion": rounded(camera.distortion, 8)}
        nodes[name] |= {"rotation": rounded(turn, 6), "translation": rounded(camera.translation, 5)}
    return {"cameras": nodes}


def _sibling(path: Path, name: str) -> Path:
    return path.with_name(name + path.suffix)


def _stem(path: Path) -> str:
    """Name of a file without its ending, which may have two parts."""
    ending = next((each for each in QUALISYS if path.name.lower().endswith(each)), path.suffix)
    return path.name[: len(path.name) - len(ending)]


def _read(path: Path) -> dict[str, Any]:
    if not path.name.lower().endswith(_KINDS):
        raise InputError(f"{path}: {path.suffix or 'no ending'}; expected {_EXPECTED}")
    if path.suffix.lower() == ".toml":
        return read_toml(path, str(path), _EXPECTED)
    if path.name.lower().endswith(QUALISYS):
        return {"cameras": read_qualisys(path, _EXPECTED)}
    return read_opencv(path, _EXPECTED)


def _cameras(data: Mapping[str, Any], where: str, name: str, warn: Warn) -> dict[str, CalibratedCamera]:
    """Cameras in a file's content."""
    listed = data.get("cameras")
    if isinstance(listed, list):
        listed = _by_name(listed, f"{where}: cameras")
    if isinstance(listed, Mapping):
        nodes = {f"{key}": node for key, node in _usable(listed, where, warn).items()}
        found = {
            key: _any_camera(node, f"{where}: cameras.{key}", alone=len(listed) == 1) for key, node in nodes.items()
        }
    elif (pair := _stereo_pair(data)) is not None:
        found = _stereo(data, pair, where)
    elif any(str(key).startswith("K_") for key in data):
        found = _easymocap(data, where)
    elif isinstance(data.get("names"), list) and any(str(key).startswith(("Rot_", "R_")) for key in data):
        raise InputError(f"{where}: places of cameras alone; expected a folder of EasyMocap's intri.yml and extri.yml")
    elif _find(data, _MATRIX) is not None:
        found = {name: _camera(data, where, alone=True)}
    else:
        found = _tables(data, where, warn)
    if not found:
        raise InputError(f"{where}: no camera in it; expected {_EXPECTED}")
    if (unit := _stated_unit(data)) != 1:
        warn(f"{where}: translations are taken as millimetres, as charuco_square_size is")
        return {key: replace(camera, translation=unit * camera.translation) for key, camera in found.items()}
    return found


def _tables(data: Mapping[str, Any], where: str, warn: Warn) -> dict[str, CalibratedCamera]:
    """Cameras of a file that has a table for each: Pose2Sim's, Anipose's, OpenCV's, MC-Calib's, Kalibr's."""
    nodes = {key: node for key, node in data.items() if isinstance(node, Mapping) and not is_matrix(node)}
    # Other tables are metadata, charuco or capture_volume. A table with a camera's name is a camera, maybe incomplete.
    nodes = {key: node for key, node in nodes.items() if _has_lens(node) or _is_camera_name(key, node)}
    if not nodes:
        raise InputError(
            f"{where}: no camera in it, but {', '.join(map(str, data)) or 'nothing'}; expected {_EXPECTED}"
        )
    alone = len(nodes) == 1
    nodes = _usable(nodes, where, warn)
    if not nodes:
        return {}
    groups = {node["camera_group"] for node in nodes.values() if isinstance(node.get("camera_group"), int)}
    if len(groups) > 1:
        raise InputError(
            f"{where}: cameras of groups {sorted(groups)}; expected one group, whose cameras share a world"
        )
    if all(_find(node, _CHAIN) is not None for node in list(nodes.values())[1:]) and not alone:
        found = _chained(nodes, where)
    else:
        found = {str(key): _camera(node, f"{where}: {key}", alone=alone) for key, node in nodes.items()}
    names = {key: node.get("name") for key, node in nodes.items()}
    if all(isinstance(each, str) for each in names.values()) and len(set(names.values())) == len(names):
        return {str(names[key]): found[str(key)] for key in nodes}
    return found


def _by_name(listed: Sequence[Any], where: str) -> dict[str, Any]:
    """Cameras of a list by their names, or by their indices in it."""
    named = [_find(node, _NAME) if isinstance(node, Mapping) else None for node in listed]
    names = [str(index if each is None else each[1]) for index, each in enumerate(named)]
    if len(set(names)) < len(names):
        raise InputError(f"{where}: {', '.join(names)}; expected each name once")
    return dict(zip(names, listed, strict=True))


def _usable(nodes: Mapping[Any, Any], where: str, warn: Warn) -> dict[Any, Any]:
    """Cameras without those that are marked as ignored, or that have no calibration or pose: Caliscope writes such."""
    some_have_pose = any(isinstance(node, Mapping) and _find(node, _TRANSLATION) is not None for node in nodes.values())
    # Kalibr's first camera has no pose, for the poses of the others are relative to it.
    chained = any(isinstance(node, Mapping) and _find(node, _CHAIN) is not None for node in nodes.values())
    found: dict[Any, Any] = {}
    for key, node in nodes.items():
        if isinstance(node, Mapping):
            matrix = _find(node, _MATRIX)
            pose = [_find(node, names) for names in (_ROTATION, _TRANSLATION)]
            lacks_pose = some_have_pose and not chained and matrix is not None and pose == [None, None]
            if node.get("ignore") is True:
                warn(f"{where}: camera {key} is left out, for it is marked with ignore")
                continue
            if _find(node, _CALISCOPE) is not None and (matrix is None or _is_nothing(matrix[1])):
                warn(f"{where}: camera {key} is left out, for it is not calibrated")
                continue
            if lacks_pose or any(each is not None and _is_nothing(each[1]) for each in pose):
                warn(f"{where}: camera {key} is left out, for it has no place")
                continue
        found[key] = node
    return found


def _has_lens(data: object) -> bool:
    """True if a file or table holds, at any depth, a camera's matrix or focal length, be it valid or not."""
    if isinstance(data, list):
        return any(map(_has_lens, data))
    if not isinstance(data, Mapping) or is_matrix(data):
        return False
    if _stereo_pair(data) is not None:
        return True
    for key, value in data.items():
        named = _plain(key) in (*_MATRIX, "focal") or str(key).startswith(("K_", "Rot_", "R_"))
        if (named and _is_numbers(value)) or _has_lens(value):
            return True
    return False


def _is_numbers(value: object) -> bool:
    """True for a matrix or a list, which may be invalid."""
    return isinstance(value, list) or (isinstance(value, Mapping) and is_matrix(value))


def _is_camera_name(key: object, node: Mapping[str, Any]) -> bool:
    """True if a table has a camera's name or a translation."""
    return _find(node, _TRANSLATION) is not None or is_camera_s(str(key))


def _is_nothing(value: object) -> bool:
    """True for null, which TOML files write as a text."""
    return value is None or (isinstance(value, str) and value.lower() in _NOTHING)


def _stated_unit(data: Mapping[str, Any]) -> float:
    """Unit of translations [m]. The size of the board's squares in FreeMoCap's file shows if it is a millimetre."""
    metadata = data.get("metadata")
    side = metadata.get("charuco_square_size") if isinstance(metadata, Mapping) else None
    in_millimetres = isinstance(side, int | float) and not isinstance(side, bool) and side >= _MILLIMETRES
    return 0.001 if in_millimetres else 1.0


def _easymocap(data: Mapping[str, Any], where: str) -> dict[str, CalibratedCamera]:
    """Cameras of EasyMocap's keys: K_01, dist_01, R_01 (Rodrigues) or Rot_01, T_01, and perhaps H_01 and W_01."""
    cameras: dict[str, CalibratedCamera] = {}
    listed = data.get("names")
    names = list(map(str, listed)) if isinstance(listed, list) else []
    if not names or any(f"K_{name}" not in data for name in names):  # 01 without quotes is 1
        names = [str(key).removeprefix("K_") for key in data if str(key).startswith("K_")]
    for name in names:
        keys = {"K": "K", "D": "dist", "dist": "dist", "Rot": "R", "R": "R", "T": "T", "W": "width", "H": "height"}
        node = {to: data[f"{key}_{name}"] for key, to in keys.items() if f"{key}_{name}" in data}
        if "T" not in node:
            raise InputError(f"{where}: T_{name}: missing; expected a folder of EasyMocap's intri.yml and extri.yml")
        cameras[name] = _camera(node, f"{where}: camera {name}", alone=False)
    return cameras


def _chained(nodes: Mapping[str, Any], where: str) -> dict[str, CalibratedCamera]:
    """Cameras of Kalibr. Each one's pose is relative to the camera before it."""
    found: dict[str, CalibratedCamera] = {}
    rotation, translation = np.eye(3), np.zeros(3)
    for key, node in nodes.items():
        camera = _camera(node, f"{where}: {key}", alone=True)
        if found:
            step = _numbers(node, _CHAIN, f"{where}: {key}", "a transformation", (4, 4))
            rotation, translation = step[:3, :3] @ rotation, step[:3, :3] @ translation + step[:3, 3]
        found[str(key)] = _made(f"{where}: {key}", **vars(camera) | {"rotation": rotation, "translation": translation})
    return found


def _stereo_pair(data: Mapping[str, Any]) -> dict[str, dict[str, Any]] | None:
    """Lenses of a stereo calibration's two cameras by name, such as M1 and D1 or cameraMatrixL and distCoeffsL."""
    plain = {_plain(key): value for key, value in data.items()}
    # EasyMocap's K_1 and K_2 have poses R_1 and T_1, R_2 and T_2.
    if any(str(key).startswith("K_") for key in data) and not {"r", "t"} <= plain.keys():
        return None
    for pair in _PAIRS:
        found: dict[str, dict[str, Any]] = {}
        for name, ending in pair:
            lens = next((plain[word + ending] for word in _MATRIX if word + ending in plain), None)
            bent = next((plain[word + ending] for word in _DISTORTION if word + ending in plain), [0.0])
            if _is_numbers(lens):
                found[name] = {"M": lens, "D": bent}
        if len(found) == len(pair):
            return found
    return None


def _stereo(data: Mapping[str, Any], pair: Mapping[str, dict[str, Any]], where: str) -> dict[str, CalibratedCamera]:
    size = {key: data[key] for key in data if _plain(key) in (*_SIZE, *_WIDTH, *_HEIGHT)}
    pose = {key: data[key] for key in data if _plain(key) in (*_ROTATION, *_TRANSLATION)}
    first, second = pair
    return {
        first: _camera(pair[first] | size, where, alone=True),
        second: _camera(pair[second] | size | pose, where, alone=False),
    }


def _plain(key: object) -> str:
    return str(key).replace("_", "").lower()


def _find(node: Mapping[str, Any], names: tuple[str, ...]) -> tuple[str, Any] | None:
    """Key and value for the first of these names that a node has; None if it has none of them."""
    keys = {_plain(key): key for key in node}
    return next(((keys[name], node[keys[name]]) for name in names if name in keys), None)


def _any_camera(node: object, where: str, *, alone: bool) -> CalibratedCamera:
    """Read a camera of a list, in the project's own form or with OpenCV's matrix."""
    if isinstance(node, Mapping) and "focal" not in node and _find(node, _MATRIX) is not None:
        return _camera(node, where, alone=alone)
    return _own_camera(node, where)


def _camera(node: Mapping[str, Any], where: str, *, alone: bool) -> CalibratedCamera:
    """Read a camera of OpenCV's matrices. If it is ``alone``, it may lack a pose, and stands at the world's origin."""
    _refuse_fisheye(node, where)
    matrix = _numbers(node, _MATRIX, where, "a camera matrix", (3, 3), (4,))
    if matrix.shape == (4,):  # Kalibr's
        matrix = np.array([[matrix[0], 0.0, matrix[2]], [0.0, matrix[1], matrix[3]], [0.0, 0.0, 1.0]])
    if matrix[2].tolist() != [0.0, 0.0, 1.0] or matrix[1, 0] != 0 or abs(matrix[0, 1]) > 1e-3 * abs(matrix[0, 0]):
        raise InputError(
            f"{where}: camera matrix {shown(matrix.tolist())}; expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        )
    turn, move = _pose(node, where, alone=alone)
    found = _find(node, _DISTORTION)
    coefficients = [] if found is None else _coefficients(found[1], f"{where}: {found[0]}")
    return _made(
        where,
        focal=(float(matrix[0, 0]), float(matrix[1, 1])),
        principal=(float(matrix[0, 2]) + 0.5, float(matrix[1, 2]) + 0.5),
        distortion=_distortion(coefficients, where),
        rotation=turn,
        translation=move,
        size=_size(node, where),
    )


def _pose(node: Mapping[str, Any], where: str, *, alone: bool) -> tuple[np.ndarray, np.ndarray]:
    """Rotation R and translation t, from world to camera."""
    if _find(node, _POSE) is not None:
        pose = _numbers(node, _POSE, where, "a camera's pose", (4, 4))
        turn = pose[:3, :3].T
        return turn, -turn @ pose[:3, 3]
    if alone and _find(node, _ROTATION) is None and _find(node, _TRANSLATION) is None:
        return np.eye(3), np.zeros(3)
    return _rotation(node, where), _vector(node, where)


def _coefficients(value: object, where: str) -> list[float]:
    """Numbers of a list, which may be empty or null."""
    if value is None or (isinstance(value, Sequence) and not value):
        return []
    numbers: list[float] = to_matrix(value, where).ravel().tolist()
    return numbers


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
    return _made(
        where,
        focal=pairs[0],
        principal=pairs[1],
        distortion=_distortion(_coefficients(node.get("distortion"), f"{where}: distortion"), where),
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
    """Numbers under the first of these names that a node has, in one of these shapes."""
    found = _find(node, names)
    if found is None:
        raise InputError(f"{where}: {names[0]}: missing, but {', '.join(map(str, node))}; expected {expected}")
    values = to_matrix(found[1], f"{where}: {found[0]}")
    if values.shape not in shapes:
        raise InputError(f"{where}: {found[0]}: shape {values.shape}; expected {expected}, {shapes[0]}")
    return values


def _rotation(node: Mapping[str, Any], where: str) -> np.ndarray:
    """Read the rotation R, given as a matrix or as Rodrigues' vector."""
    values = _numbers(node, _ROTATION, where, "a rotation, world to camera", (3, 3), (3,), (3, 1), (1, 3))
    if values.shape == (3, 3):
        return values
    angle = float(np.linalg.norm(values))
    tenths = _TENTHS * values
    if angle > _LARGEST_TURN or (angle > math.pi and np.allclose(tenths, tenths.round(), rtol=0, atol=1e-9)):
        raise InputError(
            f"{where}: rotation {shown(values.ravel().tolist())}, by {angle:g} radians; expected {_LARGEST_TURN:g} at "
            "most, and radians, not degrees"
        )
    return rotation_from_axis_angle(torch.from_numpy(values.reshape(3))).numpy()


def _vector(node: Mapping[str, Any], where: str) -> np.ndarray:
    return _numbers(node, _TRANSLATION, where, "a translation [m]", (3,), (3, 1), (1, 3)).reshape(3)


def _distortion(values: list[float], where: str) -> tuple[float, ...]:
    """OpenCV's coefficients, without those for thin prisms and tilted sensors, which must be 0."""
    if any(values[8:]):
        raise InputError(f"{where}: distortion: {len(values)} numbers; expected 0 after k1, k2, p1, p2, k3, k4, k5, k6")
    return tuple(values[:8])


def _size(node: Mapping[str, Any], where: str) -> tuple[int, int] | None:
    """Size (H, W) of the pictures from a file's width and height; None if the file states none."""
    found = _find(node, _SIZE)
    if found is not None:
        values = to_matrix(found[1], f"{where}: {found[0]}").ravel().tolist()
    else:
        sides = [_find(node, names) for names in (_WIDTH, _HEIGHT)]
        if sides[0] is None or sides[1] is None:
            return None
        values = [side[1] for side in sides if side is not None]
    if len(values) != 2 or not all(map(_is_side, values)):
        raise InputError(f"{where}: size {shown(values)}; expected width and height [px]")
    return int(values[1]), int(values[0])


def _is_side(side: object) -> bool:
    """True for a whole number above 0."""
    return isinstance(side, int | float) and not isinstance(side, bool) and 0 < side < math.inf and side % 1 == 0


def _refuse_fisheye(node: Mapping[str, Any], where: str) -> None:
    expected = "expected a pinhole camera with Brown's distortion"
    for key, value in _found(node, _FISHEYE):
        if value not in (False, 0, None, "false"):
            raise InputError(f"{where}: {key}: a fisheye lens is not supported; {expected}")
    for key, value in _found(node, _MODEL):
        if str(value).lower() not in _PLAIN_MODELS:
            raise InputError(f"{where}: {key}: {shown(value)} is not supported; {expected}")
    for key, value in _found(node, ("distortiontype",)):  # MC-Calib's
        if value not in (0, "0"):
            raise InputError(f"{where}: {key}: {shown(value)}, a fisheye lens, is not supported; {expected}")


def _found(node: Mapping[str, Any], names: tuple[str, ...]) -> Iterable[tuple[str, Any]]:
    """Keys and values for all of these names that a node has."""
    return [(key, value) for key, value in node.items() if _plain(key) in names]
