"""Files of films' people: what looks wrong in them is told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.films import write_film
from helpers.motions import COUNT, LATE, RATE, SIZE, made_fit, shade, with_confidence, write_fitted
from helpers.skins import read_glb
from PIL import Image

from warp_partdr.body.landmarks import annotated
from warp_partdr.body.skeletons import skeleton
from warp_partdr.cameras import Perspective, UsualLens
from warp_partdr.errors import InputError
from warp_partdr.inputs.films import read_frames
from warp_partdr.models.anny import anny
from warp_partdr.models.model import DetailedModel
from warp_partdr.networks.detection.person import SKELETON
from warp_partdr.pipelines.film import FilmFit, find_distant_keypoints
from warp_partdr.results.confidence_chart import confidence_chart
from warp_partdr.results.load_film import load_film_fit
from warp_partdr.results.palette import PEOPLE_COLOURS
from warp_partdr.results.predictions import load_film_bodies
from warp_partdr.results.save_film import draw_film, save_film_fit
from warp_partdr.solve.confidence.sights import NO_SIGHT, SIGHTS


def seen_fit() -> FilmFit:
    """The fit of which keypoints are known, where the bodies have them."""
    fit = made_fit()
    (film,) = fit.films
    rows = film.people.rows.copy()
    for person, motion in fit.motions.items():
        names = annotated(skeleton(SKELETON).landmarks, motion.model.landmark_names)
        marks = motion.model.landmarks(motion.bodies().detailed, names)
        points = film.view.camera.project(marks)[..., :2].numpy()
        mine = rows["tracks"] == person
        rows["keypoints"][mine] = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1)
        rows["boxes"][mine] = np.concatenate([points.min(1), points.max(1)], axis=-1)
    return replace(fit, films=(replace(film, people=replace(film.people, rows=rows)),))


@pytest.mark.parametrize("off", [0.0, 0.03, 0.09])
def test_a_body_far_from_its_keypoints_is_told(tmp_path: Path, off: float) -> None:
    """``off``: share of the second person's size by which keypoints are beside the body."""
    film = write_film(tmp_path / "walk.mp4", [np.full((*SIZE, 3), 90, np.uint8)] * COUNT, rate=RATE)
    fit = seen_fit()
    rows = fit.people.rows
    mine = (rows["tracks"] == 1) & (rows["frames"] >= LATE)
    sizes = (rows["boxes"][mine, 2:] - rows["boxes"][mine, :2]).max(1)
    rows["keypoints"][mine, :, 0] += off * sizes[:, None]
    fit = replace(fit, warnings=tuple(find_distant_keypoints(fit)))
    told = save_film_fit(fit, tmp_path / "out", films=[film])["warnings"]
    expected = f"{film}: person1 ends 9.0 % of the person's size from BlazePose's keypoints; expected at most 6 %"
    assert told == ([expected] if off > 0.06 else [])


def test_keypoints_that_a_model_lacks_are_not_compared() -> None:
    """SMPL has no landmark at the inner corner of the eye, which BlazePose's keypoints have."""
    fit = seen_fit()
    column = skeleton(SKELETON).landmarks.index("left_eye_inner")
    fit.people.rows["keypoints"][:, column, 0] += 1e4
    assert find_distant_keypoints(fit) != []
    motions = {person: replace(motion, model=without_an_eye(motion.model)) for person, motion in fit.motions.items()}
    assert find_distant_keypoints(replace(fit, motions=motions)) == []


def without_an_eye(model: DetailedModel) -> DetailedModel:
    kept = [index for index, name in enumerate(model.landmark_names) if not name.endswith("left_eye_inner")]
    names = tuple(model.landmark_names[index] for index in kept)
    return replace(model, landmark_names=names, landmark_weights=model.landmark_weights[kept])


def gray_film(folder: Path) -> Path:
    return write_film(folder / "walk.mp4", [np.full((*SIZE, 3), 90, np.uint8)] * COUNT, rate=RATE)


