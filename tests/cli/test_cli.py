"""``partdr`` as users call it: what it says, what it leaves behind, and what it does with bad input."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import HANG
from PIL import Image
from test_detailed import save_npz

from warp_partdr import __version__
from warp_partdr.body.labels import LABEL_SETS, label_set
from warp_partdr.body.skeletons import SKELETONS, convert
from warp_partdr.cli import main, progress
from warp_partdr.clothing import registration
from warp_partdr.clothing.registration import RegistrationOptions, RegistrationWeights
from warp_partdr.errors import InputError
from warp_partdr.fit import fitting, stages
from warp_partdr.fit.options import FitOptions
from warp_partdr.fit.stages import Stage
from warp_partdr.results import result_sets, save
from warp_partdr.results.body_file import load_body

EXAMPLE = Path(__file__).parents[2] / "warp_partdr" / "assets" / "example"
QUICK = (Stage("lift", 8, 6, 0.1), Stage("labels", 2, 4, 0.02, 64))
GOOD = "photo.png --keypoints k.json --parts p.png --labels cdcl14 --out out"
ALONE = "--model none"  # no detailed model: that takes most of a quick fit's time
EVERY_FILE = {*save.RESULT_FILES, *save.DETAILED_FILES}
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The packaged example at a quarter of its size: photo.png, p.png and k.json in the current folder."""
    monkeypatch.chdir(tmp_path)
    for source, name in (("photo.png", "photo.png"), ("parts.png", "p.png")):
        with Image.open(EXAMPLE / source) as image:
            image.resize((image.width // 4, image.height // 4), Image.Resampling.NEAREST).save(name)
    data = json.loads((EXAMPLE / "keypoints.json").read_text())
    data["keypoints"] = [[x / 4, y / 4, confidence] for x, y, confidence in data["keypoints"]]
    write("k.json", data)
    return tmp_path


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], few_steps: None) -> Run:
    """Call the command with a line of arguments, and few iterations: exit code, stdout, stderr."""
    monkeypatch.setitem(stages.STAGES["network"], "balanced", QUICK)

    def call(line: str, **environment: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["partdr", *line.split()])
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        capfd.readouterr()
        with pytest.raises(SystemExit) as left:
            main.main()
        return left.value.code or 0, *capfd.readouterr()

    return call


def write(name: str, data: Any) -> None:
    Path(name).write_text(data if isinstance(data, str) else json.dumps(data))


def keypoints() -> dict[str, Any]:
    return json.loads(Path("k.json").read_text())


def ids() -> np.ndarray:
    return np.array(Image.open("p.png"))


def tree(folder: Path) -> dict[str, bytes | None]:
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


# --- help ----------------------------------------------------------------------------------------------------------


def test_help_teaches(run: Run) -> None:
    code, said, complaint = run("--help", COLUMNS="100")
    assert (code, complaint) == (0, "")
    assert "fit" in said
    assert run("", COLUMNS="100") == (0, said, "")
    code, said, complaint = run("fit --help", COLUMNS="100")
    assert (code, complaint) == (0, "")
    assert "Usage: partdr fit [OPTIONS] [PHOTO]" in said
    assert '{"format": "coco17", "keypoints": [[x, y, confidence], ...]}' in said  # not taken for markup
    for name in (*LABEL_SETS, *SKELETONS, *EVERY_FILE, "--parts", "--person", "--model", "Example"):
        assert name in said, name
    told = " ".join(said.split())
    for labels in LABEL_SETS.values():
        assert f"{labels.name} ({labels.of}, {len(labels.channel_ids)} classes)" in told
    assert max(map(len, said.splitlines())) <= 100


def test_version(run: Run) -> None:
    assert run("--version") == (0, f"partdr {__version__}\n", "")


