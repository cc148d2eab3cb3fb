"""Labels that keypoints contradict: stray blobs, and background where a limb is, become "ignore".

Networks miss limbs that are dark, blurred or behind something. Background where an arm is would make a fit hide the
arm: thin, or pointing along the line of sight. Stray labels, a stranger's or a thing's pixels far from the part whose
label they have, would pull limbs away, and F1 of the foreground hides it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..body.labels import BACKGROUND, IGNORE, LabelSet
from ..body.template import MEAN_STATURE, PART_NAMES, SHAPE_INDICES, template
from .agreement import Beyond, distances_beyond, labels_at, limb_bones, places_along
from .connected_pixels import connected
from .keypoints import Keypoints2D, person_height
from .person import lower_near

STRAY = 0.1  # of the person's height, beyond a part's bones and flesh: nothing of it reaches there, clothes included
_LEAST = 0.01  # of the person's pixels: less does no harm
_CONFIRMED = 0.25  # pixels about a part's bones for each one far away; with fewer, its keypoints are in doubt

MISSING_SHARE = 1 / 3  # of a bone on background, from which on its limb is missing
LIMB_SAMPLES = 64  # points along a bone
_MARGIN = 0.01  # of the person's height: about how far keypoints are off


def ignore_stray_labels(
    groups: np.ndarray, keypoints: Keypoints2D, labels: LabelSet, seen: Beyond
) -> tuple[np.ndarray, set[str]]:
    """Turn blobs of labels far from any bone of their part, or of its mirror image, into 255; names their groups, too.

    A whole connected blob is turned, up to the part's flesh. A label whose part has no confident keypoints stays, and
    so does one that is mostly elsewhere than its keypoints. ``groups``, shape (H, W), here and below, hold this
    person's ids alone (``select_person``); ``seen`` is of them (``glance``).
    """
    cleaned, names = groups.copy(), set()
    stray = are_stray(np.array(seen.labelled), seen.sizes - seen.farther(0.0), seen.farther(STRAY))
    for group in seen.groups[stray].tolist():
        each = distances_beyond(groups, keypoints, labels, only=group)
        blob, seeds = np.zeros((2, *groups.shape), dtype=bool)
        blob[each.rows, each.columns] = each.distances > 0.0
        seeds[each.rows, each.columns] = each.distances > STRAY
        cleaned[connected(blob, seeds)] = IGNORE
        names.add(labels.group_names[group - 1])
    return cleaned, names


def are_stray(known: np.ndarray, within: np.ndarray, far: np.ndarray) -> np.ndarray:
    """True where, of so many pixels of a person, so many of a group's lie far from its flesh, and within it."""
    return (far >= np.maximum(_LEAST * known, 1.0)) & (within >= _CONFIRMED * far)


def ignore_missing_limbs(groups: np.ndarray, keypoints: Keypoints2D) -> np.ndarray:
    """Turn background into 255, ignore, along the limbs that the labels miss.

    A limb is missing if at least a third of the bone between its two confident keypoints lies on background; beyond the
    picture none does. What is then ignored is as wide as the limb of a mean adult of the person's height, and a little
    wider, for keypoints are not exact; with a forearm the hand, which few formats have keypoints of, straight on. Only
    background changes, so a limb behind another part is not missing.
    """
    names, starts, ends = limb_bones(keypoints)
    shown, inside = labels_at(groups, *limb_places(starts, ends))
    chosen = np.flatnonzero(are_missing(shown, inside)).tolist()
    return ignore_limbs(groups, person_height(keypoints), [(names[each], starts[each], ends[each]) for each in chosen])


def limb_places(starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the pixels along N limbs' bones that ``are_missing`` counts, shape (N, samples)."""
    return places_along(starts, ends, samples=LIMB_SAMPLES)


def are_missing(shown: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """True for limbs that the labels miss, by the group ids at the limbs' pixels (N, samples)."""
    missing: np.ndarray = np.count_nonzero((shown == BACKGROUND) & inside, axis=1) / LIMB_SAMPLES >= MISSING_SHARE
    return missing


def ignore_limbs(groups: np.ndarray, height: float, limbs: Sequence[tuple[str, np.ndarray, np.ndarray]]) -> np.ndarray:
    """Turn background into 255 along limbs: part, start and end [px] of each bone, of a person of a height [px]."""
    if not limbs:
        return groups
    near = np.zeros(groups.shape, dtype=bool)
    for name, start, end in limbs:
        half, further = limb_extent(name)
        beyond = (end - start).astype(np.float64) * further  # NumPy 1 would stay in float32
        lower_near(near, np.concatenate([start, end + beyond]), half * height)
    return np.where(near & (groups == BACKGROUND), IGNORE, groups).astype(np.uint8)


def limb_extent(name: str) -> tuple[np.float64, np.float64]:
    """Half the width of a limb, as a share of the height, and how far it goes on beyond its bone, of whose length."""
    mean = template()
    length, thickness, _ = SHAPE_INDICES[PART_NAMES.index(name)]
    further = np.float64(0.0)
    if name.endswith("forearm"):
        hand = SHAPE_INDICES[PART_NAMES.index(name.replace("forearm", "hand"))][0]
        further = mean.mean_lengths[hand] / mean.mean_lengths[length]
    return mean.mean_thicknesses[thickness] / (2 * MEAN_STATURE) + _MARGIN, further
