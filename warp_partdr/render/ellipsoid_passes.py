"""Launches of the exact renderer: the picture of ellipsoids, and the gradient of a loss, in buffers made for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from types import ModuleType
from typing import Any

import torch
import warp as wp

from ..interop.arrays import contiguous, warp_array, warp_arrays
from ..interop.device_cache import device_cache
from ..interop.layouts import Tensors
from ..interop.loss_graph import Buffers
from ..interop.streams import launch_bodies_on, on_torch_stream
from ..kernels.ellipsoids import edges, forces, partdr, silhouette
from ..kernels.ellipsoids import picture as ellipsoid_picture
from ..kernels.ellipsoids.silhouette import Seen, launch_see
from ..kernels.labels import NUM_EXTENTS, DenseGradient, LabelTarget
from .options import Gradient
from .part_mesh import MAX_LABEL
from .pictures import Picture, Settings, Size

_HALVINGS = 4  # of a step at one sample a pixel, to find where on it the cost changes
_MORE_HALVINGS = 1.6  # for each doubling of the samples

Launch = Callable[[slice], None]  # the work of some bodies of the batch


def estimator(gradient: Gradient) -> ModuleType:
    """Module of an estimator's kernels. It is imported when it is wanted, because Warp takes long to read kernels."""
    return import_module(f"..kernels.ellipsoids.{gradient}", __package__)


