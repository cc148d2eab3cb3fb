"""Losses of EllipBodyNet: the paper's (section 3.1), in the units of a fit's energy, and its heads' own.

L_3D is the mean over the joints in square centimetres; L_proj and L_seg are sums, in pixels of a crop of 256 px, and
L_l and L_t are sums in square millimetres. So with the paper's weights 1 : 1 : 1e-2 : 1e-3 : 1e-3 a joint that is 9 cm
off is pulled about as much as its keypoint. All are means over the batch, in which the unknown counts 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import nn

from ...body.labels import IGNORE
from ...body.landmarks import annotated
from ...body.skeletons import MPJPE_HIPS, MPJPE_JOINTS
from ...body.template import template
from ...inputs.observation import REFERENCE_SIZE, resize_nearest
from ...networks.regression.ellipbodynet import PicturePrediction
from ...networks.regression.heads import cell_centres
from ...networks.regression.landmarks import LANDMARKS
from ...networks.regression.predicted import posed_landmarks
from ...render.options import Gradient
from ...render.renderers import RendererEllipsoids
from .picture_data import Examples

_CENTIMETRES, _MILLIMETRES = 100.0, 1000.0  # a metre
_SPOT = 1.0  # [cells], standard deviation of the heat maps to be learnt


def body_terms(prediction: PicturePrediction, examples: Examples) -> dict[str, torch.Tensor]:
    """L_3D ("joints"), L_proj ("proj"), L_l ("lengths") and L_t ("thicknesses")."""
    bodies = prediction.bodies
    posed = bodies.posed()
    known = examples.has_joints * examples.has_joints[:, MPJPE_HIPS].prod(1, keepdim=True)
    apart = rooted(posed_landmarks(posed, MPJPE_JOINTS)) - rooted(examples.joints)
    plain, marks = (posed_landmarks(posed, names) for names in (LANDMARKS, annotated(LANDMARKS)))
    marked = torch.where(examples.annotated[:, None, None], marks, plain)
    projected = bodies.camera(REFERENCE_SIZE).project(marked)[..., :2]
    expected = (examples.keypoints[..., :2] + 1) * (REFERENCE_SIZE / 2)
    constants = template()

    def deviation(sizes: torch.Tensor, mean: Any) -> torch.Tensor:
        return ((sizes - torch.as_tensor(mean).to(sizes)) * _MILLIMETRES).square().sum(1).mean()

    return {
        "joints": (((apart * _CENTIMETRES).square().sum(2) * known).sum(1) / known.sum(1).clamp_min(1.0)).mean(),
        "proj": ((projected - expected).abs().sum(2) * examples.keypoints[..., 2]).sum(1).mean(),
        "lengths": deviation(bodies.lengths, constants.mean_lengths),
        "thicknesses": deviation(bodies.thicknesses, constants.mean_thicknesses),
    }


def seg_term(prediction: PicturePrediction, examples: Examples, *, size: int, gradient: Gradient) -> torch.Tensor:
    """L_seg through PartDR, drawn at ``size`` [px] a side, of labels that may be of several label sets."""
    groups, renderer = resize_nearest(examples.groups, size), RendererEllipsoids(gradient)
    total = prediction.bodies.log_scale.new_zeros(())
    for part_groups, chosen in label_sets(examples):
        bodies = prediction.bodies.select(chosen)
        loss = renderer.crop_loss(bodies, groups[chosen], part_labels=part_groups)
        total = total + loss.sum()
    return total * ((REFERENCE_SIZE / size) ** 2 / len(groups))


def head_terms(prediction: PicturePrediction, examples: Examples) -> dict[str, torch.Tensor]:
    """Cross entropies [nats]: of the keypoints inside the crop ("heatmaps"), and of the labelled pixels ("parts")."""
    keypoints = examples.keypoints
    heatmaps = prediction.heatmaps.float().flatten(2).log_softmax(-1).view_as(prediction.heatmaps)
    # Of each axis a distribution.
    columns, rows = (_spots(keypoints[..., axis], heatmaps.shape[3 - axis]) for axis in (0, 1))
    entropies = -(rows[..., :, None] * columns[..., None, :] * heatmaps).sum((2, 3))
    inside = keypoints[..., 2] * (keypoints[..., :2].abs() < 1).all(2)

    size = examples.groups.shape[-1]
    logits = nn.functional.interpolate(prediction.parts.float(), size=(size, size), mode="bilinear")
    groups = examples.groups[:, None]
    known = groups != IGNORE
    # A coarser label set tells of a pixel that it is one of several parts: their probabilities add up.
    possible = (examples.part_groups.to(groups.device)[:, :, None, None] == groups) | ~known
    log_shares = logits.masked_fill(~possible, -torch.inf).logsumexp(1) - logits.logsumexp(1)
    return {
        "heatmaps": (entropies * inside).sum() / inside.sum().clamp_min(1.0),
        "parts": -(log_shares * known[:, 0]).sum() / known.sum().clamp_min(1),
    }


def label_sets(examples: Examples) -> Iterator[tuple[tuple[int, ...], torch.Tensor | slice]]:
    """Group ids of the 20 parts in each label set of a batch, and whose labels are of it; unlabelled people in none."""
    rows, which = torch.unique(examples.part_groups, dim=0, return_inverse=True)  # on the host: nothing waits
    for index, row in enumerate(rows[:, 1:].tolist()):
        if any(row):
            everybody = len(rows) == 1
            yield tuple(row), slice(None) if everybody else (which == index).nonzero()[:, 0].to(examples.groups.device)


def rooted(joints: torch.Tensor) -> torch.Tensor:
    """``MPJPE_JOINTS`` from the middle of the hips."""
    return joints - joints[:, MPJPE_HIPS].mean(1, keepdim=True)


def _spots(positions: torch.Tensor, cells: int) -> torch.Tensor:
    """Normal distributions about places (B, L) over the cells of one axis, shape (B, L, cells)."""
    distance = (cell_centres(cells, positions.device) - positions[..., None]) * (cells / 2 / _SPOT)
    return (-0.5 * distance.square()).softmax(-1)
