"""Exact ellipsoids in fixed buffers, by launches alone, so that a graph can capture them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
import warp as wp

from ..interop.arrays import warp_array
from ..kernels.ellipsoids.forces import make_forces
from ..kernels.ellipsoids.picture import launch_draw, num_partial_losses
from ..kernels.ellipsoids.silhouette import Seen, launch_see
from ..kernels.labels import LabelTarget, launch_find_reach
from ..kernels.refine.state import Drawn, EllipsoidArrays
from .ellipsoid_passes import EllipsoidOptions
from .renderers import RendererEllipsoids


class CapturedEllipsoids:
    """Draws B bodies and compares them with N label images.

    Args:
        renderer: The gradient's options.
        part_labels: Label that each ellipsoid shows.
        targets: Label images, shape (N, size, size), uint8, on the bodies' device; body b is compared with number
            b % N. What is written there later is seen after ``update``.
        ellipsoids: Posed parts and cameras, B of them.

    Attributes:
        drawn: L_seg [px of the drawn crop] and its forces, which ``launch`` fills.
    """

    def __init__(
        self,
        renderer: RendererEllipsoids,
        part_labels: Sequence[int],
        targets: torch.Tensor,
        ellipsoids: EllipsoidArrays,
    ) -> None:
        device, (count, height, width) = ellipsoids.centres.device, targets.shape
        batch, parts = ellipsoids.centres.shape
        self._posed = ellipsoids.centres, ellipsoids.axes, ellipsoids.semi_axes, ellipsoids.camera
        self._part_labels = wp.array(list(part_labels), dtype=wp.uint8, device=device)
        self._seen = Seen.empty(batch, parts, device)
        self._parts = wp.empty((batch, height, width), dtype=wp.uint8, device=device)
        self._no_labels = wp.empty((0, 0, 0), dtype=wp.uint8, device=device)
        self._no_depth = wp.empty((0, 0, 0), dtype=float, device=device)
        self._nearest = wp.empty((batch, height, width) if device.is_cpu else (0, 0, 0), dtype=float, device=device)
        target = self._target = LabelTarget()
        target.target = warp_array(targets)
        reach = (count, 2, max((label for label in part_labels if label < 255), default=0) + 1, max(height, width))
        target.reach = wp.empty(reach if renderer.gradient == "partdr" else (0, 0, 0, 0), dtype=wp.vec2i, device=device)

        drawn = self.drawn = Drawn()
        drawn.loss = wp.empty((batch, num_partial_losses(device, batch, height, width)), dtype=float, device=device)
        drawn.forces = make_forces(batch, parts, device)
        self._launch_forces = EllipsoidOptions(**vars(renderer)).launcher()

    def update(self) -> None:
        """Update what depends on the targets after they were written to."""
        if self._target.reach.size > 0:
            launch_find_reach(self._target.target, self._target.reach)

    def launch(self) -> None:
        """Project, draw, compare, sum the forces."""
        seen = self._seen
        launch_see(self._posed, self._part_labels, near=-math.inf, perspective=False, seen=seen)
        launch_draw(
            seen.silhouettes,
            perspective=False,
            target=self._target,
            nearest=self._nearest,
            parts=self._parts,
            labels=self._no_labels,
            depth=self._no_depth,
            losses=self.drawn.loss,
        )
        self._launch_forces(
            self._posed, seen, self._parts, perspective=False, gradient=self._target, forces=self.drawn.forces
        )
