"""The detector at work: at the whole picture and at tiles of it, from boxes to a crop about each person."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .asset import PeopleNetworks
from .boxes import average_boxes, decode
from .crops import Pyramid, TurnedCrops, crops_of_people, cut_crops, join_crops, no_crops, work_on_crops
from .same_person import distinct_crops


def tiles(size: tuple[int, int], levels: int, smallest: int, picture: int = 0) -> TurnedCrops:
    """The squares that the detector looks at: one about the whole picture, then smaller ones that overlap by half.

    Args:
        size: Height and width (H, W) of the picture [px].
        levels: Number of sizes, each half of the one before.
        smallest: Least side of a tile, except the first one [px].
        picture: Index of the picture.
    """
    height, width = size
    centres, sides = [(width / 2, height / 2)], [float(max(size))]
    for level in range(1, levels):
        side = max(size) / 2**level
        if side < smallest:
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
) -> tuple[TurnedCrops, np.ndarray]:
    """Find people in some of the pictures.

    Args:
        networks: The packaged ones.
        pyramids: All pictures.
        pictures: Indices of those to look at.
        min_score: Least score of a box.
        levels: Sizes of tiles.

    Returns:
        A crop about each person, and the best score of its boxes, shape (N,).
    """
    size = networks.detector.size
    views = join_crops([no_crops(), *(tiles(pyramids[index].size, levels, size, index) for index in pictures)])

    def find(part: TurnedCrops) -> tuple[np.ndarray, ...]:
        said = networks.detector(cut_crops(pyramids, part, size) * 2 - 1)
        boxes, scores, places = decode(said["boxes"], said["scores"][..., 0], size, min_score)
        return boxes, scores, places, np.array([len(part)])

    found = work_on_crops(find, views, networks.device)
    if not found:
        return no_crops(), np.zeros(0)
    boxes, scores, places, counts = (np.concatenate(each) for each in zip(*found, strict=True))
    starts = np.repeat(np.cumsum(counts) - counts, [len(each) for each, *_ in found])
    means, scores, places = average_boxes(boxes, scores, starts + places)
    view = views[places]
    points = view.to_picture(means[:, 2:4] / size)
    # Larger tiles, which show people whole, come first.
    return distinct_crops(crops_of_people(points[:, 0], points[:, 1], view.pictures), scores)
