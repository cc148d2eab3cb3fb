"""Meshes that have no skeleton as OBJ, PLY and GLB. trimesh writes them as well, but its import takes half a second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .gltf import ELEMENT_ARRAY, Document

_HEAD = """ply
format binary_little_endian 1.0
comment warp-partdr
element vertex {vertices}
property float x
property float y
property float z
element face {faces}
property list uchar int vertex_indices
property uchar red
property uchar green
property uchar blue
property uchar alpha
end_header
"""
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3), ("colour", "u1", 4)])


@dataclass(frozen=True, eq=False)
class NamedMesh:
    """Mesh of a scene.

    Attributes:
        name: Name of the mesh and of its node.
        vertices: Vertices, y up [m], shape (V, 3).
        faces: Indices of each face's vertices, shape (F, 3).
        material: Material by glTF's names, ``pbrMetallicRoughness``.
        normals: Unit vectors at the vertices, shape (V, 3); None: viewers find them from the faces.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    material: dict[str, Any]
    normals: np.ndarray | None = None


def obj(vertices: np.ndarray, faces: np.ndarray) -> str:
    """Write a mesh as Wavefront OBJ, with coordinates to a hundredth of a micrometre.

    Args:
        vertices: Vertices [m], shape (V, 3).
        faces: Indices of each face's vertices, from 0 on, shape (F, 3).
    """
    # One format for all numbers is a third of the time that one a line takes.
    points = "v %.8f %.8f %.8f\n" * len(vertices) % tuple(vertices.ravel().tolist())
    corners = "f %d %d %d\n" * len(faces) % tuple((faces + 1).ravel().tolist())
    return f"# warp-partdr\n{points}{corners}"


def ply(vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray) -> bytes:
    """Write a mesh as binary PLY, with colours of its faces.

    Args:
        vertices: Vertices [m], shape (V, 3).
        faces: Indices of each face's vertices, shape (F, 3).
        colours: RGB of each face, shape (F, 3), uint8.
    """
    rows = np.empty(len(faces), dtype=_FACE)
    rows["count"], rows["corners"] = 3, faces
    rows["colour"] = np.pad(colours, ((0, 0), (0, 1)), constant_values=255)  # opaque
    head = _HEAD.format(vertices=len(vertices), faces=len(faces)).encode()
    return head + vertices.astype("<f4").tobytes() + rows.tobytes()


def meshes_glb(meshes: Sequence[NamedMesh]) -> bytes:
    """Write meshes as binary glTF 2.0, each with a node and a material of its own. Equal faces are stored once."""
    document = Document()
    stored: list[tuple[np.ndarray, int]] = []  # faces, and the accessor of their indices
    for mesh in meshes:
        indices = next((each for faces, each in stored if np.array_equal(faces, mesh.faces)), None)
        if indices is None:
            indices = document.add(mesh.faces.astype(np.uint32).reshape(-1), target=ELEMENT_ARRAY)
            stored.append((mesh.faces, indices))
        attributes = {"POSITION": document.add(mesh.vertices.astype(np.float32), bounds=True)}
        if mesh.normals is not None:
            attributes["NORMAL"] = document.add(mesh.normals.astype(np.float32))
        primitive = {"attributes": attributes, "indices": indices, "material": len(document.materials)}
        document.roots.append(len(document.nodes))
        document.nodes.append({"name": mesh.name, "mesh": len(document.meshes)})
        document.materials.append({"name": mesh.name, "pbrMetallicRoughness": mesh.material})
        document.meshes.append({"name": mesh.name, "primitives": [primitive]})
    return document.glb()
