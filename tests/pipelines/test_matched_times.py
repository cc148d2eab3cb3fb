"""Films of several clocks: which of their frames show one moment, and that fits go by time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from helpers.rigs import camera_at, film_of

from warp_partdr.errors import InputError
from warp_partdr.inputs.scene import Scene
from warp_partdr.lab.synthetic.scene_people import make_pair
from warp_partdr.networks.detection.film_people import FilmPeople
from warp_partdr.networks.predictors.film_predictions import FilmPredictions, GivenNetworks, pack_groups
from warp_partdr.pipelines.film import fit_film
from warp_partdr.pipelines.film_cameras import place_film_cameras
from warp_partdr.pipelines.matched_times import match_films, nearest_frames
from warp_partdr.pipelines.observed_film import ObservedFilm
from warp_partdr.solve.scene.options import SceneOptions

VARIABLE = np.array([0.0, 0.033, 0.066, 0.1, 0.2, 0.3, 0.4, 0.433, 0.466, 0.5, 0.533, 0.6])


@pytest.fixture(scope="module")
def still() -> FilmPeople:
    """Somebody who stands, in 40 frames."""
    return film_of(make_pair(101), camera_at(0.0), order=(0,), frames=40)


def timed(people: FilmPeople, times: np.ndarray, rate: float) -> ObservedFilm:
    """A film with frames at these times [s], which its keypoints' x tell, too."""
    rows = people.rows[: len(times)].copy()
    rows["times"] = times
    rows["keypoints"][..., 0] = times[:, None]
    return ObservedFilm.of(replace(people, rate=rate, times=times, rows=rows, packed=people.packed[: len(times)]))


def told_times(film: ObservedFilm) -> np.ndarray:
    return np.asarray(film.people.rows["keypoints"][:, 0, 0], dtype=np.float64)


def test_films_of_one_clock_stay_as_they_are(still: FilmPeople) -> None:
    films = [timed(still, np.arange(20) / 30, 30), timed(still, np.arange(15) / 30 + 0.004, 30)]
    assert all(one is other for one, other in zip(match_films(films), films, strict=True))


