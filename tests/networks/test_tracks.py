"""People of films keep their numbers: while they move, cross, come, go and come back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers.example import example_photo
from PIL import Image

from warp_partdr.inputs.cuts import Change
from warp_partdr.networks.detection.people import find_people
from warp_partdr.networks.detection.person import FoundPerson
from warp_partdr.networks.detection.tracks import PeopleTracker, likeness

HEIGHT, WIDTH = 400, 640


@cache
def figure() -> np.ndarray:
    """The example's person on their photo's background, cut narrow: 320 px high."""
    photo = Image.fromarray(example_photo()[20:500, 95:300])
    return np.asarray(photo.resize((137, 320)))


def frame(*lefts: int | None, mirrored: int | None = None) -> np.ndarray:
    """A picture with a figure at each of these columns; None has left, ``mirrored`` is turned round."""
    picture = np.full((HEIGHT, WIDTH, 3), figure()[2, 2], np.uint8)
    for index, left in enumerate(lefts):
        if left is not None:
            picture[40:360, left : left + 137] = figure()[:, ::-1] if index == mirrored else figure()
    return picture


def run(tracker: PeopleTracker, pictures: Iterator[np.ndarray]) -> list[dict[int, int]]:
    """Column of the middle of each person's box, by their number, of each picture."""
    middles = []
    for picture in pictures:
        found = tracker.find(picture)
        middles.append({number: round((person.box[0] + person.box[2]) / 2) for number, person in found.items()})
    return middles


def leftmost(people: Mapping[int, FoundPerson]) -> int:
    """Number of whoever stands farthest to the left."""
    return min(people, key=lambda number: people[number].box[0])


def test_people_keep_their_numbers_while_they_move() -> None:
    said = run(PeopleTracker(every=4), (frame(20 + 12 * step, 460 - 12 * step, mirrored=1) for step in range(8)))
    assert [set(people) for people in said] == [{0, 1}] * 8
    for number in (0, 1):
        steps = np.diff([people[number] for people in said])
        assert (np.sign(steps) == np.sign(steps[0])).all()
        np.testing.assert_allclose(np.abs(steps), 12, atol=8)


def test_who_comes_later_gets_the_next_number_at_the_detector_s_next_look() -> None:
    pictures = (frame(40, 420 if step >= 2 else None) for step in range(8))
    said = run(PeopleTracker(every=5), pictures)
    assert [sorted(people) for people in said] == [[0]] * 5 + [[0, 1]] * 3
    assert said[-1][1] > WIDTH / 2


def test_who_was_lost_for_a_moment_comes_back_with_their_number() -> None:
    said = run(PeopleTracker(every=3), (frame(40, None if 3 <= step < 7 else 420) for step in range(11)))
    assert [len(people) for people in said[3:7]] == [1] * 4
    assert set(said[-1]) == set(said[0]) == {0, 1}
    assert all(abs(said[-1][number] - said[0][number]) < 20 for number in (0, 1))


def test_who_stands_there_much_later_is_somebody_else() -> None:
    said = run(PeopleTracker(every=2), (frame(None if 2 <= step < 12 else 250) for step in range(15)))
    assert [sorted(people) for people in (said[0], said[5], said[-1])] == [[0], [], [1]]


@pytest.mark.parametrize(("size", "number"), [(0.45, 1), (0.68, 0)])
def test_who_comes_back_in_another_size_is_somebody_else(size: float, number: int) -> None:
    """About the same middle, from which the distance of the crops tells nothing."""
    picture = frame(None)
    height, width = round(320 * size), round(137 * size)
    small = np.asarray(Image.fromarray(figure()).resize((width, height)))
    top, left = 200 - height // 2, 318 - width // 2
    picture[top : top + height, left : left + width] = small
    tracker = PeopleTracker(every=2)
    assert set(tracker.find(frame(250))) == {0}
    assert run(tracker, [frame(None)] * 2) == [{}, {}]
    assert list(tracker.find(picture) or tracker.find(picture)) == [number]


def test_nobody_is_followed_through_a_cut() -> None:
    tracker = PeopleTracker(every=4)
    assert (set(tracker.find(frame(40))), tracker.cut) == ({0}, False)
    assert (set(tracker.find(frame(44), Change.CUT)), tracker.cut) == ({1}, True)
    assert (set(tracker.find(frame(48))), tracker.cut) == ({1}, False)


def test_at_a_cut_the_detector_looks_at_once_and_nobody_comes_back() -> None:
    tracker = PeopleTracker(every=9)
    assert set(tracker.find(frame(40, 420))) == {0, 1}
    assert len(tracker.find(frame(40, None))) == 1
    assert set(tracker.find(frame(40, 420), Change.CUT)) == {2, 3}


