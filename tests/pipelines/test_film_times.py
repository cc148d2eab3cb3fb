"""Films that did not start together: which frames show one moment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.rigs import FRAMES, RATE, moving_film, swinging

from warp_partdr.errors import InputError
from warp_partdr.lab.synthetic.scene_people import SceneSample
from warp_partdr.pipelines.film_times import align_films
from warp_partdr.pipelines.observed_film import ObservedFilm


@pytest.fixture(scope="module")
def moving() -> SceneSample:
    return swinging(1.0)


def test_a_film_that_started_later_is_joined_by_the_others(moving: SceneSample) -> None:
    late = 6
    one, other = moving_film(moving, -0.5, range(FRAMES)), moving_film(moving, 0.6, range(late, FRAMES))
    told: list[tuple[str, int, int]] = []
    for films, skipped in (((one, other), [late, 0]), ((other, one), [0, late])):
        aligned = align_films(films, progress=lambda *each: told.append(each))
        assert [each.skipped for each in aligned] == skipped
    assert {len(each.people.times) for each in aligned} == {FRAMES - late}
    assert told[-1] == ("alignment", 2, 2)


def test_a_film_that_lost_frames_is_joined_by_time(moving: SceneSample) -> None:
    """By its numbers, the frames after those that are lost would be half a second early."""
    late, lost = 6, {11, 12, 16, 17, 18}
    shown = [frame for frame in range(late, FRAMES) if frame not in lost]
    one, other = align_films([moving_film(moving, -0.5, range(FRAMES)), moving_film(moving, 0.6, shown)])
    assert (one.skipped, other.skipped) == (late, 0)
    assert len(one.people.times) == FRAMES - late
    missing = np.flatnonzero(other.file_numbers < 0) + late
    assert missing.tolist() == sorted(lost)
    assert other.people.rows["frames"].tolist() == [frame - late for frame in shown]


def test_whoever_stands_still_tells_nothing(moving: SceneSample) -> None:
    one, other = moving_film(moving, -0.5, range(12)), moving_film(swinging(0.0), 0.6, range(12))
    with pytest.raises(InputError, match=r"films\[1\]: nobody of the first film moves in the same way in both for"):
        align_films([one, other])


def since(film: ObservedFilm, frame: int) -> ObservedFilm:
    """The film without the frames before one."""
    times = film.people.times
    return film.taken(np.arange(frame, len(times)), times[frame:] - times[frame])


def test_a_film_since_a_frame_begins_there(moving: SceneSample) -> None:
    whole = moving_film(moving, 0.3, range(8))
    rest = since(whole, 3)
    assert (rest.skipped, since(rest, 2).skipped) == (3, 5)
    assert rest.people.times.tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert rest.people.rows["frames"].tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal(rest.people.rows["keypoints"], whole.people.rows["keypoints"][3:])
    np.testing.assert_array_equal(rest.people.owners(0), whole.people.owners(3))


def test_who_is_gone_before_has_no_number(moving: SceneSample) -> None:
    people = moving_film(moving, 0.3, range(8)).people
    rows = people.rows.copy()
    rows["tracks"] = np.where(rows["frames"] < 4, 0, 1)
    assert replace(people, rows=rows).taken(np.arange(4, 8), np.arange(4) / RATE).num_people == 1
