"""Search for people in pictures, at one size of tiles after the other: what was looked at is not looked at again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...body.skeletons import skeleton
from .asset import PeopleNetworks
from .crops import Pyramid, TurnedCrops, join_crops, no_crops
from .detector import Detections, detect_people, distinct_detections, join_detections, tiles, turned_views
from .look import FoundLandmarks, join_landmarks, look
from .masks import mask_shows
from .person import SKELETON, FoundPerson
from .same_person import first_of_each, similarity

_COCO = skeleton("coco17")
_COCO_LANDMARKS = [skeleton(SKELETON).landmarks.index(name) for name in _COCO.landmarks]
_MIRRORED = _COCO.mirror
_HEAD = slice(0, 11)  # the head's landmarks
_COCO_HEAD = slice(0, 5)  # the head's keypoints
_TOGETHER = 64  # people whose masks are made at a time
_FEWEST, _MOST = 2, 4  # levels where the pictures decide
_SMALL = 1.4  # side of the crop about the smallest person that a level finds, in quarters of the level's tiles
_FAINT = 0.05  # score of the detector from which on somebody may be there, so that another view is worth a look
_UPRIGHT = 0.7  # least cosine of the angle by which somebody is turned who counts as upright
_DETECTED = 0.15  # least score of a person whom the detector sees
_CERTAIN = 0.3  # score of the detector from which on it takes nothing off a person's score
_KEPT = 0.95  # least score of the second look, that of the first being 1
_POWER = 2 / 3  # of the product of all evidence; it brings the best limit, on photos, to 0.5
_CLEAR = 0.9  # score from which on somebody is not looked at once more as smaller tiles show them
_HEAD_SEEN = 0.45  # mean confidence in a head's keypoints from which on the detector sees a head
_WITHIN = 0.8  # share of somebody's mask, within those of others, from which on it needs a head of its own
_GRID = 48  # points a side at which masks are compared
_FIRST = 0.4  # least score of the first look at a person, as a share of the least score


@dataclass(frozen=True)
class ScoredLandmarks:
    """N people of several pictures, each once.

    Attributes:
        landmarks: Landmarks and masks of the people.
        scores: Confidence that there is a person, shape (N,).
    """

    landmarks: FoundLandmarks
    scores: np.ndarray

    @property
    def pictures(self) -> np.ndarray:
        """Index of each one's picture, shape (N,)."""
        return self.landmarks.crops.pictures

    def sides(self, picture: int) -> np.ndarray:
        """Sides of the crops about those of a picture [px]."""
        return self.landmarks.next_crops.sides[self.pictures == picture]

    def counts(self, num_pictures: int) -> np.ndarray:
        """Number of people in each of so many pictures."""
        return np.bincount(self.pictures, minlength=num_pictures)

    def with_those_of(self, others: ScoredLandmarks, pictures: Sequence[int]) -> ScoredLandmarks:
        """Returns a copy in which the people of some pictures are the others who were found there."""
        kept = np.flatnonzero(~np.isin(self.pictures, pictures))
        new = np.flatnonzero(np.isin(others.pictures, pictures))
        return ScoredLandmarks(
            join_landmarks([self.landmarks.select(kept), others.landmarks.select(new)]),
            np.concatenate([self.scores[kept], others.scores[new]]),
        )

    def people(self, sizes: Sequence[tuple[int, int]]) -> list[list[FoundPerson]]:
        """The people of each picture, largest first; pictures have sizes (H, W)."""
        order = np.argsort(-self.landmarks.next_crops.sides, kind="stable")
        extents = np.array(sizes).reshape(-1, 2)
        people_of: list[list[FoundPerson]] = [[] for _ in sizes]
        for start in range(0, len(order), _TOGETHER):
            rows = order[start : start + _TOGETHER]
            pictures = self.pictures[rows]
            people = self.landmarks.people(rows, self.scores[rows], extents[pictures])
            for picture, person in zip(pictures.tolist(), people, strict=True):
                people_of[picture].append(person)
        return people_of


def search_people(
    networks: PeopleNetworks, pyramids: Sequence[Pyramid], pictures: Sequence[int], min_score: float, levels: int | None
) -> ScoredLandmarks:
    """People in some of the pictures.

    Args:
        networks: The packaged ones.
        pyramids: All pictures.
        pictures: Indices of those to look at.
        min_score: Least confidence that there is a person.
        levels: Number of sizes of tiles, as in ``find_people``.
    """
    search = _Search(networks, pyramids, min_score)
    search.look_at_tiles(pictures, levels or _FEWEST)
    found = search.people(pictures)
    turned = [index for index in pictures if search.sees_more_than_upright(found, index)]
    if turned:
        search.look_at_turned(turned)
        found = found.with_those_of(search.people(turned), turned)
    for level in range(_FEWEST, _MOST if levels is None else 0):
        pictures = [index for index in pictures if _look_closer(found.sides(index), pyramids[index].size, level)]
        if not pictures:
            break
        search.look_closer(pictures, level)
        closer = search.people(pictures)
        more = closer.counts(len(pyramids)) > found.counts(len(pyramids))
        found = found.with_those_of(closer, np.flatnonzero(more).tolist())
    return found


