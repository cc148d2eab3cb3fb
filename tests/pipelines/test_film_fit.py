"""Fits of films: windows of frames that share a shape, and what passes from one to the next."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.example import example_photo
from helpers.films import write_film

from warp_partdr.errors import InputError
from warp_partdr.inputs.scene import Scene
from warp_partdr.models.measuring import statures
from warp_partdr.networks.detection.film_people import FilmPeople, find_film_people, kept_size
from warp_partdr.pipelines.film import FilmFit, film_shots, fit_film, windows
from warp_partdr.pipelines.film_pieces import FilmPieces
from warp_partdr.pipelines.observed_film import ObservedFilm
from warp_partdr.solve.confidence.scenes import SceneConfidence, judge_scene
from warp_partdr.solve.confidence.sights import NO_SIGHT
from warp_partdr.solve.mesh.mesh_options import MeshOptions
from warp_partdr.solve.scene.fitting import SceneFit, fit_scene
from warp_partdr.solve.scene.options import SceneOptions

COUNT, STEP = 14, 3  # frames, and pixels that the person moves to the right a frame
SHORT_WINDOWS = SceneOptions(mesh=MeshOptions(iterations=4), window=8, overlap=3, shape_frames=3)


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory) -> FilmPeople:
    photo = example_photo()
    height, width = (side - side % 2 for side in photo.shape[:2])
    wide = np.pad(photo, [(0, 0), (STEP * COUNT, STEP * COUNT), (0, 0)], mode="edge")
    starts = [STEP * COUNT - STEP * place for place in range(COUNT)]
    path = tmp_path_factory.mktemp("film") / "walk.mp4"
    write_film(path, [np.ascontiguousarray(wide[:height, start : start + width]) for start in starts], rate=30)
    return find_film_people(path)


@pytest.fixture(scope="module")
def fit(people: FilmPeople) -> FilmFit:
    return fit_film([ObservedFilm.of(people)], options=SHORT_WINDOWS)


def test_people_of_a_film_are_kept_small(people: FilmPeople) -> None:
    assert people.num_people == 1
    assert (people.rate, len(people.times), len(people.of(0))) == (30, COUNT, COUNT)
    np.testing.assert_allclose(people.times, np.arange(COUNT) / 30, atol=1e-6)
    first, last = people.owners(0), people.owners(COUNT - 1)
    assert first.shape == kept_size(people.image_size)
    assert set(np.unique(first)) == {0, 1}
    columns = [np.flatnonzero(each.any(0)).mean() for each in (first, last)]
    zoom = first.shape[1] / people.image_size[1]
    assert columns[1] - columns[0] == pytest.approx(STEP * (COUNT - 1) * zoom, abs=3)
    assert kept_size((2000, 1000)) == (640, 320)


def test_a_motion_is_smooth_across_windows(fit: FilmFit) -> None:
    motion = fit.motions[0]
    assert motion.frames.tolist() == list(range(COUNT))
    assert len(motion.bodies(slice(3, 5)).detailed.vertices) == 2
    across = motion.translation[:, 0].numpy()
    away, focal = float(motion.translation[:, 2].mean()), float(fit.camera.focal[0, 0])
    per_frame = (across[-1] - across[0]) / (COUNT - 1)
    # What moves STEP pixels a frame, so far away; from frame to frame too, where windows meet.
    assert per_frame == pytest.approx(STEP * away / focal, rel=0.15)
    assert np.diff(across).min() > 0
    turned = motion.rotations[1:] @ motion.rotations[:-1].mT
    assert float(turned.diagonal(dim1=-2, dim2=-1).sum(-1).min()) > 1 + 2 * np.cos(0.15)


def test_one_window_needs_no_shape_before(people: FilmPeople, fit: FilmFit) -> None:
    told: list[str] = []
    film = [ObservedFilm.of(people)]
    whole = fit_film(
        film, options=replace(SHORT_WINDOWS, window=64), progress=lambda name, done, total: told.append(name)
    )
    assert set(told) == {"motions"}
    joints = [each.motions[0].bodies().detailed.joints for each in (fit, whole)]
    apart = [each - each[:, :1] for each in joints]
    assert float((apart[0] - apart[1]).norm(dim=-1).mean()) < 0.04


def test_a_run_that_was_ended_goes_on_where_it_was(
    people: FilmPeople, fit: FilmFit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    film = tmp_path / "walk.mp4"
    film.write_bytes(b"film")
    pieces = FilmPieces(tmp_path / "out", [film], SHORT_WINDOWS)
    told = ("walk.mp4: frames missing after 0.20 s", "another")
    seen = pieces.people(0, lambda: replace(people, warnings=told))
    assert pieces.starts(lambda: [0.0, 0.25]) == [0.0, 0.25]
    done: list[int] = []
    refine = fit_scene

    def fit_twice(scene: Scene, **how: Any) -> SceneFit:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(scene.num_frames)
        return refine(scene, **how)

    monkeypatch.setattr("warp_partdr.pipelines.film.fit_scene", fit_twice)
    with pytest.raises(KeyboardInterrupt):
        fit_film([ObservedFilm.of(seen)], options=SHORT_WINDOWS, pieces=pieces)
    assert done == [3, 7]  # the shape, and the first window
    (pieces.folder / "window0.npz").write_bytes(b"a full disk")  # a damaged piece is made again
    done.clear()
    again = FilmPieces(tmp_path / "out", [film], SHORT_WINDOWS)
    found = again.people(0, lambda: pytest.fail("people are known"))
    np.testing.assert_array_equal(found.rows, people.rows)
    assert found.packed == people.packed
    assert found.warnings == told
    assert again.starts(lambda: pytest.fail("starts are known")) == [0.0, 0.25]
    with pytest.raises(KeyboardInterrupt):
        fit_film([ObservedFilm.of(found)], options=SHORT_WINDOWS, pieces=again)
    done.clear()
    whole = fit_film([ObservedFilm.of(found)], options=SHORT_WINDOWS, pieces=again)
    assert done == [7]  # the last window
    # Bit for bit what a run without a break gives.
    assert torch.equal(whole.motions[0].rotations, fit.motions[0].rotations)
    assert torch.equal(whole.motions[0].translation, fit.motions[0].translation)
    ours, theirs = whole.motions[0].confidence, fit.motions[0].confidence
    assert ours is not None
    assert theirs is not None
    for name in ("bodies", "limbs", "sights"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert FilmPieces(tmp_path / "out", [film], replace(SHORT_WINDOWS, window=9)).folder != again.folder
    again.remove()
    assert not again.folder.exists()


def test_confidence_is_blended_as_poses_are(people: FilmPeople, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows 0 to 6, 4 to 10 and 7 to 13 share frames; the person is not found in frame 9."""
    judged: list[SceneConfidence] = []

    def judge(*given: Any) -> SceneConfidence:
        judged.append(judge_scene(*given))
        return judged[-1]

    monkeypatch.setattr("warp_partdr.pipelines.film.judge_scene", judge)
    rows = people.rows[people.rows["frames"] != 9]
    found = fit_film([ObservedFilm.of(replace(people, rows=rows))], options=SHORT_WINDOWS)
    confidence = found.motions[0].confidence
    assert confidence is not None
    _, first, second, third = judged  # the first of all is the shape's
    assert confidence.bodies[2] == pytest.approx(expit(first.bodies[0, 2]))
    assert confidence.bodies[4] == pytest.approx(expit((3 * first.bodies[0, 4] + second.bodies[0, 0]) / 4))
    assert confidence.limbs[8] == pytest.approx(expit((3 * second.limbs[0, 4] + 2 * third.limbs[0, 1]) / 5))
    assert confidence.known.tolist() == [frame != 9 for frame in range(COUNT)]
    assert (confidence.sights[9] == NO_SIGHT).all()
    assert (confidence.sights[confidence.known] != NO_SIGHT).all()
    assert confidence.bodies[confidence.known].min() > 0.5
    assert found.warnings == ()


