"""PartDR on torch tensors: part images of a mesh and their approximate gradients (paper, section 3.2).

Eager code takes a ``torch.autograd.Function``; under ``torch.compile`` the same work is a registered custom op.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import chain
from typing import Any, Literal

import torch
import warp as wp

from ..errors import check_type, check_whole
from ..interop.checks import FLOATS, check_finite, check_image_size, check_near, check_tensor, contiguous
from ..interop.derivatives import once, raise_second_derivative, refuse_transforms
from ..interop.later import DrawnLater
from ..interop.loss_graph import Buffers, find_label_loss
from ..interop.streams import on_torch_stream
from ..kernels.launch import launch_in_slices
from ..kernels.mesh import map_gradient, push_xy, push_z, rasterize
from ..kernels.side_stream import launch_side_by_side
from .part_mesh import MAX_LABEL, Edges, PartMesh

Occlusion = Literal["depth", "paper"]

IGNORE_LABEL = 255  # a target pixel that neither attracts nor repels
DEFAULT_NEAR = 0.01  # [m], perspective cameras: nearer faces are not drawn
DEFAULT_DEPTH_WEIGHT = 1.0  # the paper's lambda in eq. 12, which it does not name


@dataclass(frozen=True)
class PartImage:
    """What a mesh looks like.

    Attributes:
        labels: Part at each pixel, 0 = background, shape (B, H, W), uint8.
        depth: Depth of the nearest face [m], inf = background, shape (B, H, W), float32.
        face_index: Nearest face, -1 = background (paper, eq. 8), shape (B, H, W), int32.
        maps: Part maps A^1 to A^K (paper, eq. 9), differentiable, shape (B, K, H, W); None unless asked for.
    """

    labels: torch.Tensor
    depth: torch.Tensor
    face_index: torch.Tensor
    maps: torch.Tensor | None = None


class _LaterImage(DrawnLater, PartImage):
    pass


def rasterize_parts(
    vertices: torch.Tensor,
    mesh: PartMesh,
    image_size: tuple[int, int],
    *,
    perspective: bool = False,
    near: float | None = None,
    num_maps: int = 0,
    edges: Edges = "silhouette",
    occlusion: Occlusion = "depth",
    max_distance: float = math.inf,
    depth_weight: float = DEFAULT_DEPTH_WEIGHT,
    validate: bool = True,
) -> PartImage:
    """Draw a part-labelled mesh; with ``num_maps`` the part maps carry gradients back to the vertices.

    Gradients are first ones: a second, as under ``create_graph=True``, is an error, and so is ``torch.func``.

    Args:
        vertices: Projected vertices (u [px], v [px], z [m]), shape (B, V, 3); a camera's ``project`` gives them.
        mesh: Topology and labels, on the same device.
        image_size: (H, W) [px]; need not be square.
        perspective: Whether the vertices come from a perspective camera: depth is then linear in 1/z.
        near: Faces with a vertex at or before this depth [m] are not drawn; default 0.01 for perspective, none for
            weak perspective.
        num_maps: K; part maps of labels 1 to K are made. 0 makes none, and nothing has a gradient.
        edges: Which edges the x, y gradient moves: "silhouette", or "all" as the Neural Mesh Renderer does.
        occlusion: Whether an edge is pulled over pixels that show another part: "depth", where that part lies farther
            away than the edge, which then covers it; "paper", never (eq. 11).
        max_distance: Pixels farther than this from an edge do not move it [px]. The paper has no limit, which finds far
            targets; near the target a few pixels come closer to the true derivative of the covered area.
        depth_weight: The paper's lambda of the z gradient (eq. 12); 0 leaves z without one.
        validate: Look for NaN and infinity; on CUDA that waits for the device.

    Returns:
        The picture. The gradient of the maps is PartDR's estimate: linear in the incoming gradient, not the
        derivative of the step function.

    Raises:
        ValueError: If a shape, size, dtype or option is wrong, devices differ, or ``vertices`` holds NaN or infinity.
        NotImplementedError: Under ``torch.func``, and in a second derivative.
    """
    refuse_transforms("rasterize_parts", vertices)
    check_gradient_options(occlusion, max_distance, depth_weight)
    near, height, width = _check(vertices, mesh, image_size, perspective, near, edges, validate)
    num_maps = check_whole("num_maps", num_maps, 0, MAX_LABEL)
    compiling = torch.compiler.is_compiling()
    if num_maps == 0 and not compiling:
        with torch.no_grad():
            labels, depth, face_index = _rasterize(
                vertices.float(), mesh.faces, mesh.face_labels, height, width, near, perspective
            )
        return PartImage(labels, depth, face_index)
    walked = mesh.walked_edges(edges)
    options = (
        num_maps,
        height,
        width,
        near,
        perspective,
        edges == "all",
        occlusion == "depth",
        float(max_distance),
        float(depth_weight),
    )
    function = torch.ops.warp_partdr.part_maps if compiling else _PartMaps.apply
    given = (vertices.float() if num_maps else vertices.detach().float(), mesh.faces, mesh.face_labels, walked)
    maps, labels, depth, face_index = function(*given, *options)
    return PartImage(labels, depth, face_index, maps if num_maps else None)


def label_loss(
    vertices: torch.Tensor,
    mesh: PartMesh,
    target: torch.Tensor,
    *,
    label_weights: torch.Tensor | None = None,
    perspective: bool = False,
    near: float | None = None,
    edges: Edges = "silhouette",
    occlusion: Occlusion = "depth",
    max_distance: float = math.inf,
    depth_weight: float = DEFAULT_DEPTH_WEIGHT,
    validate: bool = True,
) -> tuple[torch.Tensor, PartImage]:
    """L_seg (paper, eq. 6) against a label image, and its gradient, without making part maps.

    It is a first one: a second, as under ``create_graph=True``, is an error, and so is ``torch.func``.

    Args:
        vertices: Projected vertices (u [px], v [px], z [m]), shape (B, V, 3).
        mesh: Topology and labels, on the same device.
        target: Wanted label of each pixel, shape (B, H, W), uint8; 0 = background, 255 = ignore.
        label_weights: Weight of each label's map, shape (L,), label 0 first and without meaning; 1 by default.
        perspective: As in ``rasterize_parts``, like all that follow.
        near: Near plane [m].
        edges: "silhouette" or "all".
        occlusion: "depth" or "paper".
        max_distance: Pixels farther than this from an edge do not move it [px].
        depth_weight: The paper's lambda of the z gradient.
        validate: Look for NaN and infinity.

    Returns:
        The loss of each body [pixels of maps], shape (B,), and the picture, which is drawn when it is first looked at.

    Raises:
        ValueError: As ``rasterize_parts``, or if ``target`` does not fit the batch.
        NotImplementedError: As ``rasterize_parts``.
    """
    refuse_transforms("label_loss", vertices, target, label_weights)
    check_tensor("vertices", vertices, (None, None, 3), dtypes=FLOATS)
    check_tensor("target", target, (vertices.shape[0], None, None), dtypes=(torch.uint8,), like=("vertices", vertices))
    check_gradient_options(occlusion, max_distance, depth_weight)
    near, _, _ = _check(vertices, mesh, tuple(target.shape[1:]), perspective, near, edges, validate)
    weights = weight_table(label_weights, vertices.device, validate)
    if validate and not torch.compiler.is_compiling():
        strange = (target > mesh.num_labels) & (target != IGNORE_LABEL)
        if strange.any():
            label = int(target[strange][0])
            raise ValueError(f"target: label {label}; expected 0 to {mesh.num_labels}, or {IGNORE_LABEL} = ignore")
    walked = mesh.walked_edges(edges)
    options = (
        mesh.num_labels,
        near,
        perspective,
        edges == "all",
        occlusion == "depth",
        float(max_distance),
        float(depth_weight),
    )
    if torch.compiler.is_compiling():
        loss, labels, depth, face_index, _ = torch.ops.warp_partdr.label_loss(
            vertices.float(), mesh.faces, mesh.face_labels, walked, target.contiguous(), weights, *options
        )
        return loss, PartImage(labels, depth, face_index)
    recipe = _recipe(mesh.faces, mesh.face_labels, walked, options)
    loss, rows = find_label_loss(recipe, (vertices,), target, weights)
    return loss, _LaterImage(partial(_draw_rows, rows, vertices.shape, mesh, target.shape, near, perspective))


def _draw_rows(
    rows: torch.Tensor, shape: torch.Size, mesh: PartMesh, size: torch.Size, near: float, perspective: bool
) -> dict[str, torch.Tensor]:
    """The picture that a loss was found for, from its copy of the vertices."""
    with torch.no_grad():
        vertices, (_, height, width) = rows[0].view(shape), size
        labels, depth, face_index = _rasterize(vertices, mesh.faces, mesh.face_labels, height, width, near, perspective)
    return {"labels": labels, "depth": depth, "face_index": face_index}


def check_gradient_options(occlusion: str, max_distance: float, depth_weight: float) -> None:
    """Raise ValueError unless PartDR's rule can take these, for a mesh or for ellipsoids."""
    if occlusion not in ("depth", "paper"):
        raise ValueError(f"occlusion: {occlusion!r}; expected 'depth' or 'paper'")
    if not max_distance >= 0:
        raise ValueError(f"max_distance: {max_distance}; expected a number of pixels from 0, or infinity")
    if not 0 <= depth_weight < math.inf:
        raise ValueError(f"depth_weight: {depth_weight}; expected a finite number from 0")


