"""Films of several cameras: who is who, distortion, and bodies in one world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.quick import QUICK_SCENE
from helpers.rigs import SIZE, camera_at, centred_joints, film_of

from warp_partdr.body.skeletons import MPJPE_JOINTS
from warp_partdr.errors import InputError
from warp_partdr.lab.synthetic.scene_people import SceneSample, make_pair
from warp_partdr.pipelines.film import fit_film
from warp_partdr.pipelines.observed_film import ObservedFilm
from warp_partdr.pipelines.same_people import match_people, meeting, ray_distance

LENS = (-0.4, 0.1, 0.003, -0.002)


@pytest.fixture(scope="module")
def pair() -> SceneSample:
    return make_pair(101)


def test_rays_say_who_is_who(pair: SceneSample) -> None:
    cameras = [camera_at(turn) for turn in (-0.5, 0.4, 1.5)]
    orders = (0, 1), (1, 0), (1, 0)
    films = [
        ObservedFilm.calibrated(film_of(pair, camera, order=order, noise=2.0), camera)
        for camera, order in zip(cameras, orders, strict=True)
    ]
    assert {tuple(sorted(person)) for person in match_people(films)} == {
        ((0, 0), (1, 1), (2, 1)),
        ((0, 1), (1, 0), (2, 0)),
    }
    rows = [film.people.of(0) for film in films]
    assert ray_distance(films[0], rows[0], films[1], films[1].people.of(1)) < 0.03
    assert ray_distance(films[0], rows[0], films[1], rows[1]) > 0.1


def test_rays_miss_by_as_much_as_a_camera_is_too_high(pair: SceneSample) -> None:
    one, other = camera_at(-0.3), camera_at(0.3)
    seen = [film_of(pair, camera) for camera in (one, other)]
    high = replace(other, translation=other.translation + np.array([0.0, 0.05, 0.0]))
    films = [ObservedFilm.calibrated(people, camera) for people, camera in zip(seen, (one, high), strict=True)]
    found = ray_distance(films[0], films[0].people.of(0), films[1], films[1].people.of(0))
    assert found == pytest.approx(0.05, rel=0.1)


def test_rays_that_meet_behind_a_camera_do_not_meet(pair: SceneSample) -> None:
    """A camera that looks the other way, in whose picture the lines through all joints are the same."""
    one, other = camera_at(-0.3), camera_at(0.3)
    first, second = film_of(pair, one), film_of(pair, other)
    rows = second.rows.copy()
    rows["keypoints"][..., 1] = 2 * other.principal[1] - rows["keypoints"][..., 1]
    away = np.diag([-1.0, 1.0, -1.0])
    back = replace(other, rotation=away @ other.rotation, translation=away @ other.translation)
    films = [ObservedFilm.calibrated(first, one), ObservedFilm.calibrated(replace(second, rows=rows), back)]
    met = meeting(films[0], films[0].people.of(0), films[1], films[1].people.of(0))
    assert (met.compared, met.distance) == (True, np.inf)


def test_unsure_keypoints_are_not_compared(pair: SceneSample) -> None:
    cameras = [camera_at(-0.3), camera_at(0.3)]
    first, second = (film_of(pair, camera) for camera in cameras)
    unsure = second.rows.copy()
    unsure["keypoints"][..., 2] *= 0.4
    both = zip((first, replace(second, rows=unsure)), cameras, strict=True)
    films = [ObservedFilm.calibrated(people, camera) for people, camera in both]
    for mine, theirs in ((0, 1), (1, 0)):
        assert not meeting(films[mine], films[mine].people.of(0), films[theirs], films[theirs].people.of(0)).compared


def test_where_rays_meet_limbs_have_the_lengths_of_people(pair: SceneSample) -> None:
    """Cameras whose places are in centimetres see the same pixels of a giant."""
    cameras = [camera_at(-0.5), camera_at(0.4)]
    seen = [film_of(pair, camera) for camera in cameras]
    for unit, expected in ((1.0, True), (100.0, False), (0.01, False)):
        scaled = [replace(camera, translation=unit * camera.translation) for camera in cameras]
        films = [ObservedFilm.calibrated(people, camera) for people, camera in zip(seen, scaled, strict=True)]
        found = ray_distance(films[0], films[0].people.of(0), films[1], films[1].people.of(0))
        assert np.isfinite(found) == expected


def test_who_is_largest_in_the_pictures_is_first(pair: SceneSample) -> None:
    cameras = [camera_at(-0.5), camera_at(0.4)]
    for large in (0, 1):
        films = []
        for camera in cameras:
            people = film_of(pair, camera)
            rows = people.rows.copy()
            rows["boxes"] = np.where((rows["tracks"] == large)[:, None], [0.0, 0, 300, 400], [0.0, 0, 100, 200])
            films.append(ObservedFilm.calibrated(replace(people, rows=rows), camera))
        assert match_people(films)[0] == ((0, large), (1, large))


def test_one_whom_one_camera_sees_is_a_person_too(pair: SceneSample) -> None:
    cameras = [camera_at(-0.5), camera_at(0.4)]
    first, second = (film_of(pair, camera) for camera in cameras)
    alone = replace(second, rows=second.rows[second.rows["tracks"] == 0])
    films = [ObservedFilm.calibrated(people, camera) for people, camera in zip((first, alone), cameras, strict=True)]
    assert set(match_people(films)) == {((0, 0), (1, 0)), ((0, 1),)}


def test_two_tracks_of_one_frame_are_two_people_however_near(pair: SceneSample) -> None:
    """Found twice by one camera, where the other sees one person."""
    cameras = [camera_at(-0.5), camera_at(0.4)]
    first, second = (film_of(pair, camera) for camera in cameras)
    own = first.rows[first.rows["tracks"] == 0]
    again = own.copy()
    again["tracks"] = 1
    rows = np.concatenate([own, again])
    alone = replace(second, rows=second.rows[second.rows["tracks"] == 0])
    both = zip((replace(first, rows=rows), alone), cameras, strict=True)
    people = match_people([ObservedFilm.calibrated(film, camera) for film, camera in both])
    assert sorted(people) == [((0, 0), (1, 0)), ((0, 1),)]


def test_a_track_that_ends_and_goes_on_is_one_person(pair: SceneSample) -> None:
    cameras = [camera_at(-0.5), camera_at(0.4)]
    first, second = (film_of(pair, camera, frames=6) for camera in cameras)
    broken = first.rows.copy()
    broken["tracks"][(broken["tracks"] == 0) & (broken["frames"] > 2)] = 2
    both = zip((replace(first, rows=broken), second), cameras, strict=True)
    people = match_people([ObservedFilm.calibrated(film, camera) for film, camera in both])
    assert set(people) == {((0, 0), (0, 2), (1, 0)), ((0, 1), (1, 1))}


def test_people_who_were_never_there_at_once_are_not_compared(pair: SceneSample) -> None:
    camera, other = camera_at(-0.5), camera_at(0.4)
    first, second = film_of(pair, camera), film_of(pair, other)
    later = second.rows.copy()
    later["frames"] += 3
    films = [ObservedFilm.calibrated(first, camera), ObservedFilm.calibrated(replace(second, rows=later), other)]
    assert ray_distance(films[0], first.rows, films[1], later) == np.inf


def test_distortion_is_taken_away(pair: SceneSample) -> None:
    straight, bent = camera_at(0.3), camera_at(0.3, distortion=LENS)
    truth, seen = film_of(pair, straight), film_of(pair, bent)
    film = ObservedFilm.calibrated(seen, bent)
    sure = truth.rows["keypoints"][..., 2] > 0
    off = np.abs(film.people.rows["keypoints"] - truth.rows["keypoints"])[sure]
    assert off.max() < 0.01
    assert np.abs(seen.rows["keypoints"] - truth.rows["keypoints"])[sure].max() > 1
    assert film.lens is not None
    assert film.lens.size == SIZE
    with pytest.raises(InputError, match="picture: 640 x 480 px; expected 320 x 200, as calibrated"):
        ObservedFilm.calibrated(seen, replace(bent, size=(200, 320)))


def test_two_films_put_people_where_they_are(pair: SceneSample) -> None:
    """They are in the frame of the first camera, and nearer to the truth than with one film."""
    cameras = [camera_at(-0.6), camera_at(0.5, distortion=LENS)]
    cameras = [camera.in_frame_of(cameras[0]) for camera in cameras]
    world = camera_at(-0.6)
    truth = centred_joints(pair) @ world.rotation.T + world.translation
    films = [
        ObservedFilm.calibrated(film_of(pair, camera_at(turn, distortion=lens), order=order, noise=1.0), camera)
        for (turn, lens, order), camera in zip(((-0.6, (), (0, 1)), (0.5, LENS, (1, 0))), cameras, strict=True)
    ]
    both, alone = fit_film(films, options=QUICK_SCENE), fit_film(films[:1], options=QUICK_SCENE)

    def errors(fit: object) -> list[float]:
        found = []
        for person, motion in fit.motions.items():  # type: ignore[attr-defined]
            bodies = motion.bodies()
            joints = motion.model.landmarks(bodies.detailed, MPJPE_JOINTS)[1].numpy()
            track = next(track for film, track in fit.tracks[person] if film == 0)  # type: ignore[attr-defined]
            found.append(1000 * float(np.linalg.norm(joints - truth[track], axis=-1).mean()))
        return found

    assert len(both.motions) == 2
    assert max(errors(both)) < 60
    assert sum(errors(both)) < 0.6 * sum(errors(alone))
    rows = both.rows(0, 1)
    assert set(rows["tracks"]) == {track for film, track in both.tracks[0] if film == 1}


def test_films_at_fault_are_named(pair: SceneSample) -> None:
    camera = camera_at(0.0)
    film = ObservedFilm.calibrated(film_of(pair, camera), camera)
    slow = replace(film, people=replace(film.people, times=np.arange(3) / 10))
    with pytest.raises(InputError, match=r"films\[1\]: frame 1 is 0\.067 s from that of another film; expected films"):
        fit_film([film, slow])
    with pytest.raises(TypeError, match="films"):
        fit_film(film)  # type: ignore[arg-type]


def test_a_world_is_the_first_camera_s_frame() -> None:
    first, other = camera_at(-0.6), camera_at(0.5)
    point = np.array([0.1, -0.2, 0.3])
    seen = first.rotation @ point + first.translation
    moved = other.in_frame_of(first)
    np.testing.assert_allclose(moved.rotation @ seen + moved.translation, other.rotation @ point + other.translation)
    assert torch.equal(torch.from_numpy(first.in_frame_of(first).rotation).round(decimals=12), torch.eye(3).double())
