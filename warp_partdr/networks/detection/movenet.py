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


def read_people(maps: Mapping[str, torch.Tensor], min_heat: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """People with a heat of at least ``min_heat`` at their centre; scores may be less.

    Args:
        maps: The detector's maps of B pictures, (B, C, H, W): "centre" and "heat", logits; "size" and "centre_offset"
            of boxes; "keypoints", the way from a centre to each, and "keypoint_offset" [cells].
        min_heat: Least heat of a centre, 0 to 1.

    Returns:
        Index of each person's picture, shape (N,), rising; scores, 0 to 1, shape (N,); and 17 keypoints with x, y [px]
        and confidence, shape (N, 17, 3).
    """
    heat = maps["centre"].sigmoid()
    highest = F.max_pool2d(heat, _AROUND, stride=1, padding=_AROUND // 2)
    pictures, rows, columns = ((heat > highest - _EQUAL) & (heat >= min_heat))[:, 0].nonzero(as_tuple=True)
    cells = torch.stack([columns, rows], dim=1).to(heat)

    def at_centre(name: str) -> torch.Tensor:
        """Pairs (x, y) of a map at the centres, shape (N, K, 2)."""
        return maps[name][pictures, :, rows, columns].unflatten(1, (-1, 2)).flip(-1)

    half, middle = at_centre("size").clamp_min(0.0) / 2, cells[:, None] + at_centre("centre_offset")
    boxes = torch.cat([middle - half, middle + half], dim=1)
    expected = cells[:, None] + at_centre("keypoints")
    parts = [slice(start, start + _TOGETHER) for start in range(0, max(len(pictures), 1), _TOGETHER)]
    keypoints = torch.cat([_read_keypoints(maps, pictures[part], boxes[part], expected[part]) for part in parts])
    sure = keypoints[..., 2] > SURE
    mean = (keypoints[..., 2] * sure).sum(dim=1) / sure.sum(dim=1).clamp_min(1)
    return pictures, heat[pictures, 0, rows, columns] * mean, keypoints


def _read_keypoints(
    maps: Mapping[str, torch.Tensor], pictures: torch.Tensor, boxes: torch.Tensor, expected: torch.Tensor
) -> torch.Tensor:
    """Keypoints as ``read_people`` returns them: the hottest cells in boxes, near expected ones [cells]."""
    height, width = maps["heat"].shape[2:]
    spread = _NEAR * min(height, width)

    def nearness(axis: int, length: int) -> torch.Tensor:
        """Weights of columns or of rows, shape (N, 17, length): 0 outside the box, and else of a bell curve."""
        steps = torch.arange(length, device=boxes.device).to(boxes)
        low, high = boxes[:, :, axis, None].unbind(1)
        inside = (steps >= low) & (steps < high)
        return (-((steps - expected[..., axis, None]) ** 2) / spread).exp() * inside[:, None]

    heat = maps["heat"][pictures].sigmoid() * nearness(0, width)[:, :, None] * nearness(1, height)[..., None]
    confidence, best = heat.flatten(2).max(dim=2)
    offsets = maps["keypoint_offset"].unflatten(1, (-1, 2)).flip(2).flatten(3)
    numbers = torch.arange(NUM_KEYPOINTS, device=best.device)
    found = torch.stack([best % width, best // width], dim=-1) + offsets[pictures[:, None], numbers, :, best]
    return torch.cat([STRIDE * found, confidence[..., None]], dim=2)
