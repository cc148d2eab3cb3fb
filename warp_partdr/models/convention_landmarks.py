"""Landmarks of detailed models where data sets mark them: ``CONVENTIONS`` of ``body/landmarks.py``, and COCO's middles.

A data set's joint is fixed to the trunk or the head, some way off the landmark of its name. On a detailed model it is
a mean of a few vertices that one joint carries, with weights, some of them negative, that put it there at rest. So it
moves with its part, and scales with the body.
"""

from __future__ import annotations

from dataclasses import replace

import torch

from ..body.landmarks import CONVENTIONS, LANDMARKS, plain_landmark, rest_offset, without_side
from ..body.template import MEAN_STATURE, PART_NAMES
from .measuring import statures
from .model import DetailedModel

_CARRIERS = 8  # vertices that carry a part's landmarks
_CANDIDATES = 300  # vertices that they are chosen from: those that the part's joint carries most


@torch.no_grad()
def with_conventions(model: DetailedModel) -> DetailedModel:
    """Add the landmarks of ``CONVENTIONS`` to a model, and COCO's middles if it has the hips and shoulders."""
    names, weights = list(model.landmark_names), [model.landmark_weights]
    points = torch.cat([model.rest_vertices, model.rest_joints]).double()
    growth = float(statures(model, model.rest_vertices.new_zeros(1, model.num_shapes))) / MEAN_STATURE
    carriers: dict[str, torch.Tensor] = {}
    for convention, offsets in CONVENTIONS.items():
        for mark in (name for name in LANDMARKS if name.startswith(f"{convention}_")):
            name = plain_landmark(mark)
            part = offsets[without_side(name)][0]
            if mark in names or name not in names:
                continue
            if part not in carriers:
                carriers[part] = _carriers(model, "left_hip" if part == "pelvis" else part)
            row = model.landmark_weights[names.index(name)]
            place = row.double() @ points + growth * torch.from_numpy(rest_offset(mark)).to(points)
            weights.append(_mean_at(place, carriers[part], points).to(row)[None])
            names.append(mark)
    for middle, joint in (("coco_neck", "shoulder"), ("coco_mid_hip", "hip")):
        ends = [f"coco_{side}_{joint}" for side in ("left", "right")]
        if middle not in names and all(end in names for end in ends):
            weights.append(model.weights_of(ends).mean(0, keepdim=True))
            names.append(middle)
    return replace(model, landmark_names=tuple(names), landmark_weights=torch.cat(weights))


def _carriers(model: DetailedModel, part: str) -> torch.Tensor:
    """A few vertices far from one another among those that a part's joint carries most, int64."""
    carried = model.skin_weights[:, model.part_joints[PART_NAMES.index(part)]]
    candidates = carried.topk(min(_CANDIDATES, len(carried))).indices
    places = model.rest_vertices[candidates]
    chosen = [int((places - places.mean(0)).norm(dim=1).argmax())]
    while len(chosen) < _CARRIERS:
        chosen.append(int(torch.cdist(places, places[chosen]).amin(1).argmax()))
    return candidates[chosen]


def _mean_at(place: torch.Tensor, carriers: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """Weights of all points whose mean lies at a place, the smallest ones of the carriers, shape (V + J,)."""
    ones = points.new_ones(len(carriers), 1)
    conditions = torch.cat([points[carriers], ones], dim=1).mT
    weights = points.new_zeros(len(points))
    weights[carriers] = torch.linalg.pinv(conditions) @ torch.cat([place, ones[0]])
    return weights