def weight_table(label_weights: torch.Tensor | None, device: torch.device, validate: bool = False) -> torch.Tensor:
    """Weight of every byte that a label may be, shape (256,): 1 where none is given, 0 for background and ignored.

    Not to be written to: even weights are the same tensor in every call.

    Raises:
        ValueError: If ``label_weights`` is no vector of at most 256 numbers, or ``validate`` and one is not finite.
    """
    if label_weights is None:
        return _even_weights(device) if torch.compiler.is_compiling() else _kept_even_weights(device)
    check_tensor("label_weights", label_weights, (None,), dtypes=FLOATS)
    if label_weights.shape[0] > 256:
        raise ValueError(f"label_weights: {label_weights.shape[0]} of them; expected at most 256")
    if validate and not torch.compiler.is_compiling():
        check_finite(label_weights=label_weights)
    weights = _even_weights(device)
    weights[1 : label_weights.shape[0]] = label_weights[1:].to(weights)
    weights[IGNORE_LABEL] = 0.0
    return weights


def _even_weights(device: torch.device) -> torch.Tensor:
    weights = torch.ones(256, device=device)
    weights[0] = weights[IGNORE_LABEL] = 0.0  # neither has a map
    return weights


@lru_cache(maxsize=16)
def _kept_even_weights(device: torch.device) -> torch.Tensor:
    with torch.inference_mode(False):  # or autograd might refuse it later
        return _even_weights(device)