def _look_closer(sides: np.ndarray, size: tuple[int, int], level: int) -> bool:
    """True if tiles of a further level may show people whom those before don't.

    Args:
        sides: Sides of the crops about those who were found so far [px], shape (N,).
        size: Height and width (H, W) of the picture [px].
        level: Level as in ``tiles``.
    """
    if not len(sides):
        return level == _FEWEST
    return float(sides.min()) < _SMALL / 4 * max(size) / 2 ** (level - _FEWEST)


class _Search:
    """Search for people in pictures.

    The detector looks at each view once. The landmark network looks at each person whom the detector sees once, and
    once more in the crop that the person's landmarks give.

    Args:
        networks: The packaged ones.
        pyramids: The pictures.
        min_score: Least confidence that there is a person.
    """

    def __init__(self, networks: PeopleNetworks, pyramids: Sequence[Pyramid], min_score: float) -> None:
        self._networks, self._pyramids, self._min_score = networks, pyramids, min_score
        self._detected = join_detections([])
        self._first, self._second = _Looks(networks, pyramids), _Looks(networks, pyramids)
        self._clear = self._settled = np.zeros(0, dtype=np.int64)  # rows of what was detected

    def look_at_tiles(self, pictures: Sequence[int], levels: int) -> None:
        """Show the detector all tiles of so many levels."""
        self._detect([tiles(self._pyramids[index].size, level, index) for index in pictures for level in range(levels)])

    def look_at_turned(self, pictures: Sequence[int]) -> None:
        """Show the detector the whole pictures, turned."""
        self._detect([turned_views(self._pyramids[index].size, index) for index in pictures])

    def look_closer(self, pictures: Sequence[int], level: int) -> None:
        """Show the detector those tiles of a further level in which it has seen somebody, however faintly."""
        views = []
        for index in pictures:
            some = tiles(self._pyramids[index].size, level, index)
            middles = self._detected[self._faint(index)].middles()
            apart = np.abs(some.centres[:, None] - middles).max(axis=2)
            views.append(some[(apart <= some.sides[:, None] / 2).any(axis=1)])
        self._detect(views)
        self._settled = self._clear

    def _detect(self, views: Sequence[TurnedCrops]) -> None:
        found = detect_people(self._networks, self._pyramids, join_crops([no_crops(), *views]), _DETECTED)
        self._detected = join_detections([self._detected, found])

    def _faint(self, picture: int) -> np.ndarray:
        """Rows of those in a picture whom the detector sees at least faintly."""
        return np.flatnonzero((self._detected.pictures == picture) & (self._detected.scores >= _FAINT))

    def sees_more_than_upright(self, found: ScoredLandmarks, picture: int) -> bool:
        """True if the detector has seen somebody in a picture, however faintly, outside of all who were found upright.

        Somebody who lies or is upside down is seen faintly in upright views, too, and may be found worse in them.
        """
        upright = np.cos(found.landmarks.next_crops.angles) > _UPRIGHT
        points = found.landmarks.points[(found.pictures == picture) & upright]
        low, high = points.min(axis=1), points.max(axis=1)
        middles = self._detected[self._faint(picture)].middles()[:, None]
        return not ((middles >= low) & (middles <= high)).all(axis=2).any(axis=1).all()

    def people(self, pictures: Sequence[int]) -> ScoredLandmarks:
        """People in some pictures, by all that the detector has seen."""
        known = np.flatnonzero(np.isin(self._detected.pictures, pictures) & (self._detected.scores >= _DETECTED))
        known = known[distinct_detections(self._detected[known], np.isin(known, self._settled))]
        detected = self._detected[known]
        first = self._first.at(known, detected.crops())
        scores = _agreement_scores(detected, first)
        rows = _distinct(first, scores, _FIRST * self._min_score)
        detected, first, scores = detected[rows], first.select(rows), scores[rows]
        known = known[rows]
        second = self._second.at(known, first.next_crops)
        closer = _agreement_scores(detected, second)
        stayed = closer >= _KEPT * scores  # else the second look went to a neighbour
        found, scores = first.or_better(second, stayed), np.where(stayed, closer, scores)
        rows = _distinct(found, scores, self._min_score)
        before = self._clear[~np.isin(self._detected.pictures[self._clear], pictures)]
        self._clear = np.concatenate([before, known[rows][scores[rows] >= _CLEAR]])
        people = ScoredLandmarks(found.select(rows), scores[rows])
        return self._without_phantoms(people, detected.confidence[rows][:, _COCO_HEAD].mean(axis=1))

    def _without_phantoms(self, people: ScoredLandmarks, heads: np.ndarray) -> ScoredLandmarks:
        """The people but those who are nothing but a second look at others.

        Somebody who is within the outlines of people of higher scores must have a head that the detector sees.

        Args:
            people: People of any of the pictures.
            heads: The detector's mean confidence in the keypoints of each one's head, shape (N,).
        """
        kept = np.ones(len(heads), dtype=bool)
        for row in np.flatnonzero(heads < _HEAD_SEEN).tolist():
            picture = int(people.pictures[row])
            better = np.flatnonzero((people.pictures == picture) & (people.scores > people.scores[row]))
            kept[row] = _share_within(people.landmarks, row, better, self._pyramids[picture].size) < _WITHIN
        return ScoredLandmarks(people.landmarks.select(np.flatnonzero(kept)), people.scores[kept])


