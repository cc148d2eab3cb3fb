"""Warps share an ellipsoid's work: their sums of forces add up to the whole."""

import math

import pytest
import torch
import warp as wp

from warp_partdr.interop.arrays import contiguous, warp_array
from warp_partdr.kernels.ellipsoids.forces import NUM_SUMS
from warp_partdr.lab.bench.scene import LABELS, BenchScene
from warp_partdr.render.ellipsoid_passes import ellipsoid_passes
from warp_partdr.render.renderers import RendererEllipsoids

_SIZE, _BATCH = 96, 2
_TOLERANCES = {"edges": 1e-5, "partdr": 1e-5, "coverage": 0.03}  # of the largest; shares set the steps of outlines


@pytest.mark.parametrize("gradient", _TOLERANCES)
def test_shares_of_forces_add_up_to_the_whole(device, gradient):
    scene = BenchScene.random(_BATCH, _SIZE, device)
    posed = [
        warp_array(contiguous(scene.posed.centres), wp.vec3),
        warp_array(contiguous(scene.posed.axes), wp.mat33),
        warp_array(contiguous(scene.posed.semi_axes), wp.vec3),
        warp_array(contiguous(scene.camera.intrinsics), wp.vec4),
    ]
    labels = tuple(LABELS.part_groups[1:].tolist())
    passes = ellipsoid_passes(labels, False, near=-math.inf, **vars(RendererEllipsoids(gradient)))
    target = passes.label_target(scene.targets, _BATCH)
    parts = wp.empty((_BATCH, _SIZE, _SIZE), dtype=wp.uint8, device=posed[0].device)
    draw, seen, _ = passes.prepare_picture(posed, target, parts=parts)

    def sums(shares: int) -> torch.Tensor:
        forces = wp.full((_BATCH, len(labels), shares, NUM_SUMS), math.nan, dtype=float, device=posed[0].device)
        draw(slice(0, _BATCH))
        passes.force_launcher()(posed, seen, parts, gradient=target, forces=forces)
        wp.synchronize_device(posed[0].device)
        return wp.to_torch(forces).sum(2).cpu()

    whole = sums(1)
    assert whole.abs().amax((0, 1)).min() > 0
    for shares in (2, 3, 7):
        assert (sums(shares) - whole).abs().max() < _TOLERANCES[gradient] * whole.abs().max()
