"""Views and detections of the detector, and looks that are of one person."""

from __future__ import annotations

import numpy as np
import pytest

from warp_partdr import skeleton
from warp_partdr.networks.detection.detector import SMALLEST, Detections, distinct_detections, tiles, turned_views
from warp_partdr.networks.detection.same_person import first_of_each, similarity


@pytest.mark.parametrize("size", [(497, 884), (480, 640), (900, 300), (3000, 4000)])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_tiles_cover_the_picture_and_overlap(size: tuple[int, int], level: int) -> None:
    crops = tiles(size, level)
    side = max(size) / 2**level
    if level and side < SMALLEST:
        assert len(crops) == 0
        return
    assert (crops.sides == side).all()
    for point in np.random.default_rng(0).uniform((0, 0), size[::-1], (50, 2)):
        distance = np.abs(crops.centres - point).max(axis=1)
        assert distance.min() <= side / 2 + 1e-6
        inner = (point > side / 2) & (point < np.array(size[::-1]) - side / 2)
        if inner.all():  # whoever is not at the border is well inside some tile
            assert distance.min() <= side / 4 + 1e-6


def test_small_pictures_are_looked_at_once() -> None:
    assert [len(tiles((300, 380), level)) for level in range(3)] == [1, 0, 0]


def test_landmarks_that_coincide_are_one_person(rng):
    points = rng.uniform(0, 200, (33, 2))
    people = np.stack([points, points + 2, points + 40, points])
    confidence, sides = np.full((4, 33), 0.9), np.full(4, 250.0)
    pictures = np.array([0, 0, 0, 1])
    kept = first_of_each(people, confidence, sides, pictures, np.array([0.8, 0.9, 0.7, 0.6]))
    np.testing.assert_array_equal(kept, [1, 2, 3])
    one = (people[:1], confidence[:1], sides[:1])
    np.testing.assert_allclose(similarity(one, one), 1)
    moved = (people[:1] + np.array([0, 0.05 * 250]), confidence[:1], sides[:1])
    np.testing.assert_allclose(similarity(one, moved), np.exp(-0.5))


def test_looks_at_one_head_are_of_one_person(rng: np.random.Generator) -> None:
    points = rng.uniform(0, 200, (33, 2))
    part = points.copy()
    part[11:] += 60  # limbs that were guessed
    people, confidence = np.stack([part, points]), np.full((2, 33), 0.9)
    looks = (people, confidence, np.full(2, 250.0), np.zeros(2, int), np.array([0.5, 0.9]))
    np.testing.assert_array_equal(first_of_each(*looks), [0, 1])
    np.testing.assert_array_equal(first_of_each(*looks, slice(0, 11)), [1])


def test_crops_are_turned_as_hips_and_shoulders_stand() -> None:
    """Somebody 100 px from hips to shoulders, who lies with the head to the right."""
    names = skeleton("coco17").landmarks
    points = np.full((1, 17, 2), 100.0)
    for name, x in (("shoulder", 200.0), ("hip", 100.0), ("ankle", -100.0)):
        for y, side in ((90, "left"), (110, "right")):
            points[0, names.index(f"{side}_{name}")] = (x, y)
    seen = np.full((1, 17), 0.9)
    crops = Detections(points, seen, np.ones(1), np.zeros(1, int)).crops()
    np.testing.assert_allclose(crops.centres, [[100, 100]])
    np.testing.assert_allclose(crops.angles, [np.pi / 2])
    radius = 1.15 * np.hypot(200, 10)
    np.testing.assert_allclose(crops.sides, [2 * 1.25 * radius])
    seen[0, [names.index("left_ankle"), names.index("right_ankle")]] = 0.05  # out of the picture, perhaps
    crops = Detections(points, seen, np.ones(1), np.zeros(1, int)).crops()
    np.testing.assert_allclose(crops.sides, [2 * 1.25 * 1.75 * 100])


def test_the_whole_picture_is_looked_at_turned_too() -> None:
    views = turned_views((480, 640), 3)
    np.testing.assert_allclose(np.sort(views.angles % (2 * np.pi)), [np.pi / 2, np.pi, 1.5 * np.pi])
    assert (views.sides == 640).all()
    assert (views.pictures == 3).all()


def test_the_middle_of_somebody_is_that_of_the_keypoints_that_are_seen() -> None:
    points, seen = np.full((1, 17, 2), 500.0), np.zeros((1, 17))
    points[0, :2], seen[0, :2] = [[10, 20], [40, 20]], [0.8, 0.4]
    middles = Detections(points, seen, np.ones(1), np.zeros(1, int)).middles()
    np.testing.assert_allclose(middles, [[20, 20]], atol=0.1)


def test_people_who_are_found_clearly_are_taken_before_better_views_of_them(rng: np.random.Generator) -> None:
    points = rng.uniform(0, 200, (17, 2))
    seen = Detections(np.stack([points, points + 2]), np.full((2, 17), 0.9), np.array([0.3, 0.8]), np.zeros(2, int))
    np.testing.assert_array_equal(distinct_detections(seen, np.array([False, False])), [1])
    np.testing.assert_array_equal(distinct_detections(seen, np.array([True, False])), [0])
