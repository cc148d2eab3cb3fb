"""Qualisys' calibrations, ``.qca.txt``: XML of cameras that look along their negative third axis, in millimetres."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from ..errors import InputError, cause, shown
from .camera_names import natural_key

QUALISYS = (".qca.txt", ".qca", ".xml")
_SUBPIXELS = 64  # a pixel, in which focal lengths and principal points are given
_FILMS = ("video", "none")  # in the models of cameras that film
_PARTS = ("transform", "intrinsic", "fov_video")
_LARGEST = 2**24  # [bytes]; a camera has two thousand


def read_qualisys(path: Path, expected: str) -> dict[str, dict[str, Any]]:
    """Read cameras by serial, in natural order: OpenCV's matrix, distortion, R, t [m] and size, world to camera.

    Marker cameras beside video cameras are left out.

    Args:
        path: The file.
        expected: Accepted forms, for messages.

    Raises:
        InputError: If it can't be read, has a document type, or a camera lacks something.
    """
    cameras = _elements(path, expected)
    films = [each for each in cameras if any(kind in each["camera"].get("model", "none").lower() for kind in _FILMS)]
    found: dict[str, dict[str, Any]] = {}
    for place, parts in enumerate(films or cameras):
        name = parts["camera"].get("serial", str(place))
        if name in found:
            raise InputError(f"{path}: camera {name} a second time; expected each once")
        found[name] = _camera(parts, f"{path}: camera {name}")
    return dict(sorted(found.items(), key=lambda each: natural_key(each[0])))


def _elements(path: Path, expected: str) -> list[dict[str, dict[str, str]]]:
    """Attributes of each camera and its parts."""
    found: list[dict[str, dict[str, str]]] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        if tag.lower() == "camera":
            found.append({"camera": attributes})
        elif found and tag.lower() in _PARTS:
            found[-1][tag.lower()] = attributes

    def refuse(*_: object) -> None:
        raise InputError(f"{path}: a document type in it; expected {expected}")

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.StartDoctypeDeclHandler = refuse  # entities are declared there alone
    try:
        with path.open("rb") as file:
            data = file.read(_LARGEST + 1)
        if len(data) > _LARGEST:
            raise InputError(f"{path}: more than {_LARGEST} bytes; expected {expected}")
        parser.Parse(data, True)
    except OSError as error:
        raise InputError(f"{path}: {cause(error)}; expected {expected}") from error
    except (expat.ExpatError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: {cause(error)}; expected {expected}") from error
    if not found:
        raise InputError(f"{path}: no camera in it; expected {expected}")
    return found


def _camera(parts: Mapping[str, Mapping[str, str]], where: str) -> dict[str, Any]:
    """Camera with OpenCV's matrices: it looks along its third axis, the second one down."""

    def number(part: str, name: str) -> float:
        text = parts.get(part, {}).get(name)
        try:
            value = float("nan" if text is None else text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputError(f"{where}: {part}: {name}: {shown(text)}; expected a number")
        return value

    for part in ("transform", "intrinsic"):
        if part not in parts:
            raise InputError(f"{where}: {part}: missing; expected a calibrated camera")
    axes = np.array([[number("transform", f"r{row}{column}") for column in (1, 2, 3)] for row in (1, 2, 3)])
    rotation = np.diag([1.0, -1.0, -1.0]) @ axes
    place = np.array([number("transform", axis) for axis in ("x", "y", "z")]) / 1000.0
    if "skew" in parts["intrinsic"] and number("intrinsic", "skew"):
        raise InputError(f"{where}: skew: {number('intrinsic', 'skew'):g}; expected 0")
    left = top = 0.0
    if "fov_video" in parts:
        left, top = number("fov_video", "left"), number("fov_video", "top")
        width, height = number("fov_video", "right") - left + 1, number("fov_video", "bottom") - top + 1
    else:  # the last subpixel is that of the last pixel
        width, height = (math.ceil((number("intrinsic", f"sensorMax{axis}") + 1) / _SUBPIXELS) for axis in "UV")
    focal = [number("intrinsic", f"focalLength{axis}") / _SUBPIXELS for axis in "UV"]
    u, v = (number("intrinsic", f"centerPoint{axis}") / _SUBPIXELS for axis in "UV")
    k1, k2, k3 = (number("intrinsic", f"radialDistortion{order}") for order in (1, 2, 3))
    p1, p2 = (number("intrinsic", f"tangentalDistortion{order}") for order in (1, 2))
    return {
        "matrix": [[focal[0], 0.0, u - left], [0.0, focal[1], v - top], [0.0, 0.0, 1.0]],
        "distortions": [k1, k2, p1, p2, k3],
        "rotation": rotation.tolist(),
        "translation": (-rotation @ place).tolist(),
        "size": [width, height],
    }
