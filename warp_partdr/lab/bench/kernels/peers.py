"""Other rasterizers, where they are installed: the same mesh, the same target, their own ways to a gradient.

None of them is a dependency. Each draws labels from our projected vertices; those with a gradient also give L_seg of
their float maps, through which autograd goes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import torch

from ....cameras import ScreenCamera
from ....render.mesh import draw_mesh, mesh_label_loss
from ....render.part_mesh import PartMesh

_FRONT = 10.0  # [m] added to depths, which peers want in front of the camera
_LLVM = 17  # for Mitsuba: 15 lacks an instruction on x86-64 and ends the process, 22 runs; between them is not tried
_PICTURE_COLOURS = 3  # of one of Mitsuba's pictures


@dataclass(frozen=True)
class MeshView:
    """The scene that a peer draws."""

    vertices: torch.Tensor  # projected (u [px], v [px], z [m]), shape (B, V, 3)
    mesh: PartMesh
    targets: torch.Tensor  # wanted labels, shape (B, H, W), uint8

    @property
    def image_size(self) -> tuple[int, int]:
        """Size (H, W) of the picture [px]."""
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
    """Call the mesh renderer of this package as a peer is called."""
    scene = view.mesh, ScreenCamera(perspective=False)
    return (
        lambda: draw_mesh(view.vertices, *scene, view.image_size, validate=False).labels,
        lambda vertices: mesh_label_loss(vertices, *scene, view.targets, validate=False)[0].sum(),
    )


def drtk(view: MeshView) -> tuple[_Draw, _Loss]:
    """DRTK, from its repository, for the package index's drtk is another's: edge gradients, whole pixel centres."""
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


class _MitsubaBody:
    """One body in Mitsuba: its faces shine, and nothing else."""

    def __init__(self, view: MeshView, points: torch.Tensor) -> None:
        self._mi, self._dr, mi = import_module("mitsuba"), import_module("drjit"), import_module("mitsuba")
        (height, width), faces = view.image_size, view.mesh.faces
        lamp, shade = mi.Properties(), {"type": "mesh_attribute", "name": "face_color"}
        lamp["emitter"] = mi.load_dict({"type": "area", "radiance": shade})
        mesh = mi.Mesh("body", len(points), len(faces), props=lamp)
        dark = torch.zeros(_PICTURE_COLOURS * len(faces), device=points.device)
        mesh.add_attribute("face_color", _PICTURE_COLOURS, mi.Float(dark))
        shape = mi.traverse(mesh)
        shape["faces"] = mi.UInt32(faces.int().flatten())
        shape["vertex_positions"] = mi.Float(points.flatten())
        shape.update()
        film = {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb", "sample_border": True}
        sensor = {"type": "perspective", "fov": 90.0, "fov_axis": "x", "film": {**film, "rfilter": {"type": "box"}}}
        # A sample of outlines a pixel of the picture, of which they pass through few; no light but what faces emit.
        rule = {"type": "prb_projective", "max_depth": 1, "sppc": 0, "sppp": 1, "sppi": 0}
        self._scene = mi.load_dict({"type": "scene", "body": mesh, "sensor": sensor, "integrator": rule})
        self._values = mi.traverse(self._scene)
        rows, columns = (torch.arange(side, device=points.device) + 0.5 for side in (height, width))
        v, u = torch.meshgrid(rows, columns, indexing="ij")
        centres = mi.Point2f(mi.Float(u.flatten() / width), mi.Float(v.flatten() / height))
        self._rays, _ = self._scene.sensors()[0].sample_ray(0.0, 0.0, centres, mi.Point2f(0.5, 0.5))

    def move(self, points: torch.Tensor) -> None:
        """Set vertices (V, 3); a tree is built anew."""
        self._values["body.vertex_positions"] = self._mi.Float(points.flatten())
        self._values.update()

    def faces(self) -> torch.Tensor:
        """The face seen at each pixel, -1 for none, shape (H * W,)."""
        hits = self._scene.ray_intersect_preliminary(self._rays, coherent=True)
        faces = self._dr.select(hits.is_valid(), self._mi.Int32(hits.prim_index), -1).torch()
        self._dr.sync_thread()
        return faces

    def pull(self, colours: torch.Tensor, forces: torch.Tensor) -> torch.Tensor:
        """Gradient by vertices (V, 3), of that by maps (H, W, 3 N), for colours of faces (F, 3 N)."""
        leaf = self._values["body.vertex_positions"]
        self._dr.enable_grad(leaf)
        for seed in range(colours.shape[1] // _PICTURE_COLOURS):
            some = slice(_PICTURE_COLOURS * seed, _PICTURE_COLOURS * (seed + 1))
            self._values["body.face_color"] = self._mi.Float(colours[:, some].flatten())
            self._values.update()
            wanted = self._mi.TensorXf(forces[..., some].contiguous())
            self._scene.integrator().render_backward(self._scene, self._values, wanted, seed=seed)
        found = self._dr.grad(leaf).torch().reshape(-1, 3).clone()
        self._dr.disable_grad(leaf)
        self._dr.sync_thread()
        return found


class _MitsubaMaps(torch.autograd.Function):
    """Maps of what is seen at pixels' centres, whose gradient is that of outlines."""

    @staticmethod
    def forward(ctx: Any, points: torch.Tensor, view: MeshView, bodies: list[_MitsubaBody]) -> torch.Tensor:
        ctx.view, ctx.bodies = view, bodies
        for body, own in zip(bodies, points, strict=True):
            body.move(own)
        return view.maps_of(_mitsuba_labels(view, bodies))

    @staticmethod
    def backward(ctx: Any, forces: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        spare = (0, -forces.shape[-1] % _PICTURE_COLOURS)
        colours = torch.nn.functional.pad(ctx.view.maps_of(ctx.view.mesh.face_labels), spare)
        forces = torch.nn.functional.pad(forces, spare)
        found = [body.pull(colours, own) for body, own in zip(ctx.bodies, forces, strict=True)]
        return torch.stack(found), None, None


def _mitsuba_labels(view: MeshView, bodies: list[_MitsubaBody]) -> torch.Tensor:
    return view.labels_of(torch.stack([body.faces() for body in bodies]).view(-1, *view.image_size))


def mitsuba(view: MeshView) -> tuple[_Draw, _Loss]:
    """Mitsuba 3 on Dr.Jit: rays for labels, projective sampling of outlines for gradients, three labels a picture.

    Its gradients of outlines need a centre of projection, so bodies are bent to look the same from one: 1 / z grows
    evenly over the picture wherever z did before, and planes stay planes. Its x points left and its y up.
    """
    is_cpu = view.vertices.device.type == "cpu"
    import_module("mitsuba").set_variant("llvm_ad_rgb" if is_cpu else "cuda_ad_rgb")
    if is_cpu and import_module("drjit").detail.llvm_version()[0] < _LLVM:
        raise RuntimeError(f"it needs LLVM {_LLVM} or newer; the variable DRJIT_LIBLLVM_PATH says where it is")
    height, width = view.image_size

    def bend(vertices: torch.Tensor) -> torch.Tensor:
        flat = view.normalised(vertices)
        plane = torch.cat([-flat[..., :1], -flat[..., 1:2] * height / width, torch.ones_like(flat[..., :1])], dim=-1)
        return plane / (1 - 0.5 * flat[..., 2:])

    bodies = [_MitsubaBody(view, points) for points in bend(view.vertices.detach())]
    loss = lambda vertices: view.loss_of(_MitsubaMaps.apply(bend(vertices), view, bodies))  # noqa: E731
    return lambda: _mitsuba_labels(view, bodies), loss


@dataclass(frozen=True)
class Peer:
    """Another rasterizer."""

    package: str  # which must be importable
    devices: tuple[str, ...]  # where it runs, of "cpu" and "cuda"
    adapt: Callable[[MeshView], tuple[_Draw, _Loss | None]]  # in time that is not counted
    differentiates: bool = True
    most_bodies: int = 1024  # that are timed at once: more would take minutes

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
    "Mitsuba": Peer("mitsuba", ("cuda", "cpu"), mitsuba, most_bodies=1),
    "Embree": Peer("embreex", ("cpu",), embree, differentiates=False),
}