def test_files_hold_the_confidence_in_each_frame(tmp_path: Path) -> None:
    fit = with_confidence(made_fit())
    report = save_film_fit(fit, tmp_path / "out", films=[gray_film(tmp_path)])
    first, second = json.loads((tmp_path / "out" / "people.json").read_text())["people"]
    assert first == report["people"][0]
    assert first["confidence"] == [0.9] * 3 + [0.1] * 3 + [0.9] * 6 + [None] + [0.9] * 7
    assert second["confidence"] == [0.6] * (12 - LATE) + [None] + [0.6] * (COUNT - 13)
    assert first["mean_confidence"] == pytest.approx((16 * 0.9 + 3 * 0.1) / 19, abs=1e-3)
    assert (first["guessed"], second["guessed"]) == ({"left_arm": [[0, 9]]}, {})
    saved = load_film_fit(tmp_path / "out", anny())
    for person, motion in fit.motions.items():
        own, found = motion.confidence, saved.motions[person].confidence
        assert own is not None
        assert found is not None
        np.testing.assert_allclose(found.bodies, own.bodies, rtol=1e-6)
        np.testing.assert_allclose(found.limbs, own.limbs, rtol=1e-6)
        np.testing.assert_array_equal(found.sights, own.sights)


def test_limbs_are_guessed_in_several_runs_of_frames(tmp_path: Path) -> None:
    fit = with_confidence(made_fit())
    confidence = fit.motions[0].confidence
    assert confidence is not None
    confidence.sights[:, 0] = SIGHTS.index("seen")
    confidence.sights[[0, 1, 4, 11, 12, 13, 19], 0] = SIGHTS.index("outside")
    confidence.sights[12] = NO_SIGHT
    report = save_film_fit(fit, tmp_path / "out", films=[gray_film(tmp_path)])
    assert report["people"][0]["guessed"]["head"] == [[0, 1], [4, 4], [11, 11], [13, 13], [19, 19]]


def test_files_of_older_versions_have_no_confidence(tmp_path: Path) -> None:
    report = save_film_fit(made_fit(), tmp_path / "out", films=[gray_film(tmp_path)])
    assert "confidence" not in report["people"][0]
    with np.load(tmp_path / "out" / "person0.npz") as data:
        assert "confidence" not in data
    assert load_film_fit(tmp_path / "out", anny()).motions[0].confidence is None


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("confidence", None, "no array confidence; expected it beside limb_confidence, limb_sights"),
        ("confidence", np.full(COUNT, 1.5), r"confidence: float64 \(20,\); expected numbers \(20,\), 0 to 1"),
        ("confidence", np.zeros(3), r"confidence: float64 \(3,\); expected numbers \(20,\)"),
        ("limb_confidence", np.zeros((COUNT, 5), int), r"limb_confidence: int64 \(20, 5\); expected numbers"),
        ("limb_sights", np.full((COUNT, 5), 4, np.uint8), r"limb_sights: uint8 \(20, 5\); expected .*, 0 to 3"),
    ],
)
def test_confidence_that_is_none_is_refused(tmp_path: Path, name: str, value: np.ndarray | None, told: str) -> None:
    save_film_fit(with_confidence(made_fit()), tmp_path / "out", films=[gray_film(tmp_path)])
    path = tmp_path / "out" / "person0.npz"
    with np.load(path) as data:
        arrays = {key: data[key] for key in data if key != name}
    np.savez(path, **arrays | ({} if value is None else {name: value}))
    (tmp_path / "out" / "people.json").write_text(
        json.dumps({key: each for key, each in read_report(tmp_path).items() if key != "files"})
    )
    with pytest.raises(InputError, match=rf"person0\.npz: {told}"):
        load_film_fit(tmp_path / "out", anny())


def read_report(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "out" / "people.json").read_text())
    return found


def test_overlays_show_guessed_limbs_pale_and_all_of_who_is_not_found(tmp_path: Path) -> None:
    film = gray_film(tmp_path)
    plain, pale = (list(draw_film(fit, film)) for fit in (made_fit(), with_confidence(made_fit())))
    changed = [np.abs(one.astype(int) - other).sum(-1) > 12 for one, other in zip(plain, pale, strict=True)]
    body = [np.abs(one.astype(int) - 90).sum(-1) > 12 for one in plain]
    shares = [both.sum() / drawn.sum() for both, drawn in zip(changed, body, strict=True)]
    assert [0.01 < share < 0.2 for share in shares] == [frame < 10 for frame in range(COUNT)]
    assert shares[12] > 0.8
    assert shares[11] == shares[13] == 0
    distances = [np.abs(picture[12].astype(int) - 90).sum(-1)[body[12]].mean() for picture in (plain, pale)]
    assert distances[1] < 0.6 * distances[0]


