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
_HIPS, _SHOULDERS = ([_COCO.index(f"{side}_{name}") for side in ("left", "right")] for name in ("hip", "shoulder"))
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

    def crops(self) -> TurnedCrops:
        """Crops about the people, upright as their hips and shoulders stand."""
        hips, shoulders = (self.points[:, places].mean(axis=1) for places in (_HIPS, _SHOULDERS))
        up = shoulders - hips
        torso = np.linalg.norm(up, axis=1)
        away = np.linalg.norm(self.points - hips[:, None], axis=2) * (self.confidence > SURE)
        radius = np.maximum(_BEYOND * away.max(axis=1, initial=0.0), _TORSO * torso)
        tops = hips + up * (radius / np.maximum(torso, 1e-6))[:, None]
        return crops_of_people(hips, tops, self.pictures)


def detector_views(size: tuple[int, int], levels: int, picture: int = 0) -> TurnedCrops:
    """The squares that the detector looks at: ``tiles``, and the whole picture turned by quarters of a circle.

    Arguments are those of ``tiles``.
    """
    upright = tiles(size, levels, picture)
    return join_crops([upright, *(replace(upright[:1], angles=np.array([turn])) for turn in _TURNS)])


def tiles(size: tuple[int, int], levels: int, picture: int = 0) -> TurnedCrops:
    """Squares of a picture: one about the whole picture, then smaller ones that overlap by half.

    Args:
        size: Height and width (H, W) of the picture [px].
        levels: Number of sizes, each half of the one before. Sizes below ``SMALLEST`` are left out, but for the first.
        picture: Index of the picture.
    """
    height, width = size
    centres, sides = [(width / 2, height / 2)], [float(max(size))]
    for level in range(1, levels):
        side = max(size) / 2**level
        if side < SMALLEST:
            break
        rows, columns = (_middles(length, side) for length in size)
        centres += [(x, y) for y in rows for x in columns]
        sides += [side] * (len(rows) * len(columns))
    count = len(sides)
    return TurnedCrops(np.array(centres), np.array(sides), np.zeros(count), np.full(count, picture))


def _middles(length: int, side: float) -> list[float]:
    """Middles of the tiles that cover a length, neighbours at most half a tile apart."""
    if length <= side:
        return [length / 2]
    count = math.ceil((length - side) / (side / 2)) + 1
    return np.linspace(side / 2, length - side / 2, count).tolist()


def detect_people(
    networks: PeopleNetworks, pyramids: Sequence[Pyramid], pictures: Sequence[int], min_score: float, levels: int
) -> Detections:
    """Find people in some of the pictures.

    Args:
        networks: The packaged ones.
        pyramids: All pictures.
        pictures: Indices of those to look at.
        min_score: Least score of a person.
        levels: Sizes of tiles.

    Returns:
        People, each once, as far as keypoints in several tiles tell.
    """
    size = networks.detector.size
    views = join_crops([no_crops(), *(detector_views(pyramids[index].size, levels, index) for index in pictures)])

    def find(part: TurnedCrops) -> tuple[np.ndarray, ...]:
        said = read_people(networks.detector(cut_crops(pyramids, part, size) * 2 - 1), min_score)
        return (np.array([len(part)]), *(each.cpu().numpy() for each in said))

    found = work_on_crops(find, views, networks.device)
    if not found:
        return Detections(np.zeros((0, NUM_KEYPOINTS, 2)), np.zeros((0, NUM_KEYPOINTS)), np.zeros(0), np.zeros(0, int))
    counts, places, scores, keypoints = (np.concatenate(each) for each in zip(*found, strict=True))
    starts = np.repeat(np.cumsum(counts) - counts, [len(each) for _, each, *_ in found])
    rows = np.flatnonzero(scores >= min_score)
    view, keypoints = views[(starts + places)[rows]], keypoints[rows].astype(np.float64)
    points = view.to_picture(keypoints[..., :2] / size)
    detected = Detections(points, keypoints[..., 2], scores[rows].astype(np.float64), view.pictures)
    quality = detected.scores * detected.confidence.sum(axis=1)
    sides = detected.crops().sides
    return detected[first_of_each(detected.points, detected.confidence, sides, detected.pictures, quality)]
