"""Other rasterizers, where they are installed: the same mesh, the same target, their own ways to a gradient.

None of them is a dependency. Each adapter draws labels from our projected vertices; those with a gradient also give
L_seg of their float maps, through which autograd goes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import torch

from ...cameras import ScreenCamera
from ...render.mesh import draw_mesh, mesh_label_loss
from ...render.part_mesh import PartMesh

_FRONT = 10.0  # [m] added to depths, which peers want in front of the camera


@dataclass(frozen=True)
class MeshView:
    """The scene that a peer draws.

    Attributes:
        vertices: Projected (u [px], v [px], z [m]), shape (B, V, 3).
        mesh: Their faces and labels.
        targets: Wanted labels, shape (B, H, W), uint8.
    """

    vertices: torch.Tensor
    mesh: PartMesh
    targets: torch.Tensor

    @property
    def faces(self) -> torch.Tensor:
        """Shape (F, 3), int32."""
        return self.mesh.faces

    @property
    def image_size(self) -> tuple[int, int]:
        """(H, W) [px]."""
        return self.targets.shape[1], self.targets.shape[2]

    def normalised(self, vertices: torch.Tensor) -> torch.Tensor:
        """Vertices with u and v from -1 to 1 over the picture and z from -0.9 (near) to 0.9."""
        height, width = self.image_size
        x, y = 2 * vertices[..., 0] / width - 1, 2 * vertices[..., 1] / height - 1
        low, high = self.vertices[..., 2].aminmax()
        return torch.stack([x, y, 1.8 * (vertices[..., 2] - low) / (high - low) - 0.9], dim=-1)

    def labels_of(self, faces: torch.Tensor) -> torch.Tensor:
        """Label image of a face-index map, -1 = background."""
        table = torch.nn.functional.pad(self.mesh.face_labels, (1, 0))
        return table[(faces + 1).long()]

    def maps_of(self, labels: torch.Tensor) -> torch.Tensor:
        """Float maps of labels 1 to K, shape (B, H, W, K)."""
        return torch.nn.functional.one_hot(labels.long(), self.mesh.num_labels + 1)[..., 1:].float()

    def loss_of(self, maps: torch.Tensor) -> torch.Tensor:
        """L_seg (paper, eq. 6)."""
        return (maps - self.maps_of(self.targets)).square().sum()


class Ours:
    """This package's mesh renderer, called as a peer is."""

    def __init__(self, view: MeshView) -> None:
        self._view = view

    def labels(self) -> torch.Tensor:
        """The hard label image."""
        view = self._view
        return draw_mesh(
            view.vertices, view.mesh, ScreenCamera(perspective=False), view.image_size, validate=False
        ).labels

    def loss(self, vertices: torch.Tensor) -> torch.Tensor:
        """L_seg."""
        return mesh_label_loss(
            vertices, self._view.mesh, ScreenCamera(perspective=False), self._view.targets, validate=False
        )[0].sum()


class Drtk:
    """DRTK: rasterized edge gradients. Its pixel centres have whole coordinates."""

    def __init__(self, view: MeshView) -> None:
        self._drtk, self._view = import_module("drtk"), view

    def _pixels(self, vertices: torch.Tensor) -> torch.Tensor:
        return vertices + vertices.new_tensor([-0.5, -0.5, _FRONT])

    def labels(self) -> torch.Tensor:
        """The hard label image."""
        pixels = self._pixels(self._view.vertices)
        return self._view.labels_of(self._drtk.rasterize(pixels, self._view.faces, *self._view.image_size))

    def loss(self, vertices: torch.Tensor) -> torch.Tensor:
        """L_seg through ``edge_grad_estimator``."""
        pixels, faces = self._pixels(vertices), self._view.faces
        index = self._drtk.rasterize(pixels, faces, *self._view.image_size)
        _, weights = self._drtk.render(pixels, faces, index)
        maps = self._view.maps_of(self._view.labels_of(index)).permute(0, 3, 1, 2).contiguous()
        maps = self._drtk.edge_grad_estimator(pixels, faces, weights, maps, index)
        return self._view.loss_of(maps.permute(0, 2, 3, 1))


