"""Part-labelled mesh: faces, their labels, and the edges that may be silhouettes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from ..body.ellipbody import DEFAULT_SUBDIVISIONS, ellipbody_faces
from ..interop.movable import Movable

MAX_LABEL = 254  # 0 is background and 255 means ignore


@dataclass(frozen=True)
class PartMesh(Movable):
    """Topology shared by a whole batch; make one with ``PartMesh.from_faces`` or ``ellipbody_mesh``.

    Attributes:
        faces: Vertex indices, shape (F, 3), int32.
        face_labels: Label 1 to 254 that a face shows, shape (F,), uint8.
        edges: Vertex, vertex, face, other face or -1, and the opposite vertex of either face, shape (E, 6), int32. An
            edge between two labels, a border and each part of a non-manifold edge stand alone (other face -1).
        cull_backfaces: True draws no face from behind, which halves the work. Nobody sees those of a closed surface
            whose faces wind counterclockwise as seen from outside. Nothing is checked: a hole, or a surface turned
            inside out as in a mirror, shows what lies behind it.
        num_labels: Highest label of a face, except 255. It is 0 without faces.
        num_vertices: Least number of vertices that the faces need.

    Examples:
        >>> import torch
        >>> import trimesh
        >>> from warp_partdr import PartMesh, Perspective, draw_mesh
        >>> ball = trimesh.creation.icosphere(subdivisions=2)
        >>> mesh = PartMesh.from_faces(ball.faces, 1 + (ball.triangles_center[:, 0] > 0))  # left half 1, right half 2
        >>> vertices = torch.tensor(ball.vertices, dtype=torch.float32)[None] + torch.tensor([0.0, 0.0, 5.0])
        >>> draw_mesh(vertices, mesh, Perspective.of_picture((120, 160), focal=200.0), (120, 160)).labels.unique()
        tensor([0, 1, 2], dtype=torch.uint8)
    """

    faces: torch.Tensor
    face_labels: torch.Tensor
    edges: torch.Tensor
    cull_backfaces: bool = False
    num_labels: int = field(init=False)
    num_vertices: int = field(init=False)

    def __post_init__(self) -> None:
        # Here and not when first asked for, which may be while torch.compile traces: then tensors have no numbers.
        labels = self.face_labels[self.face_labels <= MAX_LABEL]
        object.__setattr__(self, "num_labels", int(labels.max()) if labels.numel() else 0)
        object.__setattr__(self, "num_vertices", int(self.faces.max()) + 1 if self.faces.numel() else 0)

    @classmethod
    def from_faces(
        cls,
        faces: np.ndarray,
        face_labels: np.ndarray,
        *,
        cull_backfaces: bool = False,
        device: torch.device | str = "cpu",
    ) -> PartMesh:
        """Build the edges of any triangle mesh.

        Args:
            faces: Vertex indices, shape (F, 3).
            face_labels: Label of each face, 1 to 254, shape (F,).
            cull_backfaces: True draws no face from behind.
            device: Device of the tensors.

        Raises:
            ValueError: If a shape, an index or a label is out of range.

        Examples:
            >>> import numpy as np
            >>> from warp_partdr import PartMesh
            >>> PartMesh.from_faces(np.array([[0, 1, 2], [0, 2, 3]]), np.array([1, 2])).num_labels
            2
        """
        faces, face_labels = np.asarray(faces), np.asarray(face_labels)
        for name, values in (("faces", faces), ("face_labels", face_labels)):
            if values.dtype.kind not in "biuf" or not (np.isfinite(values) & (np.mod(values, 1) == 0)).all():
                raise ValueError(f"{name}: {values.dtype}; expected integers")
        if faces.ndim != 2 or faces.shape[1] != 3:
            raise ValueError(f"faces: shape {faces.shape}; expected (F, 3)")
        if face_labels.shape != (len(faces),):
            raise ValueError(f"face_labels: shape {face_labels.shape}; expected ({len(faces)},)")
        if faces.size and not 0 <= faces.min() <= faces.max() < 2**31:
            raise ValueError(f"faces: index {faces.min()} to {faces.max()}; expected 0 or more, below 2**31")
        if face_labels.size and (face_labels.min() < 1 or face_labels.max() > MAX_LABEL):
            raise ValueError(f"face_labels: {face_labels.min()} to {face_labels.max()}; expected 1 to {MAX_LABEL}")
        faces = np.ascontiguousarray(faces, dtype=np.int32)
        return cls(
            faces=torch.from_numpy(faces).to(device),
            face_labels=torch.from_numpy(np.ascontiguousarray(face_labels, dtype=np.uint8)).to(device),
            edges=torch.from_numpy(_find_edges(faces, face_labels)).to(device),
            cull_backfaces=cull_backfaces,
        )

    def relabel(self, table: np.ndarray | Mapping[int, int]) -> PartMesh:
        """Show groups of parts: ``table[label]`` is the new label, as ``LabelSet.part_groups`` gives it.

        A face with the new label 255 still hides what is behind it, but costs nothing where it shows; one with 0 is
        left out, and then backfaces are no longer culled, for holes show them. The edges stay those of the ellipsoids
        or parts that the mesh was built from.

        Examples:
            >>> from warp_partdr import ellipbody_mesh, label_set
            >>> ellipbody_mesh(1).relabel(label_set("lsp6").part_groups).num_labels
            6
        """
        old = self.face_labels.cpu().numpy()
        try:
            labels = np.array([table[int(label)] for label in old])
        except LookupError as error:
            raise ValueError(f"table: {error}; expected a label for each of the mesh's") from error
        if labels.size and not (labels.dtype.kind in "iu" and 0 <= labels.min() <= labels.max() <= 255):
            raise ValueError(f"table: {labels.tolist()[:5]}; expected labels 0 to 255")
        new = torch.from_numpy(labels.astype(np.uint8)).to(self.faces.device)
        if (new > 0).all():
            return replace(self, face_labels=new)
        # An edge between two faces lies within one part, so both are kept or none.
        kept = torch.where(new > 0, (new > 0).cumsum(0) - 1, -1).int()
        edges = self.edges.clone()
        of_faces = edges[:, 2:4]
        edges[:, 2:4] = torch.where(of_faces >= 0, kept[of_faces.long()], -1)
        edges = edges[edges[:, 2:4].amax(1) >= 0]
        return PartMesh(self.faces[new > 0], new[new > 0], edges)

    def repeated(self, count: int, labels: int, vertices: int) -> PartMesh:
        """Repeat this mesh ``count`` times in one.

        Each copy has its labels higher than the one before by ``labels``, and its vertices by ``vertices``.

        Raises:
            ValueError: If that makes labels over 254, or ``labels`` is less than the highest.
        """
        if not self.num_labels <= labels <= MAX_LABEL // count:
            raise ValueError(
                f"labels: {labels} a mesh, {count} of them; expected {self.num_labels} to {MAX_LABEL // count}"
            )
        faces, edges, shown = [], [], []
        for index in range(count):
            faces.append(self.faces + index * vertices)
            moves = self.edges.new_tensor([vertices] * 2 + [len(self.faces)] * 2 + [vertices] * 2)
            edges.append(torch.where(self.edges >= 0, self.edges + index * moves, self.edges))
            shown.append(
                torch.where(self.face_labels <= MAX_LABEL, self.face_labels + index * labels, self.face_labels)
            )
        return PartMesh(torch.cat(faces), torch.cat(shown).to(torch.uint8), torch.cat(edges), self.cull_backfaces)


def mesh_constants(mesh: PartMesh) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, int, bool]:
    """The mesh as the first of ``mesh_passes``; no property, because ``torch.compile`` traces none of a constant."""
    return mesh.faces, mesh.face_labels, mesh.edges, mesh.num_labels, mesh.cull_backfaces


def ellipbody_mesh(subdivisions: int = DEFAULT_SUBDIVISIONS, *, device: torch.device | str = "cpu") -> PartMesh:
    """Make EllipBody's mesh with labels 1 to 20; its vertices come from ``Posed.vertices(subdivisions)``.

    Args:
        subdivisions: Level of the mesh, 0 (E0) to 3 (E3). The vertices must be of the same level.
        device: Device of the mesh, which must be that of the vertices.

    Raises:
        ValueError: If there is no such level.

    Examples:
        >>> from warp_partdr import ellipbody_mesh
        >>> mesh = ellipbody_mesh(2)
        >>> mesh.faces.shape, mesh.num_vertices, mesh.num_labels
        (torch.Size([6400, 3]), 3240, 20)
    """
    return PartMesh.from_faces(*ellipbody_faces(subdivisions), device=device)


def _find_edges(faces: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Edges as ``PartMesh.edges``: pairs where exactly two faces of one label meet, single edges otherwise."""
    count = len(faces)
    if count == 0:
        return np.zeros((0, 6), dtype=np.int32)
    start, end, opposite = faces.ravel(), faces[:, [1, 2, 0]].ravel(), faces[:, [2, 0, 1]].ravel()
    face = np.repeat(np.arange(count, dtype=np.int32), 3)
    low, high = np.minimum(start, end), np.maximum(start, end)
    # One number stands for an edge of a label; edges of equal numbers stay in the order of their faces.
    key = (low.astype(np.int64) * (int(faces.max()) + 1) + high) * 256 + labels[face]
    order = key.argsort(kind="stable")
    low, high, face, opposite, key = low[order], high[order], face[order], opposite[order], key[order]
    is_new = np.r_[True, key[1:] != key[:-1]]
    group = np.cumsum(is_new) - 1
    size = np.bincount(group)
    first = np.flatnonzero(is_new)
    paired = first[size == 2]
    single = np.flatnonzero(size[group] != 2)
    pairs = np.stack(
        [low[paired], high[paired], face[paired], face[paired + 1], opposite[paired], opposite[paired + 1]], axis=1
    )
    none = np.full(len(single), -1, dtype=np.int32)
    singles = np.stack([low[single], high[single], face[single], none, opposite[single], opposite[single]], axis=1)
    return np.concatenate([pairs, singles]).astype(np.int32)