def test_a_jump_is_a_cut_if_nobody_stays_where_they_were() -> None:
    tracker = PeopleTracker(every=9)
    assert set(tracker.find(frame(40, 420))) == {0, 1}
    assert (set(tracker.find(frame(44, 350), Change.JUMP)), tracker.cut) == ({0, 1}, False)  # one stays
    assert (set(tracker.find(frame(130, 480), Change.JUMP)), tracker.cut) == ({2, 3}, True)


def test_a_jump_is_a_cut_when_somebody_is_lost_and_none_when_nobody_was_there() -> None:
    tracker = PeopleTracker(every=1)
    assert (tracker.find(frame(None)), tracker.cut) == ({}, False)
    assert (set(tracker.find(frame(250), Change.JUMP)), tracker.cut) == ({0}, False)
    assert (tracker.find(frame(None), Change.JUMP), tracker.cut) == ({}, True)


def test_where_all_is_new_it_is_a_cut_unless_somebody_clearly_stays() -> None:
    """By 22 px, keypoints are still about where they were, but masks hardly overlap."""
    tracker = PeopleTracker(every=9)
    assert (set(tracker.find(frame(250))), tracker.cut) == ({0}, False)
    assert (set(tracker.find(frame(256), Change.NEW)), tracker.cut) == ({0}, False)
    assert (set(tracker.find(frame(430), Change.NEW)), tracker.cut) == ({1}, True)
    assert (set(tracker.find(frame(452), Change.JUMP)), tracker.cut) == ({1}, False)
    assert (set(tracker.find(frame(474), Change.NEW)), tracker.cut) == ({2}, True)


@pytest.mark.parametrize("change", [Change.JUMP, Change.NEW])
def test_the_detector_looks_at_once_where_somebody_may_come(change: Change) -> None:
    tracker = PeopleTracker(every=50)
    assert [set(tracker.find(frame(None))) for _ in range(6)] == [set()] * 6
    assert (set(tracker.find(frame(250), change)), tracker.cut) == ({0}, False)


def test_people_go_on_after_a_flash_with_their_numbers() -> None:
    white = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    tracker = PeopleTracker(every=9)
    left = leftmost(tracker.find(frame(40, 420)))
    for flash, seen in ((white, []), (frame(240, None), []), (frame(44, None), [left])):
        assert (list(tracker.find(flash, Change.FLASH)), tracker.cut) == (seen, False)
    found = tracker.find(frame(44, 424))
    assert (leftmost(found), set(found)) == (left, {0, 1})


def detector_looks(
    monkeypatch: pytest.MonkeyPatch, tracker: PeopleTracker, pictures: Iterable[tuple[np.ndarray, Change]]
) -> list[int]:
    """Numbers of the pictures in which the detector looks for people."""
    looks, calls = list[int](), list[bool]()

    def look(picture: np.ndarray, **given: Any) -> list[FoundPerson]:
        calls.append(not given["previous"])
        return find_people(picture, **given)

    monkeypatch.setattr("warp_partdr.networks.detection.tracks.find_people", look)
    for step, (picture, change) in enumerate(pictures):
        calls.clear()
        tracker.find(picture, change)
        if any(calls):
            looks.append(step)
    return looks


def test_the_detector_looks_every_few_frames_and_when_somebody_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    pictures = [(frame(250 if step < 6 else None), Change.NONE) for step in range(10)]
    assert detector_looks(monkeypatch, PeopleTracker(every=4), pictures) == [0, 4, 6]


def test_the_detector_looks_sooner_until_it_sees_somebody(monkeypatch: pytest.MonkeyPatch) -> None:
    pictures = [(frame(250 if step >= 14 else None), Change.NONE) for step in range(30)]
    pictures[10] = pictures[10][0], Change.CUT
    looks = detector_looks(monkeypatch, PeopleTracker(every=6), pictures)
    assert looks == [0, 1, 3, 7, 10, 11, 13, 17, 23, 29]


def test_who_is_found_twice_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A turned and an upright look at one person may give landmarks that differ."""
    (person,) = find_people(frame(250))
    worse = replace(person, score=0.6, keypoints=replace(person.keypoints, points=person.keypoints.points + 60))
    monkeypatch.setattr("warp_partdr.networks.detection.tracks.find_people", lambda *_, **__: [worse, person])
    assert PeopleTracker().find(frame(250)) == {0: person}


def test_likeness_falls_with_distance() -> None:
    first, again, moved, apart = (find_people(frame(left))[0] for left in (40, 44, 100, 420))
    assert likeness(first, first) == pytest.approx(1)
    assert likeness(first, again) > 0.8
    assert 0.05 < likeness(first, moved) < 0.5
    assert likeness(first, apart) < 0.01


def test_every_is_a_whole_number() -> None:
    with pytest.raises(ValueError, match="every: 0; expected an integer of 1 or more"):
        PeopleTracker(every=0)