def _check(
    vertices: torch.Tensor,
    mesh: PartMesh,
    image_size: tuple[int, ...],
    perspective: bool,
    near: float | None,
    edges: str,
    validate: bool,
) -> tuple[float, int, int]:
    """Check what both entry points share; returns the near plane and the picture's height and width."""
    check_tensor("vertices", vertices, (None, None, 3), dtypes=FLOATS)
    check_type("mesh", mesh, PartMesh, "such as ellipbody_mesh()")
    if mesh.faces.device != vertices.device:
        raise ValueError(f"mesh: on {mesh.faces.device}; expected {vertices.device}, as vertices; use mesh.to(device)")
    height, width = check_image_size(image_size, vertices.shape[0])
    if edges not in ("silhouette", "all"):
        raise ValueError(f"edges: {edges!r}; expected 'silhouette' or 'all'")
    if validate and not torch.compiler.is_compiling():
        check_finite(vertices=vertices)
    if mesh.num_vertices > vertices.shape[1]:
        raise ValueError(f"vertices: {vertices.shape[1]} a body; expected {mesh.num_vertices} or more, as the mesh")
    return check_near(near, perspective, DEFAULT_NEAR), height, width


def _wp(tensor: torch.Tensor, kind: Any) -> wp.array:
    return wp.from_torch(contiguous(tensor.detach()), dtype=kind, requires_grad=False)


def _launch(work: Callable[[slice], None], like: torch.Tensor) -> None:
    """Let ``work`` launch its kernels on the tensor's device and stream, for all of the batch."""
    with on_torch_stream(like.device) as device:
        launch_in_slices(work, like.shape[0], wp.get_device(device), modules=(rasterize, push_xy, push_z))


