"""Files of skinned bodies read back, and a motion to write."""

from __future__ import annotations

import json
import struct

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from warp_partdr.models.registration import Registered
from warp_partdr.results.skinned_files import Poses


def read_glb(data: bytes) -> tuple[dict, list[np.ndarray]]:
    """The JSON and the arrays of a GLB, by glTF 2.0's description."""
    magic, version, size = struct.unpack_from("<4sII", data)
    assert (magic, version, size) == (b"glTF", 2, len(data))
    length, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    document = json.loads(data[20 : 20 + length])
    body = data[20 + length + 8 :]
    arrays = []
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        dtype = {5126: np.float32, 5123: np.uint16, 5125: np.uint32}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]
        values = np.frombuffer(body, dtype, accessor["count"] * width, view["byteOffset"])
        arrays.append(values.reshape(accessor["count"], width))
    return document, arrays


def placed(node: dict) -> np.ndarray:
    """Matrix of a node, shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(node["rotation"]).as_matrix()
    matrix[:3, 3] = node["translation"]
    return matrix


def posed_vertices(document: dict, arrays: list[np.ndarray], skin: int) -> np.ndarray:
    """Vertices of a skin's mesh as its nodes stand, by glTF 2.0's description, shape (V, 3)."""
    nodes, given = document["nodes"], document["skins"][skin]
    above = {child: parent for parent, node in enumerate(nodes) for child in node.get("children", [])}

    def world(node: int) -> np.ndarray:
        own = placed(nodes[node])
        return world(above[node]) @ own if node in above else own

    matrices = np.stack([world(joint) for joint in given["joints"]])
    inverse_bind = arrays[given["inverseBindMatrices"]].reshape(-1, 4, 4).transpose(0, 2, 1)
    (mesh,) = [node["mesh"] for node in nodes if node.get("skin") == skin]
    attributes = document["meshes"][mesh]["primitives"][0]["attributes"]
    bind, bones, weights = (arrays[attributes[name]] for name in ("POSITION", "JOINTS_0", "WEIGHTS_0"))
    blended = np.einsum("vk,vkij->vij", weights, (matrices @ inverse_bind)[bones])
    return (blended[:, :3] @ np.column_stack([bind, np.ones(len(bind))])[..., None])[..., 0]


def standing(registered: Registered, points: torch.Tensor) -> np.ndarray:
    """Camera frame to the files': y up, the lowest vertex at 0."""
    highest = float(registered.detailed.vertices[0, :, 1].max())  # y is down
    return points.cpu().numpy() * [1.0, -1.0, -1.0] + [0.0, highest, 0.0]


def moving(registered: Registered) -> Poses:
    """Five poses: the left shoulder turns by a right angle each, and the body goes to the right."""
    joint = registered.model.joint_names.index(registered.model.joint_names[5])
    rotations = registered.rotations[:1].repeat(5, 1, 1, 1)
    for step in range(5):
        turn = Rotation.from_euler("z", 90 * step, degrees=True).as_matrix()
        rotations[step, joint] = torch.from_numpy(turn).float().to(rotations) @ rotations[step, joint]
    steps = torch.arange(5)[:, None].to(rotations) * torch.tensor([0.1, 0.0, 0.0]).to(rotations)
    lowest = Poses.first(registered).lowest
    return Poses(rotations, registered.translation[:1] + steps, np.arange(5) / 10, 10.0, lowest)
