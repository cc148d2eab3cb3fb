"""``partdr fit FILM``."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from helpers import commands
from helpers.commands import Run
from helpers.example import example_photo
from helpers.files import EXAMPLE
from helpers.films import write_film
from helpers.quick import QUICK_COMMAND
from helpers.skins import read_glb
from PIL import Image

from warp_partdr.inputs.films import film_facts, read_frames
from warp_partdr.results.predictions import load_film_bodies
from warp_partdr.solve.confidence.model import packaged_model

run = commands.run  # a fixture
SHORT_WINDOWS = f"{QUICK_COMMAND} --set window=4 --set overlap=1 --set shape_frames=2"


def photo(side: int) -> Image.Image:
    image = Image.fromarray(example_photo())
    return image.resize((image.width * side // image.height // 2 * 2, side))


@pytest.fixture
def film(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return write_film(Path("stand.mp4"), [np.asarray(photo(256))] * 6, rate=10)


def test_a_film_s_people_become_motions(run: Run, film: Path) -> None:
    usd = find_spec("pxr") is not None  # an extra
    code, said, complaint = run(f"fit stand.mp4 --out out {SHORT_WINDOWS} {'--set also=usdz' if usd else ''}")
    assert (code, complaint) == (0, "")
    first, last = said.splitlines()
    assert re.fullmatch(r"person0: frames 0 to 5, seen in 6; about .*; confidence 0\.[6-9]\d on average", first)
    assert "confidence.png the confidence in them" in last
    assert Path("out", "scene.glb").as_posix() in last
    assert not list(Path().glob(".partdr-*"))
    report = json.loads(Path("out", "people.json").read_text())
    assert len(report["people"][0]["confidence"]) == 6
    plain = {"overlay.mp4", "scene.glb", "confidence.png", "person0.npz", "person0.glb", "person0.bvh"}
    assert report["files"].keys() == plain | ({"person0.usdz"} if usd else set())
    assert (report["rate"], report["frames"]) == (10, 6)
    bodies = load_film_bodies("out/person0.npz")
    assert bodies.rows["frames"].tolist() == list(range(6))
    assert bodies.perspective
    with np.load("out/person0.npz") as data:
        assert data["detailed_rotations"].shape[0] == 6
        assert data["detailed_model"] == "anny"
    # EllipBody's joints are where the person is seen.
    seen = bodies.body(0).camera().project(torch.from_numpy(bodies.joints()[:1]))[0, :, :2].numpy()
    keypoints = bodies.rows["keypoints"][0]
    assert np.abs(seen.mean(0) - keypoints[keypoints[:, 2] > 0.5, :2].mean(0)).max() < 40
    assert "Frames: 6\nFrame Time: 0.1000000\n" in Path("out/person0.bvh").read_text()
    assert len(trimesh.load("out/person0.glb").geometry) == len(trimesh.load("out/scene.glb").geometry) == 1
    assert film_facts("out/overlay.mp4").rate == 10
    pictures = [frame.picture for frame in read_frames("out/overlay.mp4")]
    assert len(pictures) == 6
    assert np.abs(pictures[3].astype(int) - np.asarray(photo(256))[:256, : pictures[3].shape[1]]).max() > 60


def test_a_body_that_is_likely_wrong_is_told(run: Run, film: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As if all bodies of the film were likely wrong."""
    monkeypatch.setattr(
        "warp_partdr.solve.confidence.motions.packaged_model", lambda: replace(packaged_model(), least=1.0)
    )
    code, _, complaint = run(f"fit stand.mp4 --out out {SHORT_WINDOWS}")
    assert code == 0
    told = "person0: confidence below 1.00 from 0.0 to 0.5 s; expected 1.00 or more; compare overlay.mp4 with the film"
    assert complaint == f"partdr: warning: {told}\n"
    assert json.loads(Path("out", "people.json").read_text())["warnings"] == [told]


def test_a_film_that_lost_frames_is_told_once_and_right_in_time(run: Run, film: Path) -> None:
    write_film(film, [np.asarray(photo(256))] * 6, rate=20, times=[0, 1, 2, 3, 9, 10])
    code, said, complaint = run(f"fit stand.mp4 --out out {SHORT_WINDOWS}")
    assert code == 0
    (told,) = complaint.splitlines()
    assert told.startswith(
        "partdr: warning: stand.mp4: frames missing after 0.15 s (steps of up to 0.30 s, 0.050 s is "
    )
    assert "person0: frames 0 to 5, seen in 6" in said
    np.testing.assert_allclose(load_film_bodies("out/person0.npz").rows["times"][-2:], [0.45, 0.5])
    assert "Frames: 11\nFrame Time: 0.0500000\n" in Path("out/person0.bvh").read_text()
    np.testing.assert_allclose([frame.time for frame in read_frames("out/overlay.mp4")][-2:], [0.45, 0.5], atol=1e-4)


