"""Exact ellipsoids in fixed buffers, by launches alone, so that a graph can capture them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch
import warp as wp

from ..cameras import ScreenCamera
from ..kernels.refine.state import Drawn, EllipsoidArrays
from .ellipsoid_passes import ellipsoid_passes
from .renderers import RendererEllipsoids


class CapturedEllipsoids:
    """Draws B bodies and compares them with N label images.

    Args:
        renderer: The gradient's options.
        part_labels: Label that each ellipsoid shows.
        targets: Label images, shape (N, size, size), uint8, on the bodies' device; body b is compared with number
            b % N.
        ellipsoids: Posed parts and cameras, B of them.
        perspective: Kind of the cameras.

    Attributes:
        drawn: L_seg [px of the drawn crop] and its forces, which ``launch`` fills.
    """

    def __init__(
        self,
        renderer: RendererEllipsoids,
        part_labels: Sequence[int],
        targets: torch.Tensor,
        ellipsoids: EllipsoidArrays,
        perspective: bool = False,
    ) -> None:
        batch, parts = ellipsoids.centres.shape
        device, size = ellipsoids.centres.device, targets.shape[1:]
        posed = ellipsoids.centres, ellipsoids.axes, ellipsoids.semi_axes, ellipsoids.camera
        shown = wp.empty((batch, *size), dtype=wp.uint8, device=device)
        near = ScreenCamera(perspective).near_plane
        passes = ellipsoid_passes(tuple(part_labels), perspective, near=near, **vars(renderer))
        target = passes.label_target(targets, batch)
        drawn = self.drawn = Drawn()
        self._draw, seen, drawn.loss = passes.prepare_picture(posed, target, parts=shown)
        drawn.forces = passes.make_forces(batch, parts, device)
        self._push = partial(passes.force_launcher(), posed, seen, shown, gradient=target, forces=drawn.forces)
        self._bodies = slice(0, batch)

    def launch(self) -> None:
        """Project, draw, compare, sum the forces."""
        self._draw(self._bodies)
        self._push()
