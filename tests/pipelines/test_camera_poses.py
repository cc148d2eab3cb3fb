"""Cameras that nobody calibrated, placed by the people whom they see."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.rigs import camera_at, film_of

from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.stature import bone_statures
from warp_partdr.errors import InputError
from warp_partdr.inputs.scene import Scene, SceneObservation, View
from warp_partdr.lab.synthetic.scene_people import SceneSample, make_pair, make_views
from warp_partdr.networks.regression.landmarks import LANDMARKS
from warp_partdr.pipelines import film_cameras
from warp_partdr.pipelines.camera_poses import PeopleInViews, RelativePoses, place_cameras
from warp_partdr.pipelines.film_cameras import place_film_cameras
from warp_partdr.pipelines.observed_film import ObservedFilm
from warp_partdr.solve.scene.observations import observe_scene

TURNS, MOVES = [0.0, 0.9, 2.0], [[0.0, 0.0, 0.0], [0.3, 0.1, 0.4], [-0.2, 0.0, 0.9]]


def true_poses() -> RelativePoses:
    rotations = rotation_from_axis_angle(torch.tensor([[0.05 * turn, turn, 0.0] for turn in TURNS]).double())
    return RelativePoses(rotations, torch.tensor(MOVES).double())


def seen_at(poses: RelativePoses, there: Sequence[Sequence[int]], moments: int = 6) -> PeopleInViews:
    """Points about pelvises 4 m before the first camera, without any error, seen by each camera at some people."""
    rng = np.random.default_rng(3)
    marks = torch.from_numpy(rng.uniform(-0.8, 0.8, (moments, len(LANDMARKS), 3)))
    pelvises = torch.from_numpy(rng.uniform(-0.4, 0.4, (moments, 3))) + torch.tensor([0.0, 0.0, 4.0])
    turned = torch.einsum("vij,mlj->vmli", poses.rotations, marks)
    moved = torch.einsum("vij,mj->vmi", poses.rotations, pelvises) + poses.translations[:, None]
    points = turned + moved[:, :, None]
    shown = torch.zeros(len(there), moments, dtype=torch.bool)
    for view, seen in enumerate(there):
        shown[view, list(seen)] = True
    votes = shown[..., None].expand(points.shape[:3]).double()
    return PeopleInViews(points[..., :2] / points[..., 2:], votes, turned, moved, shown)


def angle(one: torch.Tensor, other: torch.Tensor) -> float:
    """Between two rotations [degrees]."""
    cosine = (float((one.double() @ other.double().mT).trace()) - 1) / 2
    return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))


def test_exact_observations_give_exact_poses() -> None:
    true = true_poses()
    people = seen_at(true, [range(6)] * 3)
    start = people.chained()
    torch.testing.assert_close(start.rotations, true.rotations)
    torch.testing.assert_close(start.translations, true.translations)
    assert people.pose_difference(true) < 1e-20
    found = people.refined(start)
    torch.testing.assert_close(found.rotations, true.rotations)
    assert found.energy < 1e-12


def test_a_view_stands_by_the_one_that_it_shares_moments_with() -> None:
    true = true_poses()
    found = seen_at(true, [[0, 1, 2], [2, 3, 4], [3, 4, 5]]).chained()
    torch.testing.assert_close(found.rotations, true.rotations)
    torch.testing.assert_close(found.translations, true.translations)
    with pytest.raises(
        InputError, match=r"views\[2\]: shows nobody when others do; expected views that were taken at the same time"
    ):
        seen_at(true, [[0, 1, 2], [2, 3, 4], [5]]).chained()


def test_rays_mend_what_the_network_says() -> None:
    """Bodies that the second view sees turned by 10 degrees, and a tenth too far away, of many people."""
    true = true_poses()
    people = seen_at(true, [range(40), range(40), []], 40)
    people = PeopleInViews(*(each[:2] for each in vars(people).values()))
    wrong = rotation_from_axis_angle(torch.tensor([0.0, math.radians(10.0), 0.0]).double())
    marks, pelvises = people.landmarks.clone(), people.pelvises.clone()
    marks[1], pelvises[1] = marks[1] @ wrong.mT, 1.1 * pelvises[1]
    people = replace(people, landmarks=marks, pelvises=pelvises)
    start = people.chained()
    assert angle(start.rotations[1], true.rotations[1]) == pytest.approx(10.0, abs=0.1)
    found = people.refined(start)
    assert angle(found.rotations[1], true.rotations[1]) < 1.5


def test_pelvises_say_how_far_cameras_are() -> None:
    """Rays meet however far cameras stand apart."""
    true = true_poses()
    found = seen_at(true, [range(6)] * 3).refined(replace(true, translations=1.2 * true.translations))
    torch.testing.assert_close(found.translations, true.translations, atol=2e-3, rtol=0)


def test_places_are_in_the_world_of_the_first_view() -> None:
    true = true_poses()
    lens = camera_at(0.0).without_distortion
    first = View(lens, rotation_from_axis_angle(torch.tensor([0.2, -0.5, 0.1])), torch.tensor([0.5, -0.2, 3.0]))
    views = true.applied_to([first, View(lens), View(lens)])
    point = torch.tensor([0.3, -0.1, 0.7])
    seen = first.to_camera(point).double()
    for view, turn, move in zip(views, true.rotations, true.translations, strict=True):
        torch.testing.assert_close(view.to_camera(point).double(), turn @ seen + move, atol=1e-5, rtol=0)


def test_a_keypoint_that_is_far_off_hardly_counts() -> None:
    true = true_poses()
    people = seen_at(true, [range(6)] * 3)
    rays = people.rays.clone()
    rays[1, :, 3] += 0.5
    found = replace(people, rays=rays).refined(true)
    assert max(angle(one, other) for one, other in zip(found.rotations, true.rotations, strict=True)) < 0.5


@pytest.fixture(scope="module")
def two() -> SceneSample:
    return make_views(9, 2)


def unplaced(scene: Scene) -> Scene:
    first, *others = scene.views
    return replace(scene, views=[first, *(View(view.camera) for view in others)])


def test_a_person_places_two_cameras(two: SceneSample) -> None:
    scene = two.scene
    found = place_cameras(unplaced(scene))
    torch.testing.assert_close(found.views[0].rotation, scene.views[0].rotation)
    torch.testing.assert_close(found.views[0].translation, scene.views[0].translation)
    assert angle(found.views[1].rotation, scene.views[1].rotation) < 12
    true, seen = (each.views[1].eye - scene.views[0].eye for each in (scene, found))
    assert float(torch.nn.functional.cosine_similarity(true, seen, dim=0)) > math.cos(math.radians(8))
    assert float(seen.norm() / true.norm()) == pytest.approx(1, abs=0.15)
    assert found.observations == scene.observations


def test_a_known_stature_says_how_far_cameras_are(two: SceneSample) -> None:
    scene = unplaced(two.scene)
    observed_bodies = observe_scene(scene, "cpu")
    heights = [float(bone_statures(observed.body.lengths)) for observed in observed_bodies]
    one, other = (place_cameras(scene, observed_bodies=observed_bodies, stature=height) for height in (1.5, 1.8))
    ratio = (other.views[1].eye - other.views[0].eye).norm() / (one.views[1].eye - one.views[0].eye).norm()
    assert float(ratio) == pytest.approx(1.2, abs=0.01)
    assert all(1.0 < height < 2.3 for height in heights)
    with pytest.raises(InputError, match=r"stature: 1.7 m, for 2 people; expected one person"):
        place_cameras(make_pair(3).scene, stature=1.7)
    with pytest.raises(InputError, match=r"stature: 175; expected metres, 0\.4 to 2\.8"):
        place_cameras(scene, observed_bodies=observed_bodies, stature=175)


def test_one_view_stays(two: SceneSample) -> None:
    alone = Scene(two.scene.views[:1], [observation for observation in two.scene.observations if observation.view == 0])
    assert place_cameras(alone) is alone


@pytest.fixture(scope="module")
def pair() -> SceneSample:
    return make_pair(101)


def films_of(pair: SceneSample, turns: Sequence[float], orders: Sequence[tuple[int, int]]) -> list[ObservedFilm]:
    """Films whose cameras' lenses alone are known."""
    cameras = [camera_at(turn) for turn in turns]
    seen = [film_of(pair, camera, order=order, noise=2.0) for camera, order in zip(cameras, orders, strict=True)]
    return [ObservedFilm.of(people, camera.without_distortion) for people, camera in zip(seen, cameras, strict=True)]


