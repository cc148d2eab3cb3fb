"""Runs on fixed buffers: both renderers, kinematics, and an iteration of the refinement.

Nothing here allocates while it runs, so that all of it can be captured and replayed.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import torch
import warp as wp

from ....body.ellipbody import bone_tree
from ....cameras import ScreenCamera
from ....interop.arrays import contiguous, warp_array
from ....interop.loss_graph import Buffers
from ....kernels import kinematics
from ....kernels.refine.state import EllipsoidArrays
from ....render.body_loss import ALL_PARTS
from ....render.captured import CapturedEllipsoids
from ....render.ellipsoid_passes import ellipsoid_passes
from ....render.ellipsoids import ellipsoid_label_loss
from ....render.mesh import mesh_label_loss
from ....render.mesh_passes import mesh_passes
from ....render.options import DEFAULT_DEPTH_WEIGHT, Gradient
from ....render.part_mesh import mesh_constants
from ....render.renderers import RendererEllipsoids, labelled_mesh
from ....solve.ellipsoids.captured import CapturedRefinement
from ....solve.ellipsoids.stepper import LEARNING_RATE
from ..scene import LABELS, BenchScene

_POISON = 77
NUM_ITERATIONS = 50  # the paper's
_SUBDIVISIONS = 1  # of the mesh that kinematics places


class ExactRun:
    """The exact renderer: ``labels`` draws the hard label image alone, ``gradient`` takes L_seg and its gradient, too.

    Labels are the 20 parts, so the index of the nearest is its label; gradients are forces on the ellipsoids.
    """

    def __init__(self, scene: BenchScene, gradient: Gradient) -> None:
        self._scene, self._renderer = scene, RendererEllipsoids(gradient)
        ellipsoids = EllipsoidArrays()
        ellipsoids.centres = warp_array(contiguous(scene.posed.centres), wp.vec3)
        ellipsoids.axes = warp_array(contiguous(scene.posed.axes), wp.mat33)
        ellipsoids.semi_axes = warp_array(contiguous(scene.posed.semi_axes), wp.vec3)
        ellipsoids.camera = warp_array(contiguous(scene.camera.intrinsics), wp.vec4)
        posed = ellipsoids.centres, ellipsoids.axes, ellipsoids.semi_axes, ellipsoids.camera
        labels = LABELS.part_groups[1:].tolist()
        self._labels = wp.full(scene.targets.shape, _POISON, dtype=wp.uint8, device=ellipsoids.centres.device)
        passes = ellipsoid_passes(tuple(labels), False, near=-math.inf, **vars(self._renderer))
        draw, _, _ = passes.prepare_picture(posed, parts=self._labels)
        self.labels = partial(draw, slice(0, scene.batch_size))
        picture = CapturedEllipsoids(self._renderer, labels, scene.targets, ellipsoids)
        self.gradient, self._drawn = picture.launch, picture.drawn

    def check(self) -> None:
        """Hold the runs against ``ellipsoid_label_loss``.

        Raises:
            AssertionError: If they differ.
        """
        scene, drawn = self._scene, self._drawn
        wp.synchronize_device(self._labels.device)  # torch, which made the inputs, has streams of its own
        drawn.loss.fill_(math.nan)
        drawn.forces.fill_(math.nan)
        self.labels()
        self.gradient()
        centres = scene.posed.centres.detach().requires_grad_()
        moved = replace(scene.posed, centres=centres)
        gradient = self._renderer.gradient
        loss, image = ellipsoid_label_loss(moved, scene.camera, scene.targets, gradient=gradient, validate=False)
        (want,) = torch.autograd.grad(loss.sum(), centres)
        wp.synchronize_device(self._labels.device)
        torch.testing.assert_close(wp.to_torch(self._labels), image.labels, rtol=0, atol=0)
        torch.testing.assert_close(wp.to_torch(drawn.loss).sum(1), loss.detach())
        _assert_near(wp.to_torch(drawn.forces).sum(2)[..., :3], want)


class MeshRun:
    """The mesh renderer as ``RendererMesh.crop_loss`` uses it, from projected vertices; does what ``ExactRun`` does."""

    def __init__(self, scene: BenchScene, subdivisions: int) -> None:
        self._scene, device = scene, scene.targets.device
        self._mesh = mesh = labelled_mesh(subdivisions, ALL_PARTS, device, cull_backfaces=True)
        self._points = scene.camera.project(scene.posed.vertices(subdivisions)).detach().contiguous()
        self._labels = torch.full_like(scene.targets, _POISON)
        passes = mesh_passes(*mesh_constants(mesh), *(False, -math.inf, math.inf, DEFAULT_DEPTH_WEIGHT))
        faults = torch.empty(len(self._points), device=device)
        self.labels = passes.prepare_labels((self._points,), self._labels, faults)
        self._buffers = buffers = Buffers.empty(passes, (self._points.shape,), scene.targets, needs_grad=True)
        buffers.numbers.fill_(math.nan)
        buffers.losses.fill_(math.nan)
        buffers.inputs[0].copy_(self._points)
        self.gradient = passes.prepare(buffers)

    def check(self) -> None:
        """Hold the runs against ``mesh_label_loss``.

        Raises:
            AssertionError: If they differ.
        """
        device = wp.device_from_torch(self._labels.device)
        wp.synchronize_device(device)
        self.labels()
        self.gradient()
        leaf = self._points.clone().requires_grad_()
        loss, image = mesh_label_loss(
            leaf, self._mesh, ScreenCamera(perspective=False), self._scene.targets, validate=False
        )
        (want,) = torch.autograd.grad(loss.sum(), leaf)
        wp.synchronize_device(device)
        torch.testing.assert_close(self._labels, image.labels, rtol=0, atol=0)
        torch.testing.assert_close(self._buffers.losses.sum(1), loss.detach())
        _assert_near(self._buffers.grads[0], want)


def _assert_near(have: torch.Tensor, want: torch.Tensor) -> None:
    torch.testing.assert_close(have, want, rtol=1e-3, atol=1e-4 * float(want.abs().max()))


class KinematicsRun:
    """Posing, mesh vertices, and the adjoints of both."""

    def __init__(self, scene: BenchScene) -> None:
        bodies, posed = scene.bodies, scene.posed
        where = wp.device_from_torch(scene.targets.device)
        self._tree = bone_tree(where.alias, wp.float32, _SUBDIVISIONS)
        rotations = warp_array(contiguous(posed.rotations), wp.mat33)  # any will do as local ones
        self._parameters = [
            warp_array(contiguous(bodies.global_orient()), wp.mat33),
            wp.zeros(scene.batch_size, dtype=wp.vec3, device=where),
            rotations,
            warp_array(contiguous(bodies.lengths)),
            warp_array(contiguous(bodies.thicknesses)),
        ]
        centres, axes = warp_array(contiguous(posed.centres), wp.vec3), warp_array(contiguous(posed.axes), wp.mat33)
        like = [warp_array(contiguous(posed.joints), wp.vec3), rotations, centres, axes, centres]
        self._posed, self._adjoints = ([wp.zeros_like(array) for array in like] for _ in range(2))
        self._gradients = [wp.zeros_like(array) for array in self._parameters]
        self._scratch = kinematics.PoseScratch.empty(self._tree, scene.batch_size)
        shape = (*centres.shape, self._tree.unit_vertices.shape[0])
        self._vertices, self._adj_vertices = (wp.zeros(shape, dtype=wp.vec3, device=where) for _ in range(2))

    def launch(self) -> None:
        """Forward and back."""
        kinematics.launch_pose(self._tree, self._parameters, self._posed)
        _, rotations, *ellipsoids = self._posed
        kinematics.launch_vertices(self._tree, ellipsoids, self._vertices)
        kinematics.launch_vertices_adjoint(self._tree, [*ellipsoids[1:], self._adj_vertices], self._adjoints[2:])
        orientation, _, local, lengths, _ = self._parameters
        kinematics.launch_pose_adjoint(
            self._tree, [orientation, local, lengths, rotations], self._adjoints, self._gradients, self._scratch
        )


def refined_once(scene: BenchScene, gradient: Gradient, learning_rate: float = LEARNING_RATE) -> CapturedRefinement:
    """The captured refinement with the exact renderer, once done: ``iterate`` repeats its last iteration.

    With a learning rate of 0 the bodies stay where they are, and every iteration does the same.
    """
    captured = CapturedRefinement(
        scene.energy(gradient), scene.batch_size, iterations=NUM_ITERATIONS, learning_rate=learning_rate
    )
    captured.refine(scene.bodies)
    return captured