_Launch = Callable[[], None]
_Images = tuple[torch.Tensor, torch.Tensor, torch.Tensor]


def _empty_images(shape: tuple[int, ...], device: torch.device) -> _Images:
    """For labels, depth and face-index map, shape (B, H, W)."""
    return (
        torch.empty(shape, dtype=torch.uint8, device=device),
        torch.empty(shape, dtype=torch.float32, device=device),
        torch.empty(shape, dtype=torch.int32, device=device),
    )


def _rasterize(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    face_labels: torch.Tensor,
    height: int,
    width: int,
    near: float,
    perspective: bool,
    then: Callable[[slice, torch.Tensor], None] | None = None,
) -> _Images:
    """Labels, depth and face-index map; ``then`` launches what follows on a slice of the batch's labels."""
    images = _empty_images((vertices.shape[0], height, width), vertices.device)

    def work(part: slice) -> None:
        here = tuple(image[part] for image in images)
        _prepare_raster(vertices[part], faces, face_labels, near, perspective, here)[0]()
        if then is not None:
            then(part, images[0])

    _launch(work, vertices)
    return images


def _prepare_raster(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    face_labels: torch.Tensor,
    near: float,
    perspective: bool,
    images: Sequence[torch.Tensor],
    background: bool = True,
) -> tuple[_Launch, rasterize.ZBuffer]:
    """What fills labels, depth and face-index map, and the z-buffer it empties again."""
    screen = _wp(vertices, wp.vec3)
    labels, depth, face_index = images
    batch, height, width = labels.shape
    zbuffer = rasterize.ZBuffer.make(batch, height, width, screen.device)
    launch = partial(
        rasterize.launch_rasterize,
        screen,
        _wp(faces, wp.vec3i),
        _wp(face_labels, wp.uint8),
        near=near,
        perspective=perspective,
        zbuffer=zbuffer,
        labels=_wp(labels, wp.uint8),
        depth=_wp(depth, wp.float32),
        face_index=_wp(face_index, wp.int32),
        background=background,
    )
    return launch, zbuffer


def _gradient(
    geometry: Sequence[torch.Tensor],
    images: _Images,
    turns: Callable[[slice], Iterable[Any]],
    options: tuple[Any, ...],
) -> torch.Tensor:
    """Gradient with respect to the vertices, shape (B, V, 3), of images from ``_rasterize``.

    ``geometry`` is vertices, faces, their labels and edges. ``turns`` gives the loss gradient of a slice of the batch,
    once for each label that the z pass has to look for.
    """
    vertices, *mesh = geometry
    grad_vertices = torch.empty(vertices.shape, device=vertices.device)

    def work(part: slice) -> None:
        here = [image[part] for image in images]
        keys = rasterize.empty_keys(tuple(here[0].shape), wp.device_from_torch(vertices.device))
        grads = grad_vertices[part]
        _prepare_gradient((vertices[part], *mesh), here, partial(turns, part), options, keys, grads)()

    _launch(work, vertices)
    return grad_vertices


def _prepare_gradient(
    geometry: Sequence[torch.Tensor],
    images: Sequence[torch.Tensor],
    turns: Callable[[], Iterable[Any]],
    options: tuple[Any, ...],
    keys: wp.array,
    grad_vertices: torch.Tensor,
) -> _Launch:
    """What fills ``grad_vertices``; ``keys`` are a ``ZBuffer``'s, empty before and after."""
    near, perspective, all_edges, over_farther, max_distance, depth_weight = options
    vertices, faces, face_labels, edges = geometry
    screen, mesh_labels = _wp(vertices, wp.vec3), _wp(face_labels, wp.uint8)
    labels, depth, face_index = images
    grad_screen = _wp(grad_vertices, wp.float32)
    view: dict[str, Any] = {
        "near": near,
        "perspective": perspective,
        "labels": _wp(labels, wp.uint8),
        "face_index": _wp(face_index, wp.int32),
        "grad_vertices": grad_screen,
    }
    push_edges = partial(
        push_xy.launch_push_edges,
        screen,
        mesh_labels,
        _wp(edges, wp.int32),
        **view,
        all_edges=all_edges,
        over_farther=over_farther,
        max_distance=max_distance,
        depth=_wp(depth, wp.float32),
        found=push_xy.SilhouetteList.make(screen.shape[0], edges.shape[0], screen.device),
    )
    push_depths = partial(
        push_z.launch_push_depths,
        screen,
        _wp(faces, wp.vec3i),
        mesh_labels,
        **view,
        depth_weight=depth_weight,
        hidden=push_z.HiddenPixels.make(keys),
    )

    def launch() -> None:
        grad_screen.zero_()
        gradients = iter(turns())
        first = next(gradients)

        def push_all_depths() -> None:
            if depth_weight != 0.0:
                for gradient in chain((first,), gradients):
                    push_depths(gradient=gradient)

        # They write other components of the gradient.
        launch_side_by_side(lambda: push_edges(gradient=first), push_all_depths)

    return launch


