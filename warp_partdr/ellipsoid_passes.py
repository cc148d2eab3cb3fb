"""What the exact renderer launches: the picture of ellipsoids, and the gradient of a loss, in buffers made for them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import torch
import warp as wp

from .kernels import ellipsoid_coverage, ellipsoid_partdr, ellipsoid_picture, surface_forces
from .kernels import ellipsoids as kernel_ellipsoids
from .kernels.ellipsoids import Seen, launch_see
from .kernels.targets import DenseGradient, LabelTarget, launch_find_reach
from .kernels.threads import launch_in_slices
from .mesh import MAX_LABEL
from .streams import capture_apart, on_torch_stream

Gradient = Literal["coverage", "partdr"]
Launch = Callable[[slice], None]  # the work of some bodies of the batch


@dataclass(frozen=True)
class View:
    """How the picture is taken."""

    height: int
    width: int
    near: float
    perspective: bool
    labels: tuple[int, ...]  # what each ellipsoid shows

    @property
    def num_labels(self) -> int:
        """The highest label that is shown, 255 aside."""
        return max((label for label in self.labels if label <= MAX_LABEL), default=0)


@dataclass(frozen=True)
class Options:
    """How the gradient is estimated."""

    gradient: Gradient
    over_farther: bool
    max_distance: float
    depth_weight: float
    steps_per_pixel: float
    halvings: int


@dataclass(frozen=True)
class Picture:
    """What ``draw`` fills: images of shape (B, H, W), losses of shape (B,)."""

    seen: Seen
    parts: torch.Tensor
    labels: torch.Tensor
    depth: torch.Tensor
    loss: torch.Tensor


@lru_cache(maxsize=64)
def label_table(labels: tuple[int, ...], device: torch.device) -> torch.Tensor:
    """On the device once: a copy from the host in every call would wait for it."""
    return torch.tensor(labels, dtype=torch.uint8, device=device)


def _wp(tensor: torch.Tensor, kind: Any) -> wp.array:
    return wp.from_torch(tensor.detach().contiguous(), dtype=kind, requires_grad=False)


def arrays_of(tensors: Sequence[torch.Tensor]) -> list[wp.array]:
    """Centres, axes, semi-axes and camera, or their gradients, as Warp arrays over the same memory."""
    return [_wp(tensor, kind) for tensor, kind in zip(tensors, (wp.vec3, wp.mat33, wp.vec3, wp.vec4), strict=True)]


def draw(tensors: Sequence[torch.Tensor], view: View, target: LabelTarget | None = None) -> Picture:
    """The picture, and its loss where there is a target."""
    picture, launch = prepare_picture(tensors, view, target)
    if len(picture.loss):  # Warp cuts nothing out of an empty array
        modules = (kernel_ellipsoids, ellipsoid_picture, surface_forces)
        with on_torch_stream(picture.parts.device) as where:
            launch_in_slices(launch, len(picture.loss), wp.get_device(where), modules=modules)
    return picture


def prepare_picture(
    tensors: Sequence[torch.Tensor], view: View, target: LabelTarget | None = None
) -> tuple[Picture, Launch]:
    """Buffers of a picture, and what fills them: launches alone."""
    device = tensors[0].device
    batch, count = tensors[0].shape[:2]
    shape = (batch, view.height, view.width)
    parts = torch.empty(shape, dtype=torch.uint8, device=device)
    labels = torch.empty(shape, dtype=torch.uint8, device=device)
    depth = torch.empty(shape, device=device)
    loss = torch.empty(batch, device=device)
    with on_torch_stream(device) as where:
        seen = Seen.empty(batch, count, where)
        arrays, table = arrays_of(tensors), _wp(label_table(view.labels, device), wp.uint8)
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

    return Picture(seen, parts, labels, depth, loss), launch


def gradients(
    tensors: Sequence[torch.Tensor], picture: Picture, view: View, options: Options, gradient: Any
) -> tuple[torch.Tensor, ...]:
    """With respect to centres, axes, semi-axes and camera."""
    grads, launch = prepare_gradients(tensors, picture, view, options, gradient)
    if len(picture.loss):
        estimator = ellipsoid_coverage if options.gradient == "coverage" else ellipsoid_partdr
        with on_torch_stream(picture.parts.device) as where:
            launch_in_slices(launch, len(picture.loss), wp.get_device(where), modules=(estimator, surface_forces))
    return grads


def prepare_gradients(
    tensors: Sequence[torch.Tensor], picture: Picture, view: View, options: Options, gradient: Any
) -> tuple[tuple[torch.Tensor, ...], Launch]:
    """Buffers of the gradients, and what fills them: launches alone."""
    device = picture.parts.device
    batch, count = tensors[0].shape[:2]
    force = torch.empty(batch, count, 3, device=device)
    moment = torch.empty(batch, count, 3, 3, device=device)
    camera_force = torch.empty(batch, count, 4, device=device)
    grads = tuple(torch.empty_like(tensor, memory_format=torch.contiguous_format) for tensor in tensors)
    with on_torch_stream(device):
        arrays = arrays_of(tensors)
        sums = {
            "force": _wp(force, wp.vec3),
            "moment": _wp(moment, wp.mat33),
            "camera_force": _wp(camera_force, wp.vec4),
        }
        parts = _wp(picture.parts, wp.uint8)
        names = ("grad_centres", "grad_axes", "grad_semi_axes", "grad_camera")
        outputs = dict(zip(names, arrays_of(grads), strict=True))

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

    return grads, launch


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


def label_target(target: torch.Tensor, weights: torch.Tensor, num_labels: int, needs_reach: bool) -> LabelTarget:
    """A target image, shape (N, H, W), and weights of labels, shape (256,), for the kernels."""
    with on_torch_stream(target.device) as device:
        made = LabelTarget()
        made.target = _wp(target, wp.uint8)
        made.label_weights = _wp(weights, wp.float32)
        shape = (target.shape[0], 2, num_labels + 1, max(target.shape[1:])) if needs_reach else (0, 0, 0, 0)
        made.reach = wp.empty(shape, dtype=wp.vec2i, device=device)
        if needs_reach:
            launch_find_reach(made.target, made.reach)
    return made


def dense_gradient(maps: torch.Tensor) -> DenseGradient:
    """A gradient with respect to label maps, shape (B, K, H, W)."""
    with on_torch_stream(maps.device):
        dense = DenseGradient()
        dense.maps = _wp(maps.float(), wp.float32)
    return dense


class LossGraph:
    """L_seg and its gradient as one captured graph in buffers of its own, for batches so small that Python would wait.

    Args:
        batch: B.
        count: P.
        targets: N, how many targets there are: 1 or B.
        device: Where.
        view: How the picture is taken.
        options: How the gradient is estimated.
    """

    def __init__(
        self, batch: int, count: int, targets: int, device: torch.device, view: View, options: Options
    ) -> None:
        shapes = ((batch, count, 3), (batch, count, 3, 3), (batch, count, 3), (batch, 4))
        self._inputs = tuple(torch.zeros(shape, device=device) for shape in shapes)
        self._target = torch.zeros(targets, view.height, view.width, dtype=torch.uint8, device=device)
        self._weights = torch.zeros(256, device=device)
        reaches = options.gradient == "partdr"
        target = label_target(self._target, self._weights, view.num_labels, reaches)
        self._picture, launch_picture = prepare_picture(self._inputs, view, target)
        self._grads, launch_gradients = prepare_gradients(self._inputs, self._picture, view, options, target)
        self._kept = target, launch_picture, launch_gradients  # the graph holds no memory alive
        whole = slice(0, batch)
        with capture_apart(device), on_torch_stream(device) as where:
            warp_device = wp.get_device(where)
            # A stream of its own on CUDA: torch's may be the default one, which can't be captured.
            stream = None if warp_device.is_cpu else wp.Stream(warp_device)
            with wp.ScopedStream(stream), wp.ScopedCapture(warp_device, stream) as capture:
                if reaches:
                    launch_find_reach(target.target, target.reach)
                launch_picture(whole)
                launch_gradients(whole)
        self._graph = capture.graph

    def __call__(
        self, tensors: Sequence[torch.Tensor], target: torch.Tensor, weights: torch.Tensor
    ) -> tuple[tuple[torch.Tensor, ...], tuple[torch.Tensor, ...]]:
        """Loss, labels, depth and parts; and the gradients. Copies, for the next call fills the buffers again."""
        for buffer, given in zip(
            (*self._inputs, self._target, self._weights), (*tensors, target, weights), strict=True
        ):
            buffer.copy_(given.detach())
        with on_torch_stream(target.device) as where:
            device = wp.get_device(where)
            wp.capture_launch(self._graph, stream=None if device.is_cpu else wp.get_stream(device))
        picture = self._picture
        shown = (picture.loss, picture.labels, picture.depth, picture.parts)
        return tuple(tensor.clone() for tensor in shown), tuple(grad.clone() for grad in self._grads)


@lru_cache(maxsize=8)
def _cached_graph(
    thread: int, stream: int, batch: int, count: int, targets: int, device: torch.device, view: View, options: Options
) -> LossGraph:
    return LossGraph(batch, count, targets, device, view, options)


def loss_graph(tensors: Sequence[torch.Tensor], target: torch.Tensor, view: View, options: Options) -> LossGraph:
    """The graph for these sizes, kept for the next call: for each thread and stream its own, for its buffers are."""
    device = target.device
    stream = 0 if device.type == "cpu" else torch.cuda.current_stream(device).cuda_stream
    batch, count = tensors[0].shape[:2]
    return _cached_graph(threading.get_ident(), stream, batch, count, len(target), device, view, options)
