"""Exact ellipsoids on torch tensors: label images in closed form, without triangles, and two gradients of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import torch
import warp as wp

from .cameras import Camera
from .checks import check_finite, check_tensor
from .kernels import ellipsoid_coverage, ellipsoid_partdr, ellipsoid_picture, surface_forces
from .kernels import ellipsoids as kernel_ellipsoids
from .kernels.ellipsoids import Seen, launch_see
from .kernels.targets import DenseGradient, LabelTarget, launch_find_reach
from .kernels.threads import launch_in_slices
from .mesh import MAX_LABEL
from .posing import Posed
from .render import DEFAULT_DEPTH_WEIGHT, DEFAULT_NEAR, IGNORE_LABEL, Occlusion
from .streams import on_torch_stream

Gradient = Literal["coverage", "partdr"]

MAX_PARTS = 255  # parts are counted in one byte, 0 = background
DEFAULT_STEPS_PER_PIXEL = 1.0
DEFAULT_HALVINGS = 4
MAX_HALVINGS = 20  # finer than float32 tells angles apart


@dataclass(frozen=True)
class EllipsoidImage:
    """What ellipsoids look like.

    Attributes:
        labels: Label at each pixel, 0 = background, shape (B, H, W), uint8.
        depth: Depth of the nearest ellipsoid [m], inf = background, shape (B, H, W), float32.
        parts: Index + 1 of the nearest ellipsoid, 0 = background, shape (B, H, W), uint8.
        maps: Maps of labels 1 to K, differentiable, shape (B, K, H, W); None unless asked for.
    """

    labels: torch.Tensor
    depth: torch.Tensor
    parts: torch.Tensor
    maps: torch.Tensor | None = None


@dataclass(frozen=True)
class Ellipsoids:
    """B times P ellipsoids in the camera frame; ``Posed`` has the same fields and serves as well.

    Attributes:
        centres: Shape (B, P, 3) [m].
        axes: Rotation matrices, axes as columns, shape (B, P, 3, 3).
        semi_axes: Shape (B, P, 3) [m].
    """

    centres: torch.Tensor
    axes: torch.Tensor
    semi_axes: torch.Tensor


def draw_ellipsoids(
    ellipsoids: Ellipsoids | Posed,
    camera: Camera,
    image_size: tuple[int, int],
    *,
    part_labels: Sequence[int] | None = None,
    num_maps: int = 0,
    gradient: Gradient = "coverage",
    near: float | None = None,
    occlusion: Occlusion = "depth",
    max_distance: float = math.inf,
    depth_weight: float = DEFAULT_DEPTH_WEIGHT,
    steps_per_pixel: float = DEFAULT_STEPS_PER_PIXEL,
    halvings: int = DEFAULT_HALVINGS,
    validate: bool = True,
) -> EllipsoidImage:
    """Draw ellipsoids in closed form; with ``num_maps`` the label maps carry gradients back.

    Args:
        ellipsoids: P of them a body, at most 255; ``Posed`` or ``Ellipsoids``.
        camera: Weak perspective or perspective, one a body.
        image_size: (H, W) [px].
        part_labels: Label that each ellipsoid shows, 1 to 254, or 255: hides what is behind and shows nothing; P of
            them. 1 to P by default; ``LabelSet.part_groups[1:]`` draws groups.
        num_maps: K; maps of labels 1 to K are made. 0 makes none, and nothing has a gradient.
        gradient: "coverage", the derivative of the area that labels cover, which sees borders alone; or "partdr", the
            paper's rule (eq. 10 to 12), with which far pixels pull.
        near: Ellipsoids that reach this depth [m] are not drawn; default 0.01 for perspective, none for weak
            perspective.
        occlusion: "partdr": as in ``rasterize_parts``.
        max_distance: "partdr": as in ``rasterize_parts`` [px].
        depth_weight: "partdr": as in ``rasterize_parts``.
        steps_per_pixel: "coverage": how densely outlines are walked.
        halvings: "coverage": how often a step is halved to find where on it the cost changes.
        validate: Look for NaN, infinity and axes that are not positive; on CUDA that waits for the device.

    Returns:
        The picture.

    Raises:
        ValueError: If a shape, size, dtype, label or number is wrong, or devices differ.
    """
    options = _options(gradient, occlusion, max_distance, depth_weight, steps_per_pixel, halvings)
    tensors, table, view = _check(ellipsoids, camera, image_size, part_labels, near, validate)
    if not 0 <= num_maps <= MAX_LABEL:
        raise ValueError(f"num_maps: {num_maps}; expected 0 to {MAX_LABEL}")
    if num_maps == 0:
        with torch.no_grad():
            picture = _draw(tensors, table, view)
        return EllipsoidImage(picture.labels, picture.depth, picture.parts)
    return EllipsoidImage(*_Maps.apply(*tensors, table, view, options, num_maps))


def ellipsoid_label_loss(
    ellipsoids: Ellipsoids | Posed,
    camera: Camera,
    target: torch.Tensor,
    *,
    part_labels: Sequence[int] | None = None,
    label_weights: torch.Tensor | None = None,
    gradient: Gradient = "coverage",
    near: float | None = None,
    occlusion: Occlusion = "depth",
    max_distance: float = math.inf,
    depth_weight: float = DEFAULT_DEPTH_WEIGHT,
    steps_per_pixel: float = DEFAULT_STEPS_PER_PIXEL,
    halvings: int = DEFAULT_HALVINGS,
    validate: bool = True,
) -> tuple[torch.Tensor, EllipsoidImage]:
    """L_seg (paper, eq. 6) against a label image and its gradient, in one go and without float maps.

    Args:
        ellipsoids: As in ``draw_ellipsoids``, like all that is not named here.
        camera: One a body.
        target: Wanted label of each pixel, shape (B, H, W) or (1, H, W) for all, uint8; 0 = background, 255 = ignore.
        part_labels: Label that each ellipsoid shows.
        label_weights: Weight of each label's map, shape (L,), label 0 first and without meaning; 1 by default.
        gradient: "coverage" or "partdr".
        near: Near plane [m].
        occlusion: "depth" or "paper".
        max_distance: Reach of a pixel [px].
        depth_weight: The paper's lambda of the z gradient.
        steps_per_pixel: How densely outlines are walked.
        halvings: How often a step is halved.
        validate: Look for NaN, infinity and axes that are not positive.

    Returns:
        The loss of each body [pixels of maps], shape (B,), and the picture.

    Raises:
        ValueError: As ``draw_ellipsoids``, or if ``target`` does not fit the batch.
    """
    options = _options(gradient, occlusion, max_distance, depth_weight, steps_per_pixel, halvings)
    check_tensor("target", target, (None, None, None), dtypes=(torch.uint8,), like=("centres", ellipsoids.centres))
    tensors, table, view = _check(ellipsoids, camera, tuple(target.shape[1:]), part_labels, near, validate)
    if target.shape[0] not in (1, tensors[0].shape[0]):
        raise ValueError(f"target: batch {target.shape[0]}; expected {tensors[0].shape[0]} as the ellipsoids, or 1")
    weights = torch.ones(256, device=target.device)
    if label_weights is not None:
        check_tensor("label_weights", label_weights, (None,), dtypes=_DTYPES)
        if label_weights.shape[0] > 256:
            raise ValueError(f"label_weights: {label_weights.shape[0]} of them; expected at most 256")
        weights[: label_weights.shape[0]] = label_weights.to(weights)
    weights[0] = weights[IGNORE_LABEL] = 0.0  # neither has a map
    loss, labels, depth, parts = _LabelLoss.apply(*tensors, table, target.contiguous(), weights, view, options)
    return loss, EllipsoidImage(labels, depth, parts)


_DTYPES = (torch.float32, torch.float64, torch.float16, torch.bfloat16)
_Tensors = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]


@dataclass(frozen=True)
class _View:
    """How the picture is taken."""

    height: int
    width: int
    near: float
    perspective: bool
    num_labels: int


@dataclass(frozen=True)
class _Options:
    """How the gradient is estimated."""

    gradient: Gradient
    over_farther: bool
    max_distance: float
    depth_weight: float
    steps_per_pixel: float
    halvings: int


@dataclass(frozen=True)
class _Picture:
    seen: Seen
    parts: torch.Tensor
    labels: torch.Tensor
    depth: torch.Tensor
    loss: torch.Tensor


def _options(
    gradient: Gradient,
    occlusion: Occlusion,
    max_distance: float,
    depth_weight: float,
    steps_per_pixel: float,
    halvings: int,
) -> _Options:
    if gradient not in ("coverage", "partdr"):
        raise ValueError(f"gradient: {gradient!r}; expected 'coverage' or 'partdr'")
    if occlusion not in ("depth", "paper"):
        raise ValueError(f"occlusion: {occlusion!r}; expected 'depth' or 'paper'")
    if not 0 < steps_per_pixel < math.inf:
        raise ValueError(f"steps_per_pixel: {steps_per_pixel}; expected a positive number")
    if not 0 <= halvings <= MAX_HALVINGS:
        raise ValueError(f"halvings: {halvings}; expected 0 to {MAX_HALVINGS}")
    over_farther = occlusion == "depth"
    return _Options(
        gradient, over_farther, float(max_distance), float(depth_weight), float(steps_per_pixel), int(halvings)
    )


def _check(
    ellipsoids: Ellipsoids | Posed,
    camera: Camera,
    image_size: tuple[int, ...],
    part_labels: Sequence[int] | None,
    near: float | None,
    validate: bool,
) -> tuple[_Tensors, torch.Tensor, _View]:
    """What both entry points share."""
    centres, axes, semi_axes, intrinsics = ellipsoids.centres, ellipsoids.axes, ellipsoids.semi_axes, camera.intrinsics
    check_tensor("centres", centres, (None, None, 3), dtypes=_DTYPES)
    batch, count = centres.shape[:2]
    like = ("centres", centres)
    check_tensor("axes", axes, (batch, count, 3, 3), dtypes=_DTYPES, like=like)
    check_tensor("semi_axes", semi_axes, (batch, count, 3), dtypes=_DTYPES, like=like)
    check_tensor("camera", intrinsics, (batch, 4), dtypes=_DTYPES)
    if intrinsics.device != centres.device:
        raise ValueError(f"camera: on {intrinsics.device}; expected {centres.device}, as centres")
    if len(image_size) != 2 or not all(isinstance(size, int) and size > 0 for size in image_size):
        raise ValueError(f"image_size: {image_size}; expected two positive integers (H, W)")
    if batch * image_size[0] * image_size[1] >= 2**31:
        raise ValueError(
            f"image_size: {batch} pictures of {image_size}; expected fewer than 2**31 pixels, split the batch"
        )
    if not 1 <= count <= MAX_PARTS:
        raise ValueError(f"centres: {count} ellipsoids a body; expected 1 to {MAX_PARTS}")
    table = list(range(1, count + 1)) if part_labels is None else [int(label) for label in part_labels]
    if len(table) != count or not all(1 <= label <= 255 for label in table):
        raise ValueError(f"part_labels: {table}; expected {count} labels from 1 to {MAX_LABEL}, or 255")
    if validate:
        for name, tensor in (("centres", centres), ("axes", axes), ("semi_axes", semi_axes), ("camera", intrinsics)):
            check_finite(name, tensor)
        if not (semi_axes > 0).all():
            raise ValueError(f"semi_axes: {float(semi_axes.min())}; expected positive lengths")
    if near is None:
        near = DEFAULT_NEAR if camera.perspective else -math.inf
    num_labels = max((label for label in table if label <= MAX_LABEL), default=0)
    view = _View(image_size[0], image_size[1], float(near), camera.perspective, num_labels)
    tensors = (centres.float(), axes.float(), semi_axes.float(), intrinsics.float())
    return tensors, _label_table(tuple(table), centres.device), view


@lru_cache(maxsize=64)
def _label_table(labels: tuple[int, ...], device: torch.device) -> torch.Tensor:
    """On the device once: a copy from the host in every call would wait for it."""
    return torch.tensor(labels, dtype=torch.uint8, device=device)


def _wp(tensor: torch.Tensor, kind: Any) -> wp.array:
    return wp.from_torch(tensor.detach().contiguous(), dtype=kind, requires_grad=False)


def _arrays(tensors: Sequence[torch.Tensor]) -> list[wp.array]:
    return [_wp(tensor, kind) for tensor, kind in zip(tensors, (wp.vec3, wp.mat33, wp.vec3, wp.vec4), strict=True)]


def _draw(
    tensors: Sequence[torch.Tensor],
    part_labels: torch.Tensor,
    view: _View,
    target: LabelTarget | None = None,
) -> _Picture:
    """The picture, and its loss where there is a target."""
    device = part_labels.device
    batch, count = tensors[0].shape[:2]
    shape = (batch, view.height, view.width)
    parts = torch.empty(shape, dtype=torch.uint8, device=device)
    labels = torch.empty(shape, dtype=torch.uint8, device=device)
    depth = torch.empty(shape, device=device)
    loss = torch.empty(batch, device=device)
    with on_torch_stream(device) as where:
        seen = Seen.empty(batch, count, where)
        arrays, table = _arrays(tensors), _wp(part_labels, wp.uint8)
        sums = ellipsoid_picture.num_partial_losses(table.device, batch, view.height, view.width)
        losses = torch.empty((batch, sums) if target is not None else (0, 0), device=device)
        outputs = {
            "nearest": wp.empty(shape if device.type == "cpu" else (0, 0, 0), dtype=float, device=where),
            "parts": _wp(parts, wp.uint8),
            "labels": _wp(labels, wp.uint8),
            "depth": _wp(depth, wp.float32),
            "losses": _wp(losses, wp.float32),
        }
        totals = _wp(loss, wp.float32)

        def launch(part: slice) -> None:
            cut = {name: _cut(array, part) for name, array in outputs.items()}
            seen_here = seen.cut(part)
            posed = [_cut(array, part) for array in arrays]
            launch_see(posed, table, near=view.near, perspective=view.perspective, seen=seen_here)
            compared = LabelTarget() if target is None else _cut_target(target, part)
            ellipsoid_picture.launch_draw(seen_here.silhouettes, perspective=view.perspective, target=compared, **cut)
            if target is not None:
                surface_forces.launch_sum_rows(cut["losses"], _cut(totals, part))

        if batch:  # Warp cuts nothing out of an empty array
            launch_in_slices(
                launch, batch, table.device, modules=(kernel_ellipsoids, ellipsoid_picture, surface_forces)
            )
    return _Picture(seen, parts, labels, depth, loss)


def _gradients(
    tensors: Sequence[torch.Tensor], picture: _Picture, view: _View, options: _Options, gradient: Any
) -> tuple[torch.Tensor, ...]:
    """With respect to centres, axes, semi-axes and camera."""
    device = picture.parts.device
    batch, count = tensors[0].shape[:2]
    force = torch.empty(batch, count, 3, device=device)
    moment = torch.empty(batch, count, 3, 3, device=device)
    camera_force = torch.empty(batch, count, 4, device=device)
    grads = tuple(torch.empty_like(tensor, memory_format=torch.contiguous_format) for tensor in tensors)
    with on_torch_stream(device) as where:
        arrays = _arrays(tensors)
        sums = {
            "force": _wp(force, wp.vec3),
            "moment": _wp(moment, wp.mat33),
            "camera_force": _wp(camera_force, wp.vec4),
        }
        parts = _wp(picture.parts, wp.uint8)
        names = ("grad_centres", "grad_axes", "grad_semi_axes", "grad_camera")
        outputs = dict(zip(names, _arrays(grads), strict=True))

        def launch(part: slice) -> None:
            posed = [_cut(array, part) for array in arrays]
            here = {name: _cut(array, part) for name, array in sums.items()}
            wanted = _cut_target(gradient, part)
            if options.gradient == "coverage":
                ellipsoid_coverage.launch_coverage_forces(
                    posed,
                    picture.seen.cut(part),
                    _cut(parts, part),
                    steps_per_pixel=options.steps_per_pixel,
                    halvings=options.halvings,
                    perspective=view.perspective,
                    gradient=wanted,
                    **here,
                )
            else:
                ellipsoid_partdr.launch_partdr_forces(
                    posed,
                    picture.seen.cut(part),
                    _cut(parts, part),
                    over_farther=options.over_farther,
                    max_distance=options.max_distance,
                    depth_weight=options.depth_weight,
                    perspective=view.perspective,
                    gradient=wanted,
                    **here,
                )
            cut = {name: _cut(array, part) for name, array in outputs.items()}
            surface_forces.launch_spread(posed[1], posed[2], *here.values(), **cut)

        estimator = ellipsoid_coverage if options.gradient == "coverage" else ellipsoid_partdr
        if batch:
            launch_in_slices(launch, batch, wp.get_device(where), modules=(estimator, surface_forces))
    return grads


def _cut(array: wp.array, part: slice) -> wp.array:
    """Some bodies' share of an array; all of it without a view, which would cost 15 us, and nothing of an empty one."""
    return array if part.stop - part.start == array.shape[0] or not array.size else array[part]


