"""Registered detailed bodies as files for other tools: GLB with skeleton and skin, OBJ, PLY, and BVH of the pose.

All have y up, stand on y = 0, seen from the camera's side, as ``ellipbody_files`` has EllipBody; metres, but for BVH:
centimetres. trimesh writes no skins, so the GLB is written here (glTF 2.0): its joints hold the pose, so that a viewer
shows the posed body and Blender can pose it further.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..body.rotations import rotation_to_axis_angle
from ..clothing.registration import Registered
from .ellipbody_files import GLTF_FROM_CAMERA
from .palette import PART_COLOURS

SKIN_WEIGHTS = 4  # a vertex, as glTF's JOINTS_0 has it
_FLOAT, _UINT16, _UINT32 = 5126, 5123, 5125  # glTF's component types
_DTYPES = {np.dtype(np.float32): _FLOAT, np.dtype(np.uint16): _UINT16, np.dtype(np.uint32): _UINT32}
_KINDS = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_INDICES = 34963  # glTF's ELEMENT_ARRAY_BUFFER


def save_detailed(registered: Registered, folder: Path, *, index: int = 0) -> None:
    """Write detailed.glb, detailed.obj, detailed.ply and detailed.bvh.

    Args:
        registered: In the camera frame.
        folder: Is there.
        index: Which body of the batch.
    """
    import trimesh

    (folder / "detailed.glb").write_bytes(glb(registered, index))
    vertices = _upright(registered, index)
    faces = registered.model.faces.cpu().numpy()
    trimesh.Trimesh(vertices, faces, process=False).export(folder / "detailed.obj")
    colours = PART_COLOURS[registered.model.face_parts.cpu().numpy()]
    trimesh.Trimesh(vertices, faces, face_colors=colours, process=False).export(folder / "detailed.ply")
    (folder / "detailed.bvh").write_text(bvh(registered, index))


def glb(registered: Registered, index: int = 0) -> bytes:
    """A body as binary glTF 2.0: mesh, skeleton, skin weights, and its pose."""
    model = registered.model
    rest = registered.rest().joints[index].detach().cpu().double().numpy()
    transforms = registered.detailed.transforms[index].detach().cpu().double().numpy()
    weights, joints = model.skin_weights.cpu().double().topk(min(SKIN_WEIGHTS, model.num_joints), dim=1)
    padding = (0, SKIN_WEIGHTS - weights.shape[1])
    shares = torch.nn.functional.pad(weights / weights.sum(1, keepdim=True), padding).numpy()
    bones = torch.nn.functional.pad(joints, padding).numpy()
    inverse_bind = np.tile(np.eye(4), (len(rest), 1, 1))
    inverse_bind[:, :3, 3] = -rest
    # The mesh that the skin takes to the posed one, so that what a viewer shows is exact.
    skin = np.einsum("vk,vkij->vij", shares, (transforms @ inverse_bind)[bones])
    posed = registered.detailed.vertices[index].detach().cpu().double().numpy()
    bind = np.linalg.solve(skin[:, :3, :3], (posed - skin[:, :3, 3])[..., None])[..., 0]

    nodes: list[dict[str, Any]] = []
    rotations = registered.rotations[index].detach().cpu()
    translation = registered.translation[index].detach().cpu().double().numpy()
    for joint, parent in enumerate(model.parents):
        offset = translation if parent < 0 else rest[joint] - rest[parent]
        node = {
            "name": model.joint_names[joint],
            "translation": offset.tolist(),
            "rotation": _quaternion(rotations[joint]),
        }
        if children := [child for child, above in enumerate(model.parents) if above == joint]:
            node["children"] = children
        nodes.append(node)
    lift = -float(_upright(registered, index, lowered=False)[:, 1].min())
    # Half a turn about x: from the camera frame to glTF's.
    nodes.append({"name": "body", "rotation": [1.0, 0.0, 0.0, 0.0], "translation": [0.0, lift, 0.0], "children": [0]})
    nodes.append({"name": model.name, "mesh": 0, "skin": 0})

    buffer = _Buffer()
    attributes = {
        "POSITION": buffer.add(bind.astype(np.float32), bounds=True),
        "NORMAL": buffer.add(_normals(bind, model.faces.cpu().numpy()).astype(np.float32)),
        "JOINTS_0": buffer.add(bones.astype(np.uint16)),
        "WEIGHTS_0": buffer.add(shares.astype(np.float32)),
    }
    indices = buffer.add(model.faces.cpu().numpy().astype(np.uint32).reshape(-1), target=_INDICES)
    # glTF's matrices are stored column by column.
    matrices = buffer.add(inverse_bind.transpose(0, 2, 1).astype(np.float32))
    skin_material = {"baseColorFactor": [0.6, 0.42, 0.34, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8}
    return buffer.glb(
        {
            "asset": {"version": "2.0", "generator": "warp-partdr"},
            "scene": 0,
            "scenes": [{"nodes": [len(nodes) - 2, len(nodes) - 1]}],
            "nodes": nodes,
            "materials": [{"name": "skin", "pbrMetallicRoughness": skin_material}],
            "meshes": [
                {"name": model.name, "primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}
            ],
            "skins": [
                {"joints": list(range(model.num_joints)), "inverseBindMatrices": matrices, "skeleton": len(nodes) - 2}
            ],
        }
    )


def bvh(registered: Registered, index: int = 0) -> str:
    """A body's skeleton and pose as BVH, one frame, centimetres and degrees."""
    model = registered.model
    rest = 100 * registered.rest().joints[index].detach().cpu().double().numpy()
    rotations = registered.rotations[index].detach().cpu().double().numpy()
    rotations[0] = GLTF_FROM_CAMERA @ rotations[0]
    upright = _upright(registered, index, lowered=False)
    root = GLTF_FROM_CAMERA @ registered.translation[index].detach().cpu().double().numpy()
    numbers = (100 * (root - [0.0, upright[:, 1].min(), 0.0])).tolist()
    lines = ["HIERARCHY"]

    def describe(joint: int, indent: str) -> None:
        parent = model.parents[joint]
        offset = np.zeros(3) if parent < 0 else rest[joint] - rest[parent]
        position = "Xposition Yposition Zposition " if parent < 0 else ""
        lines.extend(
            [
                f"{indent}{'ROOT' if parent < 0 else 'JOINT'} {model.joint_names[joint]}",
                f"{indent}{{",
                f"{indent}  OFFSET {_numbers(offset)}",
                f"{indent}  CHANNELS {6 if position else 3} {position}Zrotation Yrotation Xrotation",
            ]
        )
        numbers.extend(_euler_zyx(rotations[joint]))
        children = [child for child, above in enumerate(model.parents) if above == joint]
        for child in children:
            describe(child, indent + "  ")
        if not children:
            lines.extend([f"{indent}  End Site", f"{indent}  {{", f"{indent}    OFFSET {_numbers(np.zeros(3))}"])
            lines.append(f"{indent}  }}")
        lines.append(f"{indent}}}")

    describe(0, "")
    return "\n".join([*lines, "MOTION", "Frames: 1", "Frame Time: 0.0333333", _numbers(np.array(numbers)), ""])


