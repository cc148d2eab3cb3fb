"""Detailed body models as part-labelled meshes: the paper's "PartDR + SMPL"."""

from __future__ import annotations

from ..render.part_mesh import PartMesh
from .model import DetailedModel


def detailed_mesh(model: DetailedModel) -> PartMesh:
    """A detailed model's mesh with labels 1 to 20, on the model's device; keep it, its edges take a moment to find.

    ``draw_mesh`` and ``mesh_label_loss`` draw it with ``detailed.vertices``, and their gradients
    reach shape and rotations. ``relabel`` shows another set of parts.
    """
    faces, parts = model.faces.cpu().numpy(), model.face_parts.cpu().numpy()
    return PartMesh.from_faces(faces, parts, device=model.faces.device)
