"""Checks of numbers by a captured graph, in a fraction of the time that torch takes to launch as many kernels."""

from __future__ import annotations

import math

import torch
import warp as wp

from ..errors import LARGEST
from ..kernels.checks import launch_check_matrices, launch_check_values
from .arrays import warp_array
from .graph_cache import CapturedBodies, Launch, graphs
from .layouts import Shapes, split_blocks, total_length

VALUES, POSITIVE, ROTATIONS, FRAMES = range(4)  # frames are rotations that may mirror
_SHARE = 0.99  # share of the bounds that is accepted, because numbers are rounded on the way


def are_good(tensors: list[torch.Tensor], kinds: tuple[int, ...], tolerance: float) -> bool:
    """True if all numbers are certainly good; False if one is wrong, or if they were not checked here.

    It waits for the device.

    Args:
        tensors: Tensors of one device; matrices have the shape (..., 3, 3).
        kinds: Kind of each tensor: one of the constants above.
        tolerance: Tolerance of matrices, as in ``checks``.
    """
    device = tensors[0].device
    if any(tensor.device != device for tensor in tensors):
        return False
    key = tuple([tensor.shape for tensor in tensors]), kinds, tolerance, device
    graph = graphs.find(key, device, 4 * total_length(key[0]), lambda: _Graph(*key))
    return graph is not None and graph(tensors)


class _Graph:
    def __init__(self, shapes: Shapes, kinds: tuple[int, ...], tolerance: float, device: torch.device) -> None:
        self._inputs = split_blocks(torch.empty(total_length(shapes), device=device), shapes)
        self._faults = torch.zeros(1, dtype=torch.int32, device=device)

        def prepare(_: slice) -> Launch:
            faults = warp_array(self._faults)
            given = [each for each in zip(self._inputs, kinds, strict=True) if each[0].numel()]
            values = [(warp_array(tensor.view(-1)), kind) for tensor, kind in given]
            matrices = [
                (warp_array(tensor.view(-1, 3, 3), wp.mat33), kind)
                for tensor, kind in given
                if kind in (ROTATIONS, FRAMES)
            ]

            def launch() -> None:
                faults.zero_()
                for array, kind in values:
                    above = 0.0 if kind == POSITIVE else -math.inf
                    launch_check_values(array, largest=_SHARE * LARGEST, above=above, faults=faults)
                for array, kind in matrices:
                    mirrored = kind == FRAMES
                    launch_check_matrices(array, tolerance=_SHARE * tolerance, mirrored=mirrored, faults=faults)

            return launch

        self._launches = CapturedBodies(prepare, 1, device)

    def __call__(self, tensors: list[torch.Tensor]) -> bool:
        torch._foreach_copy_(self._inputs, tensors)
        self._launches.replay()
        return not self._faults.item()
