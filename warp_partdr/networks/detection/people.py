"""Everyone in a picture, or in several: from the detector's boxes to keypoints and masks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ...body.skeletons import skeleton
from ...errors import InputError, check_each, check_type, check_whole, shown
from ...interop.torch_threads import one_torch_thread
from . import MIN_SCORE, LandmarkNetwork, check_landmark_network
from .asset import PeopleNetworks, packaged_people_networks
from .crops import Pyramid, TurnedCrops, join_crops
from .detector import SMALLEST, Detections, detect_people
from .heavy import with_heavy_landmarks
from .look import FoundLandmarks, join_landmarks, look
from .person import SKELETON, FoundPerson
from .same_person import first_of_each, similarity

_COCO = skeleton("coco17")
_COCO_LANDMARKS = [skeleton(SKELETON).landmarks.index(name) for name in _COCO.landmarks]
_MIRRORED = _COCO.mirror
_HEAD = slice(0, 11)  # the head's landmarks
_TOGETHER = 64  # people whose masks are made at a time
_FEWEST, _MOST = 2, 4  # levels where the pictures decide
_DETECTED = 0.15  # least score of a person whom the detector sees
_CERTAIN = 0.3  # score of the detector from which on it takes nothing off a person's score
_KEPT = 0.95  # least score of the second look, that of the first being 1
_POWER = 2 / 3  # of the product of all evidence; it brings the best limit, on photos, to 0.5
_FIRST = 0.4  # least score of the first look at a person, as a share of the least score
_SMALL = 1.4  # side of the crop about the smallest person that a level finds, in quarters of the level's tiles


def find_people(
    picture: np.ndarray | Pyramid,
    *,
    device: torch.device | str = "cpu",
    min_score: float = MIN_SCORE,
    levels: int | None = None,
    previous: Sequence[FoundPerson] = (),
    landmarks: LandmarkNetwork = "full",
) -> list[FoundPerson]:
    """Find everyone in a picture.

    Args:
        picture: RGB, shape (H, W, 3), uint8; or a ``Pyramid`` of it on the device, which others may go on with.
        device: Device to run on.
        min_score: Least confidence that there is a person (``FoundPerson.score``), 0 to 1.
        levels: Number of sizes at which the picture is looked at. With 1, the whole picture alone is, where people of a
            quarter of its longer side and more are found. Each further level, at overlapping tiles of half the size,
            finds people half as large. Tiles smaller than 192 pixels are left out. If it is None, there
            are 2, and more where people are so small that there may be smaller ones, or where nobody is found.
        previous: The people of a film's last frame. Where they are given, only they are followed, and the detector
            doesn't run; nobody new is found.
        landmarks: Network whose keypoints are taken. "heavy" is nearer to the truth, and takes five times as long as a
            look of "full" for each person who is found. The people and their masks are those of "full" with either.

    Returns:
        People, largest first; none if nobody is there.

    Raises:
        TypeError: If ``picture`` is neither, or ``previous`` are no people.
        InputError: If it is no picture.
        ValueError: If a number is out of range.
    """
    (people,) = find_people_in(
        [picture], device=device, min_score=min_score, levels=levels, previous=[previous], landmarks=landmarks
    )
    return people


@one_torch_thread()
@torch.no_grad()
def find_people_in(
    pictures: Sequence[np.ndarray | Pyramid],
    *,
    device: torch.device | str = "cpu",
    min_score: float = MIN_SCORE,
    levels: int | None = None,
    previous: Sequence[Sequence[FoundPerson]] | None = None,
    half: bool = False,
    landmarks: LandmarkNetwork = "full",
) -> list[list[FoundPerson]]:
    """Find everyone in several pictures of any sizes, in batches.

    Args:
        pictures: Pictures, each as in ``find_people``.
        device: Device to run on.
        min_score: Least confidence, as in ``find_people``.
        levels: Number of sizes of tiles, as in ``find_people``.
        previous: People of the frame before each picture. If it is None, no picture has any.
        half: True asks the networks in float16 on CUDA (``HalfGraph``).
        landmarks: Network whose keypoints are taken, as in ``find_people``.

    Returns:
        The people of each picture.
    """
    for index, picture in enumerate(pictures):
        if not isinstance(picture, Pyramid):
            check_picture("picture" if len(pictures) == 1 else f"pictures[{index}]", picture)
    fixed = None if levels is None else check_whole("levels", levels, 1)
    if not 0 <= min_score < 1:
        raise ValueError(f"min_score: {shown(min_score)}; expected a number from 0 to below 1")
    before = [()] * len(pictures) if previous is None else previous
    if len(before) != len(pictures):
        raise ValueError(f"previous: of {len(before)} pictures; expected {len(pictures)}, as pictures")
    for people in before:
        check_each("previous", people, FoundPerson, "of find_people")
    check_landmark_network(landmarks)
    half = half and torch.device(device).type == "cuda"
    networks = packaged_people_networks(str(device), half=half, landmarks=landmarks)
    made = iter(Pyramid.each([each for each in pictures if not isinstance(each, Pyramid)], networks.device))
    pyramids = [each if isinstance(each, Pyramid) else next(made) for each in pictures]
    if elsewhere := {pyramid.device for pyramid in pyramids} - {networks.device}:
        raise ValueError(f"picture: a pyramid on {elsewhere.pop()}; expected one on {networks.device}")
    everyone = _find(networks, pyramids, before, min_score, fixed or _FEWEST)
    for more in range(_FEWEST + 1, 1 + (_MOST if fixed is None else 0)):
        again = [
            index
            for index, people in enumerate(everyone)
            if not before[index] and _look_closer(people, max(pyramids[index].size), more)
        ]
        closer = _find(networks, [pyramids[index] for index in again], [()] * len(again), min_score, more)
        for index, people in zip(again, closer, strict=True):
            everyone[index] = max(everyone[index], people, key=len)
    return everyone if networks.heavy is None else with_heavy_landmarks(networks.heavy, pyramids, everyone)


def check_picture(name: str, picture: np.ndarray) -> None:
    """Raise unless an argument is a picture."""
    check_type(name, picture, np.ndarray, "of read_photo")
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or not picture.size:
        raise InputError(f"{name}: {picture.dtype} {picture.shape}; expected uint8 (H, W, 3), RGB")


def _look_closer(people: Sequence[FoundPerson], longer: int, levels: int) -> bool:
    """True if one more level, the last of so many, may find people in a picture of this longer side [px]."""
    if longer / 2 ** (levels - 1) < SMALLEST:
        return False
    if not people:
        return levels == _FEWEST + 1
    smallest = min(float(person.next_crop.sides[0]) for person in people)
    return smallest < _SMALL / 4 * longer / 2 ** (levels - _FEWEST - 1)


def _find(
    networks: PeopleNetworks,
    pyramids: Sequence[Pyramid],
    before: Sequence[Sequence[FoundPerson]],
    min_score: float,
    levels: int,
) -> list[list[FoundPerson]]:
    """The people of each picture, those who were in the frame before it or else new ones."""
    new = [index for index, people in enumerate(before) if not people]
    detected = detect_people(networks, pyramids, new, _DETECTED, levels)
    first = look(networks, pyramids, detected.crops())
    scores = _agreement_scores(detected, first)
    rows = _distinct(first, scores, _FIRST * min_score)
    detected, first, scores = detected[rows], first.select(rows), scores[rows]
    followed = [_moved(person.next_crop, index) for index, people in enumerate(before) for person in people]
    found = look(networks, pyramids, join_crops([first.next_crops, *followed]))
    again, rest = np.arange(len(rows)), np.arange(len(rows), len(found.crops))
    second = found.select(again)
    closer = _agreement_scores(detected, second)
    stayed = closer >= _KEPT * scores  # else the second look went to a neighbour
    found = join_landmarks([first.or_better(second, stayed), found.select(rest)])
    scores = np.concatenate([np.where(stayed, closer, scores), found.presence[rest]])
    rows = _distinct(found, scores, min_score)
    rows = rows[np.argsort(-found.next_crops.sides[rows], kind="stable")]
    pictured = found.crops.pictures[rows]
    sizes = np.array([pyramid.size for pyramid in pyramids]).reshape(-1, 2)[pictured]
    people_of: list[list[FoundPerson]] = [[] for _ in pyramids]
    for start in range(0, len(rows), _TOGETHER):
        some = slice(start, start + _TOGETHER)
        for picture, person in zip(
            pictured[some].tolist(), found.people(rows[some], scores[rows[some]], sizes[some]), strict=True
        ):
            people_of[picture].append(person)
    return people_of


def _agreement_scores(detected: Detections, found: FoundLandmarks) -> np.ndarray:
    """Confidence in people who were detected, shape (N,): of presence and of both networks' agreement.

    It is less where the detector is unsure, for parts of people look like people to the other network. Networks that
    exchange left and right agree: on backs, the detector often does.
    """
    theirs = found.points[:, _COCO_LANDMARKS], found.confidence[:, _COCO_LANDMARKS], found.next_crops.sides
    agreement = np.maximum(
        *(
            similarity((detected.points[:, order], detected.confidence[:, order], theirs[2]), theirs)
            for order in (slice(None), _MIRRORED)
        )
    )
    certainty = np.minimum(detected.scores / _CERTAIN, 1.0)
    return (found.presence * agreement * certainty) ** _POWER


def _distinct(found: FoundLandmarks, scores: np.ndarray, min_score: float) -> np.ndarray:
    """Rows of people whose score is enough, each person once."""
    rows = np.flatnonzero(scores >= min_score)
    some = found.select(rows)
    quality = scores[rows] * some.confidence.mean(axis=1)
    kept = first_of_each(some.points, some.confidence, some.next_crops.sides, some.crops.pictures, quality, _HEAD)
    return rows[kept]


def _moved(crop: TurnedCrops, picture: int) -> TurnedCrops:
    return TurnedCrops(crop.centres, crop.sides, crop.angles, np.full(len(crop), picture))
