"""Exact ellipsoids on torch tensors: label images in closed form, without triangles, and three gradients of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ..body.posing import Posed
from ..cameras import Camera, check_camera
from ..errors import check_type, check_whole
from ..interop.checks import FLOATS, check_image_size, check_numbers, check_tensor
from ..interop.derivatives import refuse_transforms
from ..interop.device_cache import device_cache
from ..interop.layouts import Tensors, as_floats
from ..interop.movable import Movable
from . import compiled as compiled  # registers the operations for torch.compile
from .ellipsoid_passes import EllipsoidPasses, ellipsoid_passes
from .options import DEFAULT_DEPTH_WEIGHT, GRADIENTS, Gradient, check_partdr_options, check_target
from .part_mesh import MAX_LABEL
from .pictures import DrawnLater, Size, draw_picture, find_loss

MAX_PARTS = 255  # parts are counted in one byte, 0 = background
MAX_SAMPLES = 64  # a pixel; the work on creases grows with their square


@dataclass(frozen=True)
class EllipsoidImage(DrawnLater):
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


@dataclass(frozen=True)
class Ellipsoids(Movable):
    """B times P ellipsoids in the camera frame; ``Posed`` has the same fields and serves as well.

    Attributes:
        centres: Centres [m], shape (B, P, 3).
        axes: Orthonormal axes as columns, shape (B, P, 3, 3): rotations, or reflections (determinant -1), which make
            the same ellipsoids.
        semi_axes: Semi-axes [m], shape (B, P, 3).

    Examples:
        >>> import torch
        >>> from warp_partdr import Ellipsoids, WeakPerspective, draw_ellipsoids
        >>> ball = Ellipsoids(torch.zeros(1, 1, 3), torch.eye(3)[None, None], torch.full((1, 1, 3), 0.25))
        >>> camera = WeakPerspective(torch.tensor([40.0]), torch.tensor([[16.0, 16.0]]))
        >>> int(draw_ellipsoids(ball, camera, (32, 32)).labels.sum())  # [px] of a disc whose radius is 10 px
        316
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
        ellipsoids: ``Posed`` or ``Ellipsoids``, with P ellipsoids for each body, at most 255. An ellipsoid that reaches
            the camera's near plane is not drawn.
        camera: Weak-perspective or perspective cameras, one for each body or one for all.
        image_size: Height and width (H, W) of the picture [px].
        part_labels: Label that each ellipsoid shows, 1 to 254, or 255: hides what is behind and shows nothing, or 0: is
            left out; P of them. 1 to P by default; ``LabelSet.part_groups[1:]`` draws groups.
        num_maps: Number of maps K. Maps of the labels 1 to K are made. If it is 0, none are made, and nothing has a
            gradient.
        gradient: Kind of gradient. "coverage" is the derivative of the area that labels cover, which sees borders
            alone. "edges" is the same from one crossing of a border between each two pixels that differ: it is fastest,
            and blind to what covers no pixel's centre. "partdr" is the paper's rule (eq. 10 to 12), with which far
            pixels pull.
        max_distance: Greatest distance from an edge for "partdr", as in ``draw_mesh`` [px].
        depth_weight: Weight of the z gradient for "partdr", as in ``draw_mesh``.
        samples_per_pixel: Density of samples for "coverage", at most 64: steps for each pixel along outlines and,
            rounded up, rows and columns for each pixel in the search for creases. Outlines get longer steps where they
            would take more than 2**22.
        validate: True looks for NaN, infinity, axes that are not orthonormal and lengths that are not positive. On
            CUDA, that waits for the device.

    Returns:
        The picture.

    Raises:
        ValueError: If a shape, size, dtype, label or number is wrong, or devices differ.
        NotImplementedError: Under ``torch.func``, and in a second derivative.

    Examples:
        >>> from warp_partdr import BodyParameters, draw_ellipsoids
        >>> body = BodyParameters.mean(1).leaves()
        >>> image = draw_ellipsoids(body.posed(), body.camera(128), (128, 128), num_maps=20)
        >>> image.labels.shape, image.maps.shape
        (torch.Size([1, 128, 128]), torch.Size([1, 20, 128, 128]))
        >>> image.maps[:, 7].sum().backward()  # the head's map: any loss of the maps has a gradient
        >>> body.lengths.grad.shape
        torch.Size([1, 12])
    """
    rule = check_rule(gradient, max_distance, depth_weight, samples_per_pixel)
    passes, inputs, size = _check("draw_ellipsoids", ellipsoids, camera, image_size, part_labels, rule, validate)
    return draw_picture(EllipsoidImage, passes, inputs, size, check_whole("num_maps", num_maps, 0, MAX_LABEL))


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
        ellipsoids: Ellipsoids as in ``draw_ellipsoids``, as is all that is not named here.
        camera: Cameras, one for each body or one for all.
        target: Target label of each pixel, shape (B, H, W) or (1, H, W) for all, uint8; 0 = background, 255 = ignore.
        part_labels: Label that each ellipsoid shows.
        gradient: Kind of gradient, "coverage", "edges" or "partdr".
        max_distance: Reach of a pixel [px].
        depth_weight: Lambda of the paper's z gradient.
        samples_per_pixel: Density of the borders' samples.
        validate: Option to check the numbers, as in ``draw_ellipsoids``.

    Returns:
        The loss of each body [pixels of maps], shape (B,), and the picture, which is drawn when it is first looked at.

    Raises:
        ValueError: If ``draw_ellipsoids`` raises it, or if ``target`` does not fit the batch.
        NotImplementedError: If ``draw_ellipsoids`` raises it.

    Examples:
        >>> import torch
        >>> from warp_partdr import BodyParameters, draw_ellipsoids, ellipsoid_label_loss
        >>> body = BodyParameters.mean(1)
        >>> target = draw_ellipsoids(body.posed(), body.camera(128), (128, 128)).labels.roll(3, dims=2)  # 3 px right
        >>> leaves = body.leaves()
        >>> loss, image = ellipsoid_label_loss(leaves.posed(), leaves.camera(128), target, gradient="partdr")
        >>> loss.sum().backward()
        >>> bool(leaves.shift.grad[0, 0] < 0)  # so a step of descent moves the body to the right
        True
    """
    refuse_transforms("ellipsoid_label_loss", target)
    rule = check_rule(gradient, max_distance, depth_weight, samples_per_pixel)
    check_tensor("target", target, (None, None, None), dtypes=(torch.uint8,))
    size = target.shape[1:]
    passes, inputs, _ = _check("ellipsoid_label_loss", ellipsoids, camera, size, part_labels, rule, validate)
    check_target(target, ("centres", inputs[0]), inputs[0].shape[0])
    return find_loss(EllipsoidImage, passes, inputs, target)


