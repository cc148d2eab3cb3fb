"""What a fit sees of one person: a square crop with keypoints and labels, from which everybody else is left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from .body.labels import IGNORE
from .cameras import Crop
from .energy import REFERENCE_SIZE, Observation
from .errors import InputError
from .keypoints import Keypoints2D
from .missing_labels import ignore_missing_limbs
from .part_files import PartLabels
from .person import crop_nearest, person_crop, select_person

CROP_MARGIN = 0.1  # of the person's extent, on each side
LARGEST_PLACE = 1e6  # [px] of a keypoint
LABEL_SIZE = 512  # [px] side of the crop that labels are kept at, twice what is drawn


def observe(
    keypoints: Keypoints2D,
    parts: PartLabels | None,
    *,
    others: Sequence[Keypoints2D] = (),
    trust_background: bool = False,
    device: torch.device | str = "cpu",
) -> tuple[Observation, Crop]:
    """Cut one person out: a square crop, keypoints in it from -1 to 1; other people and missing limbs are ignored."""
    visible = keypoints.visible
    if not visible.any():
        raise InputError("keypoints: none is visible; expected at least one with a confidence above 0")
    if not (np.abs(keypoints.points[visible]) <= LARGEST_PLACE).all():
        raise InputError(f"keypoints: hold NaN, or numbers beyond {LARGEST_PLACE:g}; expected pixels")
    if len(np.unique(keypoints.points[visible], axis=0)) < 2:
        raise InputError("keypoints: all lie in one point; expected different places")
    groups = None
    if parts is not None:
        groups = select_person(parts.groups, keypoints, others)
        if not trust_background:
            groups = ignore_missing_limbs(groups, keypoints)
    empty = np.zeros((1, 1), dtype=np.uint8)
    x0, y0, x1, y1 = person_crop(keypoints, empty if groups is None else groups, CROP_MARGIN)
    half = max(x1 - x0, y1 - y0) / 2
    u, v = (x0 + x1) / 2, (y0 + y1) / 2
    box = (u - half, v - half, u + half, v + half)
    crop = Crop(left=box[0], top=box[1], zoom=REFERENCE_SIZE / (2 * half), size=(REFERENCE_SIZE, REFERENCE_SIZE))
    size = (LABEL_SIZE, LABEL_SIZE)
    labels = None if groups is None else torch.from_numpy(crop_nearest(groups, box, size)).to(device)
    maps = known = None
    if parts is not None and parts.maps is not None and groups is not None:
        seen = np.where(groups == IGNORE, 0.0, parts.maps.sum(0)).astype(np.float32)
        maps = torch.from_numpy(crop_nearest(parts.maps[1:], box, size, fill=0.0)).to(device)
        known = torch.from_numpy(crop_nearest(seen, box, size, fill=0.0)).to(device)
    points = (keypoints.points[visible] - (u, v)) / half
    names = [name for name, there in zip(keypoints.format.landmarks, visible, strict=True) if there]
    return (
        Observation(
            landmarks=tuple(names),
            points=torch.tensor(points, dtype=torch.float32, device=device),
            confidence=torch.tensor(keypoints.confidence[visible], dtype=torch.float32, device=device),
            labels=labels,
            label_set=None if parts is None else parts.label_set,
            maps=maps,
            known=known,
        ),
        crop,
    )
