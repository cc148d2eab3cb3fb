"""Part labels of those who have no part network: a person's mask, cut where the nearest bone changes."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch

from ..body.labels import BACKGROUND, IGNORE
from ..body.template import BONE_STARTS, MEAN_STATURE, NUM_PARTS, SHAPE_INDICES, template
from ..network.heads import cell_centres

_SHORT = 1e-4  # [half-sides of the crop]: shorter bones are points


def cut_mask(mask: torch.Tensor, joints: torch.Tensor, statures: torch.Tensor, unsure: torch.Tensor) -> torch.Tensor:
    """Parts by the nearest bone, less half the part's thickness of a mean adult.

    Args:
        mask: Pixels of the person, shape (B, S, S), bool.
        joints: ``JOINT_NAMES`` in crop coordinates, shape (B, 21, 2).
        statures: Crop coordinates that a standing person spans, shape (B,).
        unsure: Where pixels within parts that are no neighbours are to be unknown, shape (B,), bool.

    Returns:
        Labels 0 to 20, or 255 for unknown, shape (B, S, S), uint8.
    """
    radii = _radii(joints.device) * (statures / MEAN_STATURE)[:, None]
    centres = cell_centres(mask.shape[-1], joints.device)
    best = torch.full(mask.shape, torch.inf, device=joints.device)
    labels = torch.zeros(mask.shape, dtype=torch.uint8, device=joints.device)
    inside = torch.zeros(mask.shape, dtype=torch.int32, device=joints.device)  # a bit for each part
    for part, start in enumerate(BONE_STARTS):
        bone = joints[:, part + 1] - joints[:, start]
        right, down = (centres - joints[:, start, axis, None] for axis in range(2))  # (B, S) each, from where it starts
        right, down, along, across = right[:, None, :], down[:, :, None], *bone[:, :, None, None].unbind(1)
        share = (right * along + down * across) / bone.square().sum(1).clamp_min(_SHORT**2)[:, None, None]
        share = share.clamp(0.0, 1.0)
        distance = torch.hypot(right - share * along, down - share * across) - radii[:, part, None, None]
        labels = torch.where(distance < best, part + 1, labels)
        best = torch.minimum(best, distance)
        inside |= (distance < 0).int() << part
    overlap = (inside & ~_close(joints.device)[labels.long()]) != 0
    labels = torch.where(overlap & unsure[:, None, None], IGNORE, labels)
    return torch.where(mask, labels, BACKGROUND).to(torch.uint8)


@lru_cache(maxsize=8)
def _radii(device: torch.device) -> torch.Tensor:
    """Half the mean thicknesses of the parts [m], shape (20,)."""
    thicknesses = template().mean_thicknesses
    return torch.tensor([(thicknesses[a] + thicknesses[b]) / 4 for _, a, b in SHAPE_INDICES], device=device).float()


@lru_cache(maxsize=8)
def _close(device: torch.device) -> torch.Tensor:
    """Bits of the parts that share a joint with each label's, or with one that does, shape (21,), int32."""
    ends = np.eye(NUM_PARTS + 1, dtype=np.int64)
    ends = ends[BONE_STARTS] + ends[1:]
    meet = ends @ ends.T > 0
    bits = (meet @ meet) @ (1 << np.arange(NUM_PARTS))
    return torch.tensor([0, *bits.tolist()], dtype=torch.int32, device=device)