@pytest.mark.parametrize("line", ["fit --help", "--version"])
def test_help_is_quick(line: str, tmp_path: Path) -> None:
    """It loads none of the large packages."""
    heavy = {"torch", "warp", "pyvista", "PIL", "trimesh", "matplotlib"}
    code = (
        f"import sys; sys.argv = ['partdr', *{line.split()}]\nfrom warp_partdr.cli.main import main\n"
        f"try: main()\nexcept SystemExit as left: sys.exit(left.code or repr({heavy} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, timeout=HANG)
    assert done.stderr.strip() == "set()"


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("fit", "--keypoints"),
        ("fit --keypoints", "--keypoints"),
        ("fit --keypoints k.json --nonsense", "--nonsense"),
        ("fit --keypoints k.json --person first", "--person"),
        ("fit --keypoints k.json --seed 1.5", "--seed"),
        ("fit a.png b.png --keypoints k.json", "b.png"),
        ("fti", "fti"),
        ("fit --keypoints k.json --renderer dots", "--renderer"),
        ("fit --keypoints k.json --threads -1", "--threads: -1; expected 0 or more"),
        ("fit --keypoints k.json --labels-first --no-outline", "--labels-first"),
        ("fit --keypoints k.json --labels-first --renderer mesh", "--labels-first"),
        ("fit --keypoints k.json --subdivisions 2", "--subdivisions: 2, of exact ellipsoids"),
        ("fit --keypoints k.json --renderer mesh --tolerance 1", "--tolerance: 1.0"),
        ("fit --keypoints k.json --renderer mesh --subdivisions auto --tolerance 0", "--tolerance: 0.0"),
    ],
)
def test_usage_errors_are_one_line(line: str, says: str, run: Run, files: Path) -> None:
    code, said, complaint = run(line)
    assert (code, said) == (2, "")
    assert complaint.startswith("partdr: ")
    assert complaint.count("\n") == 1
    assert says in complaint


