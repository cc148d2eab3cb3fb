"""Launches of the exact renderer: the picture of ellipsoids, and the gradient of a loss, in buffers made for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from types import ModuleType
from typing import Any

import torch
import warp as wp

from ..interop.arrays import contiguous, warp_array
from ..interop.loss_graph import Buffers
from ..interop.streams import on_torch_stream
from ..kernels.ellipsoids import coverage, edges, partdr
from ..kernels.ellipsoids import forces as surface_forces
from ..kernels.ellipsoids import picture as ellipsoid_picture
from ..kernels.ellipsoids import silhouette as kernel_ellipsoids
from ..kernels.ellipsoids.silhouette import Seen, launch_see
from ..kernels.labels import DenseGradient, LabelTarget, launch_find_reach
from ..kernels.launch import launch_in_slices
from .options import Gradient
from .part_mesh import MAX_LABEL

_HALVINGS = 4  # of a step at one sample a pixel, to find where on it the cost changes
_MORE_HALVINGS = 1.6  # for each doubling of the samples

Launch = Callable[[slice], None]  # the work of some bodies of the batch


@dataclass(frozen=True)
class View:
    """Size of the picture, kind of camera, and labels."""

    height: int
    width: int
    near: float
    perspective: bool
    labels: tuple[int, ...]  # what each ellipsoid shows

    @property
    def num_labels(self) -> int:
        """Highest label that is shown, 255 aside."""
        return max((label for label in self.labels if label <= MAX_LABEL), default=0)


@dataclass(frozen=True)
class EllipsoidOptions:
    """Options of the gradient."""

    gradient: Gradient
    max_distance: float
    depth_weight: float
    samples_per_pixel: float

    @property
    def estimator(self) -> ModuleType:
        """Module of its kernels."""
        modules = {"edges": edges, "coverage": coverage, "partdr": partdr}
        return modules[self.gradient]

    def launcher(self) -> Callable[..., None]:
        """Launcher of the sums of forces on ellipsoids, with one signature for all estimators."""
        if self.gradient == "edges":
            return edges.launch_edge_forces
        if self.gradient == "coverage":
            return partial(
                coverage.launch_coverage_forces,
                steps_per_pixel=self.samples_per_pixel,
                halvings=_HALVINGS + math.ceil(_MORE_HALVINGS * math.log2(max(self.samples_per_pixel, 1.0))),
            )
        return partial(
            partdr.launch_partdr_forces,
            max_distance=self.max_distance,
            depth_weight=self.depth_weight,
        )


@dataclass(frozen=True)
class Picture:
    """Images of shape (B, H, W) that ``draw`` fills; only ``parts`` if the picture is just compared."""

    seen: Seen
    parts: torch.Tensor
    labels: torch.Tensor
    depth: torch.Tensor


@lru_cache(maxsize=64)
def labels_on_device(labels: tuple[int, ...], device: torch.device) -> torch.Tensor:
    """Labels on the device, cached: a copy from the host in every call would wait for it."""
    return torch.tensor(labels, dtype=torch.uint8, device=device)


def arrays_of(tensors: Sequence[torch.Tensor]) -> list[wp.array]:
    """Centres, axes, semi-axes and camera, or their gradients, as Warp arrays over the same memory."""
    types = (wp.vec3, wp.mat33, wp.vec3, wp.vec4)
    return [warp_array(tensor, kind) for tensor, kind in zip(tensors, types, strict=True)]


def draw(tensors: Sequence[torch.Tensor], view: View) -> Picture:
    """Draw the picture."""
    picture, launch = prepare_picture([contiguous(tensor) for tensor in tensors], view)
    if len(picture.parts):  # Warp cuts nothing out of an empty array
        modules = (kernel_ellipsoids, ellipsoid_picture)
        with on_torch_stream(picture.parts.device) as where:
            launch_in_slices(launch, len(picture.parts), wp.get_device(where), modules=modules)
    return picture


def prepare_picture(
    tensors: Sequence[torch.Tensor], view: View, target: LabelTarget | None = None, loss: torch.Tensor | None = None
) -> tuple[Picture, Launch]:
    """Buffers of a picture, and launches that fill them; with a target these fill ``loss`` instead of the labels."""
    device = tensors[0].device
    batch, count = tensors[0].shape[:2]
    shape, none = (batch, view.height, view.width), (0, 0, 0)
    parts = torch.empty(shape, dtype=torch.uint8, device=device)
    labels = torch.empty(shape if target is None else none, dtype=torch.uint8, device=device)
    depth = torch.empty(shape if target is None else none, device=device)
    with on_torch_stream(device) as where:
        seen = Seen.empty(batch, count, where)
        arrays, table = arrays_of(tensors), warp_array(labels_on_device(view.labels, device))
        sums = ellipsoid_picture.num_partial_losses(table.device, batch, view.height, view.width)
        losses = torch.empty((0, 0) if target is None else (batch, sums), device=device)
        outputs = {
            "nearest": wp.empty(shape if device.type == "cpu" else none, dtype=float, device=where),
            "parts": warp_array(parts),
            "labels": warp_array(labels),
            "depth": warp_array(depth),
            "losses": warp_array(losses),
        }
        totals = None if loss is None else warp_array(loss)

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
    tensors: Sequence[torch.Tensor], picture: Picture, view: View, options: EllipsoidOptions, gradient: Any
) -> tuple[torch.Tensor, ...]:
    """Gradients with respect to centres, axes, semi-axes and camera."""
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
    options: EllipsoidOptions,
    gradient: Any,
    grads: Sequence[torch.Tensor],
) -> Launch:
    """Prepare launches, and nothing else, that fill ``grads``, laid out as ``tensors``."""
    batch, count = tensors[0].shape[:2]
    with on_torch_stream(picture.parts.device) as where:
        arrays = arrays_of(tensors)
        forces = surface_forces.make_forces(batch, count, wp.get_device(where))
        parts = warp_array(picture.parts)
        names = ("grad_centres", "grad_axes", "grad_semi_axes", "grad_camera")
        outputs = dict(zip(names, arrays_of(grads), strict=True))
        launch_forces = options.launcher()

        def launch(part: slice) -> None:
            posed = [_cut(array, part) for array in arrays]
            here = surface_forces.cut_forces(forces, part)
            of_part = _cut_gradient(gradient, part)
            shown = picture.seen.cut(part), _cut(parts, part)
            launch_forces(posed, *shown, perspective=view.perspective, gradient=of_part, forces=here)
            cut = {name: _cut(array, part) for name, array in outputs.items()}
            surface_forces.launch_spread(posed[1], posed[2], here, **cut)

    return launch


def _cut(array: wp.array, part: slice) -> wp.array:
    """Slice of an array of bodies; the array itself if that is all, for a view costs 15 us, or if it is empty."""
    return array if part.stop - part.start == array.shape[0] or not array.size else array[part]


def _cut_gradient(gradient: Any, part: slice) -> Any:  # LabelTarget or DenseGradient, classes of Warp's own making
    """Slice of the maps of bodies; a label target stays whole, for all bodies of a launch share it."""
    if not hasattr(gradient, "maps"):
        return gradient
    dense = DenseGradient()
    dense.maps = gradient.maps[part]
    return dense


def dense_gradient(maps: torch.Tensor) -> DenseGradient:
    """Gradient with respect to label maps, shape (B, K, H, W), for the kernels."""
    with on_torch_stream(maps.device):
        dense = DenseGradient()
        dense.maps = warp_array(contiguous(maps.float()))
    return dense


@dataclass(frozen=True, eq=False)
class EllipsoidRecipe:
    """L_seg and its gradient, for ``loss_graph``; see ``ellipsoid_recipe``."""

    view: View
    options: EllipsoidOptions

    name = "ellipsoid_label_loss"

    @property
    def modules(self) -> Sequence[ModuleType]:
        """Modules of the kernels that it launches."""
        return kernel_ellipsoids, ellipsoid_picture, self.options.estimator, surface_forces

    def num_losses(self, device: torch.device, batch: int, height: int, width: int) -> int:
        """One sum: a kernel adds in a fixed order, the same for any batch."""
        return 1

    def prepare(self, buffers: Buffers) -> Callable[[], None]:
        """Launches for all bodies of the buffers."""
        view, options, inputs = self.view, self.options, buffers.inputs
        target, whole = LabelTarget(), slice(0, len(inputs[0]))
        reaches = options.gradient == "partdr" and len(buffers.grads) > 0
        with on_torch_stream(buffers.target.device) as device:
            target.target = warp_array(buffers.target)
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


ellipsoid_recipe = lru_cache(maxsize=64)(EllipsoidRecipe)  # the same object for the same options
