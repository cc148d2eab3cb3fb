"""``partdr fit`` with bad input and folders that can't be written: one line, and nothing left behind."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import HANG
from helpers import commands
from helpers.commands import GOOD, Run, change_keypoints, cut, ids, move, put_nan, save_ids, soft_maps, write
from helpers.files import tree

from warp_partdr import InputError, load_body, skeleton
from warp_partdr.models import registration
from warp_partdr.models.registration import RegistrationOptions, RegistrationWeights
from warp_partdr.results import result_sets, save
from warp_partdr.solve.ellipsoids import fitting
from warp_partdr.solve.mesh import mesh_stage

files, run = commands.files, commands.run  # fixtures

# Faults of files are tested with their readers; here is one of each reader, and what the command adds.
BAD_LINES: dict[str, tuple[str, list[str]]] = {  # name: (arguments, what the error must say)
    "no keypoint file": (GOOD.replace("k.json", "none.json"), ["none.json", "No such file"]),
    "no label file": (GOOD.replace("p.png", "none.png"), ["none.png", "No such file"]),
    "no photo": (GOOD.replace("photo.png", "none.png"), ["none.png", "No such file"]),
    "parts of no label set": (GOOD.replace(" --labels cdcl14", ""), ["--labels: missing", "p.png", "cdcl14"]),
    "a label set of no parts": (GOOD.replace(" --parts p.png", ""), ["--labels: cdcl14", "--parts"]),
    "label set": (GOOD.replace("cdcl14", "cdcl15"), ["cdcl15", "cdcl14, ", "JSON"]),
    "keypoint format": (GOOD + " --format coco19", ["coco19", "coco17", "JSON"]),
    "own skeleton": (GOOD + " --format k.json", ["k.json", '"landmarks"']),
    "folder of no keypoints": (GOOD.replace("k.json", "."), ["no keypoints of photo.png", "photo_keypoints.json"]),
    "device": (GOOD + " --device tpu", ["--device", "tpu", "cpu"]),
    "CUDA device": (GOOD + " --device cuda:99", ["--device", "cuda:99", "cpu"]),
    "person": (GOOD + " --person 1", ["person", "1", "0 to 0"]),
    "negative person": (GOOD + " --person -1", ["--person: -1; expected 0 or more"]),
    "no model": (GOOD + " --model nobody.npz", ["--model: nobody.npz", "No such file"]),
    "name of a model": (GOOD + " --model annie", ["--model: annie", "'anny'", ".npz"]),
    "damaged model": (GOOD + " --model text.npz", ["--model: text.npz", "expected a file of SMPL"]),
    "result in place of the model": (
        GOOD.replace("--out out", "--out . --model detailed.npz"),
        ["--out", "detailed.npz", "another folder"],
    ),
    "result in place of input": (
        GOOD.replace("p.png", "parts.png").replace("--out out", "--out ."),
        ["--out", "parts.png", "another folder"],
    ),
    "out is a file": (GOOD.replace("--out out", "--out k.json"), ["k.json", "folder"]),
    "out is in a file": (GOOD.replace("--out out", "--out k.json/out"), ["k.json/out", "folder"]),
    "principal point alone": (GOOD + " --principal 3,4", ["--principal", "--focal"]),
    "principal point": (GOOD + " --focal 100 --principal 3", ["--principal: '3'", "U,V"]),
    "focal length": (GOOD + " --focal -100", ["--focal: -100", "positive"]),
    "no focal length": (GOOD + " --focal long", ["--focal: 'long'", "pixels, exif or none"]),
    "no focal length, but an angle": (GOOD + " --focal none --fov 50", ["--focal: none, with --fov", "alone"]),
    "no focal length in the photo": (GOOD + " --focal exif", ["partdr: photo.png: no focal length", "EXIF"]),
    "focal length of no photo": (
        GOOD.replace("photo.png ", "") + " --focal exif",
        ["--focal: exif, without a photo; expected one"],
    ),
    "focal length and angle": (GOOD + " --focal 100 --fov 50", ["focal, fov", "one of the two"]),
    "a stage that the mesh stage replaces": (GOOD + " --set outline=labels-first", ["outline: ", "--model none"]),
    "the same of a photo": ("photo.png --out out --set outline=true", ["outline: ", "--model none"]),
    "a stage of labels without labels": (
        "photo.png --keypoints k.json --out out --set outline=true",
        ["outline: settings of a stage that needs part labels"],
    ),
    "angle of view": (GOOD + " --fov 180", ["--fov: 180", "170"]),
    "damaged .npy header": (GOOD.replace("p.png", "header.npy"), ["header.npy", "expected"]),
}
ALONE_HERE = "photo.png --keypoints k.json --out out"
BAD_FILES: dict[str, tuple[str, Callable[[], object], list[str]]] = {
    # name: (arguments, what is done to the good files, what the error must say)
    "truncated photo": (GOOD, lambda: cut("photo.png", 0.5), ["photo.png", "expected a picture"]),
    "number of keypoints": (GOOD, lambda: change_keypoints(lambda rows: rows.pop()), ["k.json", "16", "17"]),
    "label values": (GOOD, lambda: save_ids(ids() + 100), ["p.png", "100", "cdcl14", "0 to 14"]),
    "result in place of an own skeleton": (
        GOOD.replace("--out out", "--out . --format report.json"),
        lambda: write("report.json", {"landmarks": skeleton("coco17").landmarks}),
        ["--out", "report.json", "another folder"],
    ),
    "sizes": (GOOD, lambda: save_ids(ids()[:-1]), ["photo", "parts", "96x128", "96x127"]),
    "NaN in maps": (GOOD.replace("p.png", "maps.npy"), lambda: soft_maps(put_nan), ["maps.npy", "nan", "0 to 1"]),
    "keypoints beside the picture": (GOOD, lambda: move(100, 0), ["keypoints", "96x128"]),
    "keypoints beside the photo, no labels": (ALONE_HERE, lambda: move(-100, -200), ["keypoints", "96x128"]),
    "a keypoint very far away": (ALONE_HERE, lambda: put_wrist(1e6), ["keypoints", "left_wrist", "1e+06", "96x128"]),
    "a keypoint very far away, no picture": (
        "--keypoints k.json --out out",
        lambda: put_wrist(1e30),
        ["k.json", "left_wrist", "1e+30"],
    ),
    "keypoints beside the labels": (GOOD, lambda: move(55, 0), ["keypoints", "labels to agree"]),
}


def put_wrist(x: float) -> None:
    change_keypoints(lambda rows: rows[9].__setitem__(0, x))


@pytest.mark.parametrize("case", [*BAD_LINES, *BAD_FILES])
def test_bad_input_is_one_line_and_leaves_nothing(
    case: str, run: Run, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, content in (("text.npz", b"no archive"), ("header.npy", b"\x93NUMPY\x01\x00\x08\x00('''\n((((")):
        Path(name).write_bytes(content)
    for name in ("detailed.npz", "parts.png"):
        Path(name).write_bytes(Path("p.png").read_bytes())
    if case in BAD_LINES:
        line, says = BAD_LINES[case]
    else:
        line, spoil, says = BAD_FILES[case]
        spoil()
    if "model" in case:
        monkeypatch.setattr(fitting, "fit_body", lambda *_, **__: pytest.fail("must be found out before the fit"))
    before = tree(files)
    code, said, complaint = run(f"fit {line}")
    assert (code, said) == (2, "")
    assert complaint.startswith("partdr: ")
    assert complaint.count("\n") == 1
    assert complaint.endswith("\n")
    for words in says:
        assert words in complaint, complaint
    assert tree(files) == before


@pytest.mark.parametrize("stage", ["before", "while writing"])
def test_a_folder_that_cannot_be_written_to_is_one_line_and_loses_nothing(
    stage: str, run: Run, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (files / "out").mkdir()
    (files / "out" / "overlay.png").write_text("old")
    before = tree(files)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    if stage == "before":  # tests may run as root, who is refused nothing
        monkeypatch.setattr(result_sets, "scratch_folder", refuse)
        monkeypatch.setattr(fitting, "fit_body", lambda *_, **__: pytest.fail("must be found out before the fit"))
    else:
        monkeypatch.setattr(save, "loss_chart", refuse)
    code, said, complaint = run(f"fit {GOOD}")
    assert (code, said) == (2, "")
    assert complaint == "partdr: out: Permission denied; expected a folder to write to\n"
    assert tree(files) == before


@pytest.mark.parametrize(
    ("fails", "error", "says"),
    [
        ("refine_mesh", RuntimeError("no memory left\non this device"), "no memory left on this device; "),
        ("refine_mesh", ValueError("joints: holds NaN"), "joints: holds NaN; "),
        ("save_detailed", PermissionError(13, "Permission denied"), "out: Permission denied; expected a folder"),
    ],
)
def test_a_detailed_body_that_fails_leaves_the_fit(
    fails: str, error: Exception, says: str, run: Run, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(mesh_stage if fails == "refine_mesh" else save, fails, refuse)
    code, said, complaint = run(f"fit {GOOD}")
    assert code == 2
    assert "label network" in said
    assert "detailed" not in said
    assert complaint.startswith(f"partdr: {says}")
    assert complaint.endswith("out holds the fit without its detailed body\n")
    assert complaint.count("\n") == 1
    assert {path.name for path in Path("out").iterdir()} == set(save.RESULT_FILES)
    load_body("out/body.npz")


@pytest.mark.parametrize(("flags", "grows", "inscribed"), [("", False, False), ("--grow --inscribed", True, True)])
def test_only_register_lets_parts_grow(
    flags: str, grows: bool, inscribed: bool, run: Run, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[RegistrationOptions] = []

    def refuse(*_: object, options: RegistrationOptions, **__: object) -> None:
        given.append(options)
        raise InputError("seen enough")

    monkeypatch.setattr(registration, "register", refuse)
    run("fit photo.png --keypoints k.json --out out")
    run(f"register out/body.npz --photo photo.png --out out {flags}")
    assert [options.growth for options in given] == [False, grows]
    assert [options.weights.measures > 0 for options in given] == [False, grows]
    assert (given[1].weights == RegistrationWeights.inscribed()) == inscribed


def test_a_real_process_prints_one_line_too(files: Path) -> None:
    code = "from warp_partdr.cli.main import main; main()"
    line = [*GOOD.split(), "--device", "tpu"]  # found out last, when torch and Warp are loaded
    done = subprocess.run([sys.executable, "-c", code, "fit", *line], capture_output=True, text=True, timeout=HANG)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("partdr: --device: tpu; expected auto or cpu")
    assert not (files / "out").exists()