def test_people_of_two_shots_are_two_people_each_shown_in_theirs(run: Run, film: Path) -> None:
    size = photo(256).size
    other = Image.open(EXAMPLE / "astronaut.jpg").convert("RGB").resize(size)
    write_film(film, [np.asarray(photo(256))] * 5 + [np.asarray(other)] * 4, rate=10)
    code, said, complaint = run(f"fit stand.mp4 --out out {SHORT_WINDOWS}")
    told = "stand.mp4: a cut at frame 5 (0.50 s): 2 shots, each fitted apart, its people numbered anew"
    assert (code, complaint) == (0, f"partdr: warning: {told}\n")
    report = json.loads(Path("out", "people.json").read_text())
    assert report["warnings"] == [told]
    assert [(shot["first_frame"], shot["last_frame"]) for shot in report["shots"]] == [(0, 4), (5, 8)]
    people = {each["shot"]: each for each in report["people"]}
    assert [(each["first_frame"], each["last_frame"]) for _, each in sorted(people.items())] == [(0, 4), (5, 8)]
    assert all(line in said for line in ("frames 0 to 4, seen in 5", "frames 5 to 8, seen in 4"))
    # In the scene each is there in their shot alone.
    document, arrays = read_glb(Path("out", "scene.glb").read_bytes())
    names = {f"person{each['person']}": shot for shot, each in people.items()}
    shown = {}
    for channel in document["animations"][0]["channels"]:
        sampler = document["animations"][0]["samplers"][channel["sampler"]]
        if channel["target"]["path"] == "scale":
            times, values = arrays[sampler["input"]][:, 0], arrays[sampler["output"]][:, 0]
            name = document["nodes"][channel["target"]["node"]]["name"]
            shown[names[name]] = [*zip(times.round(3).tolist(), values.tolist(), strict=True)]
    assert shown == {0: [(0.0, 1.0), (0.5, 0.0)], 1: [(0.0, 0.0), (0.5, 1.0)]}


def test_a_film_that_breaks_off_is_fitted_as_far_as_it_goes(run: Run, film: Path) -> None:
    write_film(film, [np.asarray(photo(256))] * 30)
    data = bytearray(film.read_bytes())
    data[len(data) // 2 : len(data) * 3 // 4] = b"\xff" * (len(data) * 3 // 4 - len(data) // 2)
    film.write_bytes(data)
    code, said, complaint = run(f"fit stand.mp4 --out out --fov 50 {SHORT_WINDOWS} --set window=30")
    assert code == 0
    assert complaint.startswith("partdr: warning: stand.mp4: ")
    assert complaint.endswith("; frames before were fitted\n")
    assert "about" not in said


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("fit stand.mp4 --parts p.png", ["--parts: p.png, with a film"]),
        ("fit stand.mp4 --keypoints k.json", ["--keypoints: k.json, with a film"]),
        ("fit stand.mp4 --explain", ["--explain: with a film"]),
        ("fit stand.mp4 --quality fast", ["--quality", "mesh.iterations"]),
        ("fit stand.mp4 --model none", ["--model: none, with a film"]),
        ("fit stand.mp4 --focal exif", ["--focal: exif, with a film"]),
        ("fit stand.mp4 --set windw=3", ["windw: unknown; expected one of mesh, smoothing"]),
        ("fit stand.mp4 --set overlap=128", ["overlap: 128"]),
        ("fit gray.mp4 --person -1", ["--person: -1; expected 0 or more"]),
        ("fit stand.mp4 --person 3", ["person: 3; expected 0 to 0"]),
        ("fit gray.mp4", ["gray.mp4: nobody found in 4 frames"]),
        ("fit none.mp4", ["none.mp4: No such file"]),
    ],
)
def test_faults_are_one_line(run: Run, film: Path, line: str, words: list[str]) -> None:
    write_film(Path("gray.mp4"), [np.full((64, 96, 3), 90, np.uint8)] * 4)
    code, said, complaint = run(f"{line} --out out --device cpu")
    assert (code, said) == (2, "")
    (told,) = complaint.splitlines()
    assert all(word in told for word in words), told
    assert not Path("out").exists()
