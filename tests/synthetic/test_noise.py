"""PartBench's noise keeps to its bounds, and each kind does what its level says."""

from __future__ import annotations

import numpy as np
import pytest

from warp_partdr.body.labels import label_set
from warp_partdr.synthetic.noise import noisy_keypoints, noisy_labels

LABELS = label_set("cdcl14")


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
