"""Constant arrays that the captured refinement reads, made once a device: skeleton, landmarks, rules, prior."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from ...body.landmarks import LANDMARKS, landmark_points
from ...body.pose_prior import FREE_PARTS, NUM_FEATURES, PosePrior
from ...body.template import NUM_PARTS, PARENTS, SHAPE_INDICES, subtree_masks, template
from ...kernels.refine.state import Bone, Landmark, Landmarks, LandmarkShare, Mixture, Rules

LANDMARK_NAMES = tuple(LANDMARKS)


def _structs(kind: Any, device: str, **columns: Any) -> wp.array:
    """Array of Warp structs, from their members."""
    rows: Any = np.zeros(len(next(iter(columns.values()))), dtype=kind.numpy_dtype())
    for name, column in columns.items():
        rows[name] = column
    return wp.array(rows, dtype=kind, device=device)


@lru_cache(maxsize=8)
def bone_arrays(device: str) -> wp.array:
    """Bones of the template, and the root, on a Warp device."""
    return _structs(
        Bone,
        device,
        parent=(*PARENTS, -1),
        subtree=subtree_masks(),
        shape=(*SHAPE_INDICES, (0, 0, 0)),
        rest_axes=(*template().rest_axes, np.eye(3)),
    )


def landmark_arrays(device: str, names: Collection[str], points: wp.array, votes: wp.array) -> Landmarks:
    """All ``LANDMARK_NAMES`` on a Warp device, with the keypoints' ``points`` and ``votes``; ``names`` are seen."""
    parts, normalised, weights = landmark_points(LANDMARK_NAMES)
    first, second = normalised.swapaxes(0, 1)
    table = Landmarks()
    table.landmarks = _structs(Landmark, device, parts=parts, shares=weights, first=first, second=second)
    index, end = np.nonzero((weights > 0) & np.isin(LANDMARK_NAMES, list(names))[:, None])
    order = np.argsort(parts[index, end], kind="stable")
    index, end = index[order], end[order]
    table.shares = _structs(
        LandmarkShare,
        device,
        landmark=index,
        weight=weights[index, end],
        normalised=normalised[index, end],
        counts=np.equal(end, 0),
    )
    first_share = np.searchsorted(parts[index, end], np.arange(NUM_PARTS + 1))
    table.first_share = wp.array(first_share, dtype=int, device=device)
    table.points, table.votes = points, votes
    return table


def rule_arrays(
    device: str,
    prior: PosePrior | None,
    lengths: wp.array,
    thicknesses: wp.array,
    depths: wp.array,
    depth_scales: wp.array,
) -> Rules:
    """Sizes (N, 12) and (N, 15), depths and their scales (N, 20) of N people, and the prior's joint limits, if any."""
    table = Rules()
    table.usual_lengths, table.usual_thicknesses = lengths, thicknesses
    table.depths, table.depth_scales = depths, depth_scales
    free = np.full((NUM_PARTS, 3), np.inf)
    lower, upper = (
        (-free, free) if prior is None else (prior.lower_limits.cpu().numpy(), prior.upper_limits.cpu().numpy())
    )
    table.lower_limits = wp.array(lower, dtype=wp.vec3, device=device)
    table.upper_limits = wp.array(upper, dtype=wp.vec3, device=device)
    return table


_mixtures: WeakKeyDictionary[PosePrior, dict[str, Mixture]] = WeakKeyDictionary()


def mixture_arrays(device: str, prior: PosePrior | None) -> Mixture:
    """Gaussians of a prior on a Warp device; none without a prior."""
    if prior is None:
        return _mixture(device, np.empty((0, NUM_FEATURES, NUM_FEATURES)), np.empty((0, NUM_FEATURES)), np.empty(0))
    known = _mixtures.setdefault(prior, {})
    if device not in known:
        log_weights = prior._log_weights.double().cpu().numpy()
        whitened_means = prior._whitened_means.double().cpu().numpy()
        whitening = prior._whitening.double().cpu().numpy().reshape(-1, NUM_FEATURES, NUM_FEATURES)
        means = np.linalg.solve(whitening, whitened_means[..., None])[..., 0]
        known[device] = _mixture(device, whitening.transpose(0, 2, 1) @ whitening, means, log_weights)
    return known[device]


def _mixture(device: str, precisions: np.ndarray, means: np.ndarray, log_weights: np.ndarray) -> Mixture:
    slots = np.full(NUM_PARTS + 1, -1)
    if len(log_weights):
        slots[[*FREE_PARTS, NUM_PARTS]] = np.arange(len(FREE_PARTS) + 1)
    count = NUM_FEATURES // 3
    blocks = precisions.reshape(-1, count, 3, count, 3).transpose(3, 2, 4, 0, 1).reshape(count, 9, -1)
    table = Mixture()
    table.slots = wp.array(slots, dtype=int, device=device)
    table.means = wp.array(means.reshape(-1, count, 3), dtype=wp.vec3, device=device)
    table.precisions = wp.array(np.ascontiguousarray(blocks), dtype=float, device=device)
    table.log_weights = wp.array(log_weights, dtype=float, device=device)
    return table
