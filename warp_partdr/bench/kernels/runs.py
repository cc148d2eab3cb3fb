"""Runs on fixed buffers: both renderers, kinematics, and an iteration of the refinement.

Nothing here allocates while it runs, so that all of it can be captured and replayed.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import torch
import warp as wp

from ...body.ellipbody import bone_tree
from ...cameras import ScreenCamera
from ...interop.arrays import contiguous, warp_array
from ...kernels import kinematics
from ...kernels.ellipsoids.picture import launch_draw
from ...kernels.ellipsoids.silhouette import Seen, launch_see
from ...kernels.labels import LabelTarget
from ...kernels.mesh import push_xy, push_z, rasterize
from ...kernels.mesh.triangles import ImageArrays, MeshArrays
from ...kernels.refine.state import EllipsoidArrays
from ...kernels.side_stream import launch_side_by_side
from ...refinement.captured import CapturedRefinement
from ...refinement.stepper import LEARNING_RATE
from ...render.captured import CapturedEllipsoids
from ...render.ellipsoids import ellipsoid_label_loss
from ...render.mesh import mesh_label_loss
from ...render.options import DEFAULT_DEPTH_WEIGHT, Gradient
from ...render.part_mesh import ellipbody_mesh
from ...render.renderers import RendererEllipsoids
from ..scene import LABELS, BenchScene

_POISON = 77
NUM_ITERATIONS = 50  # the paper's
_SUBDIVISIONS = 1  # of the mesh that kinematics places


class ExactRun:
    """The exact renderer."""

    def __init__(self, scene: BenchScene, gradient: Gradient) -> None:
        posed, batch = scene.posed, scene.batch_size
        self._scene, self._gradient = scene, gradient
        ellipsoids = EllipsoidArrays()
        ellipsoids.centres = warp_array(contiguous(posed.centres), wp.vec3)
        ellipsoids.axes = warp_array(contiguous(posed.axes), wp.mat33)
        ellipsoids.semi_axes = warp_array(contiguous(posed.semi_axes), wp.vec3)
        ellipsoids.camera = warp_array(contiguous(scene.camera.intrinsics), wp.vec4)
        self._ellipsoids = [ellipsoids.centres, ellipsoids.axes, ellipsoids.semi_axes, ellipsoids.camera]
        where = ellipsoids.centres.device
        self._part_labels = wp.array(LABELS.part_groups[1:], dtype=wp.uint8, device=where)
        self._seen = Seen.empty(batch, posed.centres.shape[1], where)
        self._labels = wp.full((batch, scene.size, scene.size), _POISON, dtype=wp.uint8, device=where)
        self._nearest = wp.empty(self._labels.shape if where.is_cpu else (0, 0, 0), dtype=float, device=where)
        self._no_labels = wp.empty((0, 0, 0), dtype=wp.uint8, device=where)
        self._no_depth = wp.empty((0, 0, 0), dtype=float, device=where)
        self._no_losses = wp.empty((0, 0), dtype=float, device=where)
        labels = LABELS.part_groups[1:].tolist()
        self._picture = CapturedEllipsoids(RendererEllipsoids(gradient), labels, scene.targets, ellipsoids)
        self._picture.update()

    def labels(self) -> None:
        """The hard label image alone: of the 20 parts, so the index of the nearest is its label."""
        launch_see(self._ellipsoids, self._part_labels, near=-math.inf, perspective=False, seen=self._seen)
        launch_draw(
            self._seen.silhouettes,
            perspective=False,
            target=LabelTarget(),
            nearest=self._nearest,
            parts=self._labels,
            labels=self._no_labels,
            depth=self._no_depth,
            losses=self._no_losses,
        )

    def gradient(self) -> None:
        """Project, render, L_seg and its gradient, as forces on the ellipsoids."""
        self._picture.launch()

    def check(self) -> None:
        """Hold the runs against ``ellipsoid_label_loss``.

        Raises:
            AssertionError: If they differ.
        """
        wp.synchronize_device(self._labels.device)  # torch, which made the inputs, has streams of its own
        self._picture.drawn.loss.fill_(math.nan)
        self._picture.drawn.forces.values.fill_(math.nan)
        self.labels()
        self.gradient()
        centres = self._scene.posed.centres.detach().requires_grad_()
        moved = replace(self._scene.posed, centres=centres)
        loss, image = ellipsoid_label_loss(
            moved, self._scene.camera, self._scene.targets, gradient=self._gradient, validate=False
        )
        (want,) = torch.autograd.grad(loss.sum(), centres)
        wp.synchronize_device(self._labels.device)
        torch.testing.assert_close(wp.to_torch(self._labels), image.labels, rtol=0, atol=0)
        torch.testing.assert_close(wp.to_torch(self._picture.drawn.loss).sum(1), loss.detach())
        scale = float(want.abs().max())
        have = wp.to_torch(self._picture.drawn.forces.values).sum(2)[..., :3]
        torch.testing.assert_close(have, want, rtol=1e-3, atol=1e-4 * scale)


class MeshRun:
    """The mesh renderer, from projected vertices."""

    def __init__(self, scene: BenchScene, subdivisions: int) -> None:
        self._scene = scene
        self._mesh = mesh = ellipbody_mesh(subdivisions, device=scene.targets.device)
        self._points = scene.camera.project(scene.posed.vertices(subdivisions)).detach().contiguous()
        shape = (scene.batch_size, scene.size, scene.size)
        self._arrays = arrays = MeshArrays()
        arrays.vertices, arrays.faces = warp_array(contiguous(self._points), wp.vec3), warp_array(mesh.faces, wp.vec3i)
        arrays.face_labels, arrays.edges = warp_array(mesh.face_labels), warp_array(mesh.edges)
        arrays.near, arrays.perspective = -math.inf, False
        where = arrays.vertices.device
        self._zbuffer = rasterize.ZBuffer.make(*shape, where)
        self._labels = wp.full(shape, _POISON, dtype=wp.uint8, device=where)
        self._label_image, self._images = ImageArrays(), ImageArrays()
        self._label_image.labels = self._images.labels = self._labels
        self._images.depth = wp.full(shape, -9.0, dtype=wp.float32, device=where)
        self._images.face_index = wp.full(shape, -9, dtype=wp.int32, device=where)
        lanes = rasterize.pixel_lanes(shape, where.is_cpu)
        self._losses = wp.full(lanes, math.nan, dtype=wp.float32, device=where)
        self._found = push_xy.SilhouetteList.make(scene.batch_size, arrays.edges.shape[0], where)
        self._hidden = push_z.HiddenPixels.make(self._zbuffer.keys)
        self._grad = wp.full((*arrays.vertices.shape, 3), math.nan, dtype=wp.float32, device=where)
        self._target = target = LabelTarget()
        target.target = warp_array(contiguous(scene.targets))
        target.scale = wp.ones(scene.batch_size, dtype=wp.float32, device=where)
        extents = (scene.batch_size, rasterize.NUM_EXTENTS, mesh.num_labels + 1)
        target.extents = wp.zeros(extents, dtype=wp.vec4i, device=where)

    def labels(self) -> None:
        """The hard label image alone."""
        rasterize.launch_rasterize(self._arrays, self._label_image, zbuffer=self._zbuffer)

    def gradient(self) -> None:
        """Render, L_seg and its gradient."""
        rasterize.launch_rasterize(self._arrays, self._images, zbuffer=self._zbuffer, background=False)
        target = self._target
        rasterize.launch_compare_labels(self._labels, target.target, extents=target.extents, losses=self._losses)
        self._grad.zero_()
        push_edges = partial(
            push_xy.launch_push_edges,
            self._arrays,
            self._images,
            max_distance=math.inf,
            gradient=target,
            found=self._found,
            grad_vertices=self._grad,
        )
        push_depths = partial(
            push_z.launch_push_depths,
            self._arrays,
            self._images,
            depth_weight=DEFAULT_DEPTH_WEIGHT,
            gradient=target,
            hidden=self._hidden,
            grad_vertices=self._grad,
        )
        launch_side_by_side(push_edges, push_depths)

    def check(self) -> None:
        """Hold the runs against ``mesh_label_loss``.

        Raises:
            AssertionError: If they differ.
        """
        wp.synchronize_device(self._labels.device)
        leaf = self._points.clone().requires_grad_()
        loss, image = mesh_label_loss(
            leaf, self._mesh, ScreenCamera(perspective=False), self._scene.targets, validate=False
        )
        (want,) = torch.autograd.grad(loss.sum(), leaf)
        for run in (self.labels, self.gradient):
            self._labels.fill_(_POISON)
            run()
            wp.synchronize_device(self._labels.device)
            torch.testing.assert_close(wp.to_torch(self._labels), image.labels, rtol=0, atol=0)
        torch.testing.assert_close(wp.to_torch(self._losses).sum((1, 2)), loss.detach())
        scale = float(want.abs().max())
        torch.testing.assert_close(wp.to_torch(self._grad), want, rtol=1e-3, atol=1e-4 * scale)


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
        shape = (*centres.shape, self._tree.unit_vertices.shape[0])
        self._vertices, self._adj_vertices = (wp.zeros(shape, dtype=wp.vec3, device=where) for _ in range(2))

    def launch(self) -> None:
        """Forward and back."""
        joints, rotations, centres, axes, semi_axes = self._posed
        kinematics.launch_pose(self._tree, self._parameters, joints, rotations, centres, axes, semi_axes)
        kinematics.launch_vertices(self._tree, centres, axes, semi_axes, self._vertices)
        kinematics.launch_vertices_adjoint(self._tree, axes, semi_axes, self._adj_vertices, self._adjoints[2:])
        orientation, _, local, lengths, _ = self._parameters
        kinematics.launch_pose_adjoint(
            self._tree, [orientation, local, lengths, rotations], self._adjoints, self._gradients
        )


def refined_once(scene: BenchScene, gradient: Gradient, learning_rate: float = LEARNING_RATE) -> CapturedRefinement:
    """The captured refinement with the exact renderer, once done: ``iterate`` repeats its last iteration.

    With a learning rate of 0 the bodies stay where they are, and every iteration does the same.
    """
    captured = CapturedRefinement(
        scene.energies(gradient), scene.batch_size, iterations=NUM_ITERATIONS, learning_rate=learning_rate
    )
    captured.refine(scene.bodies)
    return captured
