"""EllipBody as a mesh file for other tools."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..body.icosphere import icosphere
from ..body.template import NUM_PARTS, PART_NAMES
from .palette import PART_COLOURS

if TYPE_CHECKING:
    import trimesh

    from ..body.posing import Posed

# glTF's colour factors are linear, the palette is sRGB.
_LINEAR_COLOURS = np.where(
    PART_COLOURS <= 10, PART_COLOURS / 255 / 12.92, ((PART_COLOURS / 255 + 0.055) / 1.055) ** 2.4
)
_SUBDIVISIONS = 2
GLTF_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])  # camera frame (y down, z away) to glTF's (y up, z toward the viewer)


def ellipbody_scene(posed: Posed) -> trimesh.Scene:
    """Scene of the first body as 20 named, coloured meshes [m] that stand on y = 0, y up, facing as in the picture."""
    import trimesh

    sphere, faces = icosphere(_SUBDIVISIONS)
    points = posed.vertices(_SUBDIVISIONS)[0].detach().cpu().numpy().reshape(NUM_PARTS, -1, 3)
    points = points @ GLTF_FROM_CAMERA.T
    points = points - [0.0, points[..., 1].min(), 0.0]
    # Exact normals; trimesh would average those of faces, and needs SciPy for that.
    axes, semi_axes = posed.axes[0].detach().cpu().numpy(), posed.semi_axes[0].detach().cpu().numpy()
    normals = (sphere / semi_axes[:, None]) @ axes.transpose(0, 2, 1) @ GLTF_FROM_CAMERA.T
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    scene = trimesh.Scene()
    for k, name in enumerate(PART_NAMES):
        colour = [*_LINEAR_COLOURS[k + 1].tolist(), 1.0]
        material = trimesh.visual.material.PBRMaterial(
            name=name, baseColorFactor=colour, metallicFactor=0.0, roughnessFactor=0.7
        )
        mesh = trimesh.Trimesh(points[k], faces, vertex_normals=normals[k], process=False)
        mesh.visual = trimesh.visual.TextureVisuals(material=material)
        scene.add_geometry(mesh, node_name=name, geom_name=name)
    return scene
