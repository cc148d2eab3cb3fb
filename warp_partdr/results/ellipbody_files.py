"""EllipBody as a mesh file for other tools."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..body.icosphere import icosphere
from ..body.template import NUM_PARTS, PART_NAMES
from .mesh_files import NamedMesh, meshes_glb
from .palette import PART_COLOURS

if TYPE_CHECKING:
    from ..body.posing import Posed

# glTF's colour factors are linear, the palette is sRGB.
_LINEAR_COLOURS = np.where(
    PART_COLOURS <= 10, PART_COLOURS / 255 / 12.92, ((PART_COLOURS / 255 + 0.055) / 1.055) ** 2.4
)
_SUBDIVISIONS = 2
GLTF_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])  # camera frame (y down, z away) to glTF's (y up, z toward the viewer)


def ellipbody_glb(posed: Posed) -> bytes:
    """Write the first body as GLB: 20 named, coloured meshes [m] on y = 0, y up, facing as in the picture."""
    sphere, faces = icosphere(_SUBDIVISIONS)
    points = posed.vertices(_SUBDIVISIONS)[0].detach().cpu().numpy().reshape(NUM_PARTS, -1, 3)
    points = points @ GLTF_FROM_CAMERA.T
    points = points - [0.0, points[..., 1].min(), 0.0]
    axes, semi_axes = posed.axes[0].detach().cpu().numpy(), posed.semi_axes[0].detach().cpu().numpy()
    normals = (sphere / semi_axes[:, None]) @ axes.transpose(0, 2, 1) @ GLTF_FROM_CAMERA.T
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    meshes: list[NamedMesh] = []
    for k, name in enumerate(PART_NAMES):
        colour = [*_LINEAR_COLOURS[k + 1].tolist(), 1.0]
        material = {"baseColorFactor": colour, "metallicFactor": 0.0, "roughnessFactor": 0.7}
        meshes.append(NamedMesh(name, points[k], faces, material, normals[k]))
    return meshes_glb(meshes)
