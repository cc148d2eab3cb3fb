"""L_seg and its forces for the fused refinement: exact ellipsoids, in fixed buffers and with launches alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
import warp as wp

from ..kernels.ellipsoids.forces import make_forces
from ..kernels.ellipsoids.picture import launch_draw, num_partial_losses
from ..kernels.ellipsoids.silhouette import Seen, launch_see
from ..kernels.labels import LabelTarget, launch_find_reach
from ..kernels.refine.state import Drawn, Ellipsoids
from ..render.ellipsoid_passes import Options
from ..render.ellipsoids import DEFAULT_HALVINGS, DEFAULT_STEPS_PER_PIXEL
from ..render.mesh import weight_table
from .energy import Energy


class EllipsoidPicture:
    """Draws B bodies and compares them with the labels that N energies saw; a ``PartRenderer``.

    Args:
        energies: With labels of one label set, drawn at one size.
        ellipsoids: Posed parts and cameras, B of them.
        active: Flags (B,) of bodies that still move.

    Attributes:
        drawn: Where ``launch`` leaves L_seg [px of the drawn crop] and its forces.
    """

    def __init__(
        self,
        energies: Sequence[Energy],
        ellipsoids: Ellipsoids,
        active: wp.array,
    ) -> None:
        energy = energies[0]
        label_set = energy.observation.label_set
        if label_set is None:
            raise ValueError("energies: no label set; expected labels and what they mean")
        device, size = ellipsoids.centres.device, energy.size
        batch, parts = ellipsoids.centres.shape
        self._label_set, self._active = label_set, active
        self._posed = ellipsoids.centres, ellipsoids.axes, ellipsoids.semi_axes, ellipsoids.camera
        self._part_labels = wp.array(label_set.part_groups[1:], dtype=wp.uint8, device=device)
        self._seen = Seen.empty(batch, parts, device)
        self._parts = wp.empty((batch, size, size), dtype=wp.uint8, device=device)
        self._no_labels = wp.empty((0, 0, 0), dtype=wp.uint8, device=device)
        self._no_depth = wp.empty((0, 0, 0), dtype=float, device=device)
        self._nearest = wp.empty((batch, size, size) if device.is_cpu else (0, 0, 0), dtype=float, device=device)

        torch_device = wp.device_to_torch(device)
        self._targets = torch.empty(len(energies), size, size, dtype=torch.uint8, device=torch_device)
        target = self._target = LabelTarget()
        target.target = wp.from_torch(self._targets)
        target.label_weights = wp.from_torch(weight_table(None, torch_device))
        reach = (len(energies), 2, label_set.num_groups + 1, size) if energy.gradient == "partdr" else (0, 0, 0, 0)
        target.reach = wp.empty(reach, dtype=wp.vec2i, device=device)

        drawn = self.drawn = Drawn()
        drawn.loss = wp.empty((batch, num_partial_losses(device, batch, size, size)), dtype=float, device=device)
        drawn.forces = make_forces(batch, parts, device)

        self._launch_forces = Options(
            energy.gradient,
            over_farther=True,
            max_distance=energy.max_distance,
            depth_weight=energy.depth_weight,
            steps_per_pixel=DEFAULT_STEPS_PER_PIXEL,
            halvings=DEFAULT_HALVINGS,
        ).launcher()

    def observe(self, energies: Sequence[Energy]) -> None:
        """Copy new targets.

        Raises:
            ValueError: If an energy compares no labels, or those of another label set.
        """
        for row, energy in enumerate(energies):
            if energy.target is None or energy.observation.label_set != self._label_set:
                raise ValueError(f"energies: another label set or none; expected {self._label_set.name!r}")
            self._targets[row] = energy.target
        if self._target.reach.size > 0:
            launch_find_reach(self._target.target, self._target.reach)

    def launch(self) -> None:
        """See, draw, compare."""
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
            active=self._active,
        )
        self._launch_forces(
            self._posed,
            seen,
            self._parts,
            perspective=False,
            gradient=self._target,
            forces=self.drawn.forces,
            active=self._active,
        )
