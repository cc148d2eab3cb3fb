"""``partdr predict`` of photos and films alone."""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import commands
from helpers.commands import Run
from helpers.example import example_photo
from helpers.files import EXAMPLE
from helpers.films import write_film
from PIL import Image

from warp_partdr.inputs import films
from warp_partdr.networks.detection import people
from warp_partdr.networks.detection.people import find_people_in
from warp_partdr.results.body_file import load_body
from warp_partdr.results.predictions import load_film_bodies

files, run = commands.files, commands.run  # fixtures
pytestmark = pytest.mark.usefixtures("files")


def photo(side: int = 512) -> Image.Image:
    image = Image.fromarray(example_photo())
    return image.resize((image.width * side // image.height // 2 * 2, side))


def report(folder: str = "out") -> dict[str, Any]:
    return json.loads(Path(folder, "predictions.json").read_text())


def two(far: int = 0) -> Image.Image:
    """A person, and the same one smaller beside them."""
    large, small = photo(480), photo(320)
    wide = Image.new("RGB", (large.width + small.width + 40 + far, 480), large.getpixel((3, 3)))
    wide.paste(large, (0, 0))
    wide.paste(small, (large.width + far, 100))
    return wide


def test_an_avi_whose_recorder_dropped_frames_is_whole(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_film(Path("a.avi"), [np.asarray(photo(256))] * 5, rate=10, times=[0, 1, 2, 5, 6])
    code, said, complaint = run("predict a.avi --out out --device cpu")
    assert code == 0
    assert said.startswith("1 person in 5 frames; ")
    assert complaint.startswith("partdr: warning: a.avi: frames missing after 0.20 s (steps of up to 0.30 s, ")
    (person,) = json.loads(Path("out", "predictions.json").read_text())["people"]
    assert (person["first_time"], person["last_time"]) == (0.0, 0.6)
    np.testing.assert_allclose(load_film_bodies("out/a.person0.npz").rows["times"], [0.0, 0.1, 0.2, 0.5, 0.6])


def test_a_photo_is_enough(run: Run) -> None:
    two().save("both.jpg", quality=95)
    code, said, complaint = run("predict both.jpg --out out --device cpu")
    assert (code, complaint) == (0, "")
    assert re.fullmatch(r"2 people in 1 photo; [\d.]+ a second, cpu\n.*predictions.json names.*\n", said)
    names = ["both.person0.npz", "both.person1.npz"]
    assert {path.name for path in Path("out").iterdir()} == {*names, "predictions.json"}
    large, small = (load_body(Path("out", name)) for name in names)
    assert 1.2 < large.camera_scale / small.camera_scale < 1.9
    assert large.image_size.tolist() == [480, two().width]
    told = report()
    assert [person["file"] for person in told["people"]] == names
    assert {person["picture"] for person in told["people"]} == {"both.jpg"}
    assert all(0.5 < person["score"] <= 1 and len(person["box"]) == 4 for person in told["people"])
    assert told["files"].keys() == set(names)
    code, said, _ = run("predict both.jpg --out one --device cpu --person 1 --fov 50")
    assert (code, said[:8]) == (0, "1 person")
    (only,) = report("one")["people"]
    assert only["file"] == "both.person1.npz"
    known = load_body("one/both.person1.npz")
    assert known.camera_perspective == 1
    assert known.translation[2] > 1


def test_a_folder_s_faults_are_told_and_left_out(run: Run) -> None:
    Path("in").mkdir()
    photo().save("in/a.jpg")
    photo(300).save("in/a.png")
    Image.new("RGB", (200, 100)).save("in/empty.png")
    Path("in/torn.jpg").write_bytes(Path("in/a.jpg").read_bytes()[:3000])
    Path("in/notes.txt").write_text("no picture")
    Path("in/.hidden.jpg").write_text("no picture")
    code, said, complaint = run("predict in --out out --device cpu --batch 1")
    assert code == 1
    assert said.startswith("2 people in 3 photos; ")
    left_out, *others = complaint.splitlines()
    assert left_out == "partdr: 1 file left out: 1 .txt (no picture format)"
    torn, empty = sorted(others, key=lambda line: "nobody" in line)
    assert torn.startswith(f"partdr: {Path('in', 'torn.jpg')}: ")
    assert empty == f"partdr: {Path('in', 'empty.png')}: nobody found in it"
    told = report()
    assert (told["nobody_in"], told["unreadable"]) == (["empty.png"], ["torn.jpg"])
    assert told["files"].keys() == {"a.jpg.person0.npz", "a.png.person0.npz"}


def test_a_film_s_people_have_a_file_each(run: Run) -> None:
    """The second comes later, and goes earlier."""
    frames = [np.asarray(two(12 * step) if 4 <= step < 9 else Image.new("RGB", (2, 2))) for step in range(12)]
    width = max(frame.shape[1] for frame in frames)
    alone, pictures = np.asarray(photo(480)), []
    for frame in frames:
        picture = np.full((480, width, 3), alone[3, 3], np.uint8)
        shown = frame if frame.shape[0] == 480 else alone
        picture[:, : shown.shape[1]] = shown
        pictures.append(picture)
    write_film(Path("walk.mp4"), pictures, rate=6)  # the detector looks at every second frame
    code, said, complaint = run("predict walk.mp4 --out out --device cpu")
    assert (code, complaint) == (0, "")
    assert said.startswith("2 people in 12 frames; ")
    first, second = report()["people"]
    assert (first["file"], first["film"], first["track"]) == ("walk.person0.npz", "walk.mp4", 0)
    assert (first["frames"], first["first_frame"], first["last_frame"]) == (12, 0, 11)
    assert second["first_frame"] in (4, 5)
    assert second["last_frame"] == 8
    assert {"left_knee", "right_wrist"} < set(report()["joints"])
    stays, goes = (load_film_bodies(f"out/walk.person{number}.npz") for number in (0, 1))
    assert stays.rows["frames"].tolist() == list(range(12))
    np.testing.assert_allclose(stays.rows["times"], np.arange(12) / 6, atol=1e-3)
    assert stays.image_size == (480, width)
    assert goes.rows["frames"].tolist() == list(range(second["first_frame"], 9))
    moves = np.diff(goes.rows["camera_translation"][:, 0])
    np.testing.assert_allclose(moves, 12, atol=6)
    assert np.abs(np.diff(stays.rows["camera_translation"], axis=0)).max() < 6
    code, said, _ = run("predict walk.mp4 --out out --device cpu --person 1")
    assert (code, said[:8]) == (0, "1 person")
    assert report()["files"].keys() == {"walk.person1.npz"}


def test_a_film_without_a_camera_has_no_perspective(run: Run) -> None:
    write_film(Path("film.mp4"), [np.asarray(photo(256))] * 3)
    for option, known in (("--focal none", False), ("--focal 400", True), ("", False)):
        assert run(f"predict film.mp4 --out out {option} --device cpu")[0] == 0
        assert load_film_bodies("out/film.person0.npz").perspective == known


def test_people_of_two_shots_have_a_file_each(run: Run) -> None:
    size = photo(256).size
    other = Image.open(EXAMPLE / "astronaut.jpg").convert("RGB").resize(size)
    write_film(Path("cut.mp4"), [np.asarray(other)] * 2 + [np.asarray(photo(256))] * 5, rate=20)
    code, said, complaint = run("predict cut.mp4 --out out --device cpu")
    assert code == 0
    assert "2 people in 7 frames" in said
    assert "partdr: warning: cut.mp4: a cut at frame 2 (0.10 s): 2 shots, people numbered anew" in complaint
    assert report()["cuts"] == {"cut.mp4": [2]}
    frames = {(each["first_frame"], each["last_frame"], each["frames"]) for each in report()["people"]}
    assert frames == {(0, 1, 2), (2, 6, 5)}


def test_photos_and_films_go_together_and_a_film_that_breaks_off_keeps_its_frames(run: Run) -> None:
    write_film(Path("a.mp4"), [np.asarray(photo(256))] * 30)
    data = bytearray(Path("a.mp4").read_bytes())
    data[len(data) // 2 : len(data) * 3 // 4] = b"\xff" * (len(data) * 3 // 4 - len(data) // 2)
    Path("a.mp4").write_bytes(data)
    Path("b.mp4").write_text("no film")
    photo(256).save("a.jpg")
    code, said, complaint = run("predict a.mp4 b.mp4 a.jpg --out out --device cpu")
    assert code == 1
    assert re.match(r"2 people in 1 photo and \d+ frames; ", said)
    assert [line.split(": ")[1] for line in complaint.splitlines()] == ["a.mp4", "b.mp4"]
    assert report()["unreadable"] == ["a.mp4", "b.mp4"]
    assert report()["files"].keys() == {"a.jpg.person0.npz", "a.mp4.person0.npz"}
    assert 3 < len(load_film_bodies("out/a.mp4.person0.npz").rows) < 30


def test_keypoints_are_of_the_network_that_is_asked_for(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []

    def look(pictures: object, **how: object) -> object:
        asked.append(how["landmarks"])
        return find_people_in(pictures, **how)  # type: ignore[arg-type]

    monkeypatch.setattr(people, "find_people_in", look)
    photo(256).save("photo.png")
    write_film(Path("film.mp4"), [np.asarray(photo(256))] * 3)
    for option in ("", " --landmarks heavy"):
        assert run(f"predict photo.png film.mp4 --out out{option} --device cpu")[0] == 0
    assert asked[0] == "full"
    assert set(asked[: len(asked) // 2]) == {"full"}
    assert set(asked[len(asked) // 2 :]) == {"heavy"}


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("gray.png", ["gray.png: nobody found in it"]),
        ("gray.png other.png", ["nobody found in any of 2 files"]),
        ("gray.mp4", ["gray.mp4: nobody found in 6 frames"]),
        ("text.jpg", ["text.jpg: ", "expected a picture"]),
        ("text.mp4", ["text.mp4: ", "expected a film"]),
        ("photo.png --person 3", ["photo.png: no person 3, but 1 person in it"]),
        ("photo.png --person -1", ["--person: -1; expected 0 or more"]),
        ("photo.png --min-score 1", ["--min-score: 1.0; expected 0 to below 1"]),
        ("photo.png --batch 0", ["--batch: 0; expected 1 or more"]),
        ("photo.png --labels full1", ["--labels: full1, without a folder of keypoints"]),
        ("photo.png --fov 500", ["--fov: 500"]),
        ("photo.png --focal exif", ["photo.png: no focal length"]),
        ("gray.mp4 --focal exif", ["--focal: exif, with gray.mp4, a film"]),
        ("nothing.jpg", ["nothing.jpg: No such file or folder"]),
        ("none", ["none: no photos or films in it"]),
        ("mine photo.png", ["mine: a folder with keypoints, among others"]),
        ("mine --person 1", ["--person: 1, with a folder of keypoints"]),
        ("mine --min-score 0.2", ["--min-score: 0.2, with a folder of keypoints"]),
        ("mine --landmarks heavy", ["--landmarks: heavy, with a folder of keypoints"]),
        ("photo.png --landmarks lite", ["--landmarks", "lite"]),
        ("photo.png none/../photo.png", ["photo.png: in two of the folders"]),
    ],
)
def test_faults_are_one_line_and_nothing_is_written(run: Run, line: str, words: list[str]) -> None:
    Image.new("RGB", (320, 240), (128, 128, 128)).save("gray.png")
    shutil.copy("gray.png", "other.png")
    write_film(Path("gray.mp4"), [np.full((64, 96, 3), 90, np.uint8)] * 6)
    for name in ("text.jpg", "text.mp4"):
        Path(name).write_text("neither")
    Path("none").mkdir()
    Path("mine").mkdir()
    Path("mine/a.keypoints.json").write_text("{}")
    photo().save("photo.png")
    code, said, complaint = run(f"predict {line} --out out --device cpu")
    assert (code, said) == (2, "")
    assert all(word in complaint.splitlines()[-1] for word in words), complaint
    assert len(complaint.splitlines()) == (3 if "other" in line else 1)
    assert not Path("out").exists()


def test_a_film_alone_that_breaks_off_is_told_once(run: Run) -> None:
    write_film(Path("a.mp4"), [np.asarray(photo(256))] * 30)
    data = bytearray(Path("a.mp4").read_bytes())
    data[len(data) // 2 : len(data) * 3 // 4] = b"\xff" * (len(data) * 3 // 4 - len(data) // 2)
    Path("a.mp4").write_bytes(data)
    code, said, complaint = run("predict a.mp4 --out out --device cpu")
    assert (code, said[:8], complaint.count("\n")) == (1, "1 person", 1)
    assert complaint.startswith("partdr: a.mp4: Invalid data")


def test_films_without_pyav_name_the_extra(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    write_film(Path("a.mp4"), [np.zeros((32, 32, 3), np.uint8)] * 2)
    monkeypatch.setattr(films, "find_spec", lambda name: None)
    code, said, complaint = run("predict a.mp4 --out out")
    assert (code, said) == (2, "")
    assert complaint == "partdr: a.mp4: a film, without PyAV; expected it: pip install 'av>=18'\n"


def test_a_folder_s_files_are_pictures_or_counted(run: Run) -> None:
    """Photos of all formats are taken; folders in it are not searched, and hidden files are no pictures."""
    Path("mixed/deeper").mkdir(parents=True)
    photo().save("mixed/a.GIF", save_all=True, append_images=[photo().rotate(3)])
    photo().save("mixed/b.MPO", "MPO")
    for name in ("notes.txt", "raw.CR2", ".DS_Store", "old.zip"):
        Path("mixed", name).write_text("x")
    code, said, complaint = run("predict mixed --out out --device cpu")
    assert code == 0
    assert said.startswith("2 people in 2 photos; ")
    assert complaint.splitlines() == [
        "partdr: 4 files left out: 1 .zip (archives: unpack them first); 1 folder (folders are not searched); "
        "1 .txt (no picture format); 1 .cr2 (raw photos: develop them first)",
        "partdr: warning: mixed/a.GIF: 2 pictures in the file; the first is taken",
    ]
    shutil.rmtree("mixed/deeper")
    for name in ("a.GIF", "b.MPO"):
        Path("mixed", name).unlink()
    code, _, complaint = run("predict mixed --out out --device cpu")
    assert code == 2
    assert complaint.startswith("partdr: mixed: no photos or films in it (3 files left out: 1 .zip (archives")


def test_names_of_files_need_not_be_text(run: Run) -> None:
    Path("odd").mkdir()
    photo().save("odd/plain.jpg")
    for name in (b"caf\xe9.jpg", b"broken\xff.jpg", b"two\nlines.jpg"):
        shutil.copy("odd/plain.jpg", os.path.join(b"odd", name))
    Path("odd", os.fsdecode(b"broken\xff.jpg")).write_bytes(b"broken")
    code, _, complaint = run("predict odd --out out --device cpu")
    assert code == 1
    assert complaint.startswith("partdr: odd/broken\\xff.jpg: cannot identify")
    told = json.loads(Path("out/predictions.json").read_bytes())
    assert "\\ud" not in Path("out/predictions.json").read_text()  # half a character, which others refuse
    assert sorted(person["picture"] for person in told["people"]) == ["caf\\xe9.jpg", "plain.jpg", "two\\x0alines.jpg"]
    assert told["unreadable"] == ["broken\\xff.jpg"]
    for person in told["people"]:
        load_body(Path("out", person["file"]))


@pytest.mark.skipif(os.name != "posix", reason="needs pipes with names")
def test_pipes_are_told(run: Run) -> None:
    photo().save("photo.jpg")
    Path("pipes").mkdir()
    shutil.copy("photo.jpg", "pipes/a.jpg")
    for name in ("pipes/x.png", "pipes/x.mp4", "pipe.json"):
        os.mkfifo(name)
    code, _, complaint = run("predict pipes --out out --device cpu")
    assert code == 1
    assert sorted(complaint.splitlines()) == [
        "partdr: pipes/x.mp4: a pipe, no regular file; expected a film",
        "partdr: pipes/x.png: a pipe, no regular file; expected a picture",
    ]
    for line, expected in (
        ("predict pipes/x.png", "pipes/x.png: a pipe, no regular file; expected a picture"),
        ("fit pipes/x.png", "pipes/x.png: a pipe, no regular file; expected a picture"),
        ("fit photo.jpg --keypoints pipe.json", "pipe.json: a pipe, no regular file; expected keypoints in JSON"),
        ("fit photo.jpg --config pipe.json", "pipe.json: a pipe, no regular file; expected "),
    ):
        code, said, complaint = run(f"{line} --out no --device cpu")
        assert (code, said, complaint.count("\n")) == (2, "", 1)
        assert expected in complaint


def test_an_animation_is_told_where_one_photo_is_fitted(run: Run) -> None:
    photo(128).save("a.gif", save_all=True, append_images=[photo(128).rotate(3)])
    shutil.copy("k.json", "own.json")
    code, _, complaint = run("fit a.gif --keypoints own.json --model none --out out --device cpu")
    assert code == 0
    assert "partdr: warning: a.gif: 2 pictures in the file; the first is taken\n" in complaint


def test_a_folder_of_keypoints_takes_photos_of_all_formats(run: Run) -> None:
    Path("mine").mkdir()
    for name in ("a.webp", "b.TIF"):
        photo(128).save(f"mine/{name}")
        shutil.copy("k.json", f"mine/{name[0]}.keypoints.json")
    Path("mine/notes.txt").write_text("x")
    code, said, complaint = run("predict mine --out out --device cpu")
    assert code == 0
    assert said.startswith("2 people: ")
    assert "partdr: 1 file left out: 1 .txt (no picture format)\n" in complaint
    assert {person["picture"] for person in report()["people"]} == {"a.webp", "b.TIF"}
    code, _, complaint = run("evaluate folder mine --limit 1 --device cpu")
    assert code == 0
    assert "partdr: 1 file left out: 1 .txt (no picture format)\n" in complaint