def test_curves_of_confidence_are_drawn_where_people_are_found(tmp_path: Path) -> None:
    fit = with_confidence(made_fit())
    save_film_fit(fit, tmp_path / "out", films=[gray_film(tmp_path)])
    chart = np.asarray(Image.open(tmp_path / "out" / "confidence.png")).astype(int)
    # Axes from (62, 46) to (886, 336) [px], from 0 to the time of the last frame, and from 1 to 0.
    columns = 62 + (886 - 62) * np.arange(COUNT) / (COUNT - 1)
    limit = round(336 - (336 - 46) * 0.4)
    for person, motion in fit.motions.items():
        assert motion.confidence is not None
        near = np.abs(chart - PEOPLE_COLOURS[person]).sum(-1) < 100
        near[limit - 2 : limit + 3] = False  # the line of the limit
        for frame, probability in zip(motion.frames, motion.confidence.bodies, strict=True):
            column = min(round(columns[frame]), 884)
            if np.isnan(probability):
                assert not near[50:330, column].any()
            else:
                row = round(336 - (336 - 46) * probability)
                assert near[row - 3 : row + 4, column - 1 : column + 2].any(), (person, frame)
    assert np.abs(chart[limit, 400:800] - (200, 60, 20)).sum(-1).max() < 200
    empty = np.asarray(confidence_chart(made_fit().motions, made_fit().times)).astype(int)
    assert not (np.abs(empty[50:330] - PEOPLE_COLOURS[0]).sum(-1) < 60).any()
    many = dict.fromkeys(range(40), fit.motions[0])
    assert confidence_chart(many, fit.times).size == (900, 380)


TIMES = np.cumsum([0.0, *[0.1] * 8, 0.33, 0.2, 0.2, *[0.1] * 8])  # frames are lost, as many phones lose them


def uneven_fit() -> FilmFit:
    """The fit of a film whose frames come at ``TIMES``."""
    fit = made_fit()
    (film,) = fit.films
    rows = film.people.rows.copy()
    rows["times"] = TIMES[rows["frames"]]
    return replace(fit, films=(replace(film, people=replace(film.people, rows=rows, times=TIMES, warnings=("lost",))),))


def test_files_of_a_film_of_a_variable_rate_have_its_times(tmp_path: Path) -> None:
    ticks = (100 * TIMES).round().astype(int)
    film = write_film(tmp_path / "walk.mp4", [np.full((*SIZE, 3), 90, np.uint8)] * COUNT, rate=100, times=ticks)
    report = save_film_fit(uneven_fit(), tmp_path / "out", films=[film])
    assert (report["rate"], report["frames"], report["warnings"]) == (RATE, COUNT, ["lost"])
    np.testing.assert_allclose(report["times"], TIMES, atol=1e-6)
    people = [(each["first_time"], each["last_time"]) for each in report["people"]]
    assert people == [(0.0, pytest.approx(TIMES[-1])), (pytest.approx(TIMES[LATE]), pytest.approx(TIMES[-1]))]
    shown = list(read_frames(tmp_path / "out" / "overlay.mp4"))
    np.testing.assert_allclose([frame.time for frame in shown], TIMES, atol=1e-4)
    for person, first in ((0, 0), (1, LATE)):
        own = TIMES[first:]
        rows = load_film_bodies(tmp_path / "out" / f"person{person}.npz").rows
        np.testing.assert_allclose(rows["times"], own)
        document, arrays = read_glb((tmp_path / "out" / f"person{person}.glb").read_bytes())
        (keys,) = {sampler["input"] for sampler in document["animations"][0]["samplers"]}
        np.testing.assert_allclose(arrays[keys][:, 0], own - own[0], atol=1e-6)
        timing = (tmp_path / "out" / f"person{person}.bvh").read_text().split("MOTION\n")[1].splitlines()
        assert timing[0] == f"Frames: {round((own[-1] - own[0]) * RATE) + 1}"
        assert timing[1] == "Frame Time: 0.1000000"
        if person == 0:  # who goes to the right, 0.1 m a frame: 0.03 m in each tenth of a second that lost frames
            across = [float(row.split()[0]) for row in timing[2:]]
            at = np.arange(len(across)) / RATE
            expected = np.interp(at, TIMES, 10 * np.arange(COUNT))
            np.testing.assert_allclose(np.array(across) - across[0], expected, atol=0.01)
    document, arrays = read_glb((tmp_path / "out" / "scene.glb").read_bytes())
    keys = {tuple(arrays[sampler["input"]][:, 0].round(4)) for sampler in document["animations"][0]["samplers"]}
    assert tuple(TIMES.astype(np.float32).round(4)) in keys
    assert tuple(TIMES[LATE:].astype(np.float32).round(4)) in keys
    saved = load_film_fit(tmp_path / "out", anny())
    np.testing.assert_allclose(saved.times, TIMES, atol=1e-6)


