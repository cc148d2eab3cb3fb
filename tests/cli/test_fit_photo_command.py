"""``partdr fit PHOTO`` with nothing else."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import pytest
from helpers import commands
from helpers.commands import EVERY_FILE, Run
from helpers.files import EXAMPLE, save_with_focal
from PIL import Image

from warp_partdr import FitOptions
from warp_partdr.kernels import launch
from warp_partdr.pipelines.photo import fit_photo
from warp_partdr.results.save_photo import PHOTO_FILES
from warp_partdr.results.views import VIEWS
from warp_partdr.solve.mesh.mesh_options import MeshOptions

files, run = commands.files, commands.run  # fixtures


def test_a_photo_is_enough(run: Run, files: Path) -> None:
    shutil.copy(EXAMPLE / "photo.png", "whole.png")
    code, said, complaint = run("fit whole.png --out out --device cpu")
    assert (code, complaint) == (0, "")
    first, last = said.splitlines()
    assert first.startswith("person0: confidence 0.")
    assert "about " in first
    assert first.endswith(" m away (the lens is assumed)")
    assert Path("out", "people.json").as_posix() in last
    assert {path.name for path in Path("out").iterdir()} == {*PHOTO_FILES, "person0"}
    assert {path.name for path in Path("out", "person0").iterdir()} == EVERY_FILE - {VIEWS}
    (person,) = json.loads(Path("out", "people.json").read_text())["people"]
    assert person["distance"] == "for an assumed lens"
    code, said, _ = run("fit whole.png --out known --device cpu --focal 900 --person 0")
    assert code == 0
    assert "about" not in said
    assert "usual" not in said
    (known,) = json.loads(Path("known", "people.json").read_text())["people"]
    assert known["camera"]["focal_px"] == 900
    assert known["distance"] == "for a known focal length"


def test_threads_are_a_setting_of_a_photo_without_keypoints(
    run: Run, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[int] = []
    monkeypatch.setattr(launch, "set_num_threads", told.append)
    Image.new("RGB", (320, 240), (128, 128, 128)).save("gray.png")
    assert "nobody found in it" in run("fit gray.png --set threads=1 --device cpu")[2]
    assert told == [1]


def test_a_photo_s_own_focal_length_is_taken_unless_none_is_wanted(run: Run, files: Path) -> None:
    with Image.open(EXAMPLE / "photo.png") as photo:
        save_with_focal(photo, Path("own.jpg"), focal=35, was=photo.size)
        focal = 35 / math.hypot(36, 24) * math.hypot(*photo.size)
    common = "fit own.jpg --device cpu --set mesh.iterations=1"
    for options, known in (("", True), ("--focal none", False)):
        code, _, complaint = run(f"{common} --out out {options}")
        assert code == 0
        assert complaint.startswith(f"partdr: focal length {focal:.0f} px, of the photo's EXIF data") == known
        (person,) = json.loads(Path("out", "people.json").read_text())["people"]
        assert person["camera"].get("focal_px") == (pytest.approx(focal) if known else None)
    everyone = fit_photo("own.jpg", options=FitOptions(stages=(), mesh=MeshOptions(iterations=1)))
    assert everyone.fits[0].camera.perspective
    assert float(everyone.fits[0].camera.focal[0, 0]) == pytest.approx(focal)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("fit", ["PHOTO: missing", "--keypoints"]),
        ("fit photo.png --parts p.png --labels cdcl14", ["--parts: p.png, without --keypoints"]),
        ("fit photo.png --labels cdcl14", ["--labels: cdcl14, without --keypoints"]),
        ("fit photo.png --format coco17", ["--format: coco17, without --keypoints"]),
        ("fit photo.png --explain", ["--explain: without --keypoints"]),
        ("fit whole.png --min-score 1", ["--min-score: 1.0; expected 0 to below 1"]),
        ("fit whole.png --min-score -0.1", ["--min-score: -0.1; expected 0 to below 1"]),
        ("fit whole.png --set min_score=0.6", ["min_score: 0.6, as a setting; expected the option --min-score"]),
        ("fit whole.png --min-score 0.999", ["whole.png: nobody found in it"]),
        ("fit photo.png --keypoints k.json --min-score 0.6", ["--min-score: 0.6, with --keypoints"]),
        ("fit photo.png --model none", ["--model: none"]),
        ("fit nothing.png", ["nothing.png", "no such file"]),
        ("fit gray.png", ["partdr: gray.png: nobody found in it; expected a person"]),
        ("fit overlay.png --out .", ["--out: .: the result would replace overlay.png"]),
    ],
)
def test_faults_are_one_line(run: Run, files: Path, line: str, words: list[str]) -> None:
    Image.new("RGB", (320, 240), (128, 128, 128)).save("gray.png")
    shutil.copy("gray.png", "overlay.png")
    shutil.copy(EXAMPLE / "photo.png", "whole.png")
    code, said, complaint = run(f"{line} --device cpu")
    assert (code, said) == (2, "")
    (told,) = complaint.splitlines()
    assert all(word.lower() in told.lower() for word in words), told
    assert not Path("out").exists()
