"""Other rasterizers, where they are installed: the same mesh, the same target, their own ways to a gradient.

None of them is a dependency. Each draws labels from our projected vertices; those with a gradient also give L_seg of
their float maps, through which autograd goes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec

import numpy as np
import torch

from ...cameras import ScreenCamera
from ...render.mesh import draw_mesh, mesh_label_loss
from ...render.part_mesh import PartMesh

_FRONT = 10.0  # [m] added to depths, which peers want in front of the camera


@dataclass(frozen=True)
class MeshView:
    """The scene that a peer draws."""

    vertices: torch.Tensor  # projected (u [px], v [px], z [m]), shape (B, V, 3)
    mesh: PartMesh
    targets: torch.Tensor  # wanted labels, shape (B, H, W), uint8

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


_Draw = Callable[[], torch.Tensor]  # the hard label image, shape (B, H, W)
_Loss = Callable[[torch.Tensor], torch.Tensor]  # L_seg of vertices


def ours(view: MeshView) -> tuple[_Draw, _Loss]:
    """This package's mesh renderer, called as a peer is."""
    scene = view.mesh, ScreenCamera(perspective=False)
    return (
        lambda: draw_mesh(view.vertices, *scene, view.image_size, validate=False).labels,
        lambda vertices: mesh_label_loss(vertices, *scene, view.targets, validate=False)[0].sum(),
    )


def drtk(view: MeshView) -> tuple[_Draw, _Loss]:
    """DRTK: rasterized edge gradients. Its pixel centres have whole coordinates."""
    module, faces = import_module("drtk"), view.mesh.faces
    offset = view.vertices.new_tensor([-0.5, -0.5, _FRONT])

    def loss(vertices: torch.Tensor) -> torch.Tensor:
        pixels = vertices + offset
        index = module.rasterize(pixels, faces, *view.image_size)
        _, weights = module.render(pixels, faces, index)
        maps = view.maps_of(view.labels_of(index)).permute(0, 3, 1, 2).contiguous()
        maps = module.edge_grad_estimator(pixels, faces, weights, maps, index)
        return view.loss_of(maps.permute(0, 2, 3, 1))

    return lambda: view.labels_of(module.rasterize(view.vertices + offset, faces, *view.image_size)), loss


def nvdiffrast(view: MeshView) -> tuple[_Draw, _Loss]:
    """nvdiffrast: gradients of antialiased outlines. Its first row is at y = -1, as ours is here."""
    module, faces = import_module("nvdiffrast.torch"), view.mesh.faces
    context = module.RasterizeCudaContext(device=view.vertices.device)

    def rasterize(vertices: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        clip = torch.nn.functional.pad(view.normalised(vertices), (0, 1), value=1.0).contiguous()
        raster, _ = module.rasterize(context, clip, faces, list(view.image_size))
        return clip, raster, view.labels_of(raster[..., 3] - 1)

    def loss(vertices: torch.Tensor) -> torch.Tensor:
        clip, raster, labels = rasterize(vertices)
        return view.loss_of(module.antialias(view.maps_of(labels), raster, clip, faces))

    return lambda: rasterize(view.vertices)[2], loss


def pytorch3d(view: MeshView) -> tuple[_Draw, _Loss]:
    """PyTorch3D: the nearest face, faded out over a pixel from its outline. Its x points left and its y up."""
    make_meshes = import_module("pytorch3d.structures").Meshes
    rasterize = import_module("pytorch3d.renderer.mesh.rasterize_meshes").rasterize_meshes
    blur = (2 / min(view.image_size)) ** 2  # squared distances, half-sides of the picture

    def draw(vertices: torch.Tensor, radius: float) -> tuple[torch.Tensor, torch.Tensor]:
        points = view.normalised(vertices) * vertices.new_tensor([-1.0, -1.0, 1.0])
        points = points + points.new_tensor([0.0, 0.0, _FRONT])
        faces = view.mesh.faces.long().expand(len(points), -1, -1)
        packed, _, _, distances = rasterize(
            make_meshes(points, faces), image_size=view.image_size, blur_radius=radius, faces_per_pixel=1
        )
        packed, distances = packed[..., 0], distances[..., 0]
        return view.labels_of(torch.where(packed < 0, -1, packed % faces.shape[1])), distances

    def loss(vertices: torch.Tensor) -> torch.Tensor:
        labels, distances = draw(vertices, blur)
        return view.loss_of(view.maps_of(labels) * torch.sigmoid(-distances / blur)[..., None])

    return lambda: draw(view.vertices, 0.0)[0], loss


def embree(view: MeshView) -> tuple[_Draw, None]:
    """Embree through trimesh: a ray through each pixel's centre, one body after another; trees are ready made."""
    import trimesh

    intersector = import_module("trimesh.ray.ray_pyembree").RayMeshIntersector
    height, width = view.image_size
    v, u = np.mgrid[:height, :width] + 0.5
    origins = np.stack([u.ravel(), v.ravel(), np.full(u.size, float(view.vertices[..., 2].min()) - 1)], 1)
    directions = np.tile([0.0, 0.0, 1.0], (u.size, 1))
    faces, bodies = view.mesh.faces.numpy(), view.vertices.double().numpy()
    trees = [intersector(trimesh.Trimesh(points, faces, process=False)) for points in bodies]

    def draw() -> torch.Tensor:
        hits = [tree.intersects_first(origins, directions) for tree in trees]
        return view.labels_of(torch.from_numpy(np.stack(hits)).view(-1, *view.image_size))

    return draw, None


@dataclass(frozen=True)
class Peer:
    """Another rasterizer."""

    package: str  # which must be importable
    devices: tuple[str, ...]  # where it runs, of "cpu" and "cuda"
    adapt: Callable[[MeshView], tuple[_Draw, _Loss | None]]  # in time that is not counted
    differentiates: bool = True

    @property
    def is_installed(self) -> bool:
        """True if it can be imported, as far as one can tell without doing so."""
        return find_spec(self.package) is not None


OURS = "warp-partdr"
PEERS = {
    OURS: Peer("warp_partdr", ("cuda", "cpu"), ours),
    "DRTK": Peer("drtk", ("cuda",), drtk),
    "nvdiffrast": Peer("nvdiffrast", ("cuda",), nvdiffrast),
    "PyTorch3D": Peer("pytorch3d", ("cuda", "cpu"), pytorch3d),
    "Embree": Peer("embreex", ("cpu",), embree, differentiates=False),
}
