"""Meshes that have no skeleton, as OBJ, PLY and GLB: trimesh, which writes them too, is the judge."""

from __future__ import annotations

import io

import numpy as np
import trimesh

from warp_partdr.body.icosphere import icosphere
from warp_partdr.results.mesh_files import NamedMesh, meshes_glb, obj, ply


def _ball() -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = icosphere(2)
    return vertices * [1.0, -2.0, 0.3] + [1e-9, -7.25, 123.456], faces


def test_obj_and_ply_are_those_of_trimesh() -> None:
    """They are equal to the byte, but for the comment that says who wrote them."""
    vertices, faces = _ball()
    colours = np.arange(3 * len(faces)).reshape(-1, 3).astype(np.uint8)
    mesh = trimesh.Trimesh(vertices, faces, face_colors=colours, process=False)
    ours, theirs = ply(vertices, faces, colours), mesh.export(file_type="ply")
    assert ours.replace(b"comment warp-partdr", b"comment https://github.com/mikedh/trimesh") == theirs
    theirs = trimesh.Trimesh(vertices, faces, process=False).export(file_type="obj")
    assert obj(vertices, faces).splitlines()[1:] == theirs.rstrip("\n").splitlines()[1:]


def test_a_glb_holds_its_meshes() -> None:
    vertices, faces = _ball()
    normals = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    red = {"baseColorFactor": [1.0, 0.0, 0.0, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.5}
    meshes = [
        NamedMesh("ball", vertices, faces, red, normals),
        NamedMesh("half", vertices, faces[::2], red),
        NamedMesh("same", vertices + 1.0, faces, red),
    ]
    data = meshes_glb(meshes)
    scene = trimesh.load(io.BytesIO(data), file_type="glb", process=False)
    assert list(scene.geometry) == ["ball", "half", "same"]
    for mesh in meshes:
        found = scene.geometry[mesh.name]
        np.testing.assert_allclose(found.vertices, mesh.vertices, rtol=1e-6, atol=1e-6)
        np.testing.assert_array_equal(found.faces, mesh.faces)
        np.testing.assert_array_equal(found.visual.material.baseColorFactor, [255, 0, 0, 255])
        np.testing.assert_array_equal(scene.graph[mesh.name][0], np.eye(4))
    np.testing.assert_allclose(scene.geometry["ball"].vertex_normals, normals, atol=1e-6)
    assert len(data) < len(meshes_glb(meshes[:2])) + 24 * len(vertices)  # faces that are equal are stored once
