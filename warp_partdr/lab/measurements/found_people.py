"""People found, missed and false in photos, whose people were marked by hand.

FOLDER holds packages from PyPI and npm, each unpacked into a folder of its name. The photos in them are free, but this
project may not pass them on. ``found_people.json`` names the packages, the photos, of which some are turned, and frames
of films. It has a box for each person of whom a third or more is visible, and who is taller than a 25th of the longer
side. Boxes of blurred people, statues and pictures of people are ignored: a detection there is neither right nor false.
Half of the photos, "chosen on", may be looked at when a rule is chosen. The other half is held out. Turned copies of a
photo are in the same half.

A person counts as found if the box of the keypoints, cut at the picture's border, overlaps the marked box (an
intersection over union above 0.2), one to one. Intervals of 95 % are over photos.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...inputs.films import read_frames
from ...inputs.part_labels import read_photo
from ...metrics import bootstrap_sum
from ...networks.detection import MIN_SCORE, LandmarkNetwork
from ...networks.detection.people import find_people
from ...networks.detection.person import FoundPerson
from ..options import tracked
from ..tables import Estimate, FigureTable

_OVERLAP = 0.2  # intersection over union above which a detection is the marked person
_IGNORED = 0.5  # share of a box within an ignored box above which it is ignored, too
_HALVES = {"chosen on": False, "held out": True}


def measure_found_people(
    folder: Path,
    /,
    *,
    photos: Path | None = None,
    landmarks: LandmarkNetwork = "full",
    min_score: float = MIN_SCORE,
) -> Iterator[FigureTable | str]:
    """Find the people of each photo and compare them with those who were marked.

    Args:
        folder: Folder of the packages' contents.
        photos: File of marked photos, instead of the one that belongs to this measurement.
        landmarks: Network whose keypoints are taken.
        min_score: Least score of people.

    Raises:
        InputError: If a photo is missing.
    """
    marked = marked_photos(photos)
    outcomes = []
    for index in tracked(range(len(marked))):
        picture = marked[index].read(folder)
        started = time.perf_counter()
        people = find_people(picture, landmarks=landmarks, min_score=min_score)
        seconds = time.perf_counter() - started
        outcomes.append(marked[index].judge(people, (picture.shape[0], picture.shape[1]), seconds))
    yield _table(marked, outcomes)
    for photo, outcome in zip(marked, outcomes, strict=True):
        if outcome.missed or outcome.false:
            half = "held out" if photo.held_out else "chosen on"
            yield f"{photo.name} ({half}): missed {list(outcome.missed)}, false {list(outcome.false)}"


def marked_photos(path: Path | None = None) -> list[MarkedPhoto]:
    """Read the marked photos of a file, or those that belong to this measurement."""
    text = (path or resources.files(__package__).joinpath("found_people.json")).read_text(encoding="utf-8")
    return [MarkedPhoto.from_json(each) for each in json.loads(text)["photos"]]


@dataclass(frozen=True)
class Outcome:
    """People of one photo, as they were found.

    Attributes:
        found: Number of marked people who were found.
        missed: Indices of marked people who were not found.
        false: Scores of detections where nobody is, and of second detections of a person.
        seconds: Time that it took [s].
    """

    found: int
    missed: tuple[int, ...]
    false: tuple[float, ...]
    seconds: float = 0.0


@dataclass(frozen=True)
class MarkedPhoto:
    """Photo and the people in it.

    Attributes:
        file: File in the folder of packages.
        turn: Angle by which the picture is turned, against the clock [deg], a multiple of 90.
        frame: Number of the frame, if the file is a film.
        held_out: True if rules must not be chosen on it.
        people: Left, top, right, bottom of each person, from 0 to 1 across the picture, shape (N, 4).
        ignored: Boxes of people who don't count, shape (M, 4).
    """

    file: str
    turn: int
    frame: int | None
    held_out: bool
    people: np.ndarray
    ignored: np.ndarray

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> MarkedPhoto:
        """Photo from an object of the JSON file."""
        people = np.array(values["people"], dtype=np.float64).reshape(-1, 4)
        ignored = np.array(values["ignored"], dtype=np.float64).reshape(-1, 4)
        return cls(values["file"], values.get("turn", 0), values.get("frame"), values["held_out"], people, ignored)

    @property
    def name(self) -> str:
        """Name of the file, with its frame and turn."""
        turned = f", turned by {self.turn}°" if self.turn else ""
        return self.file + ("" if self.frame is None else f", frame {self.frame}") + turned

    def read(self, folder: Path) -> np.ndarray:
        """Picture, RGB, shape (H, W, 3), uint8.

        Raises:
            InputError: If the file is missing or has no such frame.
        """
        path = folder / self.file
        if self.frame is None:
            picture = read_photo(path)
        else:
            frames = (frame.picture for index, frame in enumerate(read_frames(path)) if index == self.frame)
            found = next(frames, None)
            if found is None:
                raise InputError(f"{path}: no frame {self.frame}")
            picture = found
        return np.ascontiguousarray(np.rot90(picture, self.turn // 90))

    def judge(self, people: Sequence[FoundPerson], size: tuple[int, int], seconds: float = 0.0) -> Outcome:
        """Compare people who were found in a picture of size (H, W) with the marked people."""
        extent = np.array([size[1], size[0]])
        boxes = np.array([_keypoint_box(person, extent) for person in people]).reshape(-1, 4)
        shared = _box_overlaps(boxes, self.people)
        found: dict[int, int] = {}  # marked person of each person who was found
        for row, column in zip(*np.unravel_index(np.argsort(-shared, axis=None), shared.shape), strict=True):
            if shared[row, column] > _OVERLAP and row not in found and column not in found.values():
                found[int(row)] = int(column)
        elsewhere = _box_overlaps(boxes, self.ignored, of_ours=True).max(axis=1, initial=0.0) > _IGNORED
        false = tuple(
            round(person.score, 2) for row, person in enumerate(people) if row not in found and not elsewhere[row]
        )
        missed = tuple(sorted(set(range(len(self.people))) - set(found.values())))
        return Outcome(len(found), missed, false, seconds)


def _keypoint_box(person: FoundPerson, extent: np.ndarray) -> np.ndarray:
    points = np.clip(person.keypoints.points / extent, 0, 1)
    return np.concatenate([points.min(axis=0), points.max(axis=0)])


def _box_overlaps(ours: np.ndarray, theirs: np.ndarray, *, of_ours: bool = False) -> np.ndarray:
    """Intersection of boxes (N, 4) and (M, 4) over their union, or over the area of the first, shape (N, M)."""
    low = np.maximum(ours[:, None, :2], theirs[None, :, :2])
    high = np.minimum(ours[:, None, 2:], theirs[None, :, 2:])
    both = np.clip(high - low, 0, None).prod(axis=2)
    areas = (ours[:, 2:] - ours[:, :2]).prod(axis=1)[:, None]
    whole = areas if of_ours else areas + (theirs[:, 2:] - theirs[:, :2]).prod(axis=1) - both
    return both / np.maximum(whole, 1e-9)


def _table(photos: Sequence[MarkedPhoto], outcomes: Sequence[Outcome]) -> FigureTable:
    columns = {"photos": "", "pictures": "", "people": "", "found": "", "found [%]": ".1f", "false": ""}
    table = FigureTable("People found", {**columns, "false [%]": ".1f", "time a picture [s]": ".2f"})
    halves: dict[str, list[Outcome]] = {
        half: [outcome for photo, outcome in zip(photos, outcomes, strict=True) if photo.held_out == held_out]
        for half, held_out in _HALVES.items()
    }
    halves["all"] = list(outcomes)
    for half, some in halves.items():
        found, missed, false = np.array([(each.found, len(each.missed), len(each.false)) for each in some]).T
        table.add(
            half,
            len(some),
            int(found.sum() + missed.sum()),
            int(found.sum()),
            _share(found, missed),
            int(false.sum()),
            _share(false, found),
            float(np.mean([each.seconds for each in some])),
        )
    return table


def _share(some: np.ndarray, rest: np.ndarray) -> Estimate:
    """Share of some among all [%], whose interval is over photos."""
    counts = np.column_stack([some, some + rest]).astype(np.float64)

    def share(sums: np.ndarray) -> np.ndarray:
        return 100 * sums[..., 0] / np.maximum(sums[..., 1], 1)

    low, high = bootstrap_sum(counts, share)
    return Estimate(float(share(counts.sum(axis=0))), low, high)
