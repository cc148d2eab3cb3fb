"""Part labels of those who have no part network: a person's mask, cut where the nearest bone changes."""

from __future__ import annotations

import numpy as np
import torch
import warp as wp

from ...body.template import BONE_STARTS, MEAN_STATURE, NUM_PARTS, SHAPE_INDICES, template
from ...interop.arrays import warp_array
from ...interop.device_cache import device_cache
from ...interop.streams import launch_bodies_on
from ...kernels import bone_cuts
from ...networks.regression.heads import cell_centres

_SHORT = 1e-4  # [half-sides of the crop]: shorter bones are points


def cut_mask(mask: torch.Tensor, joints: torch.Tensor, statures: torch.Tensor, unsure: torch.Tensor) -> torch.Tensor:
    """Parts by the nearest bone, less half the part's thickness of a mean adult.

    Args:
        mask: Pixels of the person, shape (B, S, S), bool.
        joints: Joints ``JOINT_NAMES`` in crop coordinates, shape (B, 21, 2).
        statures: Height of each person standing, in crop coordinates, shape (B,).
        unsure: Flag for each person whose pixels become unknown within parts that are no neighbours, shape (B,), bool.

    Returns:
        Labels 0 to 20, or 255 for unknown, shape (B, S, S), uint8.
    """
    radii = _radii(joints.device) * (statures / MEAN_STATURE)[:, None]
    starts = joints[:, _starts(joints.device)]
    bones = joints[:, 1:] - starts
    squares = bones.square().sum(2).clamp_min(_SHORT**2)
    centres, close = cell_centres(mask.shape[-1], joints.device), _close(joints.device)
    labels = torch.empty(mask.shape, dtype=torch.uint8, device=joints.device)

    def launch(part: slice) -> None:
        points = [warp_array(each[part], wp.vec2) for each in (starts, bones)]
        numbers = [warp_array(each[part]) for each in (squares, radii, unsure)]
        arrays = [*points, *numbers, warp_array(close)]
        bone_cuts.launch_cuts(warp_array(mask[part]), arrays, warp_array(centres), warp_array(labels[part]))

    launch_bodies_on(joints.device, launch, len(mask), [bone_cuts])
    return labels


@device_cache(8)
def _starts(device: torch.device) -> torch.Tensor:
    """Joints that the parts' bones start from, shape (20,), int64."""
    return torch.tensor(BONE_STARTS, device=device)


@device_cache(8)
def _radii(device: torch.device) -> torch.Tensor:
    """Half the mean thicknesses of the parts [m], shape (20,)."""
    thicknesses = template().mean_thicknesses
    return torch.tensor([(thicknesses[a] + thicknesses[b]) / 4 for _, a, b in SHAPE_INDICES], device=device).float()


@device_cache(8)
def _close(device: torch.device) -> torch.Tensor:
    """Bits of the parts that share a joint with each label's, or with one that does, shape (21,), int32."""
    ends = np.eye(NUM_PARTS + 1, dtype=np.int64)
    ends = ends[BONE_STARTS] + ends[1:]
    meet = ends @ ends.T > 0
    bits = (meet @ meet) @ (1 << np.arange(NUM_PARTS))
    return torch.tensor([0, *bits.tolist()], dtype=torch.int32, device=device)
