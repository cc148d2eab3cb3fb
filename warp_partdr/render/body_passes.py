"""Launches from a body's parameters to L_seg or labels, and back: kinematics, a renderer's passes, the adjoint."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import torch
import warp as wp

from ..body.bone_launches import BoneLaunches, camera_array, kinematic_arrays
from ..body.ellipbody import bone_tree
from ..body.template import NUM_JOINTS, NUM_PARTS
from ..interop.arrays import warp_array
from ..interop.device_cache import device_cache
from ..interop.graph_cache import Launch
from ..interop.layouts import Tensors
from ..interop.loss_graph import Buffers, find_gradients
from ..kernels import kinematics, turns
from ..kernels.mesh import screen
from .ellipsoid_passes import EllipsoidPasses
from .mesh_passes import MeshPasses
from .pictures import Picture, Settings, Size, draw_labels

_SHAPES = ((NUM_PARTS, 3), (NUM_PARTS, 3, 3), (NUM_PARTS, 3), (4,))  # of centres, axes, semi-axes and camera


@dataclass(frozen=True, eq=False)
class BodyPasses:
    """``Passes`` that draw labels alone; their inputs are focal lengths, centres and the arguments of ``pose``."""

    renderer: EllipsoidPasses | MeshPasses
    subdivisions: int  # of the mesh
    locked: int  # parts that keep their rest rotation, as bits
    half_size: float  # of the crop that the camera's numbers are of [px]; 0: they are in pixels

    kind, name, drawing = "body", "body_label_loss", "body_maps"

    @classmethod
    def of(
        cls, constants: Sequence[torch.Tensor], integers: Sequence[int], gradient: Any, numbers: Sequence[float]
    ) -> BodyPasses:
        """Inverse of ``constants`` and ``settings``."""
        subdivisions, locked, *integers = integers
        half_size, *numbers = numbers
        renderer = MeshPasses if constants else EllipsoidPasses
        return body_passes(renderer.of(constants, integers, gradient, numbers), subdivisions, locked, half_size)

    @property
    def constants(self) -> Tensors:
        """The mesh, if there is one."""
        return self.renderer.constants

    def settings(self) -> Settings:
        """Options as custom operations take them."""
        integers, gradient, numbers = self.renderer.settings()
        return [self.subdivisions, self.locked, *integers], gradient, [self.half_size, *numbers]

    @property
    def modules(self) -> Sequence[ModuleType]:
        """Modules of the kernels that it launches."""
        return turns, kinematics, screen, *self.renderer.modules

    def num_losses(self, device: torch.device, batch: int, height: int, width: int) -> int:
        """Number of losses that the renderer gives."""
        return self.renderer.num_losses(device, batch, height, width)

    def draw(self, inputs: Tensors, size: Size) -> Picture:
        """Draw labels, and nothing else."""
        labels, faults = draw_labels(self, inputs, size)
        return Picture(labels, labels.new_empty(0), labels.new_empty(0), faults)

    def gradients(self, inputs: Tensors, picture: Picture, grad_maps: torch.Tensor) -> Tensors:
        """Gradients with respect to the inputs; kinematics and picture are made again, for nothing of them was kept."""
        return find_gradients(self, inputs, grad_maps)

    def prepare_labels(self, inputs: Tensors, labels: torch.Tensor, faults: torch.Tensor) -> Launch:
        """Launches that fill ``labels`` and ``faults``."""
        empty = Buffers.empty(self, tuple([tensor.shape for tensor in inputs]), labels, needs_grad=False)
        buffers = replace(empty, inputs=inputs)
        return self._prepare(buffers, lambda inner: self.renderer.prepare_labels(inner.inputs, labels, faults))

    def prepare(self, buffers: Buffers) -> Launch:
        """Launches of loss and gradient for all bodies of the buffers."""
        return self._prepare(buffers, self.renderer.prepare)

    def _prepare(self, buffers: Buffers, prepare: Callable[[Buffers], Launch]) -> Launch:
        """Launches of kinematics, of what ``prepare`` gives for the renderer's buffers, and of the adjoint."""
        focal, centre, *parameters = buffers.inputs
        prepare_bodies = self._prepare_mesh if isinstance(self.renderer, MeshPasses) else self._prepare_ellipsoids
        (*ellipsoids, camera), (*adjoints, adj_camera), draw = prepare_bodies(buffers, prepare)
        bones = BoneLaunches(parameters, self.locked, (focal, centre, camera), self.half_size)
        batch = len(focal)
        moved = focal.new_empty(batch, NUM_JOINTS, 3), focal.new_empty(batch, NUM_PARTS, 3, 3)
        posed = kinematic_arrays((*moved, *ellipsoids), "vmvmv")

        def launch_forward() -> None:
            bones.launch(posed)
            draw()

        if not buffers.grads:
            return launch_forward
        nothing = [wp.zeros_like(array) for array in posed[:2]]  # comes from joints and rotations
        sent = [*nothing, *kinematic_arrays(adjoints, "vmv")]
        pull = bones.prepare_adjoint(posed[1], sent, buffers.grads[2:], adj_camera, buffers.grads[:2])

        def launch() -> None:
            launch_forward()
            pull()

        return launch

    def _prepare_ellipsoids(
        self, buffers: Buffers, prepare: Callable[[Buffers], Launch]
    ) -> tuple[Tensors, Tensors, Launch]:
        """Ellipsoids and camera to be filled, their adjoints, and the launch that fills these and the loss."""
        inner = self._inner(buffers, _SHAPES)
        return inner.inputs, inner.grads or inner.inputs, prepare(inner)

    def _prepare_mesh(self, buffers: Buffers, prepare: Callable[[Buffers], Launch]) -> tuple[Tensors, Tensors, Launch]:
        device = buffers.target.device
        sphere = bone_tree(wp.device_from_torch(device).alias, wp.float32, self.subdivisions).unit_vertices
        inner = self._inner(buffers, ((NUM_PARTS * len(sphere), 3),))
        like, batch = inner.inputs[0], len(inner.inputs[0])
        filled, adjoints = (tuple(like.new_empty(batch, *shape) for shape in _SHAPES) for _ in range(2))
        adjoints = *adjoints[:3], like.new_empty(batch, NUM_PARTS, 4)
        seen, gradient = _seen(filled), _seen(adjoints)
        points = warp_array(inner.inputs[0], wp.vec3)
        adj_points = warp_array(inner.grads[0], wp.vec3) if inner.grads else None
        draw, perspective = prepare(inner), self.renderer.perspective

        def launch() -> None:
            screen.launch_place_on_screen(sphere, seen, points, perspective=perspective)
            draw()
            if adj_points is not None:
                screen.launch_place_on_screen_adjoint(sphere, seen, adj_points, gradient, perspective=perspective)

        return filled, adjoints, launch

    def _inner(self, buffers: Buffers, shapes: tuple[tuple[int, ...], ...]) -> Buffers:
        """Buffers of the renderer, which fills the same losses."""
        batched = tuple([torch.Size((len(buffers.losses), *shape)) for shape in shapes])
        inner = Buffers.empty(self.renderer, batched, buffers.target, needs_grad=len(buffers.grads) > 0)
        return replace(inner, losses=buffers.losses)


body_passes = device_cache(64)(BodyPasses)  # the same object, which is a graph's key, for the same options


def _seen(ellipsoids: Tensors) -> Any:
    seen = screen.EllipsoidsSeen()
    seen.centres, seen.axes, seen.semi_axes = kinematic_arrays(ellipsoids[:3], "vmv")
    seen.cameras = camera_array(ellipsoids[3])
    return seen
