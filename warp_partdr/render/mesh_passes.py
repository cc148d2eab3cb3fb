"""Launches of the mesh renderer: the picture, and the gradient of a loss, in buffers made for them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import ModuleType
from typing import Any, cast

import torch
import warp as wp

from ..interop.arrays import contiguous, warp_array
from ..interop.device_cache import device_cache
from ..interop.graph_cache import Launch
from ..interop.layouts import Tensors, split_blocks, total_length
from ..interop.loss_graph import Buffers
from ..interop.streams import launch_bodies_on
from ..kernels.labels import NUM_EXTENTS, DenseGradient, LabelTarget
from ..kernels.lanes import LANES
from ..kernels.launch import launch_side_by_side
from ..kernels.mesh import forces, label_borders, push_xy, push_z, rasterize, resolve
from ..kernels.mesh.triangles import MOST_FACES_IN_KEYS, ImageArrays, MeshArrays
from .options import MeshGradient
from .pictures import Picture, Settings, Size


@dataclass(frozen=True)
class _Scratch:
    """Scratch of a gradient's launches.

    Attributes:
        keys: Keys of a ``ZBuffer``, empty before and after.
        hidden: Pixels in which a part hides the target's, shape (B, squares, 32), uint32.
        silhouettes: List of silhouettes, which is empty before.
    """

    keys: wp.array
    hidden: wp.array
    silhouettes: push_xy.SilhouetteList


@dataclass(frozen=True)
class _Zeroed:
    """Arrays that are zero before a picture is drawn, in one block: each launch counts for a small batch.

    Attributes:
        counts: Counts of a ``SilhouetteList``, shape (B, 16), int64.
        extents: Extents of a LabelTarget, shape (B, 3, L, 4), int32.
        labels: Labels, shape (B, H, W), uint8.
        clear: Launch that fills them with zeros.
    """

    counts: torch.Tensor
    extents: torch.Tensor
    labels: torch.Tensor
    clear: Launch

    @classmethod
    def make(cls, shape: tuple[int, int, int], num_labels: int, device: torch.device) -> _Zeroed:
        """Allocate them for a picture (B, H, W)."""
        counts = torch.Size((shape[0], 2 * push_xy.COUNT_STRIDE))  # halves of them
        extents = torch.Size((shape[0], NUM_EXTENTS, num_labels + 1, 4))
        words = torch.Size((-(-math.prod(shape) // 4),))  # of labels
        block = torch.empty(total_length((counts, extents, words)), dtype=torch.int32, device=device)
        first, second, third = split_blocks(block, (counts, extents, words))
        labels = third.view(torch.uint8)[: math.prod(shape)].view(shape)
        return cls(first.view(torch.int64), second, labels, warp_array(block).zero_)


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
        return rasterize, resolve, forces, *((label_borders,) if self.gradient == "edges" else (push_xy, push_z))

    @classmethod
    def of(
        cls, constants: Sequence[torch.Tensor], integers: Sequence[int], gradient: str, numbers: Sequence[float]
    ) -> MeshPasses:
        """Inverse of ``constants`` and ``settings``."""
        faces, face_labels, edges = constants
        num_labels, cull_backfaces, perspective = integers
        near, max_distance, depth_weight = numbers
        return mesh_passes(
            faces,
            face_labels,
            edges,
            num_labels,
            bool(cull_backfaces),
            bool(perspective),
            near,
            max_distance,
            depth_weight,
            cast("MeshGradient", gradient),
        )

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
            self._prepare_raster(vertices[part], [image[part] for image in picture[:4]])()

        launch_bodies_on(vertices.device, work, vertices.shape[0], self.modules)
        return picture

    def prepare_labels(self, inputs: Tensors, labels: torch.Tensor, faults: torch.Tensor) -> Launch:
        """Launch that fills ``labels`` and ``faults``."""
        return self._prepare_raster(inputs[0], _labels_alone(labels, faults), background=False)

    def gradients(self, inputs: Tensors, picture: Picture, grad_maps: torch.Tensor) -> Tensors:
        """Gradient with respect to the vertices, shape (B, V, 3), from that with respect to part maps (B, K, H, W)."""
        (vertices,) = inputs
        grad_maps = contiguous(grad_maps.float())
        grad_vertices = torch.empty(vertices.shape, device=vertices.device)

        def work(part: slice) -> None:
            images = [*(image[part] for image in picture[:3]), picture.faults[part].clone()]  # forces may have faults
            shape, device = tuple(images[0].shape), wp.device_from_torch(vertices.device)
            scratch = self._scratch(shape, rasterize.empty_keys(shape, device))
            maps = warp_array(grad_maps[part])
            self._prepare_gradient(vertices[part], images, maps, grad_vertices[part], scratch)()

        launch_bodies_on(vertices.device, work, vertices.shape[0], self.modules)
        return (grad_vertices,)

    def num_losses(self, device: torch.device, batch: int, height: int, width: int) -> int:
        """One sum for each square of pixels."""
        return math.prod(rasterize.num_squares(height, width))

    def prepare(self, buffers: Buffers) -> Launch:
        """Launches of loss and gradient for all bodies of the buffers."""
        (vertices,) = buffers.inputs
        (batch, *_), (*_, height, width), device = vertices.shape, buffers.target.shape, vertices.device
        shape = batch, height, width
        zeroed = _Zeroed.make(shape, self.num_labels, device)
        faults = torch.empty(batch, device=device)
        images = _labels_alone(zeroed.labels, faults)
        if buffers.grads:
            labels, depth, faces, _ = images
            if self.gradient == "edges" or len(self.faces) > MOST_FACES_IN_KEYS:
                faces = faces.new_empty(shape)
            images = labels, depth.new_empty(shape), faces, faults
        mesh, pictures = self._arrays(vertices), _image_arrays(images)
        zbuffer = rasterize.ZBuffer.make(batch, height, width, mesh.vertices.device)
        scratch = self._scratch(shape, zbuffer.keys)
        silhouettes = scratch.silhouettes._replace(counts=warp_array(zeroed.counts, wp.uint64))
        scratch = replace(scratch, silhouettes=silhouettes)
        draw = _draw(mesh, zbuffer, zeroed.clear)
        if buffers.of_maps:
            split = partial(resolve.launch_resolve_keys, mesh, zbuffer, pictures, background=False)
            push = self._prepare_gradient(vertices, images, warp_array(buffers.target), buffers.grads[0], scratch)
            return _in_turn(draw, split, push)
        target = LabelTarget()
        target.target = warp_array(buffers.target.expand(batch, -1, -1))  # a view: what is written later is seen
        if buffers.grads and self.gradient == "partdr":
            target.extents = warp_array(zeroed.extents, wp.vec4i)
        losses = warp_array(buffers.losses)
        compare = partial(
            resolve.launch_compare_labels, mesh, zbuffer, pictures, target, hidden=scratch.hidden, losses=losses
        )
        if not buffers.grads:
            return _in_turn(draw, compare)
        push = self._prepare_gradient(vertices, images, target, buffers.grads[0], scratch)
        return _in_turn(draw, compare, push)

    def _prepare_raster(
        self, vertices: torch.Tensor, images: Sequence[torch.Tensor], background: bool = True
    ) -> Launch:
        """Launch that fills labels, depth, face-index map and faults."""
        mesh, pictures = self._arrays(vertices), _image_arrays(images)
        batch, height, width = images[0].shape
        zbuffer = rasterize.ZBuffer.make(batch, height, width, mesh.vertices.device)
        split = partial(resolve.launch_resolve_keys, mesh, zbuffer, pictures, background=background)
        return _in_turn(_draw(mesh, zbuffer, pictures.labels.zero_), split)

    def _prepare_gradient(
        self,
        vertices: torch.Tensor,
        images: Sequence[torch.Tensor],
        given: Any,
        grad_vertices: torch.Tensor,
        scratch: _Scratch,
    ) -> Launch:
        """Launch that fills ``grad_vertices``.

        Args:
            vertices: Vertices of some of the bodies, shape (B, V, 3).
            images: Images and faults of these bodies.
            given: Loss gradient: a LabelTarget, or an array of the gradient with respect to part maps, (B, K, H, W).
            grad_vertices: Gradient of the vertices, shape (B, V, 3). It is filled.
            scratch: Scratch arrays, with no silhouettes yet.
        """
        _, pictures = arrays = self._arrays(vertices), _image_arrays(images)
        maps = given if isinstance(given, wp.array) else None
        gradients = [given] if maps is None else _of_each_map(maps)
        size = pictures.labels.shape[1:]
        counts = vertices.shape[1], len(self.edges)
        pushed = forces.make_vertex_forces(size, *counts, pictures.faults, depth_slope=push_z.MAX_SLOPE, maps=maps)
        bound = [] if maps is None else [partial(forces.launch_find_largest, maps, pushed)]
        take = partial(forces.launch_take_forces, pushed, self.depth_weight, warp_array(grad_vertices))
        if self.gradient == "edges":
            push_borders = partial(label_borders.launch_push_label_borders, *arrays, gradients[0], pushed)
            return _in_turn(*bound, push_borders, take)
        push_edges = partial(
            push_xy.launch_push_edges,
            *arrays,
            gradients[0],
            max_distance=self.max_distance,
            found=scratch.silhouettes,
            forces=pushed,
        )

        def push_all_depths() -> None:
            if self.depth_weight != 0.0:
                for gradient in gradients:
                    push_z.launch_push_depths(
                        *arrays, gradient, keys=scratch.keys, hidden=scratch.hidden, forces=pushed
                    )

        # They add to other components of the forces.
        push = partial(launch_side_by_side, push_edges, push_all_depths)
        return _in_turn(*bound, push, take)

    def _scratch(self, shape: tuple[int, ...], keys: wp.array) -> _Scratch:
        """Scratch for pictures (B, H, W), with the keys of a z-buffer."""
        batch, height, width = shape
        squares = math.prod(rasterize.num_squares(height, width))
        hidden = wp.empty((batch, squares, int(LANES)), dtype=wp.uint32, device=keys.device)
        num_edges = len(self.edges) if self.gradient == "partdr" else 0
        return _Scratch(keys, hidden, push_xy.SilhouetteList.make(batch, num_edges, keys.device))

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


mesh_passes = device_cache(64)(MeshPasses)  # the same object, which is a graph's key, for the same mesh and options


def _in_turn(*launches: Launch) -> Launch:
    def launch_all() -> None:
        for launch in launches:
            launch()

    return launch_all


def _draw(mesh: MeshArrays, zbuffer: rasterize.ZBuffer, clear: Launch) -> Launch:
    """Launch that draws into a z-buffer and, beside that, fills the labels with zeros by ``clear``."""
    return partial(launch_side_by_side, partial(rasterize.launch_draw_faces, mesh, zbuffer), clear)


def _of_each_map(grad_maps: wp.array) -> list[DenseGradient]:
    """Gradient with respect to part maps (B, K, H, W), once for each map."""
    gradients = []
    for label in range(1, grad_maps.shape[1] + 1):
        gradient = DenseGradient()
        gradient.maps, gradient.label = grad_maps, label
        gradients.append(gradient)
    return gradients


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