class _Looks:
    """Looks at people who were detected, each of whom is looked at once."""

    def __init__(self, networks: PeopleNetworks, pyramids: Sequence[Pyramid]) -> None:
        self._networks, self._pyramids = networks, pyramids
        self._found = look(networks, pyramids, no_crops())
        self._places: dict[int, int] = {}  # in what was found, of each person by number

    def at(self, numbers: np.ndarray, crops: TurnedCrops) -> FoundLandmarks:
        """Landmarks in the crops of people, each of whom has a number of their own."""
        new = np.array([number not in self._places for number in numbers.tolist()], dtype=bool)
        for number in numbers[new].tolist():
            self._places[number] = len(self._places)
        self._found = join_landmarks([self._found, look(self._networks, self._pyramids, crops[new])])
        return self._found.select(np.array([self._places[number] for number in numbers.tolist()], dtype=np.int64))


def follow(
    networks: PeopleNetworks, pyramids: Sequence[Pyramid], before: Sequence[Sequence[FoundPerson]], min_score: float
) -> ScoredLandmarks:
    """People who were in the frame before each picture."""
    crops = [no_crops()]
    for index, people in enumerate(before):
        for person in people:
            crop = person.next_crop
            crops.append(TurnedCrops(crop.centres, crop.sides, crop.angles, np.full(len(crop), index)))
    found = look(networks, pyramids, join_crops(crops))
    rows = _distinct(found, found.presence, min_score)
    return ScoredLandmarks(found.select(rows), found.presence[rows])


def _share_within(landmarks: FoundLandmarks, row: int, others: np.ndarray, size: tuple[int, int]) -> float:
    """Share of one person's mask, as far as a picture of size (H, W) shows it, that the masks of others cover.

    Args:
        landmarks: People of the picture, and perhaps of more.
        row: Row of the person.
        others: Rows of the others, shape (N,).
        size: Height and width of the picture [px].
    """
    steps = (np.arange(_GRID) + 0.5) / _GRID
    crop = landmarks.crops[row : row + 1]
    positions = crop.to_picture(np.stack(np.meshgrid(steps, steps), axis=-1).reshape(1, -1, 2))[0]
    positions = positions[((positions >= 0) & (positions <= size[::-1])).all(axis=1)]
    positions = positions[mask_shows(landmarks.masks[row].sigmoid(), crop, positions)]
    covered = np.zeros(len(positions), dtype=bool)
    for other in others.tolist():
        covered |= mask_shows(landmarks.masks[other].sigmoid(), landmarks.crops[other : other + 1], positions)
    return float(covered.sum() / max(len(positions), 1))


def _agreement_scores(detected: Detections, found: FoundLandmarks) -> np.ndarray:
    """Confidence in people who were detected, shape (N,): of presence and of both networks' agreement.

    It is less where the detector is unsure, for parts of people look like people to the other network. Networks that
    exchange left and right agree: on backs, the detector often does.
    """
    sides = found.next_crops.sides
    theirs = found.points[:, _COCO_LANDMARKS], found.confidence[:, _COCO_LANDMARKS], sides
    straight = similarity((detected.points, detected.confidence, sides), theirs)
    exchanged = similarity((detected.points[:, _MIRRORED], detected.confidence[:, _MIRRORED], sides), theirs)
    agreement = np.maximum(straight, exchanged)
    certainty = np.minimum(detected.scores / _CERTAIN, 1.0)
    return (found.presence * agreement * certainty) ** _POWER


def _distinct(found: FoundLandmarks, scores: np.ndarray, min_score: float) -> np.ndarray:
    """Rows of people whose score is enough, each person once."""
    rows = np.flatnonzero(scores >= min_score)
    some = found.select(rows)
    quality = scores[rows] * some.confidence.mean(axis=1)
    kept = first_of_each(some.points, some.confidence, some.next_crops.sides, some.crops.pictures, quality, _HEAD)
    return rows[kept]