@dataclass(frozen=True, eq=False)
class EllipsoidPasses:
    """The exact renderer's ``Passes``; its inputs are centres, axes, semi-axes and camera."""

    labels: tuple[int, ...]  # what each ellipsoid shows
    perspective: bool
    gradient: Gradient
    near: float
    max_distance: float
    depth_weight: float
    samples_per_pixel: float

    kind, drawing, name = "ellipsoid", "draw_ellipsoids", "ellipsoid_label_loss"
    constants = ()

    @classmethod
    def of(
        cls, constants: Sequence[torch.Tensor], integers: Sequence[int], gradient: Any, numbers: Sequence[float]
    ) -> EllipsoidPasses:
        """Inverse of ``settings``."""
        return ellipsoid_passes(tuple(integers[1:]), bool(integers[0]), gradient, *numbers)

    def settings(self) -> Settings:
        """Options as custom operations take them."""
        numbers = [self.near, self.max_distance, self.depth_weight, self.samples_per_pixel]
        return [int(self.perspective), *self.labels], self.gradient, numbers

    @property
    def modules(self) -> Sequence[ModuleType]:
        """Modules of the kernels that it launches."""
        return silhouette, ellipsoid_picture, estimator(self.gradient), forces

    def make_forces(self, batch: int, parts: int, device: wp.Device) -> wp.array:
        """Allocate the sums of forces, shape (B, P, S, 16)."""
        return forces.make_forces(batch, parts, device, estimator(self.gradient).FEWEST_SHARES)

    def force_launcher(self) -> Callable[..., None]:
        """Launcher of the sums of forces on ellipsoids, with one signature for all estimators."""
        launch = partial(forces.launch_forces, perspective=self.perspective)
        if self.gradient == "coverage":
            coverage = estimator("coverage")
            sampling = forces.Sampling()
            sampling.steps_per_pixel = self.samples_per_pixel
            more = math.ceil(_MORE_HALVINGS * math.log2(max(self.samples_per_pixel, 1.0)))
            sampling.halvings = _HALVINGS + more
            return partial(launch, [coverage.coverage_forces], [sampling])
        if self.gradient == "partdr":
            return partial(self._launch_partdr, launch)
        return partial(launch, [edges.push_crossings], [])

    def _launch_partdr(self, launch: Callable[..., None], *args: Any, gradient: Any, **others: Any) -> None:
        """Launch the kernels of PartDR: lines are walked only where a wrong pixel can't find the ends that it moves."""
        labels = [label for label in self.labels if 0 < label <= MAX_LABEL]
        distinct = len(set(labels)) == len(labels) and not hasattr(gradient, "maps")
        kernels = [partdr.partdr_forces] if distinct else [partdr.partdr_forces, partdr.walk_outlines]
        launch(kernels, [self.max_distance, self.depth_weight, distinct], *args, gradient=gradient, **others)

    def draw(self, inputs: Tensors, size: Size) -> Picture:
        """Draw labels, depth and index + 1 of the nearest; the scratch is what cameras see of each ellipsoid."""
        shape, device = (inputs[0].shape[0], *size), inputs[0].device
        labels, parts = (torch.empty(shape, dtype=torch.uint8, device=device) for _ in range(2))
        depth, faults = torch.empty(shape, device=device), torch.empty(shape[0], device=device)
        with on_torch_stream(device):
            posed = _arrays(map(contiguous, inputs))
            launch, seen, _ = self.prepare_picture(
                posed,
                parts=warp_array(parts),
                labels=warp_array(labels),
                depth=warp_array(depth),
                faults=warp_array(faults),
            )
        launch_bodies_on(device, launch, shape[0], (silhouette, ellipsoid_picture))
        return Picture(labels, depth, parts, faults, seen)

    def prepare_labels(self, inputs: Tensors, labels: torch.Tensor, faults: torch.Tensor) -> Callable[[], None]:
        """Launch that fills ``labels`` and ``faults``."""
        posed, shown = _arrays(inputs), warp_array(labels)
        if self.labels == tuple(range(1, len(self.labels) + 1)):  # a part's label is its index + 1
            launch, _, _ = self.prepare_picture(posed, parts=shown, faults=warp_array(faults))
        else:
            parts = wp.empty(labels.shape, dtype=wp.uint8, device=shown.device)
            launch, _, _ = self.prepare_picture(posed, parts=parts, labels=shown, faults=warp_array(faults))
        return partial(launch, slice(0, len(labels)))

    def gradients(self, inputs: Tensors, picture: Picture, grad_maps: torch.Tensor) -> Tensors:
        """Gradients with respect to the inputs, from that with respect to part maps (B, K, H, W)."""
        device, seen = grad_maps.device, picture.scratch
        grads = tuple(torch.empty(each.shape, device=device) for each in inputs)
        with on_torch_stream(device):
            posed = _arrays(map(contiguous, inputs))
            if seen is None:
                seen = self._empty_seen(posed)
                self._prepare_see(device)(posed, seen=seen, extents=_nothing(3, wp.vec4i, posed[0].device.alias))
            dense = _dense_gradient(warp_array(contiguous(grad_maps.float())))
            launch = self._prepare_gradients(posed, seen, warp_array(picture.nearest), dense, grads)
        launch_bodies_on(device, launch, grad_maps.shape[0], (estimator(self.gradient), forces))
        return grads

    def num_losses(self, device: torch.device, batch: int, height: int, width: int) -> int:
        """One sum: a kernel adds in a fixed order, the same for any batch."""
        return 1

    def prepare(self, buffers: Buffers) -> Callable[[], None]:
        """Launches of loss and gradient for all bodies of the buffers."""
        inputs, size = buffers.inputs, buffers.target.shape[-2:]
        everything = slice(0, inputs[0].shape[0])
        with on_torch_stream(buffers.target.device) as where:
            target: LabelTarget | None = None
            if not buffers.of_maps:
                target = self.label_target(buffers.target, len(inputs[0]), needs_grad=len(buffers.grads) > 0)
            gradient = _dense_gradient(warp_array(buffers.target)) if target is None else target
            posed = _arrays(inputs)
            parts = wp.empty((inputs[0].shape[0], *size), dtype=wp.uint8, device=where)
            draw, seen, losses = self.prepare_picture(posed, target, parts=parts)
            totals = warp_array(buffers.losses[:, 0])
            sums = losses, totals
            push = self._prepare_gradients(posed, seen, parts, gradient, buffers.grads, sums) if buffers.grads else None

        def launch() -> None:
            draw(everything)
            if push is not None:
                push(everything)
            elif target is not None:
                forces.launch_sum_rows(losses, totals)

        return launch

    def prepare_picture(
        self,
        posed: Sequence[wp.array],
        target: LabelTarget | None = None,
        *,
        parts: wp.array,
        labels: wp.array | None = None,
        depth: wp.array | None = None,
        faults: wp.array | None = None,
    ) -> tuple[Launch, Seen, wp.array]:
        """Launch that fills images, and what else it fills: silhouettes, and sums of L_seg.

        Args:
            posed: Centres, axes, semi-axes and camera.
            target: Label images, if L_seg is asked for.
            parts: Index + 1 of the nearest, shape (B, H, W).
            labels: Array as in ``Picture``, if labels are asked for.
            depth: Array as in ``Picture``, if depth is asked for.
            faults: Array as in ``Picture``, if faults are asked for.
        """
        device, shape = posed[0].device, parts.shape
        seen = self._empty_seen(posed)
        losses, nearest = _nothing(2, float, device.alias), _nothing(3, float, device.alias)
        if target is not None:
            num_losses = ellipsoid_picture.num_partial_losses(device, *shape)
            losses = wp.empty((shape[0], num_losses), dtype=float, device=device)
        if device.is_cpu:
            nearest = wp.empty(shape, dtype=float, device=device)
        if labels is None:
            labels = _nothing(3, wp.uint8, device.alias)
        if depth is None:
            depth = _nothing(3, float, device.alias)
        if faults is None:
            faults = wp.empty(shape[0], dtype=float, device=device)
        outputs = parts, labels, depth, losses, faults
        see, compared = self._prepare_see(wp.device_to_torch(device)), target
        if compared is None:
            compared = LabelTarget()
            compared.extents = _nothing(3, wp.vec4i, device.alias)

        def launch(part: slice) -> None:
            here, cut = _cut_seen(seen, part), [_cut(array, part) for array in outputs]
            see([_cut(array, part) for array in posed], seen=here, extents=_cut(compared.extents, part))
            scratch = _cut(nearest, part)
            ellipsoid_picture.launch_draw(here.silhouettes, compared, scratch, cut, perspective=self.perspective)

        return launch, seen, losses

    def _empty_seen(self, posed: Sequence[wp.array]) -> Seen:
        batch, count = posed[0].shape
        return Seen.empty(batch, count, posed[0].device, neighbours=self.gradient == "coverage")

    def _prepare_see(self, device: torch.device | str) -> Callable[..., None]:
        """Launcher that fills ``seen`` from centres, axes, semi-axes and camera."""
        labels = warp_array(_on_device(self.labels, torch.device(device)))
        return partial(launch_see, part_labels=labels, near=self.near, perspective=self.perspective)

    def _prepare_gradients(
        self,
        posed: Sequence[wp.array],
        seen: Seen,
        parts: wp.array,
        gradient: Any,
        grads: Tensors,
        losses: tuple[wp.array, wp.array] | None = None,
    ) -> Launch:
        """Launch that fills ``grads``, and of ``losses`` the second by sums of the first's rows.

        ``gradient`` is a LabelTarget or a DenseGradient.
        """
        batch, count = posed[0].shape
        if losses is None:
            losses = _nothing(2, float, posed[0].device.alias), _nothing(1, float, posed[0].device.alias)
        sums, outputs = self.make_forces(batch, count, posed[0].device), _arrays(grads)
        launch_forces = self.force_launcher()

        def launch(part: slice) -> None:
            bodies, here = [_cut(array, part) for array in posed], _cut(sums, part)
            shown = _cut_seen(seen, part), _cut(parts, part)
            launch_forces(bodies, *shown, gradient=_cut_gradient(gradient, part), forces=here)
            sums_of_losses = [_cut(array, part) for array in losses]
            forces.launch_spread(bodies[1], bodies[2], here, [_cut(array, part) for array in outputs], *sums_of_losses)

        return launch

    def label_target(self, target: torch.Tensor, batch: int, *, needs_grad: bool = True) -> LabelTarget:
        """Label images (N, H, W) for the kernels; with ``extents``, to be filled, if the gradient asks for them."""
        found = LabelTarget()
        found.target = warp_array(target)
        num_labels = max((label for label in self.labels if label <= MAX_LABEL), default=0)
        needed = needs_grad and self.gradient == "partdr"
        extents = (batch, NUM_EXTENTS, num_labels + 1)
        found.extents = wp.empty(extents if needed else (0, 0, 0), dtype=wp.vec4i, device=found.target.device)
        return found