_Rule = tuple[Gradient, float, float, float]  # gradient, max_distance, depth_weight, samples_per_pixel


@device_cache(64)
def check_rule(gradient: Gradient, max_distance: float, depth_weight: float, samples_per_pixel: float) -> _Rule:
    """Options of the gradient, checked, for ``ellipsoid_passes``."""
    if gradient not in GRADIENTS:
        raise ValueError(f"gradient: {gradient!r}; expected one of {', '.join(GRADIENTS)}")
    check_partdr_options(max_distance, depth_weight)
    if not 0 < samples_per_pixel <= MAX_SAMPLES:
        raise ValueError(f"samples_per_pixel: {samples_per_pixel}; expected a positive number up to {MAX_SAMPLES}")
    return gradient, float(max_distance), float(depth_weight), float(samples_per_pixel)


def _check(
    name: str,
    ellipsoids: Ellipsoids | Posed,
    camera: Camera,
    image_size: tuple[int, ...],
    part_labels: Sequence[int] | None,
    rule: _Rule,
    validate: bool,
) -> tuple[EllipsoidPasses, Tensors, Size]:
    """Check the arguments that both entry points share; ``name`` is the one called."""
    check_type("ellipsoids", ellipsoids, Ellipsoids | Posed, "such as those of pose")
    centres, axes, semi_axes = ellipsoids.centres, ellipsoids.axes, ellipsoids.semi_axes
    refuse_transforms(name, centres, axes, semi_axes)
    check_tensor("centres", centres, (None, None, 3), dtypes=FLOATS)
    batch, count = centres.shape[:2]
    like = ("centres", centres)
    check_tensor("axes", axes, (batch, count, 3, 3), dtypes=FLOATS, like=like)
    check_tensor("semi_axes", semi_axes, (batch, count, 3), dtypes=FLOATS, like=like)
    intrinsics = check_camera(camera, batch, like)
    if intrinsics.shape[0] != batch:
        intrinsics = intrinsics.expand(batch, 4)
    refuse_transforms(name, intrinsics)
    size = check_image_size(image_size, batch)
    if not 1 <= count <= MAX_PARTS:
        raise ValueError(f"centres: {count} ellipsoids a body; expected 1 to {MAX_PARTS}")
    labels = check_part_labels(None if part_labels is None else tuple(part_labels), count)
    if validate and not torch.compiler.is_compiling():
        numbers = {"centres": centres, "axes": axes, "semi_axes": semi_axes, "camera": intrinsics}
        check_numbers(numbers, frames=("axes",), positive=("semi_axes",))
    passes = ellipsoid_passes(labels, camera.perspective, rule[0], camera.near_plane, *rule[1:])
    return passes, as_floats(centres, axes, semi_axes, intrinsics), size


def check_part_labels(given: tuple[int, ...] | None, count: int) -> tuple[int, ...]:
    """Label of each of ``count`` ellipsoids, checked; 1, 2, ... by default."""
    if given is None:
        return tuple(range(1, count + 1))
    plain = all(type(label) is int and 0 <= label <= 255 for label in given)
    labels = given if plain else tuple(check_whole("part_labels", label, 0, 255) for label in given)
    if len(labels) != count:
        raise ValueError(f"part_labels: {len(labels)} of them; expected {count}, as ellipsoids")
    return labels
