"""L_seg from the parameters of bodies, with its gradient, in one captured graph: what a training step needs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Protocol

import torch

from ..body.parameters import LOCKED_BITS
from ..body.posing import Posed, check_parameters, matrices_of, pose_parts
from ..body.template import BODY_SHAPES
from ..cameras import Camera, WeakPerspective, check_camera
from ..interop.checks import FLOATS, check_image_size, check_numbers, check_tensor
from ..interop.derivatives import refuse_transforms
from ..interop.loss_graph import find_label_loss
from .body_passes import BodyPasses, body_passes
from .mesh import check_labels
from .mesh_passes import MeshPasses
from .options import check_target
from .renderers import ALL_PARTS, CameraKind, Renderer, RendererEllipsoids, RendererMesh

EDGES = RendererEllipsoids("edges")


def body_label_loss(
    global_orient: torch.Tensor,
    translation: torch.Tensor,
    rotations: torch.Tensor,
    lengths: torch.Tensor,
    thicknesses: torch.Tensor,
    camera: Camera,
    target: torch.Tensor,
    *,
    renderer: Renderer = EDGES,
    part_labels: Sequence[int] = ALL_PARTS,
    validate: bool = True,
) -> torch.Tensor:
    """L_seg (paper, eq. 6) of bodies, straight from what ``pose`` takes; its gradient is found with it.

    The same as ``renderer.label_loss(pose(...), camera, target)[0]``, and a first derivative likewise.

    Args:
        global_orient: As in ``pose``, in any of its three forms, as are the following.
        translation: Position of the pelvis in the camera frame [m], shape (B, 3).
        rotations: Local rotations.
        lengths: Shape (B, 12) [m].
        thicknesses: Shape (B, 15) [m].
        camera: One a body, or one for all.
        target: Labels, shape (B, H, W) or (1, H, W) for all, uint8; 0 = background, 255 = ignore.
        renderer: Exact ellipsoids or their mesh.
        part_labels: Label that each part shows.
        validate: Look for NaN, infinity and matrices that are no rotations; on CUDA that waits for the device.

    Returns:
        The loss of each body [pixels of maps], shape (B,).

    Raises:
        ValueError: As ``pose`` and the renderer's ``label_loss``.
        NotImplementedError: Under ``torch.func``, and in a second derivative.
    """
    parameters = (global_orient, translation, rotations, lengths, thicknesses)
    refuse_transforms("body_label_loss", target, *parameters)
    check_parameters(parameters, dtypes=FLOATS)
    batch, labels = len(lengths), tuple(part_labels)
    intrinsics = check_camera(camera, batch, ("lengths", lengths)).expand(batch, 4)
    refuse_transforms("body_label_loss", intrinsics)
    check_tensor("target", target, (None, None, None), dtypes=(torch.uint8,))
    check_image_size(target.shape[1:], batch)
    check_target(target, ("lengths", lengths), batch)
    if torch.compiler.is_compiling():
        return renderer.label_loss(pose_parts(*parameters), camera, target, part_labels=labels, validate=False)[0]
    if validate:
        numbers = dict(zip(BODY_SHAPES, parameters, strict=True))
        sizes = ("lengths", "thicknesses")
        check_numbers({**numbers, "camera": intrinsics}, rotations=matrices_of(parameters), positive=sizes)
    if isinstance(renderer, RendererMesh) and renderer.subdivisions == "auto":
        with torch.no_grad():
            renderer = renderer.fixed(pose_parts(*parameters), camera)
    recipe = _passes(renderer, camera, labels, lengths.device)
    if validate and isinstance(recipe.renderer, MeshPasses):
        check_labels(target, recipe.renderer.num_labels)
    return _find_loss(recipe, (intrinsics[:, :2], intrinsics[:, 2:], *parameters), target)


class CropBodies(Protocol):
    """Bodies in crops of side 2, as ``BodyParameters`` has them; rotations in any of the forms of ``pose``."""

    orientation: torch.Tensor
    rotations: torch.Tensor
    lengths: torch.Tensor
    thicknesses: torch.Tensor
    log_scale: torch.Tensor
    shift: torch.Tensor

    def posed(self) -> Posed:
        """Posed bodies, pelvis at the origin."""

    def camera(self, size: int) -> WeakPerspective:
        """Cameras for a crop of ``size`` pixels a side."""


def crop_label_loss(
    bodies: CropBodies, target: torch.Tensor, *, renderer: Renderer = EDGES, part_labels: Sequence[int] = ALL_PARTS
) -> torch.Tensor:
    """L_seg of bodies in square crops, as ``body_label_loss``, but the numbers are not looked at.

    Args:
        bodies: ``BodyParameters``, whose hips don't turn, or what a network predicts.
        target: Labels, shape (B, S, S) or (1, S, S) for all, uint8.
        renderer: Exact ellipsoids, or their mesh of a fixed level.
        part_labels: Label that each part shows.

    Returns:
        The loss of each body [pixels of maps], shape (B,).
    """
    size, labels = target.shape[-1], tuple(part_labels)
    if torch.compiler.is_compiling():
        camera = bodies.camera(size)
        return renderer.label_loss(bodies.posed(), camera, target, part_labels=labels, validate=False)[0]
    lengths = bodies.lengths
    locked = LOCKED_BITS if bodies.rotations.dim() == 3 else 0
    recipe = _passes(renderer, _CROP, labels, lengths.device, locked, size / 2)
    pelvis = _origin(lengths.device).expand(len(lengths), 3)
    parameters = bodies.orientation, pelvis, bodies.rotations, lengths, bodies.thicknesses
    return _find_loss(recipe, (bodies.log_scale[:, None], bodies.shift, *parameters), target)


class _CropCamera:
    perspective, near_plane = False, WeakPerspective.near


_CROP = _CropCamera()


@lru_cache(maxsize=8)
def _origin(device: torch.device) -> torch.Tensor:
    return torch.zeros(1, 3, device=device)


def _passes(
    renderer: Renderer,
    camera: CameraKind,
    labels: tuple[int, ...],
    device: torch.device,
    locked: int = 0,
    half_size: float = 0.0,
) -> BodyPasses:
    level = renderer.subdivisions if isinstance(renderer, RendererMesh) else 0
    return body_passes(renderer.passes(camera, labels, device), level, locked, half_size)


def _find_loss(recipe: BodyPasses, tensors: tuple[torch.Tensor, ...], target: torch.Tensor) -> torch.Tensor:
    return find_label_loss(recipe, tuple([tensor.float() for tensor in tensors]), target)[0]
