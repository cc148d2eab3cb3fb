"""Exact ellipsoids on torch tensors: label images in closed form, without triangles, and three gradients of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, get_args

import torch

from ..body.posing import Posed
from ..cameras import Camera, check_camera
from ..errors import check_type, check_whole
from ..interop.checks import FLOATS, check_image_size, check_numbers, check_tensor
from ..interop.derivatives import once, refuse_transforms
from ..interop.later import DrawnLater
from ..interop.loss_graph import Shapes, find_label_loss, split_rows
from ..interop.movable import Movable
from .ellipsoid_ops import ellipsoid_numbers
from .ellipsoid_passes import EllipsoidOptions, View, dense_gradient, draw, ellipsoid_recipe, gradients
from .options import (
    DEFAULT_DEPTH_WEIGHT,
    Gradient,
    cached,
    check_partdr_options,
    check_target,
    label_maps,
)
from .part_mesh import MAX_LABEL

MAX_PARTS = 255  # parts are counted in one byte, 0 = background
MAX_SAMPLES = 64  # a pixel; the work on creases grows with their square


@dataclass(frozen=True)
class EllipsoidImage:
    """Picture of B bodies of ellipsoids.

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


class _LaterImage(DrawnLater, EllipsoidImage):
    pass


@dataclass(frozen=True)
class Ellipsoids(Movable):
    """B times P ellipsoids in the camera frame; ``Posed`` has the same fields and serves as well.

    Attributes:
        centres: Shape (B, P, 3) [m].
        axes: Orthonormal axes as columns, shape (B, P, 3, 3): rotations, or reflections (determinant -1), which make
            the same ellipsoids.
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
    max_distance: float = math.inf,
    depth_weight: float = DEFAULT_DEPTH_WEIGHT,
    samples_per_pixel: float = 1.0,
    validate: bool = True,
) -> EllipsoidImage:
    """Draw ellipsoids in closed form; with ``num_maps`` the label maps carry gradients back.

    Gradients are first ones: a second, as under ``create_graph=True``, is an error, and so is ``torch.func``.

    Args:
        ellipsoids: P of them a body, at most 255; ``Posed`` or ``Ellipsoids``. One that reaches the camera's near plane
            is not drawn.
        camera: Weak perspective or perspective, one a body or one for all.
        image_size: (H, W) [px].
        part_labels: Label that each ellipsoid shows, 1 to 254, or 255: hides what is behind and shows nothing, or 0: is
            left out; P of them. 1 to P by default; ``LabelSet.part_groups[1:]`` draws groups.
        num_maps: K; maps of labels 1 to K are made. 0 makes none, and nothing has a gradient.
        gradient: "coverage", the derivative of the area that labels cover, which sees borders alone; "edges", the same
            from one crossing of a border between each two pixels that differ: fastest, and blind to what covers no
            pixel's centre; or "partdr", the paper's rule (eq. 10 to 12), with which far pixels pull.
        max_distance: "partdr": as in ``draw_mesh`` [px].
        depth_weight: "partdr": as in ``draw_mesh``.
        samples_per_pixel: "coverage": steps a pixel along outlines and, rounded up, rows and columns a pixel in the
            search for creases; at most 64. Outlines get longer steps where they would take more than 2**22.
        validate: Look for NaN, infinity, axes that are not orthonormal and lengths that are not positive; on CUDA that
            waits for the device.

    Returns:
        The picture.

    Raises:
        ValueError: If a shape, size, dtype, label or number is wrong, or devices differ.
        NotImplementedError: Under ``torch.func``, and in a second derivative.
    """
    options = _options(gradient, max_distance, depth_weight, samples_per_pixel)
    tensors, view = _check("draw_ellipsoids", ellipsoids, camera, image_size, part_labels, validate)
    num_maps = check_whole("num_maps", num_maps, 0, MAX_LABEL)
    if torch.compiler.is_compiling():
        return _draw_compiled(tensors, view, options, num_maps)
    if num_maps == 0:
        with torch.no_grad():
            picture = draw(tensors, view)
        return EllipsoidImage(picture.labels, picture.depth, picture.parts)
    return EllipsoidImage(*_Maps.apply(*tensors, view, options, num_maps))


def ellipsoid_label_loss(
    ellipsoids: Ellipsoids | Posed,
    camera: Camera,
    target: torch.Tensor,
    *,
    part_labels: Sequence[int] | None = None,
    gradient: Gradient = "coverage",
    max_distance: float = math.inf,
    depth_weight: float = DEFAULT_DEPTH_WEIGHT,
    samples_per_pixel: float = 1.0,
    validate: bool = True,
) -> tuple[torch.Tensor, EllipsoidImage]:
    """L_seg (paper, eq. 6) against a label image and its gradient, in one go and without float maps.

    It is a first one: a second, as under ``create_graph=True``, is an error, and so is ``torch.func``.

    Args:
        ellipsoids: As in ``draw_ellipsoids``, like all that is not named here.
        camera: One a body, or one for all.
        target: Target label of each pixel, shape (B, H, W) or (1, H, W) for all, uint8; 0 = background, 255 = ignore.
        part_labels: Label that each ellipsoid shows.
        gradient: "coverage", "edges" or "partdr".
        max_distance: Reach of a pixel [px].
        depth_weight: The paper's lambda of the z gradient.
        samples_per_pixel: Density of the borders' samples.
        validate: As in ``draw_ellipsoids``.

    Returns:
        The loss of each body [pixels of maps], shape (B,), and the picture, which is drawn when it is first looked at.

    Raises:
        ValueError: As ``draw_ellipsoids``, or if ``target`` does not fit the batch.
        NotImplementedError: As ``draw_ellipsoids``.
    """
    refuse_transforms("ellipsoid_label_loss", target)
    options = _options(gradient, max_distance, depth_weight, samples_per_pixel)
    check_tensor("target", target, (None, None, None), dtypes=(torch.uint8,))
    size = tuple(target.shape[1:])
    tensors, view = _check("ellipsoid_label_loss", ellipsoids, camera, size, part_labels, validate)
    check_target(target, ("centres", tensors[0]), tensors[0].shape[0])
    if torch.compiler.is_compiling():
        needs_grad = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)
        given = (*tensors, target.contiguous(), needs_grad, *ellipsoid_numbers(view, options))
        loss, _ = torch.ops.warp_partdr.ellipsoid_label_loss(*given)
        return loss, _draw_compiled(tensors, view, options, 0)
    loss, rows = find_label_loss(ellipsoid_recipe(view, options), tensors, target)
    return loss, _LaterImage(partial(_draw_rows, rows, tuple([tensor.shape for tensor in tensors]), view))


def _draw_rows(rows: torch.Tensor, shapes: Shapes, view: View) -> dict[str, torch.Tensor]:
    """Draw the picture of a loss, from its copy of the ellipsoids."""
    with torch.no_grad():
        picture = draw(split_rows(rows[0], shapes), view)
    return {"labels": picture.labels, "depth": picture.depth, "parts": picture.parts}


_Tensors = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]


@cached
def _options(
    gradient: Gradient, max_distance: float, depth_weight: float, samples_per_pixel: float
) -> EllipsoidOptions:
    if gradient not in get_args(Gradient):
        raise ValueError(f"gradient: {gradient!r}; expected one of {', '.join(get_args(Gradient))}")
    check_partdr_options(max_distance, depth_weight)
    if not 0 < samples_per_pixel <= MAX_SAMPLES:
        raise ValueError(f"samples_per_pixel: {samples_per_pixel}; expected a positive number up to {MAX_SAMPLES}")
    return EllipsoidOptions(gradient, float(max_distance), float(depth_weight), float(samples_per_pixel))


def _check(
    name: str,
    ellipsoids: Ellipsoids | Posed,
    camera: Camera,
    image_size: tuple[int, ...],
    part_labels: Sequence[int] | None,
    validate: bool,
) -> tuple[_Tensors, View]:
    """Check the arguments that both entry points share; ``name`` is the one called."""
    check_type("ellipsoids", ellipsoids, Ellipsoids | Posed, "such as those of pose")
    centres, axes, semi_axes = ellipsoids.centres, ellipsoids.axes, ellipsoids.semi_axes
    refuse_transforms(name, centres, axes, semi_axes)
    check_tensor("centres", centres, (None, None, 3), dtypes=FLOATS)
    batch, count = centres.shape[:2]
    like = ("centres", centres)
    check_tensor("axes", axes, (batch, count, 3, 3), dtypes=FLOATS, like=like)
    check_tensor("semi_axes", semi_axes, (batch, count, 3), dtypes=FLOATS, like=like)
    intrinsics = check_camera(camera, batch, like).expand(batch, 4)
    refuse_transforms(name, intrinsics)
    height, width = check_image_size(image_size, batch)
    if not 1 <= count <= MAX_PARTS:
        raise ValueError(f"centres: {count} ellipsoids a body; expected 1 to {MAX_PARTS}")
    labels = _part_labels(None if part_labels is None else tuple(part_labels), count)
    if validate and not torch.compiler.is_compiling():
        numbers = {"centres": centres, "axes": axes, "semi_axes": semi_axes, "camera": intrinsics}
        check_numbers(numbers, frames=("axes",), positive=("semi_axes",))
    view = _view(height, width, camera.near_plane, camera.perspective, labels)
    tensors = (centres.float(), axes.float(), semi_axes.float(), intrinsics.float())
    return tensors, view


def _draw_compiled(tensors: _Tensors, view: View, options: EllipsoidOptions, num_maps: int) -> EllipsoidImage:
    """Draw by an operation that ``torch.compile`` removes where the picture is not used."""
    given = tensors if num_maps else [tensor.detach() for tensor in tensors]
    shape = [num_maps, view.height, view.width]
    maps, labels, depth, parts = torch.ops.warp_partdr.ellipsoid_maps(*given, shape, *ellipsoid_numbers(view, options))
    return EllipsoidImage(labels, depth, parts, maps if num_maps else None)


_view = cached(View)


def _part_labels(given: tuple[int, ...] | None, count: int) -> tuple[int, ...]:
    if given is None:
        return tuple(range(1, count + 1))
    labels = tuple(check_whole("part_labels", label, 0, 255) for label in given)
    if len(labels) != count:
        raise ValueError(f"part_labels: {len(labels)} of them; expected {count}, as ellipsoids")
    return labels


class _Maps(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[torch.Tensor, ...]:
        *tensors, view, options, num_maps = inputs
        picture = draw(tensors, view)
        maps = label_maps(picture.labels, num_maps)
        ctx.save_for_backward(*tensors)
        ctx.picture, ctx.view, ctx.options = picture, view, options
        ctx.mark_non_differentiable(picture.labels, picture.depth, picture.parts)
        ctx.set_materialize_grads(False)
        return picture.labels, picture.depth, picture.parts, maps

    @staticmethod
    def backward(ctx: Any, *incoming: torch.Tensor | None) -> Any:
        grads: tuple[torch.Tensor | None, ...] = (None,) * 4
        if incoming[3] is not None:
            of_maps = dense_gradient(incoming[3])
            found = gradients(ctx.saved_tensors, ctx.picture, ctx.view, ctx.options, of_maps)
            grads = once("draw_ellipsoids", found, incoming[3], *ctx.saved_tensors)
        return *grads, None, None, None
