"""PartBench's noise keeps to its bounds, and each kind does what its level says."""

from __future__ import annotations

import numpy as np
import pytest

from warp_partdr.body.labels import label_set
from warp_partdr.body.skeletons import skeleton
from warp_partdr.lab.synthetic.noise import Level, noisy_keypoints, noisy_labels

LABELS = label_set("cdcl14")
COCO = skeleton("coco17").landmarks
PLACES = np.arange(len(COCO))[:, None] * 5.0 + [3.0, 3.0]


def group(name: str) -> int:
    return LABELS.group_names.index(name) + 1


def blocks() -> np.ndarray:
    """A torso, a head and a left hand, shape (200, 160)."""
    groups = np.zeros((200, 160), dtype=np.uint8)
    groups[60:160, 40:120], groups[20:60, 60:100] = group("torso"), group("head")
    groups[120:127, 70:77] = group("left_hand")
    return groups


def legs() -> np.ndarray:
    """Two legs, shape (60, 60)."""
    groups = np.zeros((60, 60), dtype=np.uint8)
    for column, side in ((10, "left"), (35, "right")):
        for row, part in enumerate(("upper_leg", "lower_leg", "foot")):
            groups[10 + 13 * row : 23 + 13 * row, column : column + 15] = group(f"{side}_{part}")
    return groups


def spoilt(groups: np.ndarray, seed: int, level: Level) -> np.ndarray:
    return noisy_labels(groups, LABELS, 50.0, level, np.random.default_rng(seed))


def found(level: Level, size: tuple[int, int] = (200, 200)) -> np.ndarray:
    hidden = np.zeros(len(COCO), dtype=bool)
    return noisy_keypoints(PLACES, hidden, COCO, 100.0, size, level=level, rng=np.random.default_rng(0))


@pytest.mark.parametrize("seed", range(5))
def test_labels_move_by_a_few_pixels_only(seed: int) -> None:
    true = blocks()
    noisy = spoilt(true, seed, Level(1.0))
    assert noisy.shape == true.shape
    assert noisy.dtype == np.uint8
    assert set(np.unique(noisy)) <= {*np.unique(true), group("right_hand")}
    for each in np.unique(true)[:3]:
        overlap = ((noisy == each) & (true == each)).sum() / ((noisy == each) | (true == each)).sum()
        assert 0.8 < overlap < 1.0


def test_labels_depend_on_the_seed_alone() -> None:
    first, again, other = (spoilt(blocks(), seed, Level(1.0)) for seed in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).any()


def test_small_parts_get_lost_and_hands_confused_now_and_then() -> None:
    left, right = group("left_hand"), group("right_hand")
    seen = [set(np.unique(spoilt(blocks(), seed, Level(1.0)))) for seed in range(60)]
    assert 5 <= sum(not {left, right} & groups for groups in seen) <= 40
    assert 1 <= sum(right in groups for groups in seen) <= 15


def test_keypoint_noise_is_as_wide_as_documented() -> None:
    points, hidden = np.full((4000, 2), 100.0), np.arange(4000) % 2 == 0
    args = (points, hidden, COCO, 300.0, (200, 200))
    noisy = noisy_keypoints(*args, level=Level(1.0), rng=np.random.default_rng(0))
    assert noisy.shape == (4000, 3)
    np.testing.assert_allclose(noisy[~hidden, :2].std(), 3.0, rtol=0.05)
    np.testing.assert_allclose(noisy[hidden, :2].std(), 12.0, rtol=0.05)
    np.testing.assert_array_equal(noisy[:, 2], np.where(hidden, 0.5, 1.0))
    sure = noisy_keypoints(*args, level=Level(1.0, guessed=0.3), rng=np.random.default_rng(0))[:, 2] == 1.0
    assert sure[~hidden].all()
    assert 0.26 < sure[hidden].mean() < 0.34


def test_keypoints_are_dropped_not_found_beyond_the_border_or_on_the_other_side() -> None:
    assert (found(Level(1.0, dropout=1.0)) == 0).all()
    np.testing.assert_array_equal(found(Level(0.0), (40, 200))[:, 2] > 0, PLACES[:, 1] <= 41)
    elbows = [COCO.index(f"{side}_elbow") for side in ("left", "right")]
    swapped = found(Level(0.0, swap=4.0))  # every limb's chance is a quarter of 4
    np.testing.assert_array_equal(swapped[elbows, :2], PLACES[elbows[::-1]])


@pytest.mark.parametrize("seed", range(6))
def test_swapped_limbs_keep_the_outline(seed: int) -> None:
    swapped = spoilt(legs(), seed, Level(0.0, swap=1.0))
    np.testing.assert_array_equal(swapped > 0, legs() > 0)
    assert np.bincount(swapped.ravel(), minlength=15).tolist() == np.bincount(legs().ravel(), minlength=15).tolist()


def test_legs_are_missing_and_holes_are_background() -> None:
    lost = [spoilt(legs(), seed, Level(0.0, missing=1.0)) for seed in range(12)]
    assert any((labels > 0).sum() < 0.6 * (legs() > 0).sum() for labels in lost)
    holes = spoilt(legs(), 1, Level(0.0, holes=5.0))
    assert 0 < ((legs() > 0) & (holes == 0)).sum() < 0.5 * (legs() > 0).sum()
    np.testing.assert_array_equal(holes[holes > 0], legs()[holes > 0])


def test_growth_moves_the_outline_by_so_many_pixels() -> None:
    areas = {int((spoilt(legs(), seed, Level(0.0, growth=2)) > 0).sum()) for seed in range(20)}
    # two blocks of 39 by 15 pixels, grown as a cross or shrunk
    assert {2 * (39 - 2 * k) * (15 - 2 * k) for k in (0, 1, 2)} <= areas
    assert max(areas) == 2 * (39 * 15 + 4 * (39 + 15) + 4)
