"""Launches of the mesh renderer: the picture, and the gradient of a loss, in buffers made for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import chain
from types import ModuleType
from typing import Any, cast

import torch
import warp as wp

from ..interop.arrays import contiguous, warp_array
from ..interop.graph_cache import Launch
from ..interop.layouts import Tensors
from ..interop.loss_graph import Buffers
from ..interop.streams import launch_bodies_on
from ..kernels.labels import NUM_EXTENTS, DenseGradient, LabelTarget
from ..kernels.launch import launch_side_by_side
from ..kernels.mesh import label_borders, push_xy, push_z, rasterize, resolve
from ..kernels.mesh.triangles import ImageArrays, MeshArrays
from .options import MeshGradient, cached
from .pictures import Picture, Settings, Size


@dataclass(frozen=True, eq=False)
class MeshPasses:
    """The mesh renderer's ``Passes``; its input are vertices on the screen."""

    faces: torch.Tensor
    face_labels: torch.Tensor
    edges: torch.Tensor
    num_labels: int
    cull_backfaces: bool
    perspective: bool
    near: float
    max_distance: float
    depth_weight: float
    gradient: MeshGradient = "partdr"

    kind, drawing, name = "mesh", "draw_mesh", "mesh_label_loss"

    @property
    def modules(self) -> Sequence[ModuleType]:
        """Modules of the kernels that it launches."""
        return rasterize, resolve, *((label_borders,) if self.gradient == "edges" else (push_xy, push_z))

    @classmethod
    def of(
        cls, constants: Sequence[torch.Tensor], integers: Sequence[int], gradient: str, numbers: Sequence[float]
    ) -> MeshPasses:
        """Inverse of ``constants`` and ``settings``."""
        num_labels, *flags = integers
        return mesh_passes(*constants, num_labels, *map(bool, flags), *numbers, cast("MeshGradient", gradient))

    @property
    def constants(self) -> Tensors:
        """The mesh."""
        return self.faces, self.face_labels, self.edges

    def settings(self) -> Settings:
        """Options as custom operations take them."""
        numbers = [self.near, self.max_distance, self.depth_weight]
        return [self.num_labels, int(self.cull_backfaces), int(self.perspective)], self.gradient, numbers

    def draw(self, inputs: Tensors, size: Size) -> Picture:
        """Draw labels, depth and face-index map."""
        (vertices,) = inputs
        picture = _empty_picture((vertices.shape[0], *size), vertices.device)

        def work(part: slice) -> None:
            self.prepare_raster(vertices[part], [image[part] for image in picture[:4]])[0]()

        launch_bodies_on(vertices.device, work, vertices.shape[0], self.modules)
        return picture

    def prepare_labels(self, inputs: Tensors, labels: torch.Tensor, faults: torch.Tensor) -> Launch:
        """Launch that fills ``labels`` and ``faults``."""
        return self.prepare_raster(inputs[0], _labels_alone(labels, faults), background=False)[0]

    def gradients(self, inputs: Tensors, picture: Picture, grad_maps: torch.Tensor) -> Tensors:
        """Gradient with respect to the vertices, shape (B, V, 3), from that with respect to part maps (B, K, H, W)."""
        (vertices,) = inputs
        grad_maps = contiguous(grad_maps.float())
        grad_vertices = torch.empty(vertices.shape, device=vertices.device)

        def work(part: slice) -> None:
            images = [image[part] for image in picture[:4]]
            shape, device = tuple(images[0].shape), wp.device_from_torch(vertices.device)
            keys, hidden = rasterize.empty_keys(shape, device), resolve.hidden_blocks(shape, device)
            of_each = partial(_of_each_map, warp_array(grad_maps[part]))
            self._prepare_gradient(vertices[part], images, of_each, grad_vertices[part], keys, hidden)()

        launch_bodies_on(vertices.device, work, vertices.shape[0], self.modules)
        return (grad_vertices,)

    def num_losses(self, device: torch.device, batch: int, height: int, width: int) -> int:
        """One sum for each square of pixels."""
        return math.prod(resolve.num_squares(height, width))

    def prepare(self, buffers: Buffers) -> Launch:
        """Launches of loss and gradient for all bodies of the buffers."""
        (vertices,) = buffers.inputs
        shape, device = (vertices.shape[0], *buffers.target.shape[-2:]), vertices.device
        images: Sequence[torch.Tensor] = _empty_picture(shape, device)[:4]
        if not buffers.grads:
            images = _labels_alone(images[0], images[3])
        draw, zbuffer = self.prepare_raster(vertices, images, background=False)
        keys, hidden = zbuffer.keys, resolve.hidden_blocks(shape, wp.device_from_torch(device))
        if buffers.of_maps:
            of_each = partial(_of_each_map, warp_array(buffers.target))
            return _in_turn(draw, self._prepare_gradient(vertices, images, of_each, buffers.grads[0], keys, hidden))
        target = buffers.target.expand(shape[0], -1, -1)  # a view: what is written there later is seen
        extents = torch.empty((shape[0], NUM_EXTENTS, self.num_labels + 1, 4), dtype=torch.int32, device=device)
        of_target = LabelTarget()
        of_target.target = warp_array(target)
        of_target.extents = warp_array(extents, wp.vec4i)
        of_target.scale = wp.ones(shape[0], dtype=float, device=of_target.target.device)
        compare = partial(
            resolve.launch_compare_labels,
            *(warp_array(images[0]), of_target),
            hidden=hidden,
            losses=warp_array(buffers.losses),
            faults=warp_array(images[3]),
        )
        if not buffers.grads:
            return _in_turn(draw, compare)
        push = self._prepare_gradient(vertices, images, lambda: [of_target], buffers.grads[0], keys, hidden)
        return _in_turn(draw, compare, push)

    def prepare_raster(
        self, vertices: torch.Tensor, images: Sequence[torch.Tensor], background: bool = True
    ) -> tuple[Launch, rasterize.ZBuffer]:
        """Launch that fills labels, depth, face-index map and faults, and the z-buffer that it empties again."""
        mesh, pictures = self._arrays(vertices), _image_arrays(images)
        batch, height, width = images[0].shape
        zbuffer = rasterize.ZBuffer.make(batch, height, width, mesh.vertices.device)
        draw = partial(rasterize.launch_draw_faces, mesh, zbuffer)
        split = partial(resolve.launch_resolve_keys, mesh, zbuffer, pictures, background=background)
        return _in_turn(draw, split), zbuffer

    def _prepare_gradient(
        self,
        vertices: torch.Tensor,
        images: Sequence[torch.Tensor],
        gradients: Callable[[], Iterable[Any]],
        grad_vertices: torch.Tensor,
        keys: wp.array,
        hidden: wp.array,
    ) -> Launch:
        """Launch that fills ``grad_vertices``.

        Args:
            vertices: Vertices of some of the bodies, shape (B, V, 3).
            images: Images and faults of these bodies.
            gradients: Function that returns the loss gradient once for each label of the z pass.
            grad_vertices: Gradient of the vertices, shape (B, V, 3). It is filled.
            keys: Keys of a ``ZBuffer``, empty before and after.
            hidden: Scratch array that ``hidden_blocks`` makes.
        """
        arrays = self._arrays(vertices), _image_arrays(images)
        found_gradient, (batch, num_edges) = warp_array(grad_vertices), (vertices.shape[0], self.edges.shape[0])
        if self.gradient == "edges":
            push_borders = partial(label_borders.launch_push_label_borders, *arrays, grad=found_gradient)
            return _in_turn(found_gradient.zero_, lambda: push_borders(gradient=next(iter(gradients()))))
        push_edges = partial(
            push_xy.launch_push_edges,
            *arrays,
            max_distance=self.max_distance,
            found=push_xy.SilhouetteList.make(batch, num_edges, found_gradient.device),
            grad=found_gradient,
        )
        push_depths = partial(
            push_z.launch_push_depths,
            *arrays,
            depth_weight=self.depth_weight,
            keys=keys,
            hidden=hidden,
            grad=found_gradient,
        )

        def launch() -> None:
            found_gradient.zero_()
            given = iter(gradients())
            first = next(given)

            def push_all_depths() -> None:
                if self.depth_weight != 0.0:
                    for gradient in chain((first,), given):
                        push_depths(gradient=gradient)

            # They write other components of the gradient.
            launch_side_by_side(lambda: push_edges(gradient=first), push_all_depths)

        return launch

    @cached_property
    def _constant_arrays(self) -> tuple[wp.array, ...]:
        """The mesh, kept: to make the arrays anew takes a tenth of a small picture's time."""
        return tuple(
            warp_array(contiguous(each), kind)
            for each, kind in zip(self.constants, (wp.vec3i, None, None), strict=True)
        )

    def _arrays(self, vertices: torch.Tensor) -> MeshArrays:
        arrays = MeshArrays()
        arrays.vertices = warp_array(contiguous(vertices), wp.vec3)
        arrays.faces, arrays.face_labels, arrays.edges = self._constant_arrays
        arrays.near, arrays.perspective, arrays.cull_backfaces = self.near, self.perspective, self.cull_backfaces
        return arrays