def _maps_forward(
    vertices: torch.Tensor, faces: torch.Tensor, face_labels: torch.Tensor, options: tuple[Any, ...]
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    num_maps, height, width, near, perspective = options[:5]
    labels, depth, face_index = _rasterize(vertices, faces, face_labels, height, width, near, perspective)
    index = torch.arange(1, num_maps + 1, dtype=torch.uint8, device=labels.device)
    maps = (labels[:, None] == index[:, None, None]).float()
    return maps, labels, depth, face_index


def _maps_backward(saved: tuple[torch.Tensor, ...], grad_maps: torch.Tensor, options: tuple[Any, ...]) -> torch.Tensor:
    *geometry, labels, face_index, depth = saved
    grad_maps = grad_maps.float()

    def turns(part: slice) -> Iterator[Any]:
        gradient = map_gradient.DenseGradient()
        gradient.maps = _wp(grad_maps[part], wp.float32)
        for wanted in range(1, grad_maps.shape[1] + 1):
            gradient.wanted = wanted
            yield gradient

    return _gradient(geometry, (labels, depth, face_index), turns, options[3:])


class _PartMaps(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, vertices: torch.Tensor, faces: torch.Tensor, face_labels: torch.Tensor, *rest: Any) -> Any:
        edges, *options = rest
        maps, labels, depth, face_index = _maps_forward(vertices, faces, face_labels, tuple(options))
        ctx.save_for_backward(vertices, faces, face_labels, edges, labels, face_index, depth)
        ctx.options = tuple(options)
        ctx.mark_non_differentiable(labels, depth, face_index)
        ctx.set_materialize_grads(False)  # or autograd would fill three images with zeros in every backward pass
        return maps, labels, depth, face_index

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor | None) -> Any:
        grad_vertices = None
        if gradients[0] is not None:
            found = _maps_backward(ctx.saved_tensors, gradients[0], ctx.options)
            (grad_vertices,) = once("rasterize_parts", (found,), gradients[0], ctx.saved_tensors[0])
        return grad_vertices, *([None] * (3 + len(ctx.options)))


