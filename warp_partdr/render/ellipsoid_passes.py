"""What the exact renderer launches: the picture of ellipsoids, and the gradient of a loss, in buffers made for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from types import ModuleType
from typing import Any, Literal

import torch
import warp as wp

from ..interop.checks import contiguous
from ..interop.loss_graph import Buffers
from ..interop.streams import on_torch_stream
from ..kernels.ellipsoids import coverage, edges, partdr
from ..kernels.ellipsoids import forces as surface_forces
from ..kernels.ellipsoids import picture as ellipsoid_picture
from ..kernels.ellipsoids import silhouette as kernel_ellipsoids
from ..kernels.ellipsoids.silhouette import Seen, launch_see
from ..kernels.labels import DenseGradient, LabelTarget, launch_find_reach
from ..kernels.launch import launch_in_slices
from .part_mesh import MAX_LABEL

Gradient = Literal["edges", "coverage", "partdr"]
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

    @property
    def estimator(self) -> ModuleType:
        """Where its kernels are."""
        modules = {"edges": edges, "coverage": coverage, "partdr": partdr}
        return modules[self.gradient]

    def launcher(self) -> Callable[..., None]:
        """What fills the sums of forces on ellipsoids: one call for all estimators."""
        if self.gradient == "edges":
            return edges.launch_edge_forces
        if self.gradient == "coverage":
            return partial(
                coverage.launch_coverage_forces,
                steps_per_pixel=self.steps_per_pixel,
                halvings=self.halvings,
            )
        return partial(
            partdr.launch_partdr_forces,
            over_farther=self.over_farther,
            max_distance=self.max_distance,
            depth_weight=self.depth_weight,
        )


@dataclass(frozen=True)
class Picture:
    """What ``draw`` fills: images of shape (B, H, W); of a picture that is only compared, ``parts`` alone."""

    seen: Seen
    parts: torch.Tensor
    labels: torch.Tensor
    depth: torch.Tensor


@lru_cache(maxsize=64)
def label_table(labels: tuple[int, ...], device: torch.device) -> torch.Tensor:
    """On the device once: a copy from the host in every call would wait for it."""
    return torch.tensor(labels, dtype=torch.uint8, device=device)


def _wp(tensor: torch.Tensor, kind: Any) -> wp.array:
    return wp.from_torch(tensor.detach(), dtype=kind, requires_grad=False)


def arrays_of(tensors: Sequence[torch.Tensor]) -> list[wp.array]:
    """Centres, axes, semi-axes and camera, or their gradients, as Warp arrays over the same memory."""
    return [_wp(tensor, kind) for tensor, kind in zip(tensors, (wp.vec3, wp.mat33, wp.vec3, wp.vec4), strict=True)]


def draw(tensors: Sequence[torch.Tensor], view: View) -> Picture:
    """The picture."""
    picture, launch = prepare_picture([contiguous(tensor) for tensor in tensors], view)
    if len(picture.parts):  # Warp cuts nothing out of an empty array
        modules = (kernel_ellipsoids, ellipsoid_picture)
        with on_torch_stream(picture.parts.device) as where:
            launch_in_slices(launch, len(picture.parts), wp.get_device(where), modules=modules)
    return picture


def prepare_picture(
    tensors: Sequence[torch.Tensor], view: View, target: LabelTarget | None = None, loss: torch.Tensor | None = None
) -> tuple[Picture, Launch]:
    """Buffers of a picture, and what fills them: launches alone. With a target they fill ``loss``, and no labels."""
    device = tensors[0].device
    batch, count = tensors[0].shape[:2]
    shape, none = (batch, view.height, view.width), (0, 0, 0)
    parts = torch.empty(shape, dtype=torch.uint8, device=device)
    labels = torch.empty(shape if target is None else none, dtype=torch.uint8, device=device)
    depth = torch.empty(shape if target is None else none, device=device)
    with on_torch_stream(device) as where:
        seen = Seen.empty(batch, count, where)
        arrays, table = arrays_of(tensors), _wp(label_table(view.labels, device), wp.uint8)
        sums = ellipsoid_picture.num_partial_losses(table.device, batch, view.height, view.width)
        losses = torch.empty((0, 0) if target is None else (batch, sums), device=device)
        outputs = {
            "nearest": wp.empty(shape if device.type == "cpu" else none, dtype=float, device=where),
            "parts": _wp(parts, wp.uint8),
            "labels": _wp(labels, wp.uint8),
            "depth": _wp(depth, wp.float32),
            "losses": _wp(losses, wp.float32),
        }
        totals = None if loss is None else _wp(loss, wp.float32)

        def launch(part: slice) -> None:
            cut = {name: _cut(array, part) for name, array in outputs.items()}
            seen_here = seen.cut(part)
            posed = [_cut(array, part) for array in arrays]
            launch_see(posed, table, near=view.near, perspective=view.perspective, seen=seen_here)
            compared = LabelTarget() if target is None else target
            ellipsoid_picture.launch_draw(seen_here.silhouettes, perspective=view.perspective, target=compared, **cut)
            if totals is not None:
                surface_forces.launch_sum_rows(cut["losses"], totals)

    return Picture(seen, parts, labels, depth), launch


def gradients(
    tensors: Sequence[torch.Tensor], picture: Picture, view: View, options: Options, gradient: Any
) -> tuple[torch.Tensor, ...]:
    """With respect to centres, axes, semi-axes and camera."""
    tensors = [contiguous(tensor) for tensor in tensors]
    grads = tuple(torch.empty_like(tensor) for tensor in tensors)
    launch = prepare_gradients(tensors, picture, view, options, gradient, grads)
    if len(picture.parts):
        modules = (options.estimator, surface_forces)
        with on_torch_stream(picture.parts.device) as where:
            launch_in_slices(launch, len(picture.parts), wp.get_device(where), modules=modules)
    return grads


def prepare_gradients(
    tensors: Sequence[torch.Tensor],
    picture: Picture,
    view: View,
    options: Options,
    gradient: Any,
    grads: Sequence[torch.Tensor],
) -> Launch:
    """What fills ``grads``, which are laid out as ``tensors``: launches alone."""
    batch, count = tensors[0].shape[:2]
    with on_torch_stream(picture.parts.device) as where:
        arrays = arrays_of(tensors)
        forces = surface_forces.make_forces(batch, count, wp.get_device(where))
        parts = _wp(picture.parts, wp.uint8)
        names = ("grad_centres", "grad_axes", "grad_semi_axes", "grad_camera")
        outputs = dict(zip(names, arrays_of(grads), strict=True))
        launch_forces = options.launcher()

        def launch(part: slice) -> None:
            posed = [_cut(array, part) for array in arrays]
            here = surface_forces.cut_forces(forces, part)
            wanted = _cut_gradient(gradient, part)
            shown = picture.seen.cut(part), _cut(parts, part)
            launch_forces(posed, *shown, perspective=view.perspective, gradient=wanted, forces=here)
            cut = {name: _cut(array, part) for name, array in outputs.items()}
            surface_forces.launch_spread(posed[1], posed[2], here, **cut)

    return launch


def _cut(array: wp.array, part: slice) -> wp.array:
    """Some bodies' share of an array; all of it without a view, which would cost 15 us, and nothing of an empty one."""
    return array if part.stop - part.start == array.shape[0] or not array.size else array[part]


