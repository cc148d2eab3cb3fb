"""Calibrated cameras that do not belong: in another unit, of other films, or elsewhere; people tell it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.motions import made_fit
from helpers.rigs import camera_at, film_of

from warp_partdr.inputs.calibrated_camera import CalibratedCamera
from warp_partdr.lab.synthetic.scene_people import SceneSample, make_pair
from warp_partdr.models.measuring import statures
from warp_partdr.pipelines.camera_units import in_metres
from warp_partdr.pipelines.film import find_impossible_people, find_tall_people
from warp_partdr.pipelines.observed_film import ObservedFilm
from warp_partdr.pipelines.rig_warnings import distant_rays, unmatched_films
from warp_partdr.pipelines.same_people import match_people
from warp_partdr.solve.scene.impossible import impossible_people

TURNS = (-0.5, 0.4, 1.3)
LENS = (-0.2, 0.05, 0.003, -0.002)


@pytest.fixture(scope="module")
def pair() -> SceneSample:
    return make_pair(103)  # adults


@pytest.fixture(scope="module")
def films(pair: SceneSample) -> list[ObservedFilm]:
    """Films of three cameras in metres, of which the second one has another order of people, and the third a lens."""
    cameras = [camera_at(turn, distortion=LENS if turn == TURNS[2] else ()) for turn in TURNS]
    orders = (0, 1), (1, 0), (0, 1)
    seen = (film_of(pair, camera, order=order, noise=2.0) for camera, order in zip(cameras, orders, strict=True))
    return [ObservedFilm.calibrated(people, camera) for people, camera in zip(seen, cameras, strict=True)]


def moved(films: Sequence[ObservedFilm], place: int, camera: CalibratedCamera) -> list[ObservedFilm]:
    """The films, one of which is said to be another camera's."""
    return [ObservedFilm.calibrated(film.people, camera) if each == place else film for each, film in enumerate(films)]


def distances(films: Sequence[ObservedFilm]) -> list[float]:
    return [float(film.view.translation.norm()) for film in films]


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1000.0, "translations are taken as millimetres, with which people are about 1."),
        (100.0, "translations are taken as centimetres, with which people are about 1."),
    ],
)
def test_people_tell_the_unit(films: list[ObservedFilm], factor: float, words: str) -> None:
    assert all(len({place for place, _ in person}) == 1 for person in match_people([f.scaled(factor) for f in films]))
    found, (told,) = in_metres([film.scaled(factor) for film in films])
    assert distances(found) == pytest.approx([4.0] * 3, rel=1e-6)
    assert words in told
    assert all(len({place for place, _ in person}) == 3 for person in match_people(found))
    lens = films[2].scaled(factor).lens  # of which cameras.json is made
    assert lens is not None
    assert np.linalg.norm(lens.translation) == pytest.approx(4.0 * factor)
    assert np.linalg.norm(found[2].camera.translation) == pytest.approx(4.0)


@pytest.mark.parametrize("factor", [1 / 0.03, 1 / 0.058, 1 / 7])
def test_squares_of_a_chessboard_make_people_as_tall_as_most(films: list[ObservedFilm], factor: float) -> None:
    found, (told,) = in_metres([film.scaled(factor) for film in films])
    assert distances(found) == pytest.approx([4.0] * 3, rel=0.2)
    assert len(set(np.round(distances(found), 4))) == 1
    assert "with which people are about 1.70 m tall" in told
    assert "Are they in squares of a chessboard" in told
    assert f"multiplied by {found[0].view.translation.norm() / 4 / factor:.3g}," in told


def test_metres_stay_and_so_do_cameras_that_nobody_calibrated(films: list[ObservedFilm]) -> None:
    for factor in (0.6, 1.0, 1.5):  # children and adults
        scaled = [film.scaled(factor) for film in films]
        assert in_metres(scaled) == (scaled, [])
    placed = [film.standing(film.view.rotation, 100 * film.view.translation) for film in films]
    assert in_metres(placed) == (placed, [])
    assert in_metres(films[:1]) == (films[:1], [])


def test_a_stranger_whose_rays_pass_says_nothing_of_the_unit(films: list[ObservedFilm]) -> None:
    """Nobody is the same in two films."""
    first = replace(films[0].people, rows=films[0].people.rows[films[0].people.rows["tracks"] == 0])
    second = replace(films[1].people, rows=films[1].people.rows[films[1].people.rows["tracks"] == 0])
    strangers = [replace(films[0], people=first).scaled(100.0), replace(films[1], people=second).scaled(100.0)]
    assert in_metres(strangers) == (strangers, [])