def expit(log_odds: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-log_odds))


def test_who_is_not_seen_well_is_warned_of(people: FilmPeople) -> None:
    """Keypoints of a few frames are those of nobody."""
    rows = people.rows.copy()
    some = (rows["frames"] >= 3) & (rows["frames"] <= 6)
    rows["keypoints"][some, :, 2] *= 0.02
    rows["keypoints"][some, :, 0] += np.linspace(-150, 150, 33)
    found = fit_film([ObservedFilm.of(replace(people, rows=rows))], options=replace(SHORT_WINDOWS, window=64))
    (warning,) = found.warnings
    assert warning.startswith("person0: confidence below 0.40 from 0.1 to 0.2 s (head and left arm and left leg")
    confidence = found.motions[0].confidence
    assert confidence is not None
    assert (confidence.bodies < 0.4).tolist() == some.tolist()


def cut_at(people: FilmPeople, cut: int) -> FilmPeople:
    """The film as if it had a cut there: its person is another one after it."""
    rows = people.rows.copy()
    rows["tracks"] = rows["frames"] < cut
    return replace(people, rows=rows, cuts=(cut,))


def test_shots_are_fitted_apart(people: FilmPeople, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bodies after a cut are those of a film that begins there, and no scene reaches over it."""
    scenes: list[tuple[int, int]] = []
    refine = fit_scene

    def fit_once(scene: Scene, **how: Any) -> SceneFit:
        scenes.append((scene.num_people, scene.num_frames))
        return refine(scene, **how)

    cut, options = 6, replace(SHORT_WINDOWS, window=5, overlap=1)
    monkeypatch.setattr("warp_partdr.pipelines.film.fit_scene", fit_once)
    fit = fit_film([ObservedFilm.of(cut_at(people, cut))], options=options)
    assert fit.shots == [range(cut), range(cut, COUNT)]
    assert scenes[2:] == [(1, len(window)) for shot in fit.shots for window in windows(*shot_ends(shot), 5, 1)]
    assert {number: motion.frames.tolist() for number, motion in fit.motions.items()} == {
        0: list(range(cut, COUNT)),
        1: list(range(cut)),
    }
    rows = people.rows[people.rows["frames"] >= cut].copy()
    rows["frames"] -= cut
    rows["times"] -= people.times[cut]
    alone = replace(people, rows=rows, times=people.times[cut:] - people.times[cut], packed=people.packed[cut:])
    expected = fit_film([ObservedFilm.of(alone)], options=options).motions[0]
    torch.testing.assert_close(fit.motions[0].translation, expected.translation, atol=2e-3, rtol=0)
    torch.testing.assert_close(fit.motions[0].rotations, expected.rotations, atol=1e-2, rtol=0)


def shot_ends(shot: range) -> tuple[int, int]:
    return shot.start, shot.stop


def test_films_share_the_cuts_that_all_of_them_have(people: FilmPeople) -> None:
    films = [ObservedFilm.of(replace(people, cuts=cuts)) for cuts in ((3, 8), (8,), (5, 8, 11))]
    assert film_shots(films) == [range(8), range(8, COUNT)]
    assert film_shots(films[:1]) == [range(3), range(3, 8), range(8, COUNT)]


def test_windows_cover_all_frames() -> None:
    assert windows(5, 9, 8, 3) == [range(5, 9)]
    assert windows(0, 14, 8, 3) == [range(7), range(4, 11), range(7, 14)]
    assert windows(0, 13, 8, 3) == [range(8), range(5, 13)]


def test_a_person_has_one_shape(fit: FilmFit) -> None:
    shape = fit.motions[0].shape
    torch.testing.assert_close(fit.motions[0].bodies(slice(0, 2)).shape, shape.values.expand(2, -1))
    assert (shape.clothes >= 0).all()


def test_a_known_stature_holds_in_every_window(people: FilmPeople, fit: FilmFit) -> None:
    tall = fit_film([ObservedFilm.of(people)], options=replace(SHORT_WINDOWS, stature=2.0))
    found, guessed = (
        statures(each.motions[0].model, each.motions[0].shape.values[None]).item() for each in (tall, fit)
    )
    assert found == pytest.approx(2.0, abs=1e-4)
    farther = tall.motions[0].translation[:, 2] / fit.motions[0].translation[:, 2]
    torch.testing.assert_close(farther, torch.full_like(farther, 2.0 / guessed), rtol=0.03, atol=0)


def test_a_stature_of_several_people_is_whose(people: FilmPeople, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("warp_partdr.pipelines.film.match_people", lambda films: [((0, 0),), ((0, 0),)])
    with pytest.raises(InputError, match=r"stature: 1\.8 m, for 2 people; expected one of them, person 0 to 1"):
        fit_film([ObservedFilm.of(people)], options=replace(SHORT_WINDOWS, stature=1.8))
    monkeypatch.setattr("warp_partdr.pipelines.film.match_people", lambda films: [((0, 0), (1, 0))])
    with pytest.raises(InputError, match=r"stature: 1\.8 m, for 1 people and 2 cameras"):
        fit_film([ObservedFilm.of(people)] * 2, options=replace(SHORT_WINDOWS, stature=1.8))


def test_films_people_and_options_at_fault_are_named(people: FilmPeople, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="films: none; expected at least one"):
        fit_film([])
    with pytest.raises(TypeError, match="options: dict; expected SceneOptions or None"):
        fit_film([ObservedFilm.of(people)], options={"window": 4})  # type: ignore[arg-type]
    with pytest.raises(InputError, match="person: 1; expected 0 to 0"):
        fit_film([ObservedFilm.of(people)], person=1)
    with pytest.raises(TypeError, match="people"):
        ObservedFilm.of("walk.mp4")  # type: ignore[arg-type]
    gray = write_film(tmp_path / "gray.mp4", [np.full((64, 96, 3), 90, np.uint8)] * 6)
    with pytest.raises(InputError, match=r"gray\.mp4: nobody found in 6 frames"):
        find_film_people(gray)
    with pytest.raises(ValueError, match="overlap"):
        SceneOptions(window=8, overlap=8)
