"""PartBench's noise keeps to its bounds, and each kind does what its level says."""

from __future__ import annotations

import numpy as np
import pytest

from warp_partdr.body.labels import label_set
from warp_partdr.body.skeletons import skeleton
from warp_partdr.synthetic.noise import Level, noisy_keypoints, noisy_labels, spoil_keypoints, spoil_labels

LABELS = label_set("cdcl14")
COCO = skeleton("coco17")


def _blocks() -> np.ndarray:
    """A torso, a head and a left hand, shape (200, 160)."""
    groups = np.zeros((200, 160), dtype=np.uint8)
    groups[60:160, 40:120] = LABELS.group_names.index("torso") + 1
    groups[20:60, 60:100] = LABELS.group_names.index("head") + 1
    groups[120:127, 70:77] = LABELS.group_names.index("left_hand") + 1
    return groups


@pytest.mark.parametrize("seed", range(5))
def test_labels_move_by_a_few_pixels_only(seed: int) -> None:
    true = _blocks()
    noisy = noisy_labels(true, LABELS, np.random.default_rng(seed))
    assert noisy.shape == true.shape
    assert noisy.dtype == np.uint8
    assert set(np.unique(noisy)) <= {*np.unique(true), LABELS.group_names.index("right_hand") + 1}
    for group in np.unique(true)[:3]:
        overlap = ((noisy == group) & (true == group)).sum() / ((noisy == group) | (true == group)).sum()
        assert 0.8 < overlap < 1.0


def test_labels_depend_on_the_seed_alone() -> None:
    first, again, other = (noisy_labels(_blocks(), LABELS, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).any()


def test_small_parts_get_lost_and_hands_confused_now_and_then() -> None:
    left, right = (LABELS.group_names.index(f"{side}_hand") + 1 for side in ("left", "right"))
    seen = [set(np.unique(noisy_labels(_blocks(), LABELS, np.random.default_rng(seed)))) for seed in range(60)]
    assert 5 <= sum(not {left, right} & groups for groups in seen) <= 40
    assert 1 <= sum(right in groups for groups in seen) <= 15


def test_keypoint_noise_is_as_wide_as_documented() -> None:
    points = np.zeros((4000, 2))
    hidden = np.arange(4000) % 2 == 0
    noisy = noisy_keypoints(points, hidden, 300.0, np.random.default_rng(0))
    assert noisy.shape == (4000, 3)
    np.testing.assert_allclose(noisy[~hidden, :2].std(), 3.0, rtol=0.05)
    np.testing.assert_allclose(noisy[hidden, :2].std(), 6.0, rtol=0.05)
    np.testing.assert_array_equal(noisy[:, 2], np.where(hidden, 0.5, 1.0))


def _keypoints() -> np.ndarray:
    places = np.arange(len(COCO)) * 5.0 + 3
    return np.column_stack([places, places, np.ones(len(COCO))])


def test_dropped_keypoints_have_no_confidence() -> None:
    spoiled = spoil_keypoints(
        _keypoints(), COCO.landmarks, (200, 200), Level(1.0, dropout=1.0), np.random.default_rng(0)
    )
    assert (spoiled == 0).all()


def test_keypoints_beyond_the_border_are_not_found() -> None:
    spoiled = spoil_keypoints(_keypoints(), COCO.landmarks, (40, 200), Level(0.0), np.random.default_rng(0))
    np.testing.assert_array_equal(spoiled[:, 2] > 0, _keypoints()[:, 1] <= 41)


def test_swapped_keypoints_change_sides() -> None:
    # every limb's chance is a quarter of 4
    spoiled = spoil_keypoints(_keypoints(), COCO.landmarks, (200, 200), Level(0.0, swap=4.0), np.random.default_rng(0))
    elbows = [COCO.landmarks.index(f"{side}_elbow") for side in ("left", "right")]
    np.testing.assert_array_equal(spoiled[elbows], _keypoints()[elbows[::-1]])


def _man() -> np.ndarray:
    """Two legs, shape (60, 60)."""
    groups = np.zeros((60, 60), dtype=np.uint8)
    for column, side in ((10, "left"), (35, "right")):
        for row, part in enumerate(("upper_leg", "lower_leg", "foot")):
            groups[10 + 13 * row : 23 + 13 * row, column : column + 15] = LABELS.group_names.index(f"{side}_{part}") + 1
    return groups


@pytest.mark.parametrize("seed", range(6))
def test_swapped_limbs_keep_the_outline(seed: int) -> None:
    spoiled = spoil_labels(_man(), LABELS, 50.0, Level(0.0, swap=1.0), np.random.default_rng(seed))
    np.testing.assert_array_equal(spoiled > 0, _man() > 0)
    assert np.bincount(spoiled.ravel(), minlength=15).tolist() == np.bincount(_man().ravel(), minlength=15).tolist()


def test_legs_are_missing_and_holes_are_background() -> None:
    lost = [spoil_labels(_man(), LABELS, 50.0, Level(0.0, missing=1.0), np.random.default_rng(k)) for k in range(12)]
    assert any((labels > 0).sum() < 0.6 * (_man() > 0).sum() for labels in lost)
    holes = spoil_labels(_man(), LABELS, 50.0, Level(0.0, holes=5.0), np.random.default_rng(1))
    assert 0 < ((_man() > 0) & (holes == 0)).sum() < 0.5 * (_man() > 0).sum()
    np.testing.assert_array_equal(holes[holes > 0], _man()[holes > 0])


def test_growth_moves_the_outline_by_so_many_pixels() -> None:
    areas = {
        int((spoil_labels(_man(), LABELS, 50.0, Level(0.0, growth=2), np.random.default_rng(seed)) > 0).sum())
        for seed in range(20)
    }
    # two blocks of 39 by 15 pixels, grown as a cross or shrunk
    assert {2 * (39 - 2 * k) * (15 - 2 * k) for k in (0, 1, 2)} <= areas
    assert max(areas) == 2 * (39 * 15 + 4 * (39 + 15) + 4)