def test_two_people_place_three_films(pair: SceneSample) -> None:
    turns = (-0.5, 0.4, 1.5)
    told: list[tuple[str, int, int]] = []
    films = films_of(pair, turns, [(0, 1), (1, 0), (1, 0)])
    placed = place_film_cameras(films, progress=lambda *each: told.append(each))
    torch.testing.assert_close(placed[0].view.rotation, torch.eye(3))
    for film, turn in zip(placed, turns, strict=True):
        true = rotation_from_axis_angle(torch.tensor([0.0, turn - turns[0], 0.0]))
        assert angle(film.view.rotation, true) < 15
    assert [told[0], told[-1]] == [("cameras", 0, 3), ("cameras", 3, 3)]
    with pytest.raises(InputError, match=r"stature: 1.7 m, for 2 people; expected one of them, person 0 to 1"):
        place_film_cameras(films, stature=1.7)


def test_one_of_two_is_as_tall_as_told(pair: SceneSample) -> None:
    films = films_of(pair, (-0.5, 0.4), [(0, 1), (1, 0)])
    one, other = (place_film_cameras(films, stature=height, person=1)[1].view.eye for height in (1.5, 1.8))
    assert float(other.norm() / one.norm()) == pytest.approx(1.2, abs=0.01)
    with pytest.raises(InputError, match=r"person: 2; expected 0 to 1"):
        place_film_cameras(films, stature=1.5, person=2)
    with pytest.raises(InputError, match=r"stature: 175; expected metres, 0\.4 to 2\.8"):
        place_film_cameras(films, stature=175, person=1)
    with pytest.raises(InputError, match="films: none; expected at least one"):
        place_film_cameras([])