mesh_passes = cached(MeshPasses)  # the same object, which is a graph's key, for the same mesh and options


def _in_turn(*launches: Launch) -> Launch:
    def launch_all() -> None:
        for launch in launches:
            launch()

    return launch_all


def _of_each_map(grad_maps: wp.array) -> Iterator[DenseGradient]:
    """Gradient with respect to part maps (B, K, H, W), once for each map."""
    gradient = DenseGradient()
    gradient.maps = grad_maps
    for label in range(1, grad_maps.shape[1] + 1):
        gradient.label = label
        yield gradient


def _empty_picture(shape: tuple[int, ...], device: torch.device) -> Picture:
    types = torch.uint8, torch.float32, torch.int32
    labels, depth, faces = (torch.empty(shape, dtype=dtype, device=device) for dtype in types)
    return Picture(labels, depth, faces, torch.empty(shape[0], device=device))


def _labels_alone(labels: torch.Tensor, faults: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Images with neither depth nor faces, and faults."""
    nothing = (torch.empty(0, 0, 0, dtype=kind, device=labels.device) for kind in (torch.float32, torch.int32))
    return labels, *nothing, faults


def _image_arrays(images: Sequence[torch.Tensor]) -> ImageArrays:
    arrays = ImageArrays()
    arrays.labels, arrays.depth, arrays.face_index, arrays.faults = (warp_array(image) for image in images)
    return arrays
