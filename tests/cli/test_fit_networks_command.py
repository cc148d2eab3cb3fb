"""``partdr fit PHOTO --parts-from --keypoints-from``, with tiny networks in folders."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers import commands
from helpers.checkpoints import class_names, knowing_vitpose, tiny_detector, tiny_segformer
from helpers.commands import EVERY_FILE, Run
from helpers.example import example_keypoints, example_photo
from helpers.files import EXAMPLE
from helpers.films import write_film

from warp_partdr.body.template import JOINT_NAMES
from warp_partdr.inputs.films import read_frames
from warp_partdr.networks.detection.people import find_people
from warp_partdr.networks.predictors.networks import upright_crop
from warp_partdr.pipelines.photo import PACKAGED
from warp_partdr.results.predictions import load_film_bodies
from warp_partdr.results.views import VIEWS

ANKLES = [JOINT_NAMES.index(name) for name in ("left_ankle", "right_ankle")]

pytest.importorskip("transformers", reason="needs the extra photo")

files, run = commands.files, commands.run  # fixtures


@pytest.fixture(scope="module")
def networks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a SegFormer and a ViTPose that sees the example's keypoints, as near as its cells are."""
    folder = tmp_path_factory.mktemp("networks")
    truth = example_keypoints()
    person = find_people(example_photo())[0]
    places = upright_crop(person, (256, 192)).from_picture(truth.points[None].astype(float))[0]
    cells = np.floor(places * [12, 16]).astype(int).clip(1, [10, 14])
    knowing_vitpose(folder / "vitpose", [(row, column) for column, row in cells.tolist()])
    tiny_segformer(folder / "segformer", class_names("atr18"))
    return folder


def test_both_networks_are_loaded_from_folders(run: Run, files: Path, networks: Path) -> None:
    shutil.copy(EXAMPLE / "photo.png", "whole.png")
    line = f"fit whole.png --parts-from {networks}/segformer --keypoints-from {networks}/vitpose --out out --device cpu"
    code, said, _ = run(line)
    assert code == 0
    parts, keypoints, person, last = said.splitlines()
    assert parts.startswith(f"parts from {networks}/segformer: SegformerForSemanticSegmentation, 0.014 million param")
    assert keypoints.startswith(f"keypoints from {networks}/vitpose: VitPoseForPoseEstimation, ")
    assert keypoints.endswith(", keypoints coco17")
    assert person.startswith("person0: confidence 0.")
    assert "people.json" in last
    assert {path.name for path in Path("out", "person0").iterdir()} == EVERY_FILE - {VIEWS}
    (told,) = json.loads(Path("out", "people.json").read_text())["people"]
    assert told["format"] == "coco17"
    assert told["sources"]["keypoints"] == f"{networks}/vitpose"
    assert told["sources"]["parts"] in (f"{networks}/segformer", PACKAGED)  # a random network may see nothing
    truth = example_keypoints()
    seen = np.array(told["keypoints"])
    assert np.median(np.linalg.norm(seen[:, :2] - truth.points, axis=1)) < 20  # cells are 39 pixels wide


def test_boxes_come_from_a_detector_in_a_folder(run: Run, files: Path, networks: Path) -> None:
    """A detector that sees nobody leaves nobody to fit; one that sees the person leads to as good a fit."""
    shutil.copy(EXAMPLE / "photo.png", "whole.png")
    tiny_detector("yolos", Path("yolos"), {0: "person"})
    line = f"fit whole.png --keypoints-from {networks}/vitpose+yolos --out out --device cpu"
    code, said, complaint = run(f"{line} --min-score 0.99")
    assert code == 2
    assert complaint.splitlines()[-1].startswith("partdr: whole.png: nobody found")
    assert [each.split(":")[0] for each in said.splitlines()] == [
        "boxes from yolos",
        f"keypoints from {networks}/vitpose",
    ]
    assert run(f"{line} --min-score 0")[0] == 0
    assert json.loads(Path("out", "people.json").read_text())["people"]


FILM = "--device cpu --set mesh.iterations=3"


@pytest.fixture
def film(files: Path) -> Path:
    """The example's person, who stands still for four frames."""
    photo = example_photo()
    height, width = (side - side % 2 for side in photo.shape[:2])
    return write_film(Path("stand.mp4"), [photo[:height, :width]] * 4)


