"""``partdr fit`` with bad input and folders that can't be written: one line, and nothing left behind."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import HANG
from scenes import commands
from scenes.commands import (
    GOOD,
    Run,
    change_keypoints,
    cut,
    ids,
    keypoints,
    move,
    put_nan,
    save_ids,
    set_all,
    soft_maps,
    write,
)
from scenes.files import tree

from warp_partdr.clothing import registration
from warp_partdr.clothing.registration import RegistrationOptions, RegistrationWeights
from warp_partdr.errors import InputError
from warp_partdr.fit import fitting
from warp_partdr.results import result_sets, save
from warp_partdr.results.body_file import load_body

files, run = commands.files, commands.run  # fixtures

BAD: dict[str, tuple[str, Callable[[], object], list[str]]] = {
    # name: (arguments, what is done to the good files, what the error must say)
    "no keypoint file": (GOOD.replace("k.json", "none.json"), lambda: None, ["none.json", "No such file"]),
    "no label file": (GOOD.replace("p.png", "none.png"), lambda: None, ["none.png", "No such file"]),
    "no photo": (GOOD.replace("photo.png", "none.png"), lambda: None, ["none.png", "No such file"]),
    "keypoints are a folder": (GOOD.replace("k.json", "."), lambda: None, [".", "directory"]),
    "keypoints are no JSON": (GOOD, lambda: write("k.json", "{]"), ["k.json", "JSON"]),
    "keypoints are no text": (GOOD, lambda: Path("k.json").write_bytes(b"\xff\xfe\x00"), ["k.json", "JSON"]),
    "keypoints are something else": (GOOD, lambda: write("k.json", {"a": 1}), ["k.json", "keypoints"]),
    "nobody": (GOOD, lambda: write("k.json", {"people": []}), ["k.json", "nobody"]),
    "photo is no picture": (GOOD, lambda: write("photo.png", "no picture"), ["photo.png", "expected a picture"]),
    "truncated photo": (GOOD, lambda: cut("photo.png", 0.5), ["photo.png", "expected a picture"]),
    "parts of no label set": (
        GOOD.replace(" --labels cdcl14", ""),
        lambda: None,
        ["--labels: missing", "p.png", "cdcl14"],
    ),
    "a label set of no parts": (GOOD.replace(" --parts p.png", ""), lambda: None, ["--labels: cdcl14", "--parts"]),
    "truncated labels": (GOOD, lambda: cut("p.png", 0.5), ["p.png", "expected"]),
    "labels of a suffix": (GOOD.replace("p.png", "k.json"), lambda: None, ["k.json", ".png or .npy"]),
    "labels in colour": (GOOD.replace("p.png", "photo.png"), lambda: None, ["photo.png", "one channel"]),
    "label set": (GOOD.replace("cdcl14", "cdcl15"), lambda: None, ["cdcl15", "cdcl14, ", "JSON"]),
    "label set file": (GOOD.replace("cdcl14", "own.json"), lambda: None, ["own.json", "No such file"]),
    "label set JSON": (
        GOOD.replace("cdcl14", "own.json"),
        lambda: write("own.json", {"groups": {"head": ["haed"]}, "ids": {"0": "background"}}),
        ["own.json", "haed", "head"],
    ),
    "keypoint format": (GOOD + " --format coco18", lambda: None, ["coco18", "coco17"]),
    "keypoint format in the file": (
        GOOD,
        lambda: write("k.json", keypoints() | {"format": "coco18"}),
        ["k.json", "coco18", "coco17"],
    ),
    "number of keypoints": (GOOD, lambda: change_keypoints(lambda rows: rows.pop()), ["k.json", "16", "17"]),
    "label values": (GOOD, lambda: save_ids(ids() + 100), ["p.png", "100", "cdcl14", "0 to 14"]),
    "sizes": (GOOD, lambda: save_ids(ids()[:-1]), ["photo", "parts", "96x128", "96x127"]),
    "no visible keypoint": (GOOD, lambda: change_keypoints(lambda rows: set_all(rows, 2, 0)), ["k.json", "visible"]),
    "one point": (
        GOOD,
        lambda: change_keypoints(lambda rows: (set_all(rows, 0, 30), set_all(rows, 1, 40))),
        ["k.json", "one point", "(30, 40)"],
    ),
    "shares of the size": (
        GOOD,
        lambda: change_keypoints(lambda rows: [row.__setitem__(slice(2), [row[0] / 96, row[1] / 128]) for row in rows]),
        ["k.json", "pixels"],
    ),
    "NaN in keypoints": (
        GOOD,
        lambda: change_keypoints(lambda rows: rows[3].__setitem__(0, float("nan"))),
        ["k.json", "keypoint 3", "left_ear", "nan"],
    ),
    "infinity in keypoints": (
        GOOD,
        lambda: change_keypoints(lambda rows: rows[3].__setitem__(1, float("inf"))),
        ["k.json", "left_ear", "inf"],
    ),
    "words in keypoints": (
        GOOD,
        lambda: change_keypoints(lambda rows: rows[3].__setitem__(1, "here")),
        ["k.json", "left_ear", "here"],
    ),
    "confidence": (GOOD, lambda: change_keypoints(lambda rows: set_all(rows, 2, 70.0)), ["k.json", "70", "0 to 1"]),
    "empty labels": (GOOD, lambda: save_ids(ids() * 0), ["p.png", "empty"]),
    "one part": (GOOD, lambda: save_ids((ids() == 2) * np.uint8(2)), ["p.png", "one part only (torso)", "full1"]),
    "NaN in maps": (GOOD.replace("p.png", "maps.npy"), lambda: soft_maps(put_nan), ["maps.npy", "nan", "0 to 1"]),
    "channels of maps": (
        GOOD.replace("p.png", "maps.npy"),
        lambda: np.save("maps.npy", soft_maps()[1:]),
        ["maps.npy", "(14, 128, 96)", "(15, H, W)"],
    ),
    "no probabilities": (
        GOOD.replace("p.png", "maps.npy"),
        lambda: np.save("maps.npy", soft_maps() * 5),
        ["maps.npy", "probabilities"],
    ),
    "pickled labels": (
        GOOD.replace("p.png", "p.npy"),
        lambda: np.save("p.npy", np.array([[{}]]), allow_pickle=True),
        ["p.npy", "expected"],
    ),
    "damaged .npy header": (
        GOOD.replace("p.png", "p.npy"),
        lambda: Path("p.npy").write_bytes(b"\x93NUMPY\x01\x00\x08\x00('''\n(((("),
        ["p.npy", "expected"],
    ),
    "device": (GOOD + " --device tpu", lambda: None, ["--device", "tpu", "cpu"]),
    "CUDA device": (GOOD + " --device cuda:99", lambda: None, ["--device", "cuda:99", "cpu"]),
    "person": (GOOD + " --person 1", lambda: None, ["person", "1", "0 to 0"]),
    "no model": (GOOD + " --model nobody.npz", lambda: None, ["--model: nobody.npz", "No such file"]),
    "name of a model": (GOOD + " --model annie", lambda: None, ["--model: annie", "'anny'", ".npz"]),
    "damaged model": (
        GOOD + " --model smpl.npz",
        lambda: write("smpl.npz", "no archive"),
        ["--model: smpl.npz", "expected a file of SMPL"],
    ),
    "result in place of the model": (
        GOOD.replace("--out out", "--out . --model detailed.npz"),
        lambda: write("detailed.npz", "a model"),
        ["--out", "detailed.npz", "another folder"],
    ),
    "negative person": (GOOD + " --person -1", lambda: None, ["person", "-1", "0 to 0"]),
    "out is a file": (GOOD.replace("--out out", "--out k.json"), lambda: None, ["k.json", "folder"]),
    "out is in a file": (GOOD.replace("--out out", "--out k.json/out"), lambda: None, ["k.json/out", "folder"]),
    "result in place of input": (
        GOOD.replace("p.png", "parts.png").replace("--out out", "--out ."),
        lambda: Path("p.png").rename("parts.png"),
        ["--out", "parts.png", "another folder"],
    ),
    "keypoints beside the picture": (
        GOOD,
        lambda: change_keypoints(lambda rows: move(rows, 100, 0)),
        ["keypoints", "96x128"],
    ),
    "keypoints beside the photo, no labels": (
        "photo.png --keypoints k.json --out out",
        lambda: change_keypoints(lambda rows: move(rows, -100, -200)),
        ["keypoints", "96x128"],
    ),
    "a keypoint very far away": (
        "photo.png --keypoints k.json --out out",
        lambda: change_keypoints(lambda rows: rows[9].__setitem__(0, 1e6)),
        ["keypoints", "left_wrist", "1e+06", "96x128"],
    ),
    "a keypoint very far away, no picture": (
        "--keypoints k.json --out out",
        lambda: change_keypoints(lambda rows: rows[9].__setitem__(0, 1e30)),
        ["k.json", "left_wrist", "1e+30"],
    ),
    "keypoints beside the labels": (
        GOOD,
        lambda: change_keypoints(lambda rows: move(rows, 55, 0)),
        ["keypoints", "labels to agree"],
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_leaves_nothing(
    case: str, run: Run, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    line, spoil, says = BAD[case]
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
def test_a_folder_that_cannot_be_written_to(stage: str, run: Run, files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (files / "out").mkdir()
    (files / "out" / "overlay.png").write_text("old")
    before = tree(files)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    if stage == "before":  # tests may run as root, who is refused nothing
        monkeypatch.setattr(result_sets, "_scratch", refuse)
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
        ("register", RuntimeError("no memory left\non this device"), "no memory left on this device; "),
        ("register", ValueError("joints: holds NaN"), "joints: holds NaN; "),
        ("save_detailed", PermissionError(13, "Permission denied"), "out: Permission denied; expected a folder"),
    ],
)
def test_a_detailed_body_that_fails_leaves_the_fit(
    fails: str, error: Exception, says: str, run: Run, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(registration if fails == "register" else save, fails, refuse)
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