def _loss_forward(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    face_labels: torch.Tensor,
    target: torch.Tensor,
    weights: torch.Tensor,
    options: tuple[Any, ...],
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    num_labels, near, perspective = options[:3]
    batch, height, width = target.shape
    extents = torch.empty(_extents_shape(batch, num_labels), dtype=torch.int32, device=vertices.device)
    losses = torch.empty(rasterize.pixel_lanes(target.shape, vertices.is_cpu), device=vertices.device)

    def compare(part: slice, labels: torch.Tensor) -> None:
        _prepare_compare(labels[part], target[part], weights, extents[part], losses[part])()

    labels, depth, face_index = _rasterize(vertices, faces, face_labels, height, width, near, perspective, then=compare)
    return losses.sum((1, 2)), labels, depth, face_index, extents


def _extents_shape(batch: int, num_labels: int) -> tuple[int, int, int, int]:
    """Of the record of wrong pixels that the backward pass needs: in three ways, of labels 0 to the highest."""
    return (batch, rasterize.NUM_EXTENTS, num_labels + 1, 4)


def _prepare_compare(
    labels: torch.Tensor, target: torch.Tensor, weights: torch.Tensor, extents: torch.Tensor, losses: torch.Tensor
) -> _Launch:
    """What fills ``losses``, and ``extents`` for the gradient."""
    return partial(
        rasterize.launch_compare_labels,
        _wp(labels, wp.uint8),
        _wp(target, wp.uint8),
        _wp(weights, wp.float32),
        extents=_wp(extents, wp.vec4i),
        losses=_wp(losses, wp.float32),
    )


def _label_target(
    target: torch.Tensor, weights: torch.Tensor, scale: torch.Tensor, extents: torch.Tensor
) -> map_gradient.LabelTarget:
    """The loss gradient where L_seg's own is ``scale``."""
    gradient = map_gradient.LabelTarget()
    gradient.target = _wp(target, wp.uint8)
    gradient.label_weights = _wp(weights, wp.float32)
    gradient.scale = _wp(scale, wp.float32)
    gradient.extents = _wp(extents, wp.vec4i)
    return gradient


def _loss_backward(saved: tuple[torch.Tensor, ...], grad_loss: torch.Tensor, options: tuple[Any, ...]) -> torch.Tensor:
    *geometry, target, weights, labels, face_index, depth, extents = saved
    grad_loss = grad_loss.float()

    def turns(part: slice) -> Iterable[Any]:
        return [_label_target(target[part], weights, grad_loss[part], extents[part])]

    return _gradient(geometry, (labels, depth, face_index), turns, options[1:])


@dataclass(frozen=True, eq=False)
class _LossRecipe:
    """L_seg and its gradient, for ``loss_graph``."""

    faces: torch.Tensor
    face_labels: torch.Tensor
    edges: torch.Tensor
    options: tuple[int, float, bool, bool, bool, float, float]

    name, modules = "label_loss", (rasterize, push_xy, push_z)

    def num_losses(self, device: torch.device, batch: int, height: int, width: int) -> int:
        return math.prod(rasterize.pixel_lanes((batch, height, width), device.type == "cpu")[1:])

    def prepare(self, buffers: Buffers) -> _Launch:
        (vertices,), target, weights = buffers.inputs, buffers.target, buffers.weights
        num_labels, near, perspective = self.options[:3]
        device, batch = vertices.device, len(vertices)
        images = _empty_images(tuple(target.shape), device)
        extents = torch.empty(_extents_shape(batch, num_labels), dtype=torch.int32, device=device)
        losses = buffers.losses.view(rasterize.pixel_lanes(tuple(target.shape), vertices.is_cpu))
        mesh = self.faces, self.face_labels
        draw, zbuffer = _prepare_raster(vertices, *mesh, near, perspective, images, background=False)
        launches = [draw, _prepare_compare(images[0], target, weights, extents, losses)]
        if buffers.grads:
            gradient = _label_target(target, weights, torch.ones(batch, device=device), extents)
            turns, (grads,) = lambda: [gradient], buffers.grads
            options, keys = self.options[1:], zbuffer.keys
            geometry = vertices, *mesh, self.edges
            launches.append(_prepare_gradient(geometry, images, turns, options, keys, grads))

        def launch() -> None:
            for part in launches:
                part()

        return launch


_recipe = lru_cache(maxsize=16)(_LossRecipe)  # the same object for the same mesh and options


# --- torch.compile -----------------------------------------------------------------------------------------------


@torch.library.custom_op("warp_partdr::part_maps", mutates_args=())
def _part_maps_op(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    face_labels: torch.Tensor,
    edges: torch.Tensor,
    num_maps: int,
    height: int,
    width: int,
    near: float,
    perspective: bool,
    all_edges: bool,
    over_farther: bool,
    max_distance: float,
    depth_weight: float,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    return _maps_forward(vertices, faces, face_labels, (num_maps, height, width, near, perspective))


@_part_maps_op.register_fake
def _(
    vertices: Any, faces: Any, face_labels: Any, edges: Any, num_maps: int, height: int, width: int, *options: Any
) -> Any:
    batch = vertices.shape[0]
    return (vertices.new_empty(batch, num_maps, height, width), *_fake_image(vertices, batch, height, width))


@torch.library.custom_op("warp_partdr::part_maps_backward", mutates_args=())
def _part_maps_backward_op(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    face_labels: torch.Tensor,
    edges: torch.Tensor,
    labels: torch.Tensor,
    face_index: torch.Tensor,
    depth: torch.Tensor,
    grad_maps: torch.Tensor,
    near: float,
    perspective: bool,
    all_edges: bool,
    over_farther: bool,
    max_distance: float,
    depth_weight: float,
) -> torch.Tensor:
    saved = (vertices, faces, face_labels, edges, labels, face_index, depth)
    return _maps_backward(
        saved, grad_maps, (None, None, None, near, perspective, all_edges, over_farther, max_distance, depth_weight)
    )


@_part_maps_backward_op.register_fake
def _(vertices: Any, *rest: Any) -> Any:
    return torch.empty_like(vertices, memory_format=torch.contiguous_format)


def _setup_part_maps(ctx: Any, inputs: Any, output: Any) -> None:
    _, labels, depth, face_index = output
    ctx.save_for_backward(*inputs[:4], labels, face_index, depth)
    ctx.options = inputs[4:]


def _backward_part_maps(ctx: Any, grad_maps: torch.Tensor, *rest: Any) -> Any:
    gradient = torch.ops.warp_partdr.part_maps_backward(*ctx.saved_tensors, grad_maps, *ctx.options[3:])
    return gradient, *([None] * (3 + len(ctx.options)))


_part_maps_op.register_autograd(_backward_part_maps, setup_context=_setup_part_maps)
_part_maps_backward_op.register_autograd(lambda ctx, grad: raise_second_derivative("rasterize_parts"))


@torch.library.custom_op("warp_partdr::label_loss", mutates_args=())
def _label_loss_op(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    face_labels: torch.Tensor,
    edges: torch.Tensor,
    target: torch.Tensor,
    weights: torch.Tensor,
    num_labels: int,
    near: float,
    perspective: bool,
    all_edges: bool,
    over_farther: bool,
    max_distance: float,
    depth_weight: float,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    return _loss_forward(vertices, faces, face_labels, target, weights, (num_labels, near, perspective))


@_label_loss_op.register_fake
def _(
    vertices: Any, faces: Any, face_labels: Any, edges: Any, target: Any, weights: Any, num_labels: int, *rest: Any
) -> Any:
    batch, height, width = target.shape
    extents = vertices.new_empty(_extents_shape(batch, num_labels), dtype=torch.int32)
    return (vertices.new_empty(batch), *_fake_image(vertices, batch, height, width), extents)


@torch.library.custom_op("warp_partdr::label_loss_backward", mutates_args=())
def _label_loss_backward_op(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    face_labels: torch.Tensor,
    edges: torch.Tensor,
    target: torch.Tensor,
    weights: torch.Tensor,
    labels: torch.Tensor,
    face_index: torch.Tensor,
    depth: torch.Tensor,
    extents: torch.Tensor,
    grad_loss: torch.Tensor,
    num_labels: int,
    near: float,
    perspective: bool,
    all_edges: bool,
    over_farther: bool,
    max_distance: float,
    depth_weight: float,
) -> torch.Tensor:
    saved = (vertices, faces, face_labels, edges, target, weights, labels, face_index, depth, extents)
    return _loss_backward(
        saved, grad_loss, (num_labels, near, perspective, all_edges, over_farther, max_distance, depth_weight)
    )


@_label_loss_backward_op.register_fake
def _(vertices: Any, *rest: Any) -> Any:
    return torch.empty_like(vertices, memory_format=torch.contiguous_format)


def _setup_label_loss(ctx: Any, inputs: Any, output: Any) -> None:
    _, labels, depth, face_index, extents = output
    ctx.save_for_backward(*inputs[:6], labels, face_index, depth, extents)
    ctx.options = inputs[6:]


def _backward_label_loss(ctx: Any, grad_loss: torch.Tensor, *rest: Any) -> Any:
    gradient = torch.ops.warp_partdr.label_loss_backward(*ctx.saved_tensors, grad_loss, *ctx.options)
    return gradient, *([None] * (5 + len(ctx.options)))


_label_loss_op.register_autograd(_backward_label_loss, setup_context=_setup_label_loss)
_label_loss_backward_op.register_autograd(lambda ctx, grad: raise_second_derivative("label_loss"))


def _fake_image(vertices: torch.Tensor, batch: int, height: int, width: int) -> tuple[torch.Tensor, ...]:
    shape = (batch, height, width)
    return (
        vertices.new_empty(shape, dtype=torch.uint8),
        vertices.new_empty(shape, dtype=torch.float32),
        vertices.new_empty(shape, dtype=torch.int32),
    )
