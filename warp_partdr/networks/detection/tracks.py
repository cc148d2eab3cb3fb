"""People of a film, who keep their numbers from frame to frame.

People of the last frame are looked for near the same position, which needs one run of the landmark network for each
person. The detector is slower, but sees new people. It looks every few frames, and whenever a person was lost. Until it
sees the first person of a shot, it looks sooner, after 1, 2, 4 frames and so on. Nobody is followed through a cut: in a
new shot, everybody gets a new number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np
import torch

from ...errors import check_whole
from ...inputs.cuts import Change
from . import MIN_SCORE, LandmarkNetwork
from .crops import Pyramid, TurnedCrops
from .masks import mask_shows
from .people import find_people
from .person import FoundPerson
from .same_person import similarity

_SAME = 0.5  # likeness above which two detections are one person
_LED = 0.2  # likeness that is added for a person who is found exactly where the last frame placed the next crop
_REACH = 0.5  # farthest that a lost person moves between two looks of the detector, in sides of the crop
_RATIO = 0.6  # least ratio of the sides of a person's crops before and after the person was lost
_GRID = 48  # points along a side at which two masks are compared
_LEVELS = 2  # of the detector: a film's many frames should not take long
_PATIENCE = 3  # looks of the detector for which a lost person may be away
# Similarity of somebody's keypoints to those of the last frame, from which on they were followed through a change of
# the picture that may be a cut.
_STAYED = 0.4
# Overlap of somebody's mask with that of the last frame, from which on they clearly stayed: in a slideshow, people
# stand about the same place by chance (0.2 to 0.3; somebody who walks, every 10th frame: 0.43 to 0.95).
_COVERED = 1 / 3


class PeopleTracker:
    """People of a film, frame by frame; each has a number that stays, from 0 on as they come.

    Args:
        device: Device to run on.
        min_score: Least confidence, as in ``find_people``.
        every: Frames from one look of the detector to the next. There are fewer until it sees somebody. In the frames
            between, people who are there are only followed.
        landmarks: Network whose keypoints are taken, as in ``find_people``.

    Attributes:
        cut: True if the last frame was the first of another shot.
    """

    def __init__(
        self,
        *,
        device: torch.device | str = "cpu",
        min_score: float = MIN_SCORE,
        every: int = 10,
        landmarks: LandmarkNetwork = "full",
    ) -> None:
        self._device, self._min_score, self._landmarks = device, min_score, landmarks
        self._every = check_whole("every", every, 1)
        self._here: dict[int, FoundPerson] = {}
        self._lost: dict[int, tuple[FoundPerson, int]] = {}  # and the frames they have been away
        self._since = 0  # frames since the detector's last look
        self._wait = 0  # frames from the detector's last look to its next
        self._known = 0  # numbers that were given
        self.cut = False

    def find(self, picture: np.ndarray | Pyramid, change: Change = Change.NONE) -> dict[int, FoundPerson]:
        """Find the people of the next frame.

        Args:
            picture: Picture as in ``find_people``, of one size in all frames.
            change: Change from the last frame to this one. People who can't be followed into a flash are looked for
                after it. When there is a jump, or when all is new, this method finds whether it is a cut. If nobody was
                there, the detector looks at once.

        Returns:
            People by their numbers.
        """
        self._since += 1
        self.cut = change is Change.CUT
        if self.cut:
            self._forget_everybody()
        before = self._here
        if change in (Change.JUMP, Change.NEW) and not before:
            self._wait = 0
        followed: dict[int, FoundPerson] = {}
        if before:
            people = self._find(picture, list(before.values()))
            followed = _assign(people, before, lambda person, number: _followed(person, before[number]))
            if change is Change.FLASH:
                followed = {number: one for number, one in followed.items() if _stayed(one, before[number])}
                self._here = before | followed
                return followed
            if _is_cut(change, followed, before):
                self.cut = True
                self._forget_everybody()
                before, followed = {}, {}
        self._forget(before, followed)
        if self._since >= self._wait or len(followed) < len(before):
            self._since = 0
            new: list[FoundPerson] = []
            for person in sorted(self._find(picture, []), key=lambda person: -person.score):
                if all(likeness(person, one) < _SAME for one in (*followed.values(), *new)):
                    new.append(person)
            back = self._come_back(new)
            for number in back:
                del self._lost[number]
            known = {id(person) for person in back.values()}
            for person in new:
                if id(person) not in known:
                    back[self._known] = person
                    self._known += 1
            followed |= back
            self._wait = self._every if followed else min(max(2 * self._wait, 1), self._every)
        self._here = followed
        return dict(followed)

    def _find(self, picture: np.ndarray | Pyramid, previous: list[FoundPerson]) -> list[FoundPerson]:
        return find_people(
            picture,
            device=self._device,
            min_score=self._min_score,
            levels=_LEVELS,
            previous=previous,
            landmarks=self._landmarks,
        )

    def _come_back(self, people: list[FoundPerson]) -> dict[int, FoundPerson]:
        """Lost people who are found where they may have moved since, by their numbers."""
        reach = {number: _REACH * (frames + 1) / self._every for number, (_, frames) in self._lost.items()}

        def value(person: FoundPerson, number: int) -> float:
            last = self._lost[number][0]
            return max(_nearness(person.next_crop, last.next_crop, reach[number]), likeness(person, last) - _SAME)

        return _assign(people, self._lost, value)

    def _forget_everybody(self) -> None:
        """Begin another shot. The detector looks at its first frame."""
        self._here, self._lost = {}, {}
        self._wait = 0

    def _forget(self, before: Mapping[int, FoundPerson], followed: Mapping[int, FoundPerson]) -> None:
        """Remember lost people, but not for long, because somebody else may stand there soon."""
        away = {number: (person, frames + 1) for number, (person, frames) in self._lost.items()}
        away |= {number: (person, 0) for number, person in before.items() if number not in followed}
        self._lost = {number: each for number, each in away.items() if each[1] <= _PATIENCE * self._every}


def likeness(one: FoundPerson, other: FoundPerson) -> float:
    """Overlap of two people, 0 to 1: of their keypoints, or of their masks where that is larger."""
    return max(_keypoint_similarity(one, other), _mask_overlap(one, other))


def _keypoint_similarity(one: FoundPerson, other: FoundPerson) -> float:
    ours = one.keypoints.points[None], one.keypoints.confidence[None], one.next_crop.sides
    theirs = other.keypoints.points[None], other.keypoints.confidence[None], other.next_crop.sides
    return float(similarity(ours, theirs)[0])


def _stayed(person: FoundPerson, last: FoundPerson) -> bool:
    """True if a person is nearly unchanged since the last frame."""
    return _keypoint_similarity(person, last) >= _STAYED


def _is_cut(change: Change, followed: Mapping[int, FoundPerson], before: Mapping[int, FoundPerson]) -> bool:
    """True if a change is a cut, because nobody who was followed from the last frame stayed."""
    if change not in (Change.JUMP, Change.NEW):
        return False
    least = _COVERED if change is Change.NEW else 0.0
    pairs = [(followed[number], before[number]) for number in followed]
    return not any(_stayed(person, last) and _mask_overlap(person, last) >= least for person, last in pairs)


def _mask_overlap(one: FoundPerson, other: FoundPerson) -> float:
    """Intersection over union of two masks."""
    low, high = np.minimum(one.box[:2], other.box[:2]), np.maximum(one.box[2:], other.box[2:])
    steps = (np.arange(_GRID) + 0.5) / _GRID
    positions = low + (high - low) * np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    first = mask_shows(one.mask, one.crop, positions)
    second = mask_shows(other.mask, other.crop, positions)
    return float((first & second).sum() / max((first | second).sum(), 1))


def _followed(person: FoundPerson, last: FoundPerson) -> float:
    """Likeness of a person to one of the last frame; also above 0 if they are found just where that one led to."""
    led = person.crop.centres == last.next_crop.centres
    return likeness(person, last) + _LED * bool(led.all())


def _nearness(crop: TurnedCrops, last: TurnedCrops, reach: float) -> float:
    """Nearness of crops: 1 at the same position, 0 or less beyond ``reach`` sides of the crops or at another size."""
    (small, large), apart = np.sort([crop.sides[0], last.sides[0]]), np.linalg.norm(crop.centres - last.centres)
    return float(1 - apart / (reach * large)) if small > _RATIO * large else 0.0


def _assign(
    people: list[FoundPerson], numbers: Iterable[int], value: Callable[[FoundPerson, int], float]
) -> dict[int, FoundPerson]:
    """Assign numbers to people, the pair of the greatest value first and each once, as long as it is above 0."""
    pairs = [(value(person, number), -number, index) for index, person in enumerate(people) for number in numbers]
    assigned: dict[int, FoundPerson] = {}
    taken: set[int] = set()
    for worth, number, index in sorted(pairs, reverse=True):
        if worth > 0 and -number not in assigned and index not in taken:
            assigned[-number] = people[index]
            taken.add(index)
    return {number: assigned[number] for number in sorted(assigned)}
