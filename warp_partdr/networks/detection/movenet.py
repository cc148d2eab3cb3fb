"""People in the maps of the detector, MoveNet MultiPose: places of high heat, and 17 keypoints of each.

The network's last operators in plain torch, for all places above a score instead of the six best. A map has a cell for
4 x 4 pixels of the picture. Points are (x, y), where the network's channels have y first.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
import torch.nn.functional as F

NUM_KEYPOINTS = 17  # COCO's
STRIDE = 4  # [px] of a cell
_AROUND = 5  # side of the square of cells in which there is one person's centre
_EQUAL = 1e-6  # heats that differ less are equal
_NEAR = 0.3  # variance of a keypoint's distance from where it is expected, twice, as a share of the map's side [cells]
SURE = 0.127  # confidence above which a keypoint counts for a person's score
_TOGETHER = 64  # people whose maps are read at a time


def read_people(maps: Mapping[str, torch.Tensor], min_score: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """People with a heat of at least ``min_score`` at their centre; scores may be less.

    Args:
        maps: The detector's maps of B pictures, (B, C, H, W): "centre" and "heat", logits; "size" and "centre_offset"
            of boxes; "keypoints", the way from a centre to each, and "keypoint_offset" [cells].
        min_score: Least heat of a centre, 0 to 1.

    Returns:
        Index of each person's picture, shape (N,), rising; scores, 0 to 1, shape (N,); and 17 keypoints with x, y [px]
        and confidence, shape (N, 17, 3).
    """
    heat = maps["centre"].sigmoid()
    highest = F.max_pool2d(heat, _AROUND, stride=1, padding=_AROUND // 2)
    pictures, rows, columns = ((heat > highest - _EQUAL) & (heat >= min_score))[:, 0].nonzero(as_tuple=True)
    parts = zip(*(each.split(_TOGETHER) for each in (pictures, rows, columns)), strict=True)
    keypoints = torch.cat([_read_keypoints(maps, *part) for part in parts])
    sure = keypoints[..., 2] > SURE
    mean = (keypoints[..., 2] * sure).sum(dim=1) / sure.sum(dim=1).clamp_min(1)
    return pictures, heat[pictures, 0, rows, columns] * mean, keypoints


def _read_keypoints(
    maps: Mapping[str, torch.Tensor], pictures: torch.Tensor, rows: torch.Tensor, columns: torch.Tensor
) -> torch.Tensor:
    """Keypoints of people with centres in these cells, as ``read_people`` returns them, shape (N, 17, 3)."""
    height, width = maps["heat"].shape[2:]

    def at_centre(name: str) -> torch.Tensor:
        """Pairs (x, y) of a map at the centres, shape (N, K, 2)."""
        return maps[name][pictures, :, rows, columns].unflatten(1, (-1, 2)).flip(-1)

    cells = torch.stack([columns, rows], dim=1)[:, None].to(maps["heat"])
    size, middle = at_centre("size").clamp_min(0.0), cells + at_centre("centre_offset")
    expected = cells + at_centre("keypoints")
    low, high = middle - size / 2, middle + size / 2
    spread = _NEAR * min(height, width)

    def nearness(axis: int, length: int) -> torch.Tensor:
        """Weights of columns or of rows, shape (N, 17, length): 0 outside the box, and else of a bell curve."""
        steps = torch.arange(length, device=cells.device).to(cells)
        inside = (steps >= low[..., axis, None]) & (steps < high[..., axis, None])
        return (-((steps - expected[..., axis, None]) ** 2) / spread).exp() * inside

    heat = maps["heat"][pictures].sigmoid() * nearness(0, width)[:, :, None] * nearness(1, height)[..., None]
    confidence, best = heat.flatten(2).max(dim=2)
    found = torch.stack([best % width, best // width], dim=-1).to(cells)
    offsets = maps["keypoint_offset"].unflatten(1, (-1, 2)).flip(2).flatten(3)
    numbers = torch.arange(NUM_KEYPOINTS, device=cells.device)
    points = STRIDE * (found + offsets[pictures[:, None], numbers, :, best])
    return torch.cat([points, confidence[..., None]], dim=2)
