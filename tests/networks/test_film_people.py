"""People of a whole film: its shots, and who is seen long enough in one of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.files import EXAMPLE
from helpers.films import write_film
from PIL import Image

from warp_partdr.inputs.films import film_facts
from warp_partdr.networks.detection.film_people import FilmPeople, find_film_people, lasting, shots_between
from warp_partdr.pipelines.film_pieces import FilmPieces

SIZE = (256, 192)  # (H, W) [px]


def photo(name: str) -> np.ndarray:
    """An example photo in the size of the film."""
    image = Image.open(EXAMPLE / name).convert("RGB")
    return np.asarray(image.resize(SIZE[::-1]))


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames of somebody, then six of somebody else at about the same place."""
    pictures = [photo("astronaut.jpg")] * 2 + [photo("photo.png")] * 6
    return write_film(tmp_path_factory.mktemp("film") / "cut.mp4", pictures, rate=20)


@pytest.fixture(scope="module")
def people(path: Path) -> FilmPeople:
    return find_film_people(path)


def test_people_of_two_shots_are_two(people: FilmPeople) -> None:
    assert people.cuts == (2,)
    seen = sorted(people.of(track)["frames"].tolist() for track in range(people.num_people))
    assert seen == [[0, 1], [2, 3, 4, 5, 6, 7]]


def test_people_of_a_slideshow_are_each_their_own(tmp_path: Path) -> None:
    """Pictures of two people, a second each; one of them comes back, turned round."""
    first, second = photo("photo.png"), photo("astronaut.jpg")
    shown = [first, second, first[:, ::-1], second]
    found = find_film_people(write_film(tmp_path / "show.mp4", shown, rate=1))
    assert found.cuts == (1, 2, 3)
    assert sorted(found.of(track)["frames"].tolist() for track in range(found.num_people)) == [[0], [1], [2], [3]]


@pytest.mark.parametrize("value", [0, 255])
def test_people_are_seen_as_soon_as_a_blank_start_ends(value: int, tmp_path: Path) -> None:
    pictures = [np.full((*SIZE, 3), value, np.uint8)] * 2 + [photo("photo.png")] * 5
    found = find_film_people(write_film(tmp_path / "blank.mp4", pictures, rate=30))
    assert (found.cuts, found.num_people) == ((), 1)
    assert found.of(0)["frames"].tolist() == [2, 3, 4, 5, 6]


def test_whoever_is_seen_in_a_whole_shot_is_no_mistake() -> None:
    shots = shots_between([2, 5], 60)
    assert shots == [range(2), range(2, 5), range(5, 60)]
    assert shots_between([], 7) == [range(7)]
    for frames, kept in (([0, 1], True), ([0], False), ([2, 3], False), ([2, 3, 4], True), ([8, 9, 20], True)):
        assert lasting(np.array(frames), shots) == kept
    assert not lasting(np.array([58, 59]), shots)


def test_pieces_keep_cuts_and_older_ones_are_made_again(people: FilmPeople, path: Path, tmp_path: Path) -> None:
    pieces = FilmPieces(tmp_path / "out", [path], "how")
    pieces.people(0, lambda: people)
    again = FilmPieces(tmp_path / "out", [path], "how")
    assert again.people(0, lambda: pytest.fail("people are known")).cuts == (2,)
    (kept,) = again.folder.glob("*.npz")
    with np.load(kept) as data:
        old = {name: data[name] for name in data.files if name != "cuts"}
    np.savez(kept, **old)
    made: list[int] = []
    found = again.people(0, lambda: made.append(0) or replace(people, cuts=(3,)))
    assert (found.cuts, made) == ((3,), [0])


def test_a_photo_and_a_film_without_cuts_have_none(tmp_path: Path) -> None:
    still = write_film(tmp_path / "still.mp4", [photo("photo.png")] * 4)
    assert film_facts(still).frames == 4
    assert find_film_people(still).cuts == ()
    assert find_film_people(EXAMPLE / "photo.png").cuts == ()


def test_cuts_follow_the_frames_that_are_taken(people: FilmPeople) -> None:
    """A cut before the first frame that is taken, or at it, is left out. Frames that are missing do not hide a cut."""
    for numbers, cuts in (
        ([1, 2, 3], (1,)),
        ([2, 3, 4], ()),
        ([5, 6, 7], ()),
        ([0, -1, -1, 1, -1, -1, 3], (6,)),
        ([0, 1, -1], ()),
    ):
        assert people.taken(np.array(numbers), np.arange(len(numbers)) / 20).cuts == cuts
