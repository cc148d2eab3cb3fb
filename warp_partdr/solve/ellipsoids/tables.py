"""Constant arrays that the captured refinement reads: skeleton, landmarks, sizes, joint limits, prior."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from ...body.landmarks import LANDMARKS, landmark_points
from ...body.pose_prior import FREE_PARTS, NUM_FEATURES, PosePrior
from ...body.template import NUM_PARTS, PARENTS, SHAPE_INDICES, subtree_masks, template
from ...interop.device_cache import device_cache
from ...kernels.refine.state import Bone, Landmark, Landmarks, LandmarkShare, Mixture, Rules

LANDMARK_NAMES = tuple(LANDMARKS)


def _structs(kind: Any, device: str, **columns: Any) -> wp.array:
    """Make an array of Warp structs from columns of their members."""
    rows: Any = np.zeros(len(next(iter(columns.values()))), dtype=kind.numpy_dtype())
    for name, column in columns.items():
        rows[name] = column
    return wp.array(rows, dtype=kind, device=device)


@device_cache(8)
def bone_arrays(device: str) -> wp.array:
    """Make the array of the template's bones, and the root last, on a Warp device; it is kept."""
    return _structs(
        Bone,
        device,
        parent=(*PARENTS, -1),
        subtree=subtree_masks(),
        shape=(*SHAPE_INDICES, (0, 0, 0)),
        rest_axes=(*template().rest_axes, np.eye(3)),
    )


def landmark_arrays(device: str, names: Collection[str], points: wp.array, weights: wp.array) -> Landmarks:
    """Make the arrays of ``LANDMARK_NAMES`` on a Warp device.

    Args:
        device: Warp device.
        names: Names of the landmarks that at least one person has; only these pull at the body.
        points: Positions of the keypoints, shape (N, L), vec2.
        weights: Weights of the keypoints, shape (N, L).
    """
    parts, normalised, part_shares = landmark_points(LANDMARK_NAMES)
    first, second = normalised.swapaxes(0, 1)
    table = Landmarks()
    table.landmarks = _structs(Landmark, device, parts=parts, shares=part_shares, first=first, second=second)
    index, end = np.nonzero((part_shares > 0) & np.isin(LANDMARK_NAMES, list(names))[:, None])
    order = np.argsort(parts[index, end], kind="stable")
    index, end = index[order], end[order]
    table.shares = _structs(
        LandmarkShare,
        device,
        landmark=index,
        weight=part_shares[index, end],
        normalised=normalised[index, end],
        counts=np.equal(end, 0),
    )
    first_share = np.searchsorted(parts[index, end], np.arange(NUM_PARTS + 1))
    table.first_share = wp.array(first_share, dtype=int, device=device)
    table.points = points
    table.votes = weights
    return table


def rule_arrays(
    device: str,
    prior: PosePrior | None,
    lengths: wp.array,
    thicknesses: wp.array,
    depths: wp.array,
    depth_scales: wp.array,
) -> Rules:
    """Collect the arrays that the energy's rules read on a Warp device.

    Args:
        device: Warp device.
        prior: Prior whose joint limits hold; None: there are none.
        lengths: Expected lengths of N people [m], shape (N, 12).
        thicknesses: Expected thicknesses [m], shape (N, 15).
        depths: Expected depths of the parts' centres [m], shape (N, 20).
        depth_scales: Inverse of the uncertainty of these depths [1/m], shape (N, 20).
    """
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
    """Make the arrays of a prior's Gaussians on a Warp device; without a prior there are none."""
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
