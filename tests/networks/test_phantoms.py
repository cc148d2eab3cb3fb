"""A second look at somebody's body is no second person; one of two who overlap is."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from warp_partdr.networks.detection.asset import packaged_people_networks
from warp_partdr.networks.detection.crops import Pyramid, TurnedCrops
from warp_partdr.networks.detection.detector import Detections
from warp_partdr.networks.detection.look import NUM_LANDMARKS, FoundLandmarks
from warp_partdr.networks.detection.search import ScoredLandmarks, _Search, _share_within

SIZE = (200, 300)


def outlines(*boxes: tuple[float, float, float, float], pictures: list[int] | None = None) -> FoundLandmarks:
    """People whose masks fill boxes (left, top, right, bottom) [px] of a picture, each in a crop of 200 px."""
    count = len(boxes)
    masks = torch.full((count, 256, 256), -9.0)
    centres = np.array([[100.0, 100.0]] * count)
    for mask, box in zip(masks, boxes, strict=True):
        left, top, right, bottom = (round(each / 200 * 256) for each in box)
        mask[top:bottom, left:right] = 9.0
    crops = TurnedCrops(centres, np.full(count, 200.0), np.zeros(count), np.array(pictures or [0] * count))
    points = np.zeros((count, NUM_LANDMARKS, 2))
    return FoundLandmarks(crops, points, points[..., 0], np.ones(count), crops, masks)


def test_a_share_of_a_mask_is_within_those_of_all_others() -> None:
    found = outlines((0, 0, 100, 100), (0, 0, 25, 100), (75, 0, 200, 100))
    assert _share_within(found, 0, np.array([], dtype=int), SIZE) == 0
    assert _share_within(found, 0, np.array([1]), SIZE) == pytest.approx(0.25, abs=0.03)
    assert _share_within(found, 0, np.array([1, 2]), SIZE) == pytest.approx(0.5, abs=0.03)
    assert _share_within(found, 1, np.array([0]), SIZE) == 1


def test_only_what_the_picture_shows_of_a_mask_counts() -> None:
    found = outlines((0, 0, 100, 200), (0, 0, 100, 100))
    assert _share_within(found, 0, np.array([1]), SIZE) == pytest.approx(0.5, abs=0.03)
    assert _share_within(found, 0, np.array([1]), (100, 300)) == 1


@pytest.mark.parametrize(
    ("scores", "heads", "kept"),
    [
        ([0.9, 0.6], [0.6, 0.1], [0]),  # somebody within another's outline, without a head
        ([0.9, 0.6], [0.6, 0.6], [0, 1]),  # a child in front of somebody has one
        ([0.6, 0.9], [0.1, 0.1], [1]),  # from behind, heads are not seen well: the better one stays
    ],
)
def test_whoever_is_within_another_needs_a_head(scores: list[float], heads: list[float], kept: list[int]) -> None:
    pyramids = [Pyramid(np.zeros((*SIZE, 3), np.uint8), "cpu")]
    search = _Search(packaged_people_networks("cpu"), pyramids, 0.5)
    people = ScoredLandmarks(outlines((20, 20, 120, 180), (25, 20, 120, 170)), np.array(scores))
    left = search._without_phantoms(people, np.array(heads))
    np.testing.assert_array_equal(left.scores, np.array(scores)[kept])


@pytest.mark.parametrize(
    ("middle", "score", "angle", "more"),
    [
        ((60.0, 60.0), 0.06, 0.0, False),
        ((140.0, 60.0), 0.06, 0.0, True),
        ((60.0, 140.0), 0.06, 0.0, True),
        ((10.0, 60.0), 0.06, 0.0, True),
        ((140.0, 60.0), 0.04, 0.0, False),  # too faint
        ((60.0, 60.0), 0.06, np.pi / 2, True),  # who lies may be seen better in a turned picture
    ],
)
def test_somebody_seen_faintly_beside_all_who_stand_is_more(
    middle: tuple[float, float], score: float, angle: float, more: bool
) -> None:
    """Somebody stands, or lies, between 20 and 120 px."""
    search = _Search(packaged_people_networks("cpu"), [Pyramid(np.zeros((*SIZE, 3), np.uint8), "cpu")], 0.5)
    points, one = np.broadcast_to(middle, (1, 17, 2)), np.ones(1)
    search._detected = Detections(points, np.full((1, 17), 0.5), score * one, np.zeros(1, int))
    found = outlines((20, 20, 120, 120))
    found.points[0, :2] = [[20, 20], [120, 120]]
    found.points[0, 2:] = 70
    found.next_crops.angles[:] = angle
    assert search.sees_more_than_upright(ScoredLandmarks(found, one), 0) is more


def test_people_beside_others_and_in_other_pictures_need_no_head() -> None:
    pyramids = [Pyramid(np.zeros((*SIZE, 3), np.uint8), "cpu")] * 2
    search = _Search(packaged_people_networks("cpu"), pyramids, 0.5)
    boxes = (20, 20, 120, 180), (80, 20, 180, 180), (20, 20, 120, 180)
    people = ScoredLandmarks(outlines(*boxes, pictures=[0, 0, 1]), np.array([0.9, 0.6, 0.6]))
    assert len(search._without_phantoms(people, np.full(3, 0.1)).scores) == 3
