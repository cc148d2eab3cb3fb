"""Anchors and boxes of the detector, and crops that stand for others."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from warp_partdr.networks.detection.boxes import anchors, average_boxes, decode, overlap
from warp_partdr.networks.detection.crops import TurnedCrops
from warp_partdr.networks.detection.detector import tiles
from warp_partdr.networks.detection.same_person import distinct_crops, first_of_each, similarity


def box(x: float, y: float, side: float) -> np.ndarray:
    points = [(x, y), (side, side), (x, y + 10), (x, y - 30), (x, y), (x, y)]
    return np.array(points, dtype=np.float64)


def test_anchors_are_the_cells_centres():
    places = anchors(224)
    assert places.shape == (2 * 28**2 + 2 * 14**2 + 6 * 7**2, 2) == (2254, 2)
    np.testing.assert_array_equal(places[:4], [[4, 4], [4, 4], [12, 4], [12, 4]])
    np.testing.assert_array_equal(places[2 * 28**2], [8, 8])
    np.testing.assert_array_equal(places[-1], [208, 208])


def test_boxes_are_relative_to_their_anchors():
    said, logits = np.zeros((2254, 12), dtype=np.float32), np.full(2254, -9.0, dtype=np.float32)
    said[3] = [1, 2, 30, 40, 5, 6, 7, 8, 0, 0, 0, 0]
    logits[3] = 1.0
    nothing = np.full_like(logits, -9.0)
    both = torch.from_numpy(np.stack([said, said])), torch.from_numpy(np.stack([nothing, logits]))
    found, scores, pictures = decode(*both, 224, 0.5)
    assert pictures.tolist() == [1]
    np.testing.assert_allclose(scores, [1 / (1 + np.exp(-1))])
    expected = [[13, 6], [30, 40], [17, 10], [19, 12], [12, 4], [12, 4]]  # the size is no place
    np.testing.assert_allclose(found, [expected])
    assert decode(*both, 224, 0.75)[1].size == 0


def test_overlap_is_intersection_over_union():
    one = box(50, 50, 20)
    others = np.stack([one, box(60, 50, 20), box(90, 50, 20), box(50, 50, 10)])
    np.testing.assert_allclose(overlap(one, others), [1, 1 / 3, 0, 1 / 4])


def test_boxes_that_overlap_are_averaged_by_score():
    boxes = np.stack([box(54, 50, 20), box(150, 50, 20), box(50, 50, 20)])
    means, scores, pictures = average_boxes(boxes, np.array([0.6, 0.7, 0.9]), np.zeros(3, int))
    assert scores.tolist() == [0.9, 0.7]
    assert pictures.tolist() == [0, 0]
    np.testing.assert_allclose(means[0, 0], [(0.9 * 50 + 0.6 * 54) / 1.5, 50])
    np.testing.assert_allclose(means[1], boxes[1])
    assert average_boxes(boxes[:0], np.zeros(0), np.zeros(0, int))[0].shape == (0, 6, 2)


def test_boxes_are_averaged_within_each_picture_alone(rng):
    """The boxes of all pictures at once give the same as each picture alone."""
    pictures = np.sort(rng.integers(0, 5, 60)) * 2
    boxes = np.stack([box(x, y, 30) for x, y in rng.uniform(0, 100, (60, 2))])
    scores = rng.uniform(0.5, 1, 60)
    means, best, whose = average_boxes(boxes, scores, pictures)
    for number in range(10):
        alone = average_boxes(*(each[pictures == number] for each in (boxes, scores, pictures)))
        assert (np.diff(alone[1]) <= 0).all()
        for each, expected in zip((means, best), alone, strict=False):
            np.testing.assert_array_equal(each[whose == number], expected)


@pytest.mark.parametrize("size", [(497, 884), (480, 640), (900, 300), (3000, 4000)])
@pytest.mark.parametrize("levels", [2, 3])
def test_tiles_cover_the_picture_and_overlap(size, levels):
    crops = tiles(size, levels, 224)
    assert crops.sides[0] == max(size)
    assert crops.sides.min() == max(size) / 2 ** (levels - 1) or crops.sides.min() / 2 < 224
    smallest = crops[crops.sides == crops.sides.min()]
    side = smallest.sides[0]
    for point in np.random.default_rng(0).uniform((0, 0), size[::-1], (50, 2)):
        distance = np.abs(smallest.centres - point).max(axis=1)
        assert distance.min() <= side / 2 + 1e-6
        inner = (point > side / 2) & (point < np.array(size[::-1]) - side / 2)
        if inner.all():  # whoever is not at the border is well inside some tile
            assert distance.min() <= side / 4 + 1e-6


def test_small_pictures_are_looked_at_once():
    assert len(tiles((300, 440), 3, 224)) == 1


def test_crops_stand_for_those_that_are_about_the_same():
    centres = np.array([[100.0, 100], [105, 102], [100, 100], [100, 100], [140, 100], [100, 100]])
    sides = np.array([200.0, 180, 80, 200, 200, 200])
    angles = np.array([3.1, -3.1, 3.1, 0.0, 3.1, 3.1])
    pictures = np.array([0, 0, 0, 0, 0, 1])
    kept, scores = distinct_crops(TurnedCrops(centres, sides, angles, pictures), np.linspace(0.5, 1.0, 6))
    np.testing.assert_array_equal(kept.centres, centres[[0, 2, 3, 4, 5]])
    np.testing.assert_allclose(scores, [0.6, 0.7, 0.8, 0.9, 1.0])


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
