"""Qualisys' calibrations, ``.qca.txt``: XML, in millimetres. The cameras look along their negative third axis."""

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
_SUBPIXELS = 64  # units in a pixel, for focal lengths and principal points
_FILMS = ("video", "none")  # parts of the models' names, for cameras that film
_PARTS = ("transform", "intrinsic", "fov_video")
_LARGEST = 2**24  # [bytes]; a camera has two thousand


def read_qualisys(path: Path, expected: str) -> dict[str, dict[str, Any]]:
    """Read cameras by serial number, in natural order, with OpenCV's matrix, distortion, R, t [m] and size.

    R and t lead from world to camera. If there are video cameras, marker cameras are left out.

    Args:
        path: File of the calibration.
        expected: Accepted formats, for messages.

    Raises:
        InputError: If it can't be read, has a document type, or a camera is incomplete.
    """
    cameras = _elements(path, expected)
    films = [each for each in cameras if any(kind in each["camera"].get("model", "none").lower() for kind in _FILMS)]
    found: dict[str, dict[str, Any]] = {}
    for index, parts in enumerate(films or cameras):
        name = parts["camera"].get("serial", str(index))
        if name in found:
            raise InputError(f"{path}: camera {name} a second time; expected each once")
        found[name] = _camera(parts, f"{path}: camera {name}")
    return dict(sorted(found.items(), key=lambda each: natural_key(each[0])))


def _elements(path: Path, expected: str) -> list[dict[str, dict[str, str]]]:
    """Attributes of each camera and of its parts, as the XML has them."""
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
    """Camera with OpenCV's matrices: it looks along its third axis, and its second axis points down."""

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
    position = np.array([number("transform", axis) for axis in ("x", "y", "z")]) / 1000.0
    if "skew" in parts["intrinsic"] and number("intrinsic", "skew"):
        raise InputError(f"{where}: skew: {number('intrinsic', 'skew'):g}; expected 0")
    left = top = 0.0
    if "fov_video" in parts:
        left, top = number("fov_video", "left"), number("fov_video", "top")
        width, height = number("fov_video", "right") - left + 1, number("fov_video", "bottom") - top + 1
    else:  # the last subpixel belongs to the last pixel
        width = math.ceil((number("intrinsic", "sensorMaxU") + 1) / _SUBPIXELS)
        height = math.ceil((number("intrinsic", "sensorMaxV") + 1) / _SUBPIXELS)
    focal = [number("intrinsic", f"focalLength{axis}") / _SUBPIXELS for axis in "UV"]
    u = number("intrinsic", "centerPointU") / _SUBPIXELS
    v = number("intrinsic", "centerPointV") / _SUBPIXELS
    radial = [number("intrinsic", f"radialDistortion{order}") for order in (1, 2, 3)]
    tangential = [number("intrinsic", f"tangentalDistortion{order}") for order in (1, 2)]  # as the files spell it
    return {
        "matrix": [[focal[0], 0.0, u - left], [0.0, focal[1], v - top], [0.0, 0.0, 1.0]],
        "distortions": [*radial[:2], *tangential, radial[2]],
        "rotation": rotation.tolist(),
        "translation": (-rotation @ position).tolist(),
        "size": [width, height],
    }
