"""The demo of a fitted film, driven without a screen: its folder, slider, views and recordings."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import viewer
from helpers.motions import COUNT, LATE, RATE, SIZE, made_fit, shade, write_fitted
from helpers.viewer import box as box_of
from helpers.viewer import buttons, click
from helpers.viewer import said as said_by
from PIL import Image
from typer.testing import CliRunner

from warp_partdr.cli.main import app
from warp_partdr.errors import InputError
from warp_partdr.inputs.films import film_facts, read_frames
from warp_partdr.results.film_overlays import PosedMotions
from warp_partdr.results.save_film import draw_film
from warp_partdr.viewer.buttons import Slider
from warp_partdr.viewer.motion_state import MotionSettings, open_motion
from warp_partdr.viewer.motion_views import ViewPictures, arrange
from warp_partdr.viewer.motion_window import MotionWindow
from warp_partdr.viewer.plotted import Look

one_thread = viewer.one_thread  # a fixture
ASIDE = {  # from the people's left, where the first camera sees their fronts; y is down in the world
    "film": "gone.mp4",
    "size": [320, 200],
    "focal": 300.0,
    "principal": [160.0, 100.0],
    "rotation": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
    "translation": [-5, 0, 5],
}
FRONT = ASIDE | {"film": "walk.mp4", "rotation": np.eye(3).tolist(), "translation": [0, 0, 0]}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_fitted(tmp_path)
    return tmp_path / "out"


def change(folder: Path, **values: Any) -> None:
    report = json.loads((folder / "people.json").read_text())
    (folder / "people.json").write_text(json.dumps(report | values))


@pytest.fixture
def window(folder: Path, can_draw: None) -> Iterator[MotionWindow]:
    change(folder, views=[FRONT, ASIDE])
    state, films = open_motion(folder, MotionSettings())
    made = MotionWindow(state, films, folder.parent / "saved", off_screen=True, more=True)
    made.scene.screenshot()
    yield made
    made.scene.close()


def test_a_lens_s_distortion_is_taken_away(folder: Path, tmp_path: Path) -> None:
    """A grid of the film lies where the camera's own removal puts it."""
    from helpers.films import write_film

    grid = np.full((*SIZE, 3), 40, np.uint8)
    grid[::25], grid[:, ::40] = 220, 220
    write_film(tmp_path / "walk.mp4", [grid] * COUNT, rate=RATE)
    lens = {"focal": [300.0, 302.0], "distortion": [-0.2, 0.03, 0.001, 0.0]}
    change(folder, views=[FRONT | {"lens": lens}])
    state, films = open_motion(folder, MotionSettings())
    (view,) = state.saved.views
    assert view.lens is not None
    assert (list(view.lens.focal), list(view.lens.distortion)) == (lens["focal"], lens["distortion"])
    pictures = ViewPictures(state, None, films)  # type: ignore[arg-type]
    pictures.arrange((SIZE[1] + 16, SIZE[0] + 20 + 16))
    state.hidden = set(state.people)
    drawn = pictures.picture(0).astype(int)
    expected = view.lens.undistort_picture(grid).astype(int)
    assert drawn.shape == expected.shape
    assert np.abs(drawn - expected).mean() < 5 < np.abs(drawn - grid).mean()


