"""``partdr scene``."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import commands
from helpers.commands import Run
from helpers.example import example_photo
from helpers.files import save_with_focal
from helpers.films import write_film
from helpers.quick import QUICK_COMMAND
from PIL import Image

from warp_partdr.body.rotations import rotation_to_axis_angle
from warp_partdr.inputs.camera_files import read_cameras
from warp_partdr.inputs.films import film_facts
from warp_partdr.lab.synthetic.people import anny_mesh
from warp_partdr.lab.synthetic.rng import TorchRng
from warp_partdr.lab.synthetic.scene_people import SceneSample, make_views
from warp_partdr.lab.synthetic.shading import shade_people

run = commands.run  # a fixture
PERSON = 5  # of PartBench, whose cameras are found
SIDE, FOCAL, AWAY, BESIDE = 256, 300.0, 3.0, 0.5  # [px], [px], [m], [m] from one camera to the other


@pytest.fixture
def films(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """A cardboard person AWAY from two cameras side by side; the width of the films [px]."""
    monkeypatch.chdir(tmp_path)
    picture = Image.fromarray(example_photo())
    picture = picture.resize((picture.width * SIDE // picture.height, SIDE))
    shift = round(FOCAL * BESIDE / AWAY)
    wide = np.pad(np.asarray(picture), [(0, 0), (shift, shift), (0, 0)], mode="edge")
    width = (wide.shape[1] - shift) // 2 * 2
    for name, start in (("right", shift), ("left", 0)):
        write_film(Path(f"{name}.mp4"), [np.ascontiguousarray(wide[:, start : start + width])] * 4, rate=10)
    camera = {"size": [width, SIDE], "focal": [FOCAL, FOCAL], "principal": [width / 2, SIDE / 2]}
    camera |= {"rotation": [0, 0, 0], "distortion": []}
    rig = {"left": camera | {"translation": [0, 0, 0]}, "right": camera | {"translation": [-BESIDE, 0, 0]}}
    Path("rig.json").write_text(json.dumps({"cameras": rig}))
    return width


def test_films_of_two_cameras_say_how_far_a_person_is(run: Run, films: int) -> None:
    code, said, complaint = run(f"scene left.mp4 right.mp4 --cameras rig.json --out out {QUICK_COMMAND}")
    assert (code, complaint) == (0, "")
    first, last = said.splitlines()
    assert first.startswith("person0: frames 0 to 3, seen in 4, by left.mp4, right.mp4; ")
    assert "overlay.mp4 shows all bodies" in last
    report = json.loads(Path("out", "people.json").read_text())
    (person,) = report["people"]
    assert person["distance_m"] == pytest.approx(AWAY, abs=0.25)
    left, right = report["views"]
    assert (left["film"], right["film"]) == ("left.mp4", "right.mp4")
    assert (left["size"], left["focal"], left["translation"]) == ([films, SIDE], FOCAL, [0, 0, 0])
    assert right["translation"] == pytest.approx([-BESIDE, 0, 0])
    names = {
        "overlay.mp4",
        "overlay1.mp4",
        "scene.glb",
        "confidence.png",
        "person0.npz",
        "person0.glb",
        "person0.bvh",
        "cameras.json",
    }
    assert names == set(report["files"])
    assert film_facts("out/overlay1.mp4").frames == 4
    # The other way around, the world is the other camera's; the order of films says nothing about names.
    code, _, complaint = run(f"scene right.mp4 left.mp4 --cameras rig.json --out other {QUICK_COMMAND}")
    assert (code, complaint) == (0, "")
    turned = json.loads(Path("other", "people.json").read_text())
    assert turned["views"][1]["translation"] == pytest.approx([BESIDE, 0, 0])


def test_cameras_of_another_unit_size_and_order_are_told(run: Run, films: int) -> None:
    """Centimetres, pictures of twice the size, and cam10 before cam2."""
    Path("left.mp4").rename("walk_cam10.mp4")
    Path("right.mp4").rename("walk_cam2.mp4")
    rig = json.loads(Path("rig.json").read_text())["cameras"]
    for camera in rig.values():
        camera |= {key: [2 * value for value in camera[key]] for key in ("size", "focal", "principal")}
    rig["right"]["translation"] = [-100 * BESIDE, 0, 0]
    Path("cm.json").write_text(json.dumps({"cameras": {"cam2": rig["right"], "cam10": rig["left"]}}))
    code, said, complaint = run(f"scene walk_cam10.mp4 walk_cam2.mp4 --cameras cm.json --out out {QUICK_COMMAND}")
    assert code == 0
    assert "seen in 4, by walk_cam10.mp4, walk_cam2.mp4; " in said
    report = json.loads(Path("out", "people.json").read_text())
    first, second, unit = report["warnings"]
    size = f"pictures of {films} x {SIDE} px, calibrated at {2 * films} x {2 * SIDE} px: the camera is scaled by 0.5"
    assert (first, second) == (f"walk_cam10.mp4: {size}", f"walk_cam2.mp4: {size}")
    assert unit.startswith("cameras: translations are taken as centimetres, with which people are about ")
    assert complaint.splitlines() == [f"partdr: warning: {warning}" for warning in report["warnings"]]
    assert report["people"][0]["distance_m"] == pytest.approx(AWAY, abs=0.25)
    assert report["views"][1]["translation"] == pytest.approx([-BESIDE, 0, 0])
    assert read_cameras("out/cameras.json")["walk_cam2"].translation.tolist() == pytest.approx([-BESIDE, 0, 0])
    # Where only the order says whose a film is, and the films are the other way around, nobody is in both.
    rig = {name: rig[camera] for name, camera in (("a", "right"), ("b", "left"))}
    rig["b"]["rotation"] = [0.6, 0, 0]
    Path("ab.json").write_text(json.dumps({"cameras": rig}))
    code, _, complaint = run(f"scene walk_cam10.mp4 walk_cam2.mp4 --cameras ab.json --out other {QUICK_COMMAND}")
    assert code == 0
    order, *warnings = complaint.splitlines()
    assert order.startswith("partdr: ab.json: films are taken in the order of cameras")
    assert order.endswith("walk_cam10 of b, walk_cam2 of a")
    assert any("nobody is seen by two cameras at once" in warning for warning in warnings)
    assert warnings == [
        f"partdr: warning: {each}" for each in json.loads(Path("other/people.json").read_text())["warnings"]
    ]


def test_films_of_other_rates_are_matched_by_time(run: Run, films: int) -> None:
    """The person goes to the right; by their numbers, frames would show the person where nobody can be."""
    picture = Image.fromarray(example_photo())
    picture = picture.resize((picture.width * SIDE // picture.height, SIDE))
    shift, speed = round(FOCAL * BESIDE / AWAY), 120  # [px], [px/s]
    wide = np.pad(np.asarray(picture), [(0, 0), (shift + speed, shift + speed), (0, 0)], mode="edge")
    for name, start, ticks in (("left", 0, [0, 6, 12, 18, 24, 30]), ("right", shift, [0, 3, 6, 9, 12, 19, 24, 31])):
        edges = [speed + start - round(speed * tick / 60) for tick in ticks]
        pictures = [np.ascontiguousarray(wide[:, edge : edge + films]) for edge in edges]
        write_film(Path(f"{name}.mp4"), pictures, rate=60, times=ticks)
    code, said, complaint = run(f"scene left.mp4 right.mp4 --cameras rig.json --out out {QUICK_COMMAND}")
    assert code == 0
    assert "person0: frames 0 to 5, seen in 6, by left.mp4, right.mp4; " in said
    assert complaint.splitlines() == [line for line in complaint.splitlines() if "right.mp4: frames missing" in line]
    report = json.loads(Path("out", "people.json").read_text())
    (person,) = report["people"]
    assert person["distance_m"] == pytest.approx(AWAY, abs=0.25)
    assert report["views"][1]["film_frames"] == [0, 2, 4, 5, 6, 7]
    assert film_facts("out/overlay1.mp4").frames == 6


@pytest.fixture
def unplaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SceneSample:
    """Films and photos of a person who stands still, whose cameras nobody calibrated."""
    monkeypatch.chdir(tmp_path)
    sample = make_views(PERSON, 2)
    size = sample.parts.shape[1], sample.parts.shape[2]
    for name, view in zip(("left", "right"), sample.scene.views, strict=True):
        vertices = view.to_camera(torch.from_numpy(sample.vertices[0]))
        (picture,), _ = shade_people(vertices, anny_mesh(), view.camera, size, TorchRng(PERSON, "cpu"))
        Image.fromarray(picture).save(f"{name}.png")
        write_film(Path(f"{name}.mp4"), [picture] * 4, rate=10)
    return sample


def test_cameras_are_found(run: Run, unplaced: SceneSample) -> None:
    height = float(unplaced.statures[0])
    code, said, complaint = run(f"scene left.mp4 right.mp4 --fov 50 --set stature={height} --out out {QUICK_COMMAND}")
    assert (code, complaint) == (0, "")
    assert "seen in 4, by left.mp4, right.mp4; about" in said
    told = re.search(r"right.mp4: about ([\d.]+) m from the camera of left.mp4, turned by (\d+)", said)
    assert told is not None
    one, other = unplaced.scene.views
    turn = math.degrees(float(rotation_to_axis_angle(other.rotation @ one.rotation.mT).norm()))
    assert float(told[2]) == pytest.approx(turn, abs=12)
    cameras = read_cameras("out/cameras.json")
    assert list(cameras) == ["left", "right"]
    report = json.loads(Path("out", "people.json").read_text())
    assert cameras["right"].size == unplaced.parts.shape[1:]
    assert cameras["right"].focal[0] == pytest.approx(report["views"][1]["focal"], abs=0.005)  # rounded in people.json
    np.testing.assert_allclose(cameras["right"].translation, report["views"][1]["translation"], atol=1e-4)
    # The file serves as calibrated cameras.
    code, said, complaint = run(f"scene left.mp4 right.mp4 --cameras out/cameras.json --out again {QUICK_COMMAND}")
    assert (code, complaint) == (0, "")
    assert "about" not in said
    again = json.loads(Path("again", "people.json").read_text())
    np.testing.assert_allclose(again["views"][1]["rotation"], report["views"][1]["rotation"], atol=1e-4)


def test_photos_are_films_of_one_moment(run: Run, unplaced: SceneSample) -> None:
    """Their EXIF data say how long their lenses are."""
    height, width = unplaced.parts.shape[1:]
    save_with_focal(Image.open("left.png"), Path("left.jpg"), 50, (width, height))
    code, said, complaint = run(f"scene left.jpg right.png --out out {QUICK_COMMAND}")
    assert code == 0
    focal = 50 / 43.27 * math.hypot(width, height)
    assert complaint.startswith(f"partdr: focal length {focal:.0f} px, of the photo's EXIF data")
    assert len(complaint.splitlines()) == 1
    cameras = read_cameras("out/cameras.json")
    assert cameras["left"].focal[0] == pytest.approx(focal, rel=1e-3)
    assert cameras["right"].focal[0] == pytest.approx(max(width, height), rel=1e-3)
    assert "person0: frames 0 to 0, seen in 1, by left.jpg, right.png; about" in said


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("scene left.mp4 left.mp4 --cameras rig.json", ["FILM: the same one twice"]),
        ("scene left.mp4 none.mp4 --cameras rig.json", ["none.mp4"]),
        ("scene left.mp4 --cameras none.toml", ["none.toml: No such file"]),
        ("scene left.mp4 right.mp4 --cameras one.json", ["one.json: cameras left; expected one a film: left, right"]),
        (
            "scene left.mp4 right.mp4 --cameras rig.json --fov 50",
            ["--focal, --fov, --principal: with --cameras rig.json"],
        ),
        ("scene left.mp4 right.mp4 --focal exif", ["--focal: exif, with a film"]),
        ("scene gray.png other.png --focal exif", ["gray.png: no focal length"]),
        ("scene left.mp4 right.mp4 --align", ["right.mp4: nobody of the first film moves in the same way"]),
        ("scene left.mp4 right.mp4 --cameras rig.json --min-score 2", ["--min-score: 2"]),
        (
            "scene left.mp4 right.mp4 --cameras cameras.json --out .",
            ["--out: .: the result would replace cameras.json"],
        ),
        # Told before anybody is looked for, whom gray films do not show.
        ("scene gray.mp4 text.mp4", ["text.mp4: Invalid data found when processing input; expected a film"]),
        ("scene gray.mp4 slow.mp4 --person -1", ["--person: -1; expected 0 or more"]),
        ("scene right.mp4 gray.mp4 --cameras rig.json", ["cameras left, right; expected one a film: right, gray"]),
        ("scene gray.mp4 other.mp4 --cameras rig.json", ["gray.mp4: 96 x 64 px; expected "]),
        (
            "scene left.mp4 right.mp4 --cameras rig.json --set stature=1.7",
            ["stature: 1.7 m, for 1 people and 2 cameras"],
        ),
    ],
)
def test_faults_are_refused_before_anything_is_written(run: Run, films: int, line: str, words: list[str]) -> None:
    rig = json.loads(Path("rig.json").read_text())["cameras"]
    Path("one.json").write_text(json.dumps({"cameras": {"left": rig["left"]}}))
    Path("text.mp4").write_text("no film")
    for name in ("gray", "other"):
        write_film(Path(f"{name}.mp4"), [np.full((64, 96, 3), 90, np.uint8)] * 4, rate=10)
        Image.new("RGB", (96, 64)).save(f"{name}.png")
    Path("cameras.json").write_text(Path("rig.json").read_text())
    code, said, complaint = run(f"{line} --device cpu" if "--out" in line else f"{line} --out out --device cpu")
    assert (code, said) == (2, "")
    for word in words:
        assert word in complaint
    assert not Path("out").exists()
