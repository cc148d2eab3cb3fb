"""Writer of binary glTF 2.0: nodes, skinned meshes, cameras and one animation (Khronos Group, glTF 2.0)."""

from __future__ import annotations

import json
import struct
from typing import Any, Literal

import numpy as np

_DTYPES = {"float32": 5126, "uint16": 5123, "uint32": 5125}  # component types
_KINDS = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}

ELEMENT_ARRAY = 34963  # target of indices, glTF's ELEMENT_ARRAY_BUFFER

_Animated = Literal["translation", "rotation", "scale"]


class Document:
    """File that is being made. Its lists are those of glTF."""

    def __init__(self) -> None:
        self.roots: list[int] = []
        self.nodes: list[dict[str, Any]] = []
        self.meshes: list[dict[str, Any]] = []
        self.skins: list[dict[str, Any]] = []
        self.materials: list[dict[str, Any]] = []
        self.cameras: list[dict[str, Any]] = []
        self._data = bytearray()
        self._views: list[dict[str, int]] = []
        self._accessors: list[dict[str, Any]] = []
        self._channels: list[dict[str, Any]] = []
        self._samplers: list[dict[str, Any]] = []

    def add(self, values: np.ndarray, *, target: int | None = None, bounds: bool = False) -> int:
        """Append an array, and return its accessor's index."""
        view = {"buffer": 0, "byteOffset": len(self._data), "byteLength": values.nbytes}
        self._views.append(view if target is None else {**view, "target": target})
        self._data += values.tobytes()
        self._data += bytes(-len(self._data) % 4)
        accessor = {
            "bufferView": len(self._views) - 1,
            "componentType": _DTYPES[values.dtype.name],
            "count": len(values),
            "type": _KINDS[values.shape[1:]],
        }
        extent = {}
        if bounds:
            extent = {
                "min": np.atleast_1d(values.min(axis=0)).tolist(),
                "max": np.atleast_1d(values.max(axis=0)).tolist(),
            }
        self._accessors.append({**accessor, **extent})
        return len(self._accessors) - 1

    def add_times(self, times: np.ndarray) -> int:
        """Append times of key frames [s], shape (T,), and return their accessor's index."""
        return self.add(times.astype(np.float32), bounds=True)

    def animate(self, node: int, path: _Animated, times: int, values: np.ndarray, *, steps: bool = False) -> None:
        """Animate a node with values at ``times``, (T, 3) or (T, 4), which are interpolated unless in ``steps``."""
        self._channels.append({"sampler": len(self._samplers), "target": {"node": node, "path": path}})
        output = self.add(values.astype(np.float32))
        self._samplers.append({"input": times, "output": output, "interpolation": "STEP" if steps else "LINEAR"})

    def glb(self) -> bytes:
        """Return the file's bytes: a header, a chunk of JSON and a chunk of numbers."""
        motion = {"name": "motion", "channels": self._channels, "samplers": self._samplers}
        whole = {
            "asset": {"version": "2.0", "generator": "warp-partdr"},
            "scene": 0,
            "scenes": [{"nodes": self.roots}],
            "nodes": self.nodes,
            "materials": self.materials,
            "meshes": self.meshes,
            "skins": self.skins,
            "cameras": self.cameras,
            "animations": [motion] if self._channels else [],
            "buffers": [{"byteLength": len(self._data)}],
            "bufferViews": self._views,
            "accessors": self._accessors,
        }
        given = {key: value for key, value in whole.items() if value != []}  # glTF has no empty lists
        text = json.dumps(given, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self._data), b"BIN\0") + bytes(self._data)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