def whose(picture: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """Places (N, 2), row and column, of a person's pixels: those of their hue, however they are lit."""
    seen = picture.astype(float) - picture.min(-1, keepdims=True)
    hue = colour.astype(float) - colour.min()
    near = (seen * hue).sum(-1) / (np.linalg.norm(seen, axis=-1) * np.linalg.norm(hue) + 1e-9) > 0.97
    return np.argwhere(near & (np.ptp(picture.astype(int), axis=-1) > 40))


def test_a_folder_is_read_back_as_it_was(folder: Path) -> None:
    fit, (state, films) = made_fit(), open_motion(folder, MotionSettings(film=str(folder.parent / "walk.mp4")))
    saved = state.saved
    assert (saved.rate, len(saved.times), saved.times[-1]) == (RATE, COUNT, pytest.approx((COUNT - 1) / RATE))
    assert films == [folder.parent / "walk.mp4"]
    for person, motion in fit.motions.items():
        read = saved.motions[person]
        assert read.frames.tolist() == motion.frames.tolist()
        for name in ("rotations", "translation"):
            assert (getattr(read, name) == getattr(motion, name)).all()
    (view,) = saved.views
    assert (view.film, view.size, view.lens) == ("walk.mp4", SIZE, None)
    assert view.view.camera.intrinsics.tolist() == fit.camera.intrinsics.tolist()
    assert state.room.turn.tolist() == np.diag([1, -1, -1]).tolist()
    feet = max(float(each.bodies().detailed.vertices[..., 1].max()) for each in fit.motions.values())
    assert state.room.low[1] == pytest.approx(-feet, abs=0.01)  # of each fourth vertex


def test_views_are_what_overlays_show(window: MotionWindow, folder: Path) -> None:
    """Camera and positions are the same; in the front view the walker is on the left, the other behind them."""
    frame = 12
    window.slide(frame)
    picture = window.scene.pictures.picture(0)
    drawn = list(draw_film(made_fit(), folder.parent / "walk.mp4"))[frame]
    drawn = np.asarray(Image.fromarray(drawn).resize(picture.shape[1::-1], Image.Resampling.BILINEAR))
    shown, wanted = (np.ptp(each.astype(int), axis=-1) > least for each, least in ((picture, 20), (drawn, 4)))
    assert (shown & wanted).sum() / (shown | wanted).sum() > 0.95
    walker, other = (whose(picture, window.state.colour(person)) for person in (0, 1))
    assert len(walker) > 1.4 * len(other) > 1000
    assert walker[:, 1].mean() < other[:, 1].mean() - 60
    assert float(np.median(picture[:20])) == pytest.approx(shade(frame), abs=3)  # the film's own frame


def test_a_second_view_has_its_own_side(window: MotionWindow) -> None:
    """A camera at their left sees the farther one of the first view to the right, over plain gray."""
    window.slide(LATE)
    picture = window.scene.pictures.picture(1)
    box = window.scene.pictures.boxes[1]
    zoom = box.size[1] / 320
    for person, (x, z) in enumerate(((-1.2 + 0.1 * LATE, 4.5), (1.3, 6.0))):
        column = (160 + 300 * (z - 5) / (5 - x)) * zoom
        assert whose(picture, window.state.colour(person))[:, 1].mean() == pytest.approx(column, abs=8), person
    assert (picture[:10] == picture[0, 0]).all()


def test_the_slider_moves_bodies(window: MotionWindow) -> None:
    window.slide(0)
    scene = window.scene
    first, before = scene.people[0].mapper.dataset.points.copy(), scene.screenshot()
    assert not scene.people[1].visibility  # who comes later
    (slider,) = (placed.entry for placed in window.panel.entries if isinstance(placed.entry, Slider))
    window.pull(slider, 1.03)  # [s]
    assert window.state.frame == 10
    np.testing.assert_allclose(scene.people[0].mapper.dataset.points, first + np.array([1, 0, 0]), atol=1e-4)
    assert scene.people[1].visibility
    assert "frame 10 of 20 · 1.00 s · 2 of 2 people" in said_by(window)
    after = scene.screenshot()
    solid = box_of(window, "solid")
    places = [whose(each[solid], window.state.colour(0))[:, 1].mean() for each in (before, after)]
    assert places[1] > places[0] + 10
    assert (before != after)[box_of(window, "pictures")].any()


def test_buttons_and_keys_change_what_is_shown(window: MotionWindow) -> None:
    state, scene = window.state, window.scene
    for text, now in (
        ("play", lambda: state.playing),
        (">", lambda: state.frame == 1 and not state.playing),
        ("<", lambda: state.frame == 0),
        ("0.25", lambda: state.speed == 0.25),
        ("person 1", lambda: state.hidden == {1}),
        ("everyone", lambda: not state.hidden),
        ("one", lambda: state.hidden == {1}),
        ("one", lambda: state.hidden == {0}),
        ("background", lambda: not scene.pictures.over_film),
        ("ground", lambda: not scene._grid.visibility),
        ("cameras", lambda: not scene._pyramids.visibility),
    ):
        click(window, text)
        assert now(), text
        assert scene.message == "", text
    picture = scene.pictures.picture(0)
    assert len(whose(picture, state.colour(0))) == 0
    window.press("End")
    assert (state.frame, len(state.bodies())) == (COUNT - 1, 1)
    window.press("Right")
    assert state.frame == COUNT - 1
    for key in window.keys:
        window.press(key)
        assert "expected" not in scene.message, key


def test_the_first_screen_has_a_sentence_play_and_time(window: MotionWindow) -> None:
    click(window, "less")
    assert [button.text for button in buttons(window)] == ["play", "more"]
    assert said_by(window).startswith("Press play: you see 2 people of a film in 3D")
    (slider,) = (placed.entry for placed in window.panel.entries if isinstance(placed.entry, Slider))
    assert (slider.title, slider.high) == ("time [s]", pytest.approx((COUNT - 1) / RATE))
    window.pull(slider, 99.0)
    assert window.state.frame == COUNT - 1


@pytest.mark.parametrize("size", [(390, 500), (1280, 800), (640, 480)])
def test_pictures_have_the_size_of_their_view(window: MotionWindow, size: tuple[int, int]) -> None:
    window.arrange(Look(size))
    window.refresh()
    rows, columns = box_of(window, "pictures")
    for placed in window.scene.pictures.boxes:
        assert placed.left + placed.size[1] + 16 <= columns.stop - columns.start
        assert placed.top + placed.size[0] + 16 <= rows.stop - rows.start
    seen = window.scene.screenshot()[rows, columns]
    assert (seen != 250).any(-1).mean() > 0.1


def test_it_plays_as_fast_as_the_film_and_begins_anew(window: MotionWindow, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr("warp_partdr.viewer.motion_window.time.perf_counter", lambda: clock[0])
    seen = []
    window.press("space")
    for place in range(24):
        clock[0] += 0.15 if not place else 0.1
        window.scene.plotter.iren.interactor.InvokeEvent("TimerEvent")
        seen.append(window.state.frame)
    assert seen == [1 + place for place in range(COUNT - 1)] + [0, 1, 2, 3, 4]
    window.press("space")
    clock[0] += 5
    window.press("space")
    window.tick()
    assert window.state.frame == 4  # a pause is no part of the film
    window.state.speed = 2.0
    clock[0] += 0.1
    window.tick()
    assert window.state.frame == 6


def test_few_meshes_are_in_memory() -> None:
    fit, asked = made_fit(), []
    posed = PosedMotions(fit.motions)
    for frame in range(COUNT):
        bodies = posed.at(frame)
        assert list(bodies) == ([0] if frame < LATE else [0, 1])
        whole = fit.motions[0].bodies(slice(frame, frame + 1)).detailed.vertices
        np.testing.assert_allclose(bodies[0].vertices, whole, atol=1e-5)
        asked.append(len(posed._posed[0][1].detailed.vertices))
    assert max(asked) <= 16 < COUNT


def test_pictures_fill_the_room() -> None:
    for sizes in ([(1080, 1920)], [(1920, 1080)] * 2, [(480, 640)] * 4, [(100, 300), (300, 100), (200, 200)]):
        found = arrange(sizes, (496, 784))
        for (height, width), box in zip(sizes, found, strict=True):
            assert box.size[0] / box.size[1] == pytest.approx(height / width, rel=0.05)
            assert box.left >= 0 <= box.top - 20
            assert box.left + box.size[1] <= 496
            assert box.top + box.size[0] <= 784
    (one,) = arrange([(1080, 1920)], (496, 784))
    assert one.size[1] == 496
    left, right = arrange([(1920, 1080)] * 2, (496, 784))
    assert left.top == right.top


@pytest.mark.parametrize("name", ["out.gif", "out.mp4"])
def test_a_motion_is_recorded_from_first_to_last_frame(can_draw: None, folder: Path, name: str) -> None:
    path = folder.parent / name
    film = f"film={folder.parent / 'walk.mp4'}"
    done = CliRunner().invoke(app, ["demo", str(folder), "--record", str(path), "--set", film])
    assert done.exit_code == 0, done.output
    assert f"{COUNT} pictures" in done.output
    if name == "out.gif":
        with Image.open(path) as pictures:
            assert (pictures.n_frames, pictures.size, pictures.info["duration"]) == (COUNT, (1280, 800), 100)
            first = np.asarray(pictures.convert("RGB"))
            pictures.seek(COUNT - 1)
            last = np.asarray(pictures.convert("RGB"))
    else:
        assert film_facts(path).rate == RATE
        pictures = [frame.picture for frame in read_frames(path)]
        first, last = pictures[0], pictures[COUNT - 1]
    colour = open_motion(folder, MotionSettings())[0].colour(0)
    before, after = (whose(each[:, 780:], colour)[:, 1].mean() for each in (first, last))
    assert after > before + 60


def refused(folder: Path, *arguments: str) -> str:
    done = CliRunner().invoke(app, ["demo", str(folder), "--record", str(folder.parent / "x.gif"), *arguments])
    assert isinstance(done.exception, InputError), done.output
    return str(done.exception)


def test_faults_name_the_file(folder: Path) -> None:
    bare = folder.parent / "bare"
    bare.mkdir()
    assert "people.json: No such file or directory; expected the people.json of `partdr fit FILM" in refused(bare)
    (bare / "people.json").write_text('{"people": [{"folder": "person0"}]}')  # of a photo
    assert "people.json: of no film" in refused(bare)
    assert "--target: sitting, with" in refused(folder, "--target", "sitting")
    assert "--person: 1, with" in refused(folder, "--person", "1")
    assert "film: nowhere.mp4; expected a folder with the films of all views, or the film" in refused(
        folder, "--set", "film=nowhere.mp4"
    )
    assert "speed: 0; expected more than 0" in refused(folder, "--set", "speed=0.0")
    assert "steps" in refused(folder, "--set", "steps=3")
    change(folder, views=[FRONT, ASIDE | {"rotation": np.diag([1, 1, -1]).tolist()}])
    assert "people.json: views: ValueError: rotation: not orthonormal, or a mirror image" in refused(folder)
    change(folder, views=[{"film": "walk.mp4"}])
    assert "people.json: views: KeyError: 'size'; expected {" in refused(folder)
    change(folder, views=[], frames=5)
    assert "person0.npz: frames: 0 to 19; expected some of 0 to 4, in order" in refused(folder)
    change(folder, frames=COUNT)
    whole = (folder / "person1.npz").read_bytes()
    (folder / "person1.npz").write_bytes(whole[: len(whole) // 2])
    assert "person1.npz: not readable" in refused(folder)
    with np.load(folder / "person0.npz") as data:
        arrays = dict(data)
    change(folder, files={})
    (folder / "person1.npz").write_bytes(whole)
    for name, values, said in (
        ("detailed_model", np.array("smplx"), "a body of 'smplx'; expected one of 'anny'"),
        ("detailed_shape", np.zeros(3, np.float32), "detailed_shape: float32 (3,); expected finite numbers (20,)"),
        ("detailed_translation", np.full((COUNT, 3), np.nan), "detailed_translation: float64 (20, 3); expected finite"),
    ):
        np.savez(folder / "person0.npz", **(arrays | {name: values}))
        assert f"person0.npz: {said}" in refused(folder)
    assert "walk.mp4: a film; expected the folder that `partdr fit walk.mp4" in refused(folder.parent / "walk.mp4")


def test_another_film_is_told_and_left_out(window: MotionWindow, folder: Path) -> None:
    """Views go on over plain gray."""
    from helpers.films import write_film

    write_film(folder.parent / "walk.mp4", [np.full((96, 160, 3), 90, np.uint8)] * COUNT, rate=RATE)
    state, films = open_motion(folder, MotionSettings())
    other = MotionWindow(state, films, folder.parent / "saved", off_screen=True)
    assert "pictures of 160x96; expected 320x200" in said_by(other)
    assert np.median(other.scene.pictures.picture(0)) == 232
    other.scene.close()