def test_who_leaves_is_gone_when_the_next_frame_comes(tmp_path: Path) -> None:
    fit = uneven_fit()
    gone = 9  # frames; the next one comes late
    motion = fit.motions[0]
    short = replace(
        motion, frames=motion.frames[:gone], rotations=motion.rotations[:gone], translation=motion.translation[:gone]
    )
    rows = fit.people.rows[(fit.people.rows["tracks"] == 1) | (fit.people.rows["frames"] < gone)]
    (film,) = fit.films
    cut = replace(
        fit, films=(replace(film, people=replace(film.people, rows=rows)),), motions={0: short, 1: fit.motions[1]}
    )
    path = write_film(tmp_path / "walk.mp4", [np.full((*SIZE, 3), 90, np.uint8)] * COUNT, rate=RATE)
    save_film_fit(cut, tmp_path / "out", films=[path])
    document, arrays = read_glb((tmp_path / "out" / "scene.glb").read_bytes())
    animation = document["animations"][0]
    seen = {
        document["nodes"][channel["target"]["node"]]["name"]: arrays[animation["samplers"][channel["sampler"]]["input"]]
        for channel in animation["channels"]
        if channel["target"]["path"] == "scale"
    }
    np.testing.assert_allclose(seen["person0"][:, 0], [0.0, TIMES[gone]], atol=1e-6)
    np.testing.assert_allclose(seen["person1"][:, 0], [0.0, TIMES[LATE]], atol=1e-6)


def test_a_film_says_that_its_lens_is_assumed(tmp_path: Path) -> None:
    fit = made_fit()
    (film,) = fit.films
    path = write_film(tmp_path / "walk.mp4", [np.full((*SIZE, 3), 90, np.uint8)] * COUNT, rate=RATE)
    for lens, guessed in ((UsualLens.of_size(SIZE), True), (Perspective.of_picture(SIZE, focal=max(SIZE)), False)):
        seen = replace(fit, films=(replace(film, view=replace(film.view, camera=lens)),))
        (view,) = save_film_fit(seen, tmp_path / "out", films=[path])["views"]
        assert view.get("guessed", False) == guessed


