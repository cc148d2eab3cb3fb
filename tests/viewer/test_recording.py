"""Recordings of the demo, and ``partdr demo`` as users call it."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest
from helpers import viewer
from helpers.example import example_photo
from helpers.viewer import click, cropped
from PIL import Image
from typer.testing import CliRunner

from warp_partdr.cli.main import app
from warp_partdr.errors import InputError
from warp_partdr.pipelines.photo import person_in_photo
from warp_partdr.viewer.recording import Film, check_format
from warp_partdr.viewer.targets import person_target

one_thread, open_window, window = viewer.one_thread, viewer.open_window, viewer.window  # fixtures


@pytest.mark.parametrize("name", ["out.gif", "out.html"])
def test_the_command_records_a_film_or_a_page(can_draw, tmp_path, name):
    line = ["demo", "--record", str(tmp_path / name), "--set", "steps=3", "--set", "size=64"]
    done = CliRunner().invoke(app, line)
    assert done.exit_code == 0, done.output
    assert "3 pictures" in done.output
    if name == "out.gif":
        with Image.open(tmp_path / name) as film:
            assert (film.n_frames, film.size) == (3, (1280, 800))
    else:
        page = (tmp_path / name).read_text()
        assert page.count("data:image/webp;base64,") == 3
        assert "http" not in page  # it needs no network


def test_a_photo_is_enough(can_draw, tmp_path):
    """The second largest of the people in it is the target, with photo and parts."""
    photo = Image.fromarray(example_photo())
    both = Image.new("RGB", (2 * photo.width, photo.height), photo.getpixel((5, 5)))
    both.paste(photo, (0, 0))
    both.paste(photo.resize((photo.width // 2, photo.height // 2)), (photo.width + 60, 120))
    both.save(tmp_path / "both.png")
    line = ["demo", str(tmp_path / "both.png"), "--record", str(tmp_path / "out.gif"), "--set", "steps=2"]
    done = CliRunner().invoke(app, [*line, "--person", "1", "--start", "network"])
    assert done.exit_code == 0, done.output
    target = person_target(person_in_photo(np.asarray(both), 1))
    assert target.label_set.name == "ellipbody20"
    assert target.photo is not None
    labels = target.observation.labels.numpy()
    seen = (labels > 0) & (labels < 255)
    shirt = cropped(target.photo, len(seen))[seen].mean(axis=0)
    assert 0.05 < seen.mean() < 0.5
    assert shirt[0] > shirt[2] + 10  # the person, not the background, which is bluish
    for arguments in ([*line, "--person", "2"], ["demo", str(tmp_path / "gray.png"), *line[2:]]):
        Image.new("RGB", (200, 200)).save(tmp_path / "gray.png")
        refused = CliRunner().invoke(app, arguments).exception
        assert isinstance(refused, InputError)
        assert re.match(r"person: 2; expected 0 to 1|.*gray\.png: nobody found", str(refused))


def test_record_checks_the_name(tmp_path, monkeypatch):
    for path, said in (
        (tmp_path / "out.avi", r"out\.avi; expected a name that ends with \.gif"),
        (tmp_path / "nowhere" / "out.gif", "expected a file in a folder that is there"),
    ):
        with pytest.raises(InputError, match=said):
            check_format(path)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(InputError, match=r"pip install av\), or \.gif or \.html"):
        check_format(tmp_path / "out.mp4")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "no display"),
        (["--web", "--record", "out.gif"], "--web, --record, --profile: more than one; expected one"),
        (["--set", "port=80"], "port: without --web; expected both, or neither"),
        (["--set", "browser=false"], "browser: without --web"),
        (["photo.png", "--record", "out.gif"], "photo.png: No such file"),
        (["photo.png", "--record", "out.gif", "--parts", "parts.png"], "--keypoints: none with --parts"),
        (["--record", "out.gif", "--person", "1"], "--person: 1, without a photo or keypoints"),
        (["--record", "out.gif", "--target", "dancing"], "'dancing'; expected one of"),
        (["--record", "out.gif", "--start", "nowhere.npz"], "nowhere.npz: No such file"),
    ],
)
def test_faults_of_the_command_are_refused(arguments, said, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    done = CliRunner().invoke(app, ["demo", *arguments])
    assert isinstance(done.exception, InputError)
    assert said in str(done.exception)


def test_the_film_button_records_until_it_is_pressed_again(window, monkeypatch):
    click(window, "film")
    for _ in range(3):
        window.press("n")
    window.slide(0, window.page().sliders[0].high)
    click(window, "film")
    assert window.scene.message == f"5 pictures in {window.folder / 'demo.gif'}"
    with Image.open(window.folder / "demo.gif") as film:
        assert film.size == (640, 400)
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(film.n_frames - 1)
        assert (np.abs(np.asarray(film.convert("RGB")) - first).max(-1) > 40).mean() > 0.01
    monkeypatch.setattr("warp_partdr.viewer.recording.MOST", 2)  # then it ends by itself
    window.press("f")
    window.press("n")
    assert not window.controls.filming.film.running
    assert "2 pictures" in window.scene.message
    window.folder.joinpath("demo.gif").unlink()
    window.folder.joinpath("demo.gif").mkdir()
    window.press("f")
    window.press("n")
    assert "Is a directory" in window.scene.message
    window.folder.joinpath("demo.gif").rmdir()
    window.press("f")
    assert "2 pictures" in window.scene.message  # those of before


def test_a_film_keeps_one_size_though_the_window_changes(tmp_path):
    film = Film()
    for height, width in ((800, 1281), (900, 1280), (400, 500)):
        film.take(np.full((height, width, 3), 90, np.uint8))
    assert film.write(tmp_path) == 3
    with Image.open(tmp_path / "demo.gif") as written:
        assert (written.size, written.n_frames) == ((427, 267), 3)
    assert film.write(tmp_path) == 0


def test_a_film_is_written_when_the_window_closes(window):
    assert window.finish() == ""
    window.press("f")
    window.press("n")
    assert window.finish() == f"{window.folder / 'demo.gif'}: 2 pictures"
