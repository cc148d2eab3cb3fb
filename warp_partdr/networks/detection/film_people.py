"""People of a whole film, and the frames that show them, in little memory, so that a film may be long."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ...errors import InputError
from ...inputs.cuts import Change, with_changes
from ...inputs.films import Frame, film_facts, read_frames
from ...inputs.frame_times import time_warnings, usual_rate
from ...inputs.keypoints import Keypoints2D
from ...interop.ahead import made_ahead
from ...interop.torch_threads import one_torch_thread
from . import MIN_SCORE, LandmarkNetwork
from .crops import Pyramid
from .masks import instance_map
from .person import SKELETON, FoundPerson
from .tracks import PeopleTracker

_LOOKS = 3  # looks of the detector in a second of film
_SHORTEST = 3  # least number of frames of a person in a shot; fewer are taken for a mistake
_SIDE = 640  # [px], longer side of the maps of people that are kept; masks have 256 px a person

SEEN: dict[str, tuple[type, tuple[int, ...]]] = {
    "frames": (np.int64, ()),
    "times": (np.float64, ()),
    "scores": (np.float32, ()),
    "boxes": (np.float32, (4,)),
    "keypoints": (np.float32, (33, 3)),
}
_ROW = np.dtype([(name, *kind) for name, kind in SEEN.items()] + [("tracks", np.int64), ("places", np.int64)])


@dataclass(frozen=True)
class FilmPeople:
    """People of a film.

    Attributes:
        image_size: Height and width (H, W) of the film [px].
        rate: Frame rate of most of the film [frames/s].
        times: Time of each frame since the first [s], rising, shape (F,).
        rows: Row for each observation of a person, with the fields ``SEEN``. ``tracks`` is the person, where 0 is
            the one seen most and largest, and ``places`` is the index in ``owners`` of the frame.
        packed: Compressed ``owners`` of each frame.
        fault: Reason why reading ended before the end of the film. It is empty if the whole film was read.
        warnings: Sentences about frames that are missing, and about times that are guesses.
        cuts: First frame of each shot except the first shot, in order. Nobody is followed through a cut.
    """

    image_size: tuple[int, int]
    rate: float
    times: np.ndarray
    rows: np.ndarray
    packed: tuple[bytes, ...]
    fault: str = ""
    warnings: tuple[str, ...] = ()
    cuts: tuple[int, ...] = ()

    @property
    def num_people(self) -> int:
        """Number of people."""
        return int(self.rows["tracks"].max(initial=-1)) + 1

    def owners(self, frame: int) -> np.ndarray:
        """Place + 1 of the person that each pixel shows, 0 for nobody, shape ``kept_size(image_size)``, uint8."""
        return np.frombuffer(zlib.decompress(self.packed[frame]), np.uint8).reshape(kept_size(self.image_size))

    def taken(self, numbers: np.ndarray, times: np.ndarray) -> FilmPeople:
        """Returns a copy of the film with some of its frames.

        Args:
            numbers: Index of each new frame in this film, rising, and -1 where the film has none, shape (T,), int64.
            times: Time of each new frame [s], shape (T,).
        """
        rows = self.rows[np.isin(self.rows["frames"], numbers)].copy()
        rows["frames"] = frame_places(rows["frames"], numbers)
        rows["times"] = times[rows["frames"]]
        packed = tuple(self.packed[number] if number >= 0 else b"" for number in numbers.tolist())
        cuts = _cuts_taken(self.cuts, numbers)
        kept = _by_size(rows, shots_between(cuts, len(times)))
        return replace(self, times=times, rows=kept, packed=packed, cuts=cuts)

    def of(self, track: int) -> np.ndarray:
        """Rows of a person."""
        return self.rows[self.rows["tracks"] == track]


def frame_places(frames: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Places of frames among the numbers, which rise but for -1, where there is none, shape of ``frames``, int64."""
    there = np.flatnonzero(numbers >= 0)
    return there[np.searchsorted(numbers[there], frames)]


def shots_between(cuts: Sequence[int], num_frames: int) -> list[range]:
    """Frames of each shot of a film that has cuts at these frames."""
    return [range(*each) for each in pairwise((0, *cuts, num_frames))]


def _cuts_taken(cuts: Sequence[int], numbers: np.ndarray) -> tuple[int, ...]:
    """Cuts of a film after some of its frames are taken, as in ``FilmPeople.taken``."""
    there = np.flatnonzero(numbers >= 0)
    first = np.unique(np.searchsorted(numbers[there], cuts))
    return tuple(there[first[(first > 0) & (first < len(there))]].tolist())


def kept_size(size: tuple[int, int]) -> tuple[int, int]:
    """Size (H, W) of the maps that are kept for the frames of a film [px]."""
    zoom = min(1.0, _SIDE / max(size))
    return max(round(size[0] * zoom), 1), max(round(size[1] * zoom), 1)


def row_keypoints(row: np.ndarray) -> Keypoints2D:
    """Keypoints of a row [px]."""
    points = row["keypoints"]
    return Keypoints2D(SKELETON, points[:, :2].copy(), points[:, 2].copy())