def test_a_camera_of_another_film_is_told(films: list[ObservedFilm]) -> None:
    people = match_people(films)
    assert unmatched_films(films, people) == []
    assert distant_rays(films, dict(enumerate(people))) == []
    high = camera_at(TURNS[2])
    high = replace(high, translation=high.translation + np.array([0.0, 1.0, 0.0]))
    wrong = moved(films, 2, high)
    (told,) = unmatched_films(wrong, match_people(wrong))
    assert told.startswith("films[2]: shows nobody whom another film shows")
    assert told.endswith(
        "are translations in metres, is each film of its camera, and do the films show the same moments?"
    )
    both = [wrong[0], wrong[2]]
    (told,) = unmatched_films(both, match_people(both))
    assert told.startswith("films: nobody is seen by two cameras at once")
    assert unmatched_films(films[:1], match_people(films[:1])) == []


def test_a_film_without_the_others_moments_is_not_compared(films: list[ObservedFilm]) -> None:
    later = films[2].people.rows.copy()
    later["frames"] += 3
    late = [*films[:2], replace(films[2], people=replace(films[2].people, rows=later))]
    assert unmatched_films(late, match_people(late)) == []


def test_rays_that_miss_are_told(films: list[ObservedFilm]) -> None:
    """A camera that is said to be 13 cm higher than it is: people are still the same, but something is wrong."""
    high = camera_at(TURNS[1])
    high = replace(high, translation=high.translation + np.array([0.0, 0.13, 0.0]))
    wrong = moved(films[:2], 1, high)
    people = dict(enumerate(match_people(wrong)))
    assert [{film for film, _ in tracks} for tracks in people.values()] == [{0, 1}, {0, 1}]
    told = distant_rays(wrong, people)
    assert [sentence.partition(":")[0] for sentence in told] == ["person0", "person1"]
    assert all("rays of films[0] and films[1] miss one another by 0.1" in sentence for sentence in told)
    placed = [film.standing(film.view.rotation, film.view.translation) for film in wrong]
    assert distant_rays(placed, people) == []  # as well as they could be found


def test_people_of_impossible_size_or_distance_are_told() -> None:
    assert impossible_people({0: 1.7, 1: 0.6}, {0: 99.0, 1: 1.0}) == []
    small, tall, far = impossible_people({0: 0.4, 1: 2.7, 4: 1.7}, {0: 1.0, 1: 500.0, 4: 101.0})
    assert small.startswith("person0 is 0.40 m tall; expected 0.5 to 2.6 m: are translations in metres")
    assert tall.startswith("person1 is 2.70 m tall")
    assert far.startswith("person4 is 101 m away from a camera; expected 100 m at most")


def test_bodies_far_from_one_of_several_cameras_are_told() -> None:
    fit = made_fit()
    (film,) = fit.films
    near = film.standing(torch.eye(3), torch.tensor([0.0, 0.0, -20.0]))
    far = film.standing(torch.eye(3), torch.tensor([0.0, 150.0, 0.0]))
    assert find_impossible_people(fit) == []
    assert find_impossible_people(replace(fit, films=(film, near))) == []
    told = find_impossible_people(replace(fit, films=(film, near, far)))
    assert [sentence.partition(";")[0] for sentence in told] == [
        f"person{person} is 150 m away from a camera" for person in (0, 1)
    ]
    motion = fit.motions[1]
    tall = replace(motion.shape, values=motion.shape.values + 40.0)
    assert float(statures(motion.model, tall.values[None])) > 2.6
    grown = replace(fit, films=(film, near), motions={1: replace(motion, shape=tall)})
    (sentence,) = find_impossible_people(grown)
    assert sentence.startswith("person1 is ")
    assert "m tall; expected 0.5 to 2.6 m" in sentence


def test_people_who_are_too_tall_in_one_film_are_told() -> None:
    """One camera shows no sizes, so a height that nobody has is a warning; several cameras have their own."""
    fit = made_fit()
    (film,) = fit.films
    assert find_tall_people(fit) == []
    motion = fit.motions[1]
    shape = replace(motion.shape, values=motion.shape.values + 40.0)
    tall = replace(fit, motions={1: replace(motion, shape=shape)})
    (sentence,) = find_tall_people(tall)
    assert sentence.startswith("person1 is ")
    assert "One camera does not show how tall somebody is" in sentence
    assert find_tall_people(replace(tall, films=(film, film))) == []