def test_both_networks_see_a_film(run: Run, film: Path, networks: Path) -> None:
    """Labels and keypoints of a network are what is fitted, not the packaged one's."""
    given = f"--parts-from {networks}/segformer --keypoints-from {networks}/vitpose"
    code, said, complaint = run(f"fit stand.mp4 {given} --out out {FILM}")
    assert code == 0
    # Knees and ankles are seen in wrong places, and so the body is likely wrong.
    expected = "labels of the given network", "person0: confidence below 0.40 from 0.0 to 0.3 s"
    assert not [line for line in complaint.splitlines() if not any(words in line for words in expected)]
    parts, keypoints, person, last = said.splitlines()
    assert parts.startswith(f"parts from {networks}/segformer: ")
    assert keypoints.startswith(f"keypoints from {networks}/vitpose: ")
    assert person.startswith("person0: frames 0 to 3")
    assert "overlay.mp4" in last
    view = json.loads(Path("out", "people.json").read_text())["views"][0]
    assert (view["parts"], view["keypoints"]) == (f"{networks}/segformer", f"{networks}/vitpose")
    assert not list(Path().glob(".partdr-*"))
    # Knees and ankles seen 60 px too high: they end there.
    truth = example_keypoints()
    person_found = find_people(example_photo())[0]
    raised = truth.points[None].astype(float)
    raised[0, 13:] -= [0, 60]
    places = upright_crop(person_found, (256, 192)).from_picture(raised)[0]
    cells = np.floor(places * [12, 16]).astype(int).clip(1, [10, 14])
    knowing_vitpose(Path("higher"), [(row, column) for column, row in cells.tolist()])
    assert run(f"fit stand.mp4 --keypoints-from higher --out higher_out {FILM}0")[0] == 0
    assert run(f"fit stand.mp4 --keypoints-from {networks}/vitpose --out same_out {FILM}0")[0] == 0
    feet = {}
    for name in ("higher_out", "same_out"):
        bodies = load_film_bodies(f"{name}/person0.npz")
        joints = torch.from_numpy(bodies.joints()[:1])
        feet[name] = float(bodies.body(0).camera().project(joints)[0, ANKLES, 1].mean())
    assert feet["same_out"] - feet["higher_out"] > 20


def test_films_of_cameras_are_seen_by_networks(run: Run, film: Path, networks: Path) -> None:
    shutil.copy("stand.mp4", "right.mp4")
    facts = next(iter(read_frames("stand.mp4"))).picture.shape
    camera = {"size": [facts[1], facts[0]], "focal": [900, 900], "principal": [facts[1] / 2, facts[0] / 2]}
    camera |= {"rotation": [0, 0, 0], "distortion": [-0.05]}
    rig = {name: camera | {"translation": [away, 0, 0]} for name, away in (("stand", 0), ("right", -0.001))}
    Path("rig.json").write_text(json.dumps({"cameras": rig}))
    given = f"--parts-from {networks}/segformer --keypoints-from {networks}/vitpose"
    code, said, _ = run(f"scene stand.mp4 right.mp4 --cameras rig.json {given} --person 0 --out out {FILM}")
    assert code == 0
    assert said.count("from ") == 2
    assert Path("out", "person0.npz").is_file()


def test_a_network_s_fault_in_a_film_is_none_of_the_film(run: Run, film: Path, networks: Path) -> None:
    detector = tiny_detector("yolos", Path("yolos"), {0: "person"})
    for line, words in (
        ("fit stand.mp4 --labels lip20", "--labels: lip20, without --parts-from; expected both"),
        ("fit stand.mp4 --format coco17", "--format: coco17, without --keypoints-from"),
        ("fit stand.mp4 --parts-from nowhere/net", "nowhere/net: no such folder"),
        (f"fit stand.mp4 --parts-from {networks}/segformer --labels lip20", "lip20, of 20 classes"),
        (
            f"fit stand.mp4 --keypoints-from {networks}/vitpose+{detector}",
            "yolos, for a film, whose people the packaged",
        ),
        ("scene stand.mp4 --cameras rig.json --labels lip20", "--labels: lip20, without --parts-from"),
        ("fit stand.mp4 --parts-from packaged", "--parts-from: packaged, for a film, which has masks so far"),
        ("fit stand.mp4 --parts-from mask --labels lip20", "--labels: lip20, without --parts-from"),
    ):
        code, said, complaint = run(f"{line} --out out --device cpu")
        assert (code, said) == (2, ""), line
        assert words in complaint
        assert not Path("out").exists()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("photo.png --parts-from nowhere/net", ["nowhere/net: no such folder", "hf:ORG/NAME"]),
        (
            "photo.png --parts-from VIT",
            ["vitpose: a vitpose; expected a network of semantic segmentation"],
        ),
        ("photo.png --keypoints-from SEG", ["segformer: a segformer; expected a vitpose"]),
        (
            "photo.png --parts-from SEG --labels lip20",
            ["--labels: lip20, of 20 classes; expected one of"],
        ),
        ("photo.png --keypoints-from VIT --format lsp14", ["vitpose: 17 keypoints; expected 14 of lsp14"]),
        (
            "photo.png --parts-from SEG --format coco17",
            ["--format: coco17, without --keypoints or --key"],
        ),
        (
            "photo.png --keypoints-from VIT --labels lip20",
            ["--labels: lip20, without --keypoints or --par"],
        ),
        ("photo.png --keypoints-from VIT --parts p.png", ["--parts: p.png, without --keypoints;"]),
        (
            "photo.png --keypoints k.json --parts-from NET",
            ["--parts-from: NET, with --keypoints; expected a photo alone"],
        ),
        ("photo.png --keypoints k.json --keypoints-from NET", ["--keypoints-from: NET, with --keypoints"]),
        ("photo.png --keypoints-from VIT+SEG", ["segformer: a segformer; expected a network of object detection"]),
        ("photo.png --keypoints-from VIT+", ["vitpose+: a + without two names"]),
        ("--parts-from SEG", ["PHOTO: missing"]),
    ],
)
def test_faults_are_one_line(run: Run, files: Path, networks: Path, line: str, words: list[str]) -> None:
    line = line.replace("SEG", f"{networks}/segformer").replace("VIT", f"{networks}/vitpose")
    code, said, complaint = run(f"fit {line} --device cpu")
    assert (code, said) == (2, "")
    (told,) = complaint.splitlines()
    assert all(word in told for word in words), told
    assert not Path("out").exists()