@pytest.mark.parametrize(("rates", "numbers"), [((30, 60), [0, 2, 4, 6]), ((60, 30), [0, -1, 1, -1, 2, -1, 3, -1])])
def test_a_film_of_twice_the_rate_gives_or_takes_every_second_frame(
    still: FilmPeople, rates: tuple[int, int], numbers: list[int]
) -> None:
    films = [timed(still, np.arange(rate // 7) / rate, rate) for rate in rates]
    one, other = match_films(films)
    assert one.numbers is not None
    assert other.numbers is not None
    assert one.numbers.tolist() == list(range(len(films[0].people.times)))
    assert other.numbers.tolist() == numbers
    np.testing.assert_array_equal(other.people.times, one.people.times)
    np.testing.assert_allclose(told_times(other), other.people.times[other.people.rows["frames"]], atol=1e-6)
    assert [bool(packed) for packed in other.people.packed] == [number >= 0 for number in numbers]
    for frame, number in enumerate(numbers):
        if number >= 0:
            np.testing.assert_array_equal(other.people.owners(frame), films[1].people.owners(number))


def test_films_of_variable_rates_meet_in_time(still: FilmPeople) -> None:
    """Two phones: by their numbers, frames would be 0.2 s apart."""
    even = np.arange(19) / 30
    one, other = timed(still, VARIABLE, 30), timed(still, even, 30)
    for films in ([one, other], [other, one]):
        matched = match_films(films)
        for film in matched:
            np.testing.assert_array_equal(film.people.times, films[0].people.times)
            off = told_times(film) - film.people.times[film.people.rows["frames"]]
            assert np.abs(off).max() <= 0.5 / 30 + 1e-6
        assert sum(len(film.people.rows) for film in matched) == 2 * len(VARIABLE) + 7 * (films[0] is other)


def test_a_film_that_goes_on_adds_its_frames(still: FilmPeople) -> None:
    one, other = timed(still, np.arange(6) / 30, 30), timed(still, np.arange(12) / 40, 40)
    first, second = match_films([one, other])
    np.testing.assert_allclose(first.people.times, [*np.arange(6) / 30, *np.arange(8, 12) / 40])
    assert first.file_numbers.tolist() == [0, 1, 2, 3, 4, 5, -1, -1, -1, -1]
    assert second.file_numbers.tolist()[-4:] == [8, 9, 10, 11]
    assert np.array_equal(told_times(second)[-4:].round(6), np.arange(8, 12) / 40)


def test_films_that_started_apart_are_matched_from_the_later_start(still: FilmPeople) -> None:
    one, other = timed(still, np.arange(20) / 30, 30), timed(still, np.arange(16) / 25, 25)
    first, second = match_films([one, other], [0.2, 0.0])
    assert (first.skipped, second.skipped) == (6, 0)
    assert first.people.times[0] == 0
    shown = second.people.rows["frames"]
    np.testing.assert_allclose(told_times(second), first.people.times[shown], atol=0.5 / 30 + 1e-6)
    assert len(first.people.times) == len(second.people.times)
    again = match_films([first, second], [0.1, 0.1])  # numbers are still the file's
    assert (again[0].skipped, again[1].skipped) == (9, 3)  # 0.08 s is too far from 0.1


def test_a_frame_shows_one_moment_at_most() -> None:
    times, moments = np.array([0.0, 0.1, 0.2]), np.array([0.0, 0.09, 0.12, 0.26])
    assert nearest_frames(times, moments, 0.05).tolist() == [0, 1, -1, -1]
    assert nearest_frames(times, moments, 0.07).tolist() == [0, 1, -1, 2]
    assert nearest_frames(times[:1], moments, 0.05).tolist() == [0, -1, -1, -1]


def test_predictions_of_networks_go_with_their_frames() -> None:
    frames, places = np.array([0, 1, 1, 2, 3]), np.array([0, 0, 1, 0, 0])
    keypoints = np.arange(15, dtype=np.float32).reshape(5, 1, 3)
    packed = tuple(pack_groups(np.full((2, 3), row, np.uint8)) for row in range(5))
    taken = FilmPredictions(GivenNetworks(), frames, places, keypoints, (2, 3), packed).taken(np.array([1, -1, 3]))
    assert taken.frames.tolist() == [0, 0, 2]
    assert taken.places.tolist() == [0, 1, 0]
    np.testing.assert_array_equal(taken.keypoints, keypoints[[1, 2, 4]])
    shown = taken.groups(2)
    assert shown is not None
    assert (shown == 4).all()


def test_films_of_other_clocks_are_refused(still: FilmPeople) -> None:
    films = [timed(still, np.arange(20) / 30, 30), timed(still, np.arange(20) / 25, 25)]
    for fit in (fit_film, place_film_cameras):
        with pytest.raises(InputError, match=r"films\[1\]: frame 3 is 0\.020 s from that of another film; "):
            fit(films)
    late = [films[0], timed(still, np.array([0.3, 0.5]), 5)]
    with pytest.raises(InputError, match=r"films\[0\]: ends before another one starts"):
        match_films(films, [9.0, 0.0])
    with pytest.raises(InputError, match=r"films\[1\]: no frame when the first film has one; expected films"):
        match_films(late, [0.0, 0.7])


class _SeenError(Exception):
    """A scene was to be fitted."""


@pytest.mark.parametrize("times", [np.arange(12) / 30, VARIABLE])
def test_windows_of_a_film_know_its_times(
    still: FilmPeople, times: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenes: list[Scene] = []

    def fit(scene: Scene, **how: Any) -> None:
        scenes.append(scene)
        if scene.num_frames > 3:
            raise _SeenError

    people = replace(still, rate=30, times=times, rows=still.rows[: len(times)], packed=still.packed[: len(times)])
    monkeypatch.setattr("warp_partdr.pipelines.film.fit_scene", fit)
    with pytest.raises(_SeenError):
        fit_film([ObservedFilm.of(people)], options=SceneOptions(window=64))
    (scene,) = scenes
    np.testing.assert_allclose(scene.frame_times, times)
    assert (scene.times is None) == (times is not VARIABLE)  # even films have the sums that they had


def test_a_scene_s_times_must_rise_and_replace_the_frame_rate() -> None:
    scene = make_pair(101, "clean").scene
    film = [replace(observation, frame=frame) for frame in range(3) for observation in scene.observations]
    for wrong in ([0.0, 0.1], [0.0, 0.2, 0.2], [0.0, 0.2, np.nan], ["a", "b", "c"], [[0.0, 1.0, 2.0]]):
        with pytest.raises(InputError, match="times: "):
            Scene(scene.views, film, times=wrong)
    assert Scene(scene.views, film, 10.0).frame_times.tolist() == [0.0, 0.1, 0.2]
    uneven = Scene(scene.views, film, times=(1, 2, 4)).frame_times
    assert (uneven.tolist(), uneven.dtype) == ([1.0, 2.0, 4.0], np.float64)
    assert torch.from_numpy(uneven).diff().tolist() == [1.0, 2.0]


def test_a_taken_film_has_the_times_of_its_moments(still: FilmPeople) -> None:
    taken = still.taken(np.array([2, -1, 5, 7]), np.array([0.0, 0.5, 0.6, 0.8]))
    assert taken.times.tolist() == [0.0, 0.5, 0.6, 0.8]
    assert taken.rows["frames"].tolist() == [0, 2, 3]
    assert taken.rows["times"].tolist() == [0.0, 0.6, 0.8]
    assert taken.packed == (still.packed[2], b"", still.packed[5], still.packed[7])
