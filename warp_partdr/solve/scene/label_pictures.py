"""Label pictures of a scene: one for each person who overlaps nobody, and one for each group of people who overlap."""

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

NO_LENS = (1.0, 0.0, 0.0)  # lens of a picture that shows nobody
_MARGIN = 0.02  # margin of a crop around several people, as a share of its side


def cluster_pictures(
    plan: ScenePlan, clusters: Clusters, size: int, observed_bodies: Sequence[ObservedBody]
) -> LabelPictures | None:
    """Draws the label pictures of clusters in all frames and views.

    Args:
        plan: Plan of the scene's fit.
        clusters: Clusters to draw.
        size: Side of the pictures [px].
        observed_bodies: Bodies that ``observe_scene`` returns.

    Returns:
        Pictures, which are all 255 (ignored) if no observation belongs to them. None if there is no cluster.
    """
    if not clusters:
        return None
    scene = plan.scene
    like = observed_bodies[0].body.log_scale
    slots, rows = slots_of(clusters, scene.num_people, like.device)
    places: list[list[int]] = rows.tolist()
    shape = len(clusters) * scene.num_frames * len(scene.views), size, size
    target = torch.full(shape, IGNORE, dtype=torch.uint8, device=like.device)
    lenses = like.new_tensor(NO_LENS).repeat(shape[0], 1)
    groups: dict[int, list[ObservedBody]] = {}
    for observed in observed_bodies:
        cluster = places[observed.person][0]
        if cluster >= 0 and observed.observation.labels is not None:
            row = cluster * scene.num_frames + observed.frame
            groups.setdefault(row * len(scene.views) + observed.view, []).append(observed)
    for picture, group in groups.items():
        if len(group) == 1:
            observed = group[0]
            assert observed.observation.labels is not None
            assert observed.observation.lens is not None
            target[picture] = _shifted(resize_nearest(observed.observation.labels, size), observed, places)
            lenses[picture] = observed.observation.lens
        else:
            target[picture], lenses[picture] = _shared_labels(group, places, size, scene.views[group[0].view], like)
    return LabelPictures.of(target, Slots(lenses, slots, rows))


def _shifted(labels: torch.Tensor, observed: ObservedBody, places: Sequence[Sequence[int]]) -> torch.Tensor:
    """Group ids of a person, shifted to the ids that the person has in the cluster's pictures."""
    shifted = labels + places[observed.person][1] * observed.evidence.labels.label_set.num_groups
    return torch.where((labels == BACKGROUND) | (labels == IGNORE), labels, shifted.to(torch.uint8))


def _shared_labels(
    group: Sequence[ObservedBody], places: Sequence[Sequence[int]], size: int, view: View, like: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Labels of several people in one crop around them, and the lens of the crop."""
    sides = [observed.crop.size[0] / observed.crop.zoom for observed in group]
    low = np.min([(observed.crop.left, observed.crop.top) for observed in group], axis=0)
    corners = [
        (observed.crop.left + side, observed.crop.top + side) for observed, side in zip(group, sides, strict=True)
    ]
    high = np.max(corners, axis=0)
    side = float((high - low).max()) * (1 + _MARGIN)
    left, top = (low + high - side) / 2
    crop = Crop(float(left), float(top), REFERENCE_SIZE / side, (REFERENCE_SIZE, REFERENCE_SIZE))
    box = (crop.left, crop.top, crop.left + side, crop.top + side)
    targets = [torch.from_numpy(observed.evidence.target((size, size), box)).to(like.device) for observed in group]
    stack = torch.stack(targets)
    known = (stack != BACKGROUND) & (stack != IGNORE)
    shifted = torch.stack([_shifted(labels, each, places) for labels, each in zip(targets, group, strict=True)])
    # A pixel belongs to a person if only this person's labels claim it. It is background if all labels say so.
    owned = torch.where(known, shifted, 0).sum(0).to(torch.uint8)
    rest = torch.where((stack == BACKGROUND).all(0), BACKGROUND, IGNORE).to(torch.uint8)
    return torch.where(known.sum(0) == 1, owned, rest), crop_lens(view.camera, crop).to(like)
