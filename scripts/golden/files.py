"""Files of results as arrays and text, without times, versions, paths and whatever else changes from run to run."""

from __future__ import annotations

import hashlib
import json
import re
import struct
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from differences import Found
from PIL import Image

from warp_partdr.inputs.films import read_frames

# Keys of reports and metadata, which belong to a run.
_LEFT_OUT = {"seconds", "seconds_total", "versions", "version", "device", "files", "asset", "sha256", "options_sha256"}
_NORMAL = 10  # a normal counts so much less than a length in metres
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def read_results(folder: Path) -> Found:
    """All files of a folder, and of those in it, by their paths."""
    found: Found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            name = path.relative_to(folder).as_posix()
            found |= {f"{name}, {part}": value for part, value in _READERS.get(path.suffix, _read_bytes)(path)}
    return found


def text_arrays(text: str) -> Iterator[tuple[str, np.ndarray]]:
    """A text as its words and its numbers, which may differ a little where the words must not."""
    yield "words", np.array(_NUMBER.sub("#", text))
    yield "numbers", np.array([float(number) for number in _NUMBER.findall(text)])


def _read_bytes(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    yield "SHA-256", np.array(hashlib.sha256(path.read_bytes()).hexdigest())


def _read_text(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    return text_arrays(path.read_text(encoding="utf-8"))


def _read_bvh(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """A motion's text; angles become radians, so that a thousandth of one moves a limb by about a millimetre."""
    for kind, array in _read_text(path):
        yield kind, np.radians(array) if kind == "numbers" else array


def _read_json(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    data = json.loads(path.read_text(encoding="utf-8"))
    for key, value in _lasting(data).items():
        for kind, array in text_arrays(json.dumps(value)):
            yield f"{key}, {kind}", array


def _lasting(data: Any) -> Any:
    """Data of JSON without what belongs to a run."""
    if isinstance(data, dict):
        return {key: _lasting(value) for key, value in data.items() if key not in _LEFT_OUT}
    return [_lasting(value) for value in data] if isinstance(data, list) else data


def _read_npz(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    with np.load(path, allow_pickle=False) as data:
        yield from ((name, data[name]) for name in data.files)


def _read_picture(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    with Image.open(path) as image:
        yield "pixels", np.asarray(image.convert("RGB"))


def _read_film(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    frames = list(read_frames(path))
    yield "frames", np.stack([frame.picture for frame in frames])
    yield "times", np.array([frame.time for frame in frames])


def _read_glb(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """The document and the arrays of a GLB, by glTF 2.0's description."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + length])
    for kind, array in text_arrays(json.dumps(_lasting(document))):
        yield f"document, {kind}", array
    body = data[20 + length + 8 :]
    primitives = [each for mesh in document["meshes"] for each in mesh["primitives"]]
    normals = {primitive["attributes"].get("NORMAL") for primitive in primitives}
    types = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
    for number, accessor in enumerate(document["accessors"]):
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        values = np.frombuffer(body, types[accessor["componentType"]], accessor["count"] * width, start)
        if number in normals:  # those of small triangles turn far when vertices move little
            values = values / np.float32(_NORMAL)
        yield f"array {number}", values.reshape(-1, width)


def _read_ply(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """The header of a binary PLY, its numbers of vertices by name, and the bytes of its faces."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = header.decode("ascii").splitlines()
    yield "header", np.array("\n".join(lines))
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    types = {"float": "<f4", "double": "<f8", "uchar": "u1"}
    start = lines.index(f"element vertex {count}") + 1
    properties = [line.split()[1:] for line in takewhile(lambda line: line.startswith("property"), lines[start:])]
    form = np.dtype([(name, types[kind]) for kind, name in properties])
    vertices = np.frombuffer(body, form, count)
    yield from ((name, vertices[name].copy()) for name in form.names or ())
    yield "faces", np.frombuffer(body, np.uint8, offset=count * form.itemsize)


def _read_parquet(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """The columns of a table, and its metadata."""
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    for field in table.schema:
        said = {key.decode(): value.decode() for key, value in (field.metadata or {}).items()}
        yield f"{field.name}, field", np.array(f"{field.type} {said}")
        yield from (
            (f"{field.name}, {kind}", array) for kind, array in text_arrays(json.dumps(table[field.name].to_pylist()))
        )
    for key, value in (table.schema.metadata or {}).items():
        for kind, array in text_arrays(json.dumps(_lasting(json.loads(value)))):
            yield f"metadata {key.decode()}, {kind}", array


_READERS = {
    ".npz": _read_npz,
    ".json": _read_json,
    ".png": _read_picture,
    ".mp4": _read_film,
    ".glb": _read_glb,
    ".ply": _read_ply,
    ".obj": _read_text,
    ".mtl": _read_text,
    ".bvh": _read_bvh,
    ".parquet": _read_parquet,
}
