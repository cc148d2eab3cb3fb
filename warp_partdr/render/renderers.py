"""Renderers of bodies as objects: exact ellipsoids, or their mesh, with the options of the gradient."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from ..body.ellipbody import DEFAULT_SUBDIVISIONS
from ..body.icosphere import MAX_SUBDIVISIONS
from ..body.posing import Posed
from ..body.template import NUM_PARTS
from ..cameras import Camera
from ..interop.device_cache import device_cache
from .body_loss import ALL_PARTS, BodyLoss, Seeing
from .body_passes import BodyPasses, body_passes
from .ellipsoid_passes import ellipsoid_passes
from .ellipsoids import EllipsoidImage, check_part_labels, check_rule, draw_ellipsoids, ellipsoid_label_loss
from .mesh import PartImage, draw_mesh, mesh_label_loss
from .mesh_passes import mesh_passes
from .options import DEFAULT_DEPTH_WEIGHT, Gradient, MeshGradient, check_mesh_rule
from .part_mesh import PartMesh, ellipbody_mesh, mesh_constants
from .subdivisions import DEFAULT_TOLERANCE, Subdivisions, coarsest_subdivisions


@dataclass(frozen=True)
class RendererEllipsoids(BodyLoss):
    """Renderer of the exact ellipsoids, in closed form.

    Attributes:
        gradient: Kind of gradient, "partdr", "coverage" or "edges", see ``draw_ellipsoids``.
        max_distance: Greatest distance from an edge of a pixel that moves it with "partdr" [px].
        depth_weight: Lambda of the paper's z gradient (eq. 12) with "partdr". If it is 0, z has no gradient.
        samples_per_pixel: Density of the borders' samples with "coverage".

    Examples:
        >>> import torch
        >>> from warp_partdr import BodyParameters, RendererEllipsoids
        >>> renderer = RendererEllipsoids("coverage")
        >>> leaves = BodyParameters.mean(2).leaves()
        >>> renderer.draw(leaves.posed(), leaves.camera(64), (64, 64)).labels.shape
        torch.Size([2, 64, 64])
        >>> loss = renderer.crop_loss(leaves, torch.zeros(2, 64, 64, dtype=torch.uint8))
        >>> loss.sum().backward()
        >>> loss.shape
        torch.Size([2])
    """

    gradient: Gradient = "partdr"
    max_distance: float = math.inf
    depth_weight: float = DEFAULT_DEPTH_WEIGHT
    samples_per_pixel: float = 1.0

    def __post_init__(self) -> None:
        check_rule(**self._rule)

    def draw(
        self,
        posed: Posed,
        camera: Camera,
        image_size: tuple[int, int],
        *,
        part_labels: Sequence[int] = ALL_PARTS,
        num_maps: int = 0,
        validate: bool = True,
    ) -> EllipsoidImage:
        """Draw bodies with the arguments and errors of ``draw_ellipsoids``."""
        return draw_ellipsoids(
            posed, camera, image_size, part_labels=part_labels, num_maps=num_maps, validate=validate, **self._rule
        )

    def label_loss(
        self,
        posed: Posed,
        camera: Camera,
        target: torch.Tensor,
        *,
        part_labels: Sequence[int] = ALL_PARTS,
        validate: bool = True,
    ) -> tuple[torch.Tensor, EllipsoidImage]:
        """L_seg of bodies with the arguments and errors of ``ellipsoid_label_loss``."""
        return ellipsoid_label_loss(posed, camera, target, part_labels=part_labels, validate=validate, **self._rule)

    def body_passes(self, seeing: Seeing, device: torch.device) -> BodyPasses:
        """Launches from parameters of bodies to L_seg, with the errors of ``draw_ellipsoids``."""
        if seeing.part_labels is not ALL_PARTS:
            check_part_labels(seeing.part_labels, NUM_PARTS)
        return _ellipsoid_body_passes(self, seeing)

    def fixed(self, posed: Posed, camera: Camera) -> RendererEllipsoids:
        """Return itself: nothing in it depends on the bodies."""
        return self

    @property
    def _rule(self) -> dict[str, Any]:  # not ``vars``, which torch.compile of torch 2.11 can't trace
        return {
            "gradient": self.gradient,
            "max_distance": self.max_distance,
            "depth_weight": self.depth_weight,
            "samples_per_pixel": self.samples_per_pixel,
        }


@dataclass(frozen=True)
class RendererMesh(BodyLoss):
    """Renderer of EllipBody's mesh; with PartDR's gradient, it is the paper's.

    Attributes:
        subdivisions: Level of the mesh, 0 to 3, or "auto" for the coarsest that keeps ``tolerance``.
        tolerance: Greatest distance of silhouettes from those of the ellipsoids that "auto" allows [px].
        max_distance: Greatest distance from an edge of a pixel that moves it with "partdr" [px].
        depth_weight: Lambda of the paper's z gradient (eq. 12) with "partdr". If it is 0, z has no gradient.
        gradient: Kind of gradient, "partdr" or "edges", see ``draw_mesh``.

    Examples:
        >>> import torch
        >>> from warp_partdr import BodyParameters, RendererMesh
        >>> renderer = RendererMesh("auto", tolerance=0.5)
        >>> body = BodyParameters.mean(2)
        >>> loss, image = renderer.label_loss(body.posed(), body.camera(64), torch.zeros(2, 64, 64, dtype=torch.uint8))
        >>> loss.shape, image.labels.shape
        (torch.Size([2]), torch.Size([2, 64, 64]))
    """

    subdivisions: Subdivisions = DEFAULT_SUBDIVISIONS
    tolerance: float = DEFAULT_TOLERANCE
    max_distance: float = math.inf
    depth_weight: float = DEFAULT_DEPTH_WEIGHT
    gradient: MeshGradient = "partdr"

    def __post_init__(self) -> None:
        check_mesh_rule(**self._rule)
        level, tolerance = self.subdivisions, self.tolerance
        if level != "auto" and (type(level) is not int or not 0 <= level <= MAX_SUBDIVISIONS):
            raise ValueError(f"subdivisions: {level!r}; expected 0 to {MAX_SUBDIVISIONS}, or auto")
        if not 0 < tolerance < math.inf:
            raise ValueError(f"tolerance: {tolerance}; expected a positive number of pixels")

    def draw(
        self,
        posed: Posed,
        camera: Camera,
        image_size: tuple[int, int],
        *,
        part_labels: Sequence[int] = ALL_PARTS,
        num_maps: int = 0,
        validate: bool = True,
    ) -> PartImage:
        """Draw bodies with the arguments and errors of ``draw_mesh`` and ``draw_ellipsoids``."""
        vertices, mesh = self._mesh(posed, camera, part_labels)
        return draw_mesh(vertices, mesh, camera, image_size, num_maps=num_maps, validate=validate, **self._rule)

    def label_loss(
        self,
        posed: Posed,
        camera: Camera,
        target: torch.Tensor,
        *,
        part_labels: Sequence[int] = ALL_PARTS,
        validate: bool = True,
    ) -> tuple[torch.Tensor, PartImage]:
        """L_seg of bodies with the arguments and errors of ``mesh_label_loss`` and ``draw_ellipsoids``."""
        vertices, mesh = self._mesh(posed, camera, part_labels)
        return mesh_label_loss(vertices, mesh, camera, target, validate=validate, **self._rule)

    def body_passes(self, seeing: Seeing, device: torch.device) -> BodyPasses:
        """Launches from parameters of bodies to L_seg, of a fixed level, with the errors of ``draw_mesh``."""
        return _mesh_body_passes(self, seeing, device)

    def fixed(self, posed: Posed, camera: Camera) -> RendererMesh:
        """Renderer with the level that these bodies need, so that a loss does not jump while it is minimised."""
        if self.subdivisions != "auto":
            return self
        return replace(self, subdivisions=coarsest_subdivisions(posed, camera, tolerance=self.tolerance))

    @property
    def _rule(self) -> dict[str, Any]:
        return {"gradient": self.gradient, "max_distance": self.max_distance, "depth_weight": self.depth_weight}

    def _mesh(self, posed: Posed, camera: Camera, part_labels: Sequence[int]) -> tuple[torch.Tensor, PartMesh]:
        level = self.fixed(posed, camera).subdivisions
        assert level != "auto"
        vertices = posed.vertices(level)
        return vertices, labelled_mesh(level, tuple(part_labels), vertices.device)


Renderer = RendererEllipsoids | RendererMesh


@device_cache(64)
def _ellipsoid_body_passes(renderer: RendererEllipsoids, seeing: Seeing) -> BodyPasses:
    gradient, *numbers = check_rule(**renderer._rule)
    passes = ellipsoid_passes(seeing.part_labels, seeing.perspective, gradient, seeing.near_plane, *numbers)
    return body_passes(passes, 0, seeing.locked, seeing.half_size)


@device_cache(64)
def _mesh_body_passes(renderer: RendererMesh, seeing: Seeing, device: torch.device) -> BodyPasses:
    if renderer.subdivisions == "auto":
        raise ValueError("subdivisions: auto; expected 0 to 3, or the renderer that fixed(posed, camera) returns")
    rule = check_mesh_rule(**renderer._rule)
    # Posed here, by rotations, so that no ellipsoid is its own mirror image, whose faces would be inside out.
    mesh = labelled_mesh(renderer.subdivisions, seeing.part_labels, device, cull_backfaces=True)
    options = seeing.perspective, seeing.near_plane, *rule
    passes = mesh_passes(*mesh_constants(mesh), *options)
    return body_passes(passes, renderer.subdivisions, seeing.locked, seeing.half_size)


def labelled_mesh(
    level: int, part_labels: tuple[int, ...], device: torch.device, *, cull_backfaces: bool = False
) -> PartMesh:
    """Mesh with its labels, cached, for its edges take a moment to find."""
    return _labelled_mesh(level, part_labels, device, cull_backfaces)


# Not traced: how a mesh is found is no arithmetic of tensors. This is what torch.compiler.assume_constant_result does;
# it would import torch's compiler, which takes seconds.
labelled_mesh._dynamo_marked_constant = True  # type: ignore[attr-defined]


@device_cache(32)
def _labelled_mesh(level: int, part_labels: tuple[int, ...], device: torch.device, cull_backfaces: bool) -> PartMesh:
    mesh = replace(ellipbody_mesh(level, device=device), cull_backfaces=cull_backfaces)
    return mesh if part_labels == ALL_PARTS else mesh.relabel(np.array([0, *part_labels], dtype=np.uint8))