@one_torch_thread()
def find_film_people(
    path: str | Path,
    *,
    min_score: float = MIN_SCORE,
    device: torch.device | str = "cpu",
    progress: Callable[[int, int], None] | None = None,
    watch: Callable[[Frame, Pyramid, Sequence[FoundPerson]], None] | None = None,
    landmarks: LandmarkNetwork = "heavy",
) -> FilmPeople:
    """Find and follow the people of a film, frame by frame.

    Args:
        path: The film.
        min_score: Least confidence that there is a person.
        device: Device to run on.
        progress: Function that is called with the number of frames done and their total number.
        watch: Function that is called with each frame, its picture to cut crops from, and its people, in the order of
            ``places``.
        landmarks: Network whose keypoints are taken, as in ``find_people``; "full" takes two fifths of the time.

    Raises:
        InputError: If the file can't be read as a film, or nobody is found before it ends or breaks off.

    Examples:
        >>> from warp_partdr import find_film_people
        >>> people = find_film_people("walk.mp4")
        >>> people.num_people, len(people.times)
        (1, 3)
        >>> people.of(0)["keypoints"].shape  # x [px], y [px] and confidence in each frame
        (3, 33, 3)
    """
    facts = film_facts(path)
    rows: list[np.ndarray] = []
    packed: list[bytes] = []
    times: list[float] = []
    guessed: list[bool] = []
    cuts: list[int] = []
    size, fault = (0, 0), ""
    try:
        for followed in follow_people(path, facts.rate, min_score=min_score, device=device, landmarks=landmarks):
            frame, found = followed.frame, followed.people
            size = (frame.picture.shape[0], frame.picture.shape[1])
            if followed.cut:
                cuts.append(frame.index)
            packed.append(_pack(list(found.values()), size))
            times.append(frame.time)
            guessed.append(frame.guessed)
            for index, (number, person) in enumerate(found.items()):
                rows.append(np.array([(*seen_values(person, frame.index, frame.time), number, index)], _ROW))
            if watch is not None:
                watch(frame, followed.pyramid, list(found.values()))
            if progress is not None:
                progress(len(times), max(facts.frames, len(times)))
    except InputError as error:
        if not times:
            raise
        fault = str(error)
    everyone = np.concatenate(rows) if rows else np.zeros(0, _ROW)
    numbered = _by_size(everyone, shots_between(cuts, len(times)))
    if not len(numbered):
        raise InputError(fault or f"{path}: nobody found in {len(times)} frames; expected people")
    rate = usual_rate(times, facts.rate)
    warnings = time_warnings(str(path), times, guessed, rate)
    return FilmPeople(size, rate, np.array(times), numbered, tuple(packed), fault, warnings, tuple(cuts))


@dataclass(frozen=True)
class FollowedFrame:
    """Frame of a film and the people in it.

    Attributes:
        frame: The frame.
        pyramid: Pyramid of its picture, to cut crops from.
        people: People by numbers that stay through a shot.
        cut: True if another shot begins with it.
    """

    frame: Frame
    pyramid: Pyramid
    people: dict[int, FoundPerson]
    cut: bool


def follow_people(
    path: str | Path,
    rate: float,
    *,
    min_score: float,
    device: torch.device | str,
    landmarks: LandmarkNetwork = "full",
) -> Iterator[FollowedFrame]:
    """Find and follow the people of a film with ``rate`` frames a second.

    Raises:
        InputError: If ``read_frames`` raises it.
    """
    every = max(round(rate / _LOOKS), 1)
    tracker = PeopleTracker(device=device, min_score=min_score, every=every, landmarks=landmarks)
    for frame, pyramid, change in made_ahead(_with_pyramids(path, device)):
        people = tracker.find(pyramid, change)
        yield FollowedFrame(frame, pyramid, people, tracker.cut)


def _with_pyramids(path: str | Path, device: torch.device | str) -> Iterator[tuple[Frame, Pyramid, Change]]:
    for frame, change in with_changes(read_frames(path)):
        pyramid = Pyramid(frame.picture, device)
        pyramid.level(0)
        yield frame, pyramid, change


def seen_values(person: FoundPerson, frame: int, time: float) -> tuple[Any, ...]:
    """Values of ``SEEN`` for a person in a frame at this time [s]."""
    keypoints = np.column_stack([person.keypoints.points, person.keypoints.confidence])
    return frame, time, person.score, person.box, keypoints


def areas(boxes: np.ndarray) -> np.ndarray:
    """Areas of boxes (N, 4), shape (N,)."""
    return (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])


def _pack(people: Sequence[FoundPerson], size: tuple[int, int]) -> bytes:
    kept = kept_size(size)
    small = [replace(person, crop=person.crop.zoomed(kept[1] / size[1])) for person in people]
    return pack_owners(instance_map(small, kept).clip(0, 255).astype(np.uint8))


def pack_owners(owners: np.ndarray) -> bytes:
    """Compress owners, uint8, as ``FilmPeople.packed`` has them."""
    return zlib.compress(owners.tobytes(), 1)


def lasting(frames: np.ndarray, shots: Sequence[range]) -> bool:
    """True if a person is seen in enough frames of one shot. Fewer frames are taken for a mistake."""
    shot = next(shot for shot in shots if frames[0] in shot)
    return len(frames) >= min(_SHORTEST, len(shot))


def _by_size(rows: np.ndarray, shots: Sequence[range]) -> np.ndarray:
    """Rows of people who are seen long enough, numbered by the share of the film that they take."""
    tracks = [rows[rows["tracks"] == track] for track in np.unique(rows["tracks"])]
    kept = [track for track in tracks if lasting(track["frames"], shots)]
    sizes = [-areas(track["boxes"]).sum() for track in kept]
    order = np.argsort(sizes, kind="stable").tolist()
    table = {int(kept[each]["tracks"][0]): rank for rank, each in enumerate(order)}
    known = rows[np.isin(rows["tracks"], list(table))].copy()
    known["tracks"] = [table[track] for track in known["tracks"].tolist()]
    return known
