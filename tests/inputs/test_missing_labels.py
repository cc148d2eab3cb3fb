"""Limbs that labels miss: where background is ignored, where it is not, and that fits keep such limbs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.bodies import seen_by, standing_adult, walker
from helpers.quick import QUICK_SEARCH

from warp_partdr.body.labels import BACKGROUND, IGNORE
from warp_partdr.body.landmarks import annotated
from warp_partdr.body.template import PART_NAMES, THICKNESS_NAMES, template
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import observe
from warp_partdr.inputs.own_pixels import ignore_missing_limbs
from warp_partdr.solve.ellipsoids.fitting import fit_body

LIMBS = {"upper_arm": "elbow", "forearm": "wrist", "upper_leg": "knee", "lower_leg": "ankle"}  # and where they end


def label(name: str) -> int:
    return PART_NAMES.index(name) + 1


def column(keypoints: Keypoints2D, landmark: str) -> float:
    """Place of a landmark along x [px]."""
    return float(keypoints.points[keypoints.format.landmarks.index(landmark), 0])


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("limb", LIMBS)
def test_background_along_a_missing_limb_is_ignored(limb: str, side: str) -> None:
    full = standing_adult()[1].groups
    keypoints, parts = standing_adult(f"{side}_{limb}")
    groups = ignore_missing_limbs(parts.groups, keypoints)
    changed = groups != parts.groups
    assert (groups[changed] == IGNORE).all()
    assert (parts.groups[changed] == BACKGROUND).all()
    assert changed[full == label(f"{side}_{limb}")].mean() > 0.95
    # Nothing far from the limb, or from the hand that goes with a forearm, is touched.
    near = [label(f"{side}_{limb}"), *([label(f"{side}_hand")] if limb == "forearm" else [])]
    offsets = np.argwhere(changed)[:, None] - np.argwhere(np.isin(full, near))
    assert np.linalg.norm(offsets, axis=-1).min(1).max() < 9  # annotators mark hips 2 px above the joint


def test_the_hand_goes_with_the_forearm() -> None:
    full = standing_adult()[1].groups
    keypoints, parts = standing_adult("left_forearm", "left_hand")
    groups = ignore_missing_limbs(parts.groups, keypoints)
    assert (groups[full == label("left_hand")] == IGNORE).mean() > 0.7
    keypoints, parts = standing_adult("left_hand")
    np.testing.assert_array_equal(ignore_missing_limbs(parts.groups, keypoints), parts.groups)


def test_labels_that_miss_nothing_stay() -> None:
    for keypoints, parts in (standing_adult(), seen_by(walker())):
        np.testing.assert_array_equal(ignore_missing_limbs(parts.groups, keypoints), parts.groups)


@pytest.mark.parametrize("limb", LIMBS)
def test_limbs_stay_that_are_hidden_or_whose_keypoints_are_in_doubt(limb: str) -> None:
    keypoints, parts = standing_adult()
    for other in (label("chest"), IGNORE):
        groups = np.where(parts.groups == label(f"left_{limb}"), other, parts.groups).astype(np.uint8)
        np.testing.assert_array_equal(ignore_missing_limbs(groups, keypoints), groups)
    keypoints, parts = standing_adult(f"right_{limb}")
    for value in (0.0, 0.2):
        doubtful = replace(keypoints, confidence=keypoints.confidence.copy())
        doubtful.confidence[keypoints.format.landmarks.index(f"right_{LIMBS[limb]}")] = value
        np.testing.assert_array_equal(ignore_missing_limbs(parts.groups, doubtful), parts.groups)


def test_a_small_gap_stays() -> None:
    keypoints, parts = standing_adult()
    elbow, wrist = column(keypoints, "left_elbow"), column(keypoints, "left_wrist")
    arm = np.isin(parts.groups, [label("left_forearm"), label("left_hand")])
    for share, stays in ((0.25, True), (0.45, False)):
        lost = arm & (np.arange(arm.shape[1]) > wrist + share * (elbow - wrist))
        groups = np.where(lost, BACKGROUND, parts.groups).astype(np.uint8)
        assert (ignore_missing_limbs(groups, keypoints) == groups).all() == stays


def test_a_limb_that_the_border_cuts_off_stays() -> None:
    """Pixels that the camera never saw are no background: of this forearm a quarter is, and that is too little."""
    keypoints, parts = standing_adult("left_forearm", "left_hand")  # the left arm is at the picture's right
    elbow, wrist = column(keypoints, "left_elbow"), column(keypoints, "left_wrist")
    for share, stays in ((0.0, True), (0.25, True), (0.6, False)):
        groups = parts.groups[:, : round(elbow + share * (wrist - elbow))]
        assert (ignore_missing_limbs(groups, keypoints) == groups).all() == stays


def test_observations_of_labels_and_of_maps_ignore_the_same() -> None:
    keypoints, parts = standing_adult("left_forearm", "right_lower_leg")
    maps = (parts.groups == np.arange(len(PART_NAMES) + 1)[:, None, None]).astype(np.float32)
    seen, _ = observe(keypoints, replace(parts, maps=maps))
    whole, _ = observe(*standing_adult())
    assert (seen.labels == IGNORE).sum() > (whole.labels == IGNORE).sum() + 1000
    torch.testing.assert_close(seen.known, (seen.labels != IGNORE).float())


def test_an_observation_knows_what_its_keypoints_mark() -> None:
    keypoints, parts = standing_adult()
    unseen = replace(keypoints, confidence=np.where(np.arange(17) == 11, 0, keypoints.confidence).astype(np.float32))
    seen, _ = observe(unseen, parts)
    assert "left_hip" not in seen.landmarks
    assert seen.body_points == tuple(annotated(seen.landmarks)) != seen.landmarks
    assert replace(seen, marks=None).body_points == seen.landmarks


def test_a_fit_keeps_an_arm_whose_labels_are_lost() -> None:
    keypoints, parts = standing_adult("left_upper_arm", "left_forearm", "left_hand", "right_forearm", "right_hand")
    result = fit_body(keypoints, parts, options=QUICK_SEARCH)
    index = THICKNESS_NAMES.index("forearm thickness")
    assert result.parameters.thicknesses[0, index].item() > 0.75 * template().mean_thicknesses[index]
    shown = result.draw(parts.groups.shape).labels[0].numpy()
    full = standing_adult()[1].groups
    arm = np.isin(full, [label("left_upper_arm"), label("left_forearm")])
    assert np.isin(shown[arm], [label("left_upper_arm"), label("left_forearm")]).mean() > 0.7
