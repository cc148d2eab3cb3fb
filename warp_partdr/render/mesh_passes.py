"""Launches of the mesh renderer: the picture, and the gradient of a loss, in buffers made for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import chain
from typing import Any

import torch
import warp as wp

from ..interop.arrays import contiguous, warp_array
from ..interop.loss_graph import Buffers
from ..interop.streams import on_torch_stream
from ..kernels.labels import DenseGradient, LabelTarget
from ..kernels.launch import launch_in_slices
from ..kernels.mesh import push_xy, push_z, rasterize
from ..kernels.mesh.triangles import ImageArrays, MeshArrays
from ..kernels.side_stream import launch_side_by_side

Geometry = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]  # vertices on the screen, faces, labels, edges
Images = tuple[torch.Tensor, torch.Tensor, torch.Tensor]  # labels, depth and face index, shape (B, H, W)
_Launch = Callable[[], None]


@dataclass(frozen=True)
class MeshOptions:
    """Options of the mesh renderer's picture and gradient."""

    near: float
    perspective: bool
    max_distance: float
    depth_weight: float


def draw_images(geometry: Geometry, size: tuple[int, int], options: MeshOptions) -> Images:
    """Draw labels, depth and face-index map."""
    vertices, *mesh = geometry
    images = _empty_images((vertices.shape[0], *size), vertices.device)

    def work(part: slice) -> None:
        here = [image[part] for image in images]
        prepare_raster((vertices[part], *mesh), here, options)[0]()

    _launch_slices(work, vertices)
    return images


def vertex_gradient(geometry: Geometry, images: Images, grad_maps: torch.Tensor, options: MeshOptions) -> torch.Tensor:
    """Gradient with respect to the vertices, shape (B, V, 3), from that with respect to part maps (B, K, H, W)."""
    vertices, *mesh = geometry
    grad_maps = contiguous(grad_maps.float())
    grad_vertices = torch.empty(vertices.shape, device=vertices.device)

    def of_each_map(part: slice) -> Iterator[DenseGradient]:
        gradient = DenseGradient()
        gradient.maps = warp_array(grad_maps[part])
        for label in range(1, grad_maps.shape[1] + 1):
            gradient.label = label
            yield gradient

    def work(part: slice) -> None:
        here = [image[part] for image in images]
        keys = rasterize.empty_keys(tuple(here[0].shape), wp.device_from_torch(vertices.device))
        rows = (vertices[part], *mesh)
        prepare_gradient(rows, here, partial(of_each_map, part), options, keys, grad_vertices[part])()

    _launch_slices(work, vertices)
    return grad_vertices


def prepare_raster(
    geometry: Sequence[torch.Tensor], images: Sequence[torch.Tensor], options: MeshOptions, background: bool = True
) -> tuple[_Launch, rasterize.ZBuffer]:
    """Launch that fills labels, depth and face-index map, and the z-buffer that it empties again."""
    mesh, pictures = _mesh_arrays(geometry, options), _image_arrays(images)
    batch, height, width = images[0].shape
    zbuffer = rasterize.ZBuffer.make(batch, height, width, mesh.vertices.device)
    return partial(rasterize.launch_rasterize, mesh, pictures, zbuffer=zbuffer, background=background), zbuffer


def prepare_gradient(
    geometry: Sequence[torch.Tensor],
    images: Sequence[torch.Tensor],
    gradients: Callable[[], Iterable[Any]],
    options: MeshOptions,
    keys: wp.array,
    grad_vertices: torch.Tensor,
) -> _Launch:
    """Launch that fills ``grad_vertices``.

    Args:
        geometry: A slice of the bodies' geometry.
        images: Their images.
        gradients: Returns the loss gradient once for each label of the z pass.
        options: As the picture was drawn.
        keys: A ``ZBuffer``'s, empty before and after.
        grad_vertices: Shape (B, V, 3).
    """
    mesh, pictures, found_gradient = _mesh_arrays(geometry, options), _image_arrays(images), warp_array(grad_vertices)
    device = mesh.vertices.device
    push_edges = partial(
        push_xy.launch_push_edges,
        mesh,
        pictures,
        max_distance=options.max_distance,
        found=push_xy.SilhouetteList.make(mesh.vertices.shape[0], mesh.edges.shape[0], device),
        grad_vertices=found_gradient,
    )
    push_depths = partial(
        push_z.launch_push_depths,
        mesh,
        pictures,
        depth_weight=options.depth_weight,
        hidden=push_z.HiddenPixels.make(keys),
        grad_vertices=found_gradient,
    )

    def launch() -> None:
        found_gradient.zero_()
        given = iter(gradients())
        first = next(given)

        def push_all_depths() -> None:
            if options.depth_weight != 0.0:
                for gradient in chain((first,), given):
                    push_depths(gradient=gradient)

        # They write other components of the gradient.
        launch_side_by_side(lambda: push_edges(gradient=first), push_all_depths)

    return launch