class _Buffer:
    """The binary part of a GLB and what describes it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, int]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: np.ndarray, *, target: int | None = None, bounds: bool = False) -> int:
        """Append an array; returns its accessor's index."""
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes}
        self.views.append(view if target is None else {**view, "target": target})
        self.data += values.tobytes()
        self.data += bytes(-len(self.data) % 4)
        accessor = {
            "bufferView": len(self.views) - 1,
            "componentType": _DTYPES[values.dtype],
            "count": len(values),
            "type": _KINDS[values.shape[1:]],
        }
        extent = {"min": values.min(0).tolist(), "max": values.max(0).tolist()} if bounds else {}
        self.accessors.append({**accessor, **extent})
        return len(self.accessors) - 1

    def glb(self, document: dict[str, Any]) -> bytes:
        """The file: a header, a chunk of JSON and a chunk of numbers."""
        whole = {
            **document,
            "buffers": [{"byteLength": len(self.data)}],
            "bufferViews": self.views,
            "accessors": self.accessors,
        }
        text = json.dumps(whole, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self.data), b"BIN\0") + bytes(self.data)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _upright(registered: Registered, index: int, *, lowered: bool = True) -> np.ndarray:
    """Posed vertices with y up, the lowest at y = 0 [m], shape (V, 3)."""
    vertices = registered.detailed.vertices[index].detach().cpu().double().numpy() @ GLTF_FROM_CAMERA.T
    return vertices - [0.0, vertices[:, 1].min(), 0.0] if lowered else vertices


def _quaternion(rotation: torch.Tensor) -> list[float]:
    """(x, y, z, w) of a rotation matrix, of unit length."""
    vector = rotation_to_axis_angle(rotation.double())
    angle = float(vector.norm())
    half = np.sinc(angle / 2 / np.pi) / 2
    quaternion = np.array([*(half * vector.numpy()), np.cos(angle / 2)])
    return (quaternion / np.linalg.norm(quaternion)).tolist()


def _euler_zyx(rotation: np.ndarray) -> list[float]:
    """Angles [degrees] about z, y and x of ``Rz Ry Rx``; where y is at a right angle, the one about x is 0."""
    cosine = np.hypot(rotation[0, 0], rotation[1, 0])
    y = np.arctan2(-rotation[2, 0], cosine)
    if cosine < 1e-6:
        z, x = np.arctan2(-rotation[0, 1], rotation[1, 1]), 0.0
    else:
        z, x = np.arctan2(rotation[1, 0], rotation[0, 0]), np.arctan2(rotation[2, 1], rotation[2, 2])
    return np.degrees([z, y, x]).tolist()


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Of the vertices, weighted by the faces' areas, unit length, shape (V, 3)."""
    corners = vertices[faces]
    of_faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in faces.T:
        np.add.at(normals, corner, of_faces)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(lengths > 0, normals / np.maximum(lengths, 1e-30), [0.0, 0.0, 1.0])


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.6f}" for value in values)