def _cut_gradient(gradient: Any, part: slice) -> Any:  # LabelTarget or DenseGradient, classes of Warp's own making
    """Some bodies' maps; a label target stays, which belongs to all bodies of a launch."""
    if not hasattr(gradient, "maps"):
        return gradient
    dense = DenseGradient()
    dense.maps = gradient.maps[part]
    return dense


def dense_gradient(maps: torch.Tensor) -> DenseGradient:
    """A gradient with respect to label maps, shape (B, K, H, W)."""
    with on_torch_stream(maps.device):
        dense = DenseGradient()
        dense.maps = _wp(contiguous(maps.float()), wp.float32)
    return dense


@dataclass(frozen=True, eq=False)
class LossRecipe:
    """L_seg and its gradient, for ``loss_graph``; see ``loss_recipe``."""

    view: View
    options: Options

    name = "ellipsoid_label_loss"

    @property
    def modules(self) -> Sequence[ModuleType]:
        """What it launches."""
        return kernel_ellipsoids, ellipsoid_picture, self.options.estimator, surface_forces

    def num_losses(self, device: torch.device, batch: int, height: int, width: int) -> int:
        """One sum: a kernel adds up in a fixed order, for any batch the same."""
        return 1

    def prepare(self, buffers: Buffers) -> Callable[[], None]:
        """Launches for all bodies of the buffers."""
        view, options, inputs = self.view, self.options, buffers.inputs
        target, whole = LabelTarget(), slice(0, len(inputs[0]))
        reaches = options.gradient == "partdr" and len(buffers.grads) > 0
        with on_torch_stream(buffers.target.device) as device:
            target.target = _wp(buffers.target, wp.uint8)
            target.label_weights = _wp(buffers.weights, wp.float32)
            reach = (len(buffers.target), 2, view.num_labels + 1, max(view.height, view.width))
            target.reach = wp.empty(reach if reaches else (0, 0, 0, 0), dtype=wp.vec2i, device=device)
        picture, launch_picture = prepare_picture(inputs, view, target, buffers.losses[:, 0])
        launch_gradients: Launch | None = None
        if buffers.grads:
            launch_gradients = prepare_gradients(inputs, picture, view, options, target, buffers.grads)

        def launch() -> None:
            launch_picture(whole)
            if reaches:
                launch_find_reach(target.target, target.reach)
            if launch_gradients is not None:
                launch_gradients(whole)

        return launch


@lru_cache(maxsize=64)
def loss_recipe(view: View, options: Options) -> LossRecipe:
    """The same object for the same options."""
    return LossRecipe(view, options)