def test_films_of_other_moments_are_told(pair: SceneSample) -> None:
    one, other = films_of(pair, (-0.5, 0.4), [(0, 1), (0, 1)])
    rows = other.people.rows.copy()
    rows["frames"] += 100
    later = replace(other, people=replace(other.people, rows=rows))
    with pytest.raises(
        InputError, match=r"films\[1\]: shows nobody when another film does; expected films that were taken"
    ):
        place_film_cameras([one, later])


def test_a_film_whose_people_are_in_no_other_is_told(pair: SceneSample, monkeypatch: pytest.MonkeyPatch) -> None:
    films = films_of(pair, (-0.5, 0.4, 1.5), [(0, 1)] * 3)
    found = [((0, 0), (1, 0)), ((0, 1), (1, 1)), ((2, 0),), ((2, 1),)]  # film, and number of a person in it
    monkeypatch.setattr(film_cameras, "match_people", lambda films: found)
    with pytest.raises(
        InputError, match=r"films\[2\]: shows nobody by whom it can be placed; expected a person who is in another film"
    ):
        place_film_cameras(films)


def test_a_film_knows_its_camera(pair: SceneSample) -> None:
    (film,) = films_of(pair, [0.3], [(0, 1)])
    known = camera_at(0.3)
    film = film.standing(*(torch.from_numpy(each).float() for each in (known.rotation, known.translation)))
    camera = film.camera
    assert (camera.size, camera.distortion) == (known.size, ())
    assert camera.focal == pytest.approx(known.focal)
    assert camera.principal == pytest.approx(known.principal)
    np.testing.assert_allclose(camera.rotation, known.rotation, atol=1e-6)
    np.testing.assert_allclose(camera.translation, known.translation, atol=1e-6)


def test_observations_need_no_order(two: SceneSample) -> None:
    scene = unplaced(two.scene)
    turned: list[SceneObservation] = list(reversed(scene.observations))
    one, other = place_cameras(scene), place_cameras(replace(scene, observations=turned))
    torch.testing.assert_close(one.views[1].rotation, other.views[1].rotation, atol=1e-4, rtol=0)