class Nvdiffrast:
    """nvdiffrast: gradients of antialiased outlines. Its first row is at y = -1, as ours is here."""

    def __init__(self, view: MeshView) -> None:
        self._dr, self._view = import_module("nvdiffrast.torch"), view
        self._context = self._dr.RasterizeCudaContext(device=view.vertices.device)

    def _clip(self, vertices: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.pad(self._view.normalised(vertices), (0, 1), value=1.0).contiguous()

    def _rasterize(self, clip: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        raster, _ = self._dr.rasterize(self._context, clip, self._view.faces, list(self._view.image_size))
        return raster, self._view.labels_of(raster[..., 3] - 1)

    def labels(self) -> torch.Tensor:
        """The hard label image."""
        return self._rasterize(self._clip(self._view.vertices))[1]

    def loss(self, vertices: torch.Tensor) -> torch.Tensor:
        """L_seg through ``antialias``."""
        clip = self._clip(vertices)
        raster, labels = self._rasterize(clip)
        maps = self._dr.antialias(self._view.maps_of(labels), raster, clip, self._view.faces)
        return self._view.loss_of(maps)


class Pytorch3d:
    """PyTorch3D: the nearest face, faded out over a pixel from its outline. Its x points left and its y up."""

    def __init__(self, view: MeshView) -> None:
        self._view = view
        self._meshes = import_module("pytorch3d.structures").Meshes
        self._rasterize = import_module("pytorch3d.renderer.mesh.rasterize_meshes").rasterize_meshes

    def _fragments(self, vertices: torch.Tensor, blur: float) -> tuple[torch.Tensor, torch.Tensor]:
        points = self._view.normalised(vertices) * vertices.new_tensor([-1.0, -1.0, 1.0])
        points = points + points.new_tensor([0.0, 0.0, _FRONT])
        faces = self._view.faces.long().expand(len(points), -1, -1)
        packed, _, _, distances = self._rasterize(
            self._meshes(points, faces), image_size=self._view.image_size, blur_radius=blur, faces_per_pixel=1
        )
        packed, distances = packed[..., 0], distances[..., 0]
        return self._view.labels_of(torch.where(packed < 0, -1, packed % faces.shape[1])), distances

    def labels(self) -> torch.Tensor:
        """The hard label image."""
        return self._fragments(self._view.vertices, 0.0)[0]

    def loss(self, vertices: torch.Tensor) -> torch.Tensor:
        """L_seg through the faces' distances from pixels."""
        blur = (2 / min(self._view.image_size)) ** 2  # squared distances, half-sides of the picture
        labels, distances = self._fragments(vertices, blur)
        return self._view.loss_of(self._view.maps_of(labels) * torch.sigmoid(-distances / blur)[..., None])


class Embree:
    """Embree through trimesh: a ray through each pixel's centre, one body after another. No gradient."""

    def __init__(self, view: MeshView) -> None:
        import trimesh

        intersector = import_module("trimesh.ray.ray_pyembree").RayMeshIntersector
        self._view = view
        height, width = view.image_size
        v, u = np.mgrid[:height, :width] + 0.5
        self._origins = np.stack([u.ravel(), v.ravel(), np.full(u.size, float(view.vertices[..., 2].min()) - 1)], 1)
        self._directions = np.tile([0.0, 0.0, 1.0], (u.size, 1))
        faces = view.faces.numpy()
        self._bodies = [
            intersector(trimesh.Trimesh(points, faces, process=False)) for points in view.vertices.double().numpy()
        ]

    def labels(self) -> torch.Tensor:
        """The hard label image; rays find their trees ready made."""
        hits = [body.intersects_first(self._origins, self._directions) for body in self._bodies]
        return self._view.labels_of(torch.from_numpy(np.stack(hits)).view(-1, *self._view.image_size))


@dataclass(frozen=True)
class Peer:
    """Another rasterizer.

    Attributes:
        package: What must be importable.
        devices: Where it runs, of "cpu" and "cuda".
        adapt: Makes its adapter for a view, in time that is not counted: ``labels()`` gives the hard label image, of
            shape (B, H, W), and ``loss(vertices)`` L_seg where there is a gradient.
    """

    package: str
    devices: tuple[str, ...]
    adapt: Callable[[MeshView], Any]

    @property
    def is_installed(self) -> bool:
        """True if it can be imported, as far as one can tell without doing so."""
        return find_spec(self.package) is not None


OURS = "warp-partdr"
PEERS = {
    OURS: Peer("warp_partdr", ("cuda", "cpu"), Ours),
    "DRTK": Peer("drtk", ("cuda",), Drtk),
    "nvdiffrast": Peer("nvdiffrast", ("cuda",), Nvdiffrast),
    "PyTorch3D": Peer("pytorch3d", ("cuda", "cpu"), Pytorch3d),
    "Embree": Peer("embreex", ("cpu",), Embree),
}