def test_overlays_of_matched_films_show_the_frames_of_each_moment(tmp_path: Path) -> None:
    """The second film has every third frame of the first one's, after two that are left out."""
    fit = made_fit()
    (film,) = fit.films
    rows = film.people.rows[:0]
    numbers = np.where(np.arange(COUNT) % 3 == 0, 2 + np.arange(COUNT) // 3, -1)
    other = replace(film, people=replace(film.people, rows=rows), numbers=numbers)
    both = replace(fit, films=(film, other))
    names = [tmp_path / name for name in ("walk.mp4", "slow.mp4")]
    write_film(names[0], [np.full((*SIZE, 3), shade(frame), np.uint8) for frame in range(COUNT)], rate=RATE)
    slow = [np.full((*SIZE, 3), 10, np.uint8)] * 2
    slow += [np.full((*SIZE, 3), shade(frame), np.uint8) for frame in range(0, COUNT, 3)]
    write_film(names[1], slow, rate=3)
    report = save_film_fit(both, tmp_path / "out", films=names)
    assert [view["skipped_frames"] for view in report["views"]] == [0, 2]
    assert report["views"][1]["film_frames"] == numbers.tolist()
    assert "film_frames" not in report["views"][0]
    shown = list(read_frames(tmp_path / "out" / "overlay1.mp4"))
    np.testing.assert_allclose([frame.time for frame in shown], np.arange(0, COUNT, 3) / RATE, atol=1e-4)
    corners = [float(frame.picture[:20, :20].mean()) for frame in shown]
    np.testing.assert_allclose(corners, [shade(frame) for frame in range(0, COUNT, 3)], atol=4)
    saved = load_film_fit(tmp_path / "out", anny())
    assert [saved.views[1].number(frame) for frame in (0, 1, 3, COUNT)] == [2, None, 3, None]
    assert saved.views[0].number(4) == 4


def test_times_of_a_report_that_do_not_rise_are_refused(tmp_path: Path) -> None:
    write_fitted(tmp_path)
    path = tmp_path / "out" / "people.json"
    report = json.loads(path.read_text())
    for wrong in ([0.0] * COUNT, [0.0, 1.0], "soon", None):
        path.write_text(json.dumps(report | {"times": wrong}))
        if wrong is None:  # as earlier versions wrote it
            np.testing.assert_allclose(load_film_fit(tmp_path / "out", anny()).times, np.arange(COUNT) / RATE)
        else:
            with pytest.raises(InputError, match=r"people\.json: times: not of 20 frames, or they do not rise"):
                load_film_fit(tmp_path / "out", anny())


def cut_fit(*cuts: tuple[int, ...]) -> FilmFit:
    """The fit as if of films that have these cuts."""
    fit = seen_fit()
    (film,) = fit.films
    return replace(fit, films=tuple(replace(film, people=replace(film.people, cuts=each)) for each in cuts))


def test_cuts_are_told_and_shots_are_in_the_report(tmp_path: Path) -> None:
    film = write_film(tmp_path / "walk.mp4", [np.full((*SIZE, 3), 90, np.uint8)] * COUNT, rate=RATE)
    report = save_film_fit(cut_fit((LATE, 12)), tmp_path / "out", films=[film])
    cuts = f"cuts at frames {LATE}, 12 (0.60, 1.20 s): 3 shots"
    assert report["warnings"] == [f"{film}: {cuts}, each fitted apart, its people numbered anew"]
    assert report["shots"] == [
        {"first_frame": 0, "last_frame": 5, "start": 0.0, "end": 0.5},
        {"first_frame": 6, "last_frame": 11, "start": 0.6, "end": 1.1},
        {"first_frame": 12, "last_frame": 19, "start": 1.2, "end": 1.9},
    ]
    assert [person["shot"] for person in report["people"]] == [0, 1]
    assert len(save_film_fit(cut_fit(()), tmp_path / "whole", films=[film])["shots"]) == 1


def test_a_cut_that_one_of_several_films_has_is_told(tmp_path: Path) -> None:
    films = [
        write_film(tmp_path / name, [np.full((*SIZE, 3), 90, np.uint8)] * COUNT, rate=RATE)
        for name in ("left.mp4", "right.mp4")
    ]
    report = save_film_fit(cut_fit((12,), (LATE, 12)), tmp_path / "out", films=films)
    fitted, alone = report["warnings"]
    assert fitted == f"{films[0]}: a cut at frame 12 (1.20 s): 2 shots, each fitted apart, its people numbered anew"
    assert alone.startswith(f"{films[1]}: cuts at frames {LATE}, 12 (0.60, 1.20 s): 3 shots, which not all films have")
    assert [shot["first_frame"] for shot in report["shots"]] == [0, 12]


def test_other_films_than_the_fit_s_are_refused(tmp_path: Path) -> None:
    fit = made_fit()
    for wrong, told in (
        ({"films": []}, "films: 0 files; expected 1, those of the fit"),
        ({"films": ["walk.mp4"], "formats": ["obj"]}, "formats: 'obj'; expected of usda, usdz, fbx"),
    ):
        with pytest.raises(InputError, match=told):
            save_film_fit(fit, tmp_path / "out", **wrong)  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()