def _cut_target(gradient: Any, part: slice) -> Any:  # LabelTarget or DenseGradient, which Warp makes classes of its own
    """The target of some bodies; one for all stays."""
    if hasattr(gradient, "maps"):
        dense = DenseGradient()
        dense.maps = gradient.maps[part]
        return dense
    if gradient.target.shape[0] == 1:
        return gradient
    target = LabelTarget()
    target.target, target.label_weights = gradient.target[part], gradient.label_weights
    target.reach = _cut(gradient.reach, part)
    return target


def _label_target(target: torch.Tensor, weights: torch.Tensor, num_labels: int, needs_reach: bool) -> LabelTarget:
    with on_torch_stream(target.device) as device:
        made = LabelTarget()
        made.target = _wp(target, wp.uint8)
        made.label_weights = _wp(weights, wp.float32)
        shape = (target.shape[0], 2, num_labels + 1, max(target.shape[1:])) if needs_reach else (0, 0, 0, 0)
        made.reach = wp.empty(shape, dtype=wp.vec2i, device=device)
        if needs_reach:
            launch_find_reach(made.target, made.reach)
    return made


class _LabelLoss(torch.autograd.Function):
    """The gradient is made in the forward pass, where all it needs is at hand, and scaled in the backward pass."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[torch.Tensor, ...]:
        *tensors, table, target, weights, view, options = inputs
        label_target = _label_target(target, weights, view.num_labels, options.gradient == "partdr")
        picture = _draw(tensors, table, view, label_target)
        if any(ctx.needs_input_grad):
            ctx.save_for_backward(*_gradients(tensors, picture, view, options, label_target))
        ctx.mark_non_differentiable(picture.labels, picture.depth, picture.parts)
        ctx.set_materialize_grads(False)
        return picture.loss, picture.labels, picture.depth, picture.parts

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor | None) -> Any:
        grads: tuple[torch.Tensor | None, ...] = (None,) * 4
        if gradients[0] is not None:
            grads = tuple(gradients[0].view(-1, *[1] * (saved.dim() - 1)) * saved for saved in ctx.saved_tensors)
        return *grads, None, None, None, None, None


class _Maps(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[torch.Tensor, ...]:
        *tensors, table, view, options, num_maps = inputs
        picture = _draw(tensors, table, view)
        index = torch.arange(1, num_maps + 1, dtype=torch.uint8, device=table.device)
        maps = (picture.labels[:, None] == index[:, None, None]).float()
        ctx.save_for_backward(*tensors)
        ctx.picture, ctx.view, ctx.options = picture, view, options
        ctx.mark_non_differentiable(picture.labels, picture.depth, picture.parts)
        ctx.set_materialize_grads(False)
        return picture.labels, picture.depth, picture.parts, maps

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor | None) -> Any:
        grads: tuple[torch.Tensor | None, ...] = (None,) * 4
        if gradients[3] is not None:
            dense = DenseGradient()
            dense.maps = _wp(gradients[3].float(), wp.float32)
            grads = _gradients(ctx.saved_tensors, ctx.picture, ctx.view, ctx.options, dense)
        return *grads, None, None, None, None