ellipsoid_passes = device_cache(64)(EllipsoidPasses)  # the same object, which is a graph's key, for the same options


@device_cache(64)
def _on_device(labels: tuple[int, ...], device: torch.device) -> torch.Tensor:
    """Labels on the device, cached: a copy from the host in every call would wait for it."""
    return torch.tensor(labels, dtype=torch.uint8, device=device)


def _arrays(tensors: Iterable[torch.Tensor]) -> list[wp.array]:
    """Centres, axes, semi-axes and camera, or their gradients, as Warp arrays over the same memory."""
    return warp_arrays(tensors, (wp.vec3, wp.mat33, wp.vec3, wp.vec4))


@cache  # an allocation takes 10 us
def _nothing(ndim: int, dtype: type, device: str) -> wp.array:
    """An empty array for what is not asked for."""
    return wp.empty((0,) * ndim, dtype=dtype, device=device)


def _cut(array: wp.array, part: slice) -> wp.array:
    """Slice of an array of bodies; the array itself if that is all, for a view costs 15 us, or if it is empty."""
    return array if part.stop - part.start == array.shape[0] or not array.size else array[part]


def _cut_seen(seen: Seen, part: slice) -> Seen:
    return Seen(*(_cut(array, part) for array in seen))


def _cut_gradient(gradient: Any, part: slice) -> Any:  # LabelTarget or DenseGradient, classes of Warp's own making
    """Slice of the maps of bodies; a label target stays whole, for all bodies of a launch share it."""
    if not hasattr(gradient, "maps"):
        return gradient
    return _dense_gradient(gradient.maps[part])


def _dense_gradient(maps: wp.array) -> DenseGradient:
    dense = DenseGradient()
    dense.maps = maps
    return dense