@dataclass(frozen=True, eq=False)
class MeshRecipe:
    """L_seg and its gradient, for ``loss_graph``; see ``mesh_recipe``."""

    faces: torch.Tensor
    face_labels: torch.Tensor
    edges: torch.Tensor
    num_labels: int
    options: MeshOptions

    name, modules = "mesh_label_loss", (rasterize, push_xy, push_z)

    def num_losses(self, device: torch.device, batch: int, height: int, width: int) -> int:
        """One sum for each thread that compares pixels."""
        return math.prod(rasterize.pixel_lanes((batch, height, width), device.type == "cpu")[1:])

    def prepare(self, buffers: Buffers) -> _Launch:
        """Launches for all bodies of the buffers."""
        (vertices,) = buffers.inputs
        batch, device = len(vertices), vertices.device
        target = buffers.target.expand(batch, -1, -1)  # a view: what is written there later is seen
        images = _empty_images((batch, *target.shape[1:]), device)
        extents = torch.empty((batch, rasterize.NUM_EXTENTS, self.num_labels + 1, 4), dtype=torch.int32, device=device)
        geometry = vertices, self.faces, self.face_labels, self.edges
        draw, zbuffer = prepare_raster(geometry, images, self.options, background=False)
        of_target = LabelTarget()
        of_target.target = warp_array(target)
        of_target.extents = warp_array(extents, wp.vec4i)
        of_target.scale = wp.ones(batch, dtype=float, device=of_target.target.device)
        lanes = rasterize.pixel_lanes(tuple(images[0].shape), vertices.is_cpu)
        losses = warp_array(buffers.losses.view(lanes))
        compare = partial(
            rasterize.launch_compare_labels,
            warp_array(images[0]),
            of_target.target,
            extents=of_target.extents,
            losses=losses,
        )
        launches: list[_Launch] = [draw, compare]
        if buffers.grads:
            gradient = prepare_gradient(
                geometry, images, lambda: [of_target], self.options, zbuffer.keys, buffers.grads[0]
            )
            launches.append(gradient)

        def launch() -> None:
            for part in launches:
                part()

        return launch


mesh_recipe = lru_cache(maxsize=16)(MeshRecipe)  # the same object for the same mesh and options


def _launch_slices(work: Callable[[slice], None], like: torch.Tensor) -> None:
    """Call ``work`` for slices of the batch, with launches on the tensor's device and stream."""
    with on_torch_stream(like.device) as device:
        launch_in_slices(work, like.shape[0], wp.get_device(device), modules=(rasterize, push_xy, push_z))


def _empty_images(shape: tuple[int, ...], device: torch.device) -> Images:
    return (
        torch.empty(shape, dtype=torch.uint8, device=device),
        torch.empty(shape, dtype=torch.float32, device=device),
        torch.empty(shape, dtype=torch.int32, device=device),
    )


def _mesh_arrays(geometry: Sequence[torch.Tensor], options: MeshOptions) -> MeshArrays:
    vertices, faces, face_labels, edges = (contiguous(tensor) for tensor in geometry)
    arrays = MeshArrays()
    arrays.vertices, arrays.faces = warp_array(vertices, wp.vec3), warp_array(faces, wp.vec3i)
    arrays.face_labels, arrays.edges = warp_array(face_labels), warp_array(edges)
    arrays.near, arrays.perspective = options.near, options.perspective
    return arrays


def _image_arrays(images: Sequence[torch.Tensor]) -> ImageArrays:
    arrays = ImageArrays()
    arrays.labels, arrays.depth, arrays.face_index = (warp_array(image) for image in images)
    return arrays
