"""Label pictures of a scene: of each person who overlaps nobody, and of all who overlap in one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ...body.labels import BACKGROUND, IGNORE
from ...cameras import Crop
from ...inputs.observation import REFERENCE_SIZE, crop_lens, resize_nearest
from ...inputs.scene import View
from ..mesh.observed_body import ObservedBody
from ..mesh.starts import LabelPictures, Slots
from .clusters import Clusters, slots_of
from .plan import ScenePlan

NO_LENS = (1.0, 0.0, 0.0)  # of a picture that nobody is seen in
_MARGIN = 0.02  # of a picture's crop around several people


def cluster_pictures(
    plan: ScenePlan, clusters: Clusters, size: int, looks: Sequence[ObservedBody]
) -> LabelPictures | None:
    """Pictures of these clusters in crops of a size, all ignored where nobody is seen; None if there is no cluster."""
    if not clusters:
        return None
    scene, like = plan.scene, looks[0].body.log_scale
    slots, rows = slots_of(clusters, scene.num_people, like.device)
    places: list[list[int]] = rows.tolist()
    shape = len(clusters) * scene.num_frames * len(scene.views), size, size
    target = torch.full(shape, IGNORE, dtype=torch.uint8, device=like.device)
    lenses = like.new_tensor(NO_LENS).repeat(shape[0], 1)
    groups: dict[int, list[ObservedBody]] = {}
    for look in looks:
        cluster = places[look.sight.person][0]
        if cluster >= 0 and look.observation.labels is not None:
            row = cluster * scene.num_frames + look.sight.frame
            groups.setdefault(row * len(scene.views) + look.sight.view, []).append(look)
    for picture, group in groups.items():
        if len(group) == 1:
            look = group[0]
            assert look.observation.labels is not None
            assert look.observation.lens is not None
            labels = _shifted(resize_nearest(look.observation.labels, size), look, places)
            target[picture], lenses[picture] = labels, look.observation.lens
        else:
            target[picture], lenses[picture] = _together(group, places, size, scene.views[group[0].sight.view], like)
    return LabelPictures.of(target, Slots(lenses, slots, rows))


def _shifted(labels: torch.Tensor, look: ObservedBody, places: Sequence[Sequence[int]]) -> torch.Tensor:
    """Group ids of a person as the cluster's pictures have them."""
    moved = labels + places[look.sight.person][1] * look.evidence.labels.label_set.num_groups
    return torch.where((labels == BACKGROUND) | (labels == IGNORE), labels, moved.to(torch.uint8))


def _together(
    group: Sequence[ObservedBody], places: Sequence[Sequence[int]], size: int, view: View, like: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Labels of several people in one crop around them, and its lens."""
    sides = [look.crop.size[0] / look.crop.zoom for look in group]
    low = np.min([(look.crop.left, look.crop.top) for look in group], axis=0)
    high = np.max(
        [(look.crop.left + side, look.crop.top + side) for look, side in zip(group, sides, strict=True)], axis=0
    )
    side = float((high - low).max()) * (1 + _MARGIN)
    left, top = (low + high - side) / 2
    crop = Crop(float(left), float(top), REFERENCE_SIZE / side, (REFERENCE_SIZE, REFERENCE_SIZE))
    box = (crop.left, crop.top, crop.left + side, crop.top + side)
    each = [torch.from_numpy(look.evidence.target((size, size), box)).to(like.device) for look in group]
    stack = torch.stack(each)
    known = (stack != BACKGROUND) & (stack != IGNORE)
    shifted = torch.stack([_shifted(labels, look, places) for labels, look in zip(each, group, strict=True)])
    # A pixel is somebody's if just one says so, and background if all do.
    owned = torch.where(known, shifted, 0).sum(0).to(torch.uint8)
    rest = torch.where((stack == BACKGROUND).all(0), BACKGROUND, IGNORE).to(torch.uint8)
    return torch.where(known.sum(0) == 1, owned, rest), crop_lens(view.camera, crop).to(like)