def test_subdivisions_reach_the_fit(run: Run, files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[FitOptions] = []

    def fit_body(*_: Any, options: FitOptions, **__: Any) -> None:
        seen.append(options)
        raise InputError("enough")

    monkeypatch.setattr(fitting, "fit_body", fit_body)
    for line in ("--subdivisions 3", "--subdivisions auto --tolerance 0.2", ""):
        run(f"fit {GOOD} {ALONE} --renderer mesh {line}")
    assert [(options.subdivisions, options.tolerance) for options in seen] == [(3, 0.5), ("auto", 0.2), (1, 0.5)]


# --- bad input -----------------------------------------------------------------------------------------------------


def cut(name: str, share: float) -> None:
    data = Path(name).read_bytes()
    Path(name).write_bytes(data[: int(len(data) * share)])


def change_keypoints(change: Callable[[list[list[Any]]], object]) -> None:
    data = keypoints()
    change(data["keypoints"])
    write("k.json", data)


def set_all(rows: list[list[Any]], column: int, value: float) -> None:
    for row in rows:
        row[column] = value


def move(rows: list[list[Any]], x: float, y: float) -> None:
    for row in rows:
        row[0], row[1] = row[0] + x, row[1] + y


def save_ids(image: np.ndarray) -> None:
    Image.fromarray(image).save("p.png")


def soft_maps(spoil: Callable[[np.ndarray], object] | None = None) -> np.ndarray:
    """The ids as a network's probabilities, (15, H, W)."""
    maps = np.moveaxis(np.eye(15, dtype=np.float32)[ids()], -1, 0) * 0.9 + 0.1 / 15
    if spoil is not None:
        spoil(maps)
    np.save("maps.npy", maps)
    return maps


def put_nan(maps: np.ndarray) -> None:
    maps[3, 5, 5] = np.nan


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
    "keypoint format": (GOOD + " --keypoint-format coco18", lambda: None, ["coco18", "coco17"]),
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


# --- good input ----------------------------------------------------------------------------------------------------


def test_a_real_process_says_what_it_found_and_no_more(files: Path) -> None:
    """Neither Warp's greeting, nor what it compiles, nor that it looked for a CUDA driver."""
    code = (
        "from warp_partdr.cli import main\n"
        "from warp_partdr.fit import stages\n"
        "stages.STAGES['network']['balanced'] = (stages.Stage('labels', 2, 4, 0.02, 64),)\nmain.main()"
    )
    line = [*GOOD.split(), "--device", "cpu"]
    done = subprocess.run([sys.executable, "-c", code, "fit", *line], capture_output=True, text=True, timeout=HANG)
    assert (done.returncode, done.stderr) == (0, "")
    first, second, third = done.stdout.splitlines()
    assert "label network" in first
    assert "foreground F1 0." in first
    assert Path("out", "overlay.png").as_posix() in second
    assert Path("out", "detailed.png").as_posix() in third
    assert {path.name for path in Path("out").iterdir()} == EVERY_FILE


def test_a_second_run_replaces_the_first_and_nothing_else(run: Run, files: Path) -> None:
    Path("out").mkdir()
    for name in ("report.json", "notes.txt", "parts.png"):
        Path("out", name).write_text("old")
    assert run(f"fit photo.png --keypoints k.json --out out {ALONE}")[0] == 0
    assert Path("out", "notes.txt").read_text() == "old"
    assert Path("out", "parts.png").read_text() == "old"  # not a file of this run
    assert "energy" in json.loads(Path("out", "report.json").read_text())
    assert {path.name for path in files.iterdir()} == {"photo.png", "p.png", "k.json", "out"}


def openpose() -> None:
    rows = convert(np.array(keypoints()["keypoints"]), "coco17", "body25", missing=0.0)
    write("k.json", {"version": 1.3, "people": [{"person_id": [-1], "pose_keypoints_2d": rows.ravel().tolist()}]})


def two_people() -> None:
    me = keypoints()["keypoints"]
    other = [[0.5 * x, 0.5 * y, confidence] for x, y, confidence in me]
    write("k.json", {"format": "coco17", "keypoints": [other, me]})


def own_labels() -> None:
    groups = {"head": ["head", "neck"], "rest": ["chest", "abdomen", "left_upper_arm", "right_upper_arm"]}
    write("own.json", {"groups": groups, "ids": {"0": "background", "1": "head", "2": "rest", "9": "ignore"}})
    image = ids()
    np.save("p.npy", np.where(image > 4, 9, np.minimum(image, 2)))


def describe_labels() -> None:
    labels = label_set("cdcl14")
    write("labels.json", {str(number): labels.class_names.get(number, name) for number, name in labels.ids.items()})


TAKEN: dict[str, tuple[str, Callable[[], object]]] = {
    "everything": (GOOD, lambda: None),
    "no detailed model": (GOOD, lambda: None),
    "model from a file": (GOOD + " --model smpl.npz", lambda: save_npz(Path("smpl.npz"))),
    "keypoints alone": ("--keypoints k.json --out out", lambda: None),
    "no photo": (GOOD.replace("photo.png ", ""), lambda: None),
    "no labels": ("photo.png --keypoints k.json --out out", lambda: None),
    "OpenPose": (GOOD, openpose),
    "soft maps": (GOOD.replace("p.png", "maps.npy"), soft_maps),
    "soft maps, channels last": (
        GOOD.replace("p.png", "maps.npy"),
        lambda: np.save("maps.npy", np.moveaxis(soft_maps(), 0, -1).astype(np.float16)),
    ),
    "silhouette": (GOOD.replace("cdcl14", "full1"), lambda: save_ids((ids() > 0) * np.uint8(255))),
    "own label set": (GOOD.replace("p.png", "p.npy").replace("cdcl14", "own.json"), own_labels),
    "labels.json beside the parts": (GOOD.replace(" --labels cdcl14", ""), describe_labels),
    "16 bits": (GOOD, lambda: Image.fromarray(ids().astype(np.uint16)).save("p.png")),
    "wide picture": (
        GOOD,
        lambda: [Image.open(name).crop((0, 0, 250, 128)).save(name) for name in ("photo.png", "p.png")],
    ),
    "gray photo": (GOOD, lambda: Image.open("photo.png").convert("L").save("photo.png")),
    "the second person": (GOOD + " --person 1", two_people),
    "the largest person": (GOOD, two_people),
    "cut off by the border": (
        GOOD,
        lambda: [Image.open(name).crop((0, 0, 96, 80)).save(name) for name in ("photo.png", "p.png")],
    ),
    "missing keypoints": (
        GOOD,
        lambda: change_keypoints(lambda rows: [row.__setitem__(2, 0) for row in rows[7:11]]),
    ),
}


@pytest.mark.parametrize("case", TAKEN)
def test_good_input_gives_all_files(case: str, run: Run, files: Path) -> None:
    line, prepare = TAKEN[case]
    prepare()
    clothed = case in ("everything", "keypoints alone", "wide picture", "model from a file")
    code, said, complaint = run(f"fit {line}" if clothed else f"fit {line} {ALONE}")
    assert (code, complaint) == (0, "")
    assert said.count("\n") == 2 + clothed
    assert said.count("F1") == 2 * (1 + clothed) * ("--parts" in line)  # of the ellipsoids, and of the mesh
    expected = EVERY_FILE if clothed else set(save.RESULT_FILES)
    expected = expected - (set() if "--parts" in line else {"parts.png"})
    assert {path.name for path in Path("out").iterdir()} == expected
    for name in (name for name in expected if name.endswith(".png")):
        with Image.open(Path("out", name)) as image:
            image.load()
            if name in ("overlay.png", "detailed.png") and "photo.png" in line:
                assert image.size == Image.open("photo.png").size
    body = load_body("out/body.npz")
    assert body.image_size.tolist() == list(Image.open("out/overlay.png").size[::-1])
    report = json.loads(Path("out", "report.json").read_text())
    assert np.isfinite(report["energy_total"])
    if clothed:
        detailed = json.loads(Path("out", "registration.json").read_text())
        assert detailed["model"] == ("smpl" if "smpl" in line else "anny")
        assert np.isfinite(list(detailed["losses"].values())).all()
        assert ("parts" in detailed) == ("--parts" in line)
    if "person" in case:  # the small one's head is at half the height
        assert report["keypoints"]["mean_distance_px"] < 10
        joints = json.loads(Path("out", "body.json").read_text())["joints"]
        assert np.ptp(np.array(joints["pixels"])[:, 1]) > 70


def test_labels_of_all_20_parts(run: Run, files: Path) -> None:
    image = np.zeros(label_set("cdcl14").num_groups + 1, dtype=np.uint8)
    for group, members in enumerate(label_set("cdcl14").groups.values(), start=1):
        image[group] = 1 + list(label_set("ellipbody20").groups).index(members[0])
    np.save("p.npy", image[label_set("cdcl14").to_groups(ids())])
    line = f"fit photo.png --keypoints k.json --parts p.npy --labels ellipbody20 --out out {ALONE}"
    assert run(line)[0] == 0
    assert json.loads(Path("out", "report.json").read_text())["parts"]["label_set"] == "ellipbody20"


def test_what_contradicts_itself_is_told(run: Run, files: Path) -> None:
    mirrored = [0, 1, 2, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13]  # left for right, in cdcl14
    save_ids(np.array(mirrored, dtype=np.uint8)[ids()])
    code, said, complaint = run(f"fit {GOOD} {ALONE}")
    told = "labels: left and right exchanged, say the keypoints; taken so"
    assert (code, complaint.splitlines()[0]) == (0, f"partdr: warning: {told}")
    assert "partdr:" not in said
    assert told in json.loads(Path("out", "report.json").read_text())["warnings"]


def test_every_stage_is_told(run: Run, files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[str, int, int]] = []

    class Recorder(progress.FitProgress):
        def __call__(self, stage: str, done: int, total: int) -> None:
            told.append((stage, done, total))

    monkeypatch.setattr(progress, "FitProgress", Recorder)
    assert run(f"fit {GOOD}")[0] == 0
    assert [name for name, _ in groupby(stage for stage, _, _ in told)] == [
        *(stage.name for stage in QUICK),
        "writing results",
        "registration",
        "writing results",
    ]
    assert told[-2] == ("registration", 2, 2)


def test_a_bar_shows_the_stages(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes stderr for a terminal then
    with progress.FitProgress():
        pass
    assert "compiling kernels" in capfd.readouterr().err
    with progress.FitProgress() as bar:
        bar("labels, fine", 3, 4)
    said = capfd.readouterr().err
    assert "labels, fine" in said
    assert "75%" in said
