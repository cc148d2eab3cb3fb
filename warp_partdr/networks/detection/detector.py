"""The detector at work: at the whole picture and at tiles of it, from its keypoints to a crop about each person."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...body.skeletons import skeleton
from .asset import PeopleNetworks
from .crops import Pyramid, TurnedCrops, crops_of_people, cut_crops, join_crops, no_crops, work_on_crops
from .movenet import NUM_KEYPOINTS, SURE, read_people
from .same_person import first_of_each

_COCO = skeleton("coco17").landmarks
_HIPS = [_COCO.index("left_hip"), _COCO.index("right_hip")]
_SHOULDERS = [_COCO.index("left_shoulder"), _COCO.index("right_shoulder")]
_TURNS = (math.pi / 2, math.pi, -math.pi / 2)  # [rad] by which the whole picture is turned, for those who don't stand
SMALLEST = 192  # [px], least side of a tile
_BEYOND = 1.15  # radius of the circle about a person, the way from the hips to the farthest keypoint being 1
_TORSO = 1.75  # the same radius, the way from the hips to the shoulders being 1


@dataclass(frozen=True)
class Detections:
    """N people whom the detector sees.

    Attributes:
        points: COCO's 17 keypoints [px], shape (N, 17, 2).
        confidence: Confidence in each keypoint, shape (N, 17).
        scores: Confidence that there is a person, shape (N,).
        pictures: Index of each one's picture, shape (N,), int64.
    """

    points: np.ndarray
    confidence: np.ndarray
    scores: np.ndarray
    pictures: np.ndarray

    def __len__(self) -> int:
        return len(self.scores)

    def __getitem__(self, rows: np.ndarray) -> Detections:
        return Detections(self.points[rows], self.confidence[rows], self.scores[rows], self.pictures[rows])

    def middles(self) -> np.ndarray:
        """Means of the keypoints [px], each weighted by its confidence, shape (N, 2)."""
        weights = self.confidence[..., None] + 1e-6
        means: np.ndarray = (self.points * weights).sum(axis=1) / weights.sum(axis=1)
        return means

    def crops(self) -> TurnedCrops:
        """Crops about the people, upright as their hips and shoulders stand."""
        hips, shoulders = self.points[:, _HIPS].mean(axis=1), self.points[:, _SHOULDERS].mean(axis=1)
        up = shoulders - hips
        torso = np.linalg.norm(up, axis=1)
        away = np.linalg.norm(self.points - hips[:, None], axis=2) * (self.confidence > SURE)
        radius = np.maximum(_BEYOND * away.max(axis=1, initial=0.0), _TORSO * torso)
        tops = hips + up * (radius / np.maximum(torso, 1e-6))[:, None]
        return crops_of_people(hips, tops, self.pictures)


def tiles(size: tuple[int, int], level: int, picture: int = 0) -> TurnedCrops:
    """Squares of a picture in which the detector looks for people, those of one size.

    Args:
        size: Height and width (H, W) of the picture [px].
        level: Number of the size. Level 0 is one square about the whole picture. Each further level has tiles of half
            the side, which overlap by half; there are none if their sides are below ``SMALLEST``.
        picture: Index of the picture.
    """
    height, width = size
    if level == 0:
        return TurnedCrops(
            np.array([[width / 2, height / 2]]), np.array([float(max(size))]), np.zeros(1), np.array([picture])
        )
    side = max(size) / 2**level
    if side < SMALLEST:
        return no_crops()
    rows, columns = _middles(height, side), _middles(width, side)
    centres = np.array([(x, y) for y in rows for x in columns])
    count = len(centres)
    return TurnedCrops(centres, np.full(count, side), np.zeros(count), np.full(count, picture))


def turned_views(size: tuple[int, int], picture: int = 0) -> TurnedCrops:
    """Squares about a whole picture, turned by quarters of a circle, in which those who don't stand are seen.

    Arguments are those of ``tiles``.
    """
    whole = tiles(size, 0, picture)
    return join_crops([replace(whole, angles=np.array([turn])) for turn in _TURNS])


def _middles(length: int, side: float) -> list[float]:
    """Middles of the tiles that cover a length, neighbours at most half a tile apart."""
    if length <= side:
        return [length / 2]
    count = math.ceil((length - side) / (side / 2)) + 1
    return np.linspace(side / 2, length - side / 2, count).tolist()


def detect_people(
    networks: PeopleNetworks, pyramids: Sequence[Pyramid], views: TurnedCrops, min_heat: float
) -> Detections:
    """Find people in views of the pictures; those whom several views show are there several times.

    Args:
        networks: The packaged ones.
        pyramids: All pictures.
        views: Squares to look at.
        min_heat: Least heat of the centre of a person, as in ``read_people``; scores may be less.
    """
    size = networks.detector.size

    def find(part: TurnedCrops) -> Detections:
        maps = networks.detector(cut_crops(pyramids, part, size) * 2 - 1)
        places, scores, found = read_people(maps, min_heat)
        view = part[places.cpu().numpy()]
        keypoints = found.cpu().numpy().astype(np.float64)
        points = view.to_picture(keypoints[..., :2] / size)
        return Detections(points, keypoints[..., 2], scores.cpu().numpy().astype(np.float64), view.pictures)

    return join_detections(work_on_crops(find, views, networks.device))


def join_detections(parts: Sequence[Detections]) -> Detections:
    """All of the people in a row."""
    if not parts:
        return Detections(np.zeros((0, NUM_KEYPOINTS, 2)), np.zeros((0, NUM_KEYPOINTS)), np.zeros(0), np.zeros(0, int))
    return Detections(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.confidence for part in parts]),
        np.concatenate([part.scores for part in parts]),
        np.concatenate([part.pictures for part in parts]),
    )


def distinct_detections(detected: Detections, preferred: np.ndarray) -> np.ndarray:
    """Rows of people, each once, as far as keypoints in several views tell.

    Args:
        detected: People in views.
        preferred: Mask of those who are taken before all others, shape (N,), bool.
    """
    quality = detected.scores * detected.confidence.sum(axis=1)
    quality = quality + preferred * (1 + quality.max(initial=0.0))
    sides = detected.crops().sides
    return first_of_each(detected.points, detected.confidence, sides, detected.pictures, quality)
