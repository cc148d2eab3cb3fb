"""``partdr fit`` with good input: the files it leaves, and its words."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from conftest import HANG
from helpers import commands
from helpers.commands import (
    ALONE,
    EVERY_FILE,
    GOOD,
    Run,
    change_keypoints,
    ids,
    keypoints,
    save_ids,
    soft_maps,
    write,
)
from helpers.files import save_npz
from helpers.quick import QUICK_FIT
from PIL import Image

from warp_partdr import label_set, load_body, read_keypoints, skeleton
from warp_partdr.cli import progress
from warp_partdr.results import save
from warp_partdr.solve.ellipsoids import stages

files, run = commands.files, commands.run  # fixtures


def test_a_real_process_says_what_it_found_and_no_more(files: Path) -> None:
    """Neither Warp's greeting, nor what it compiles, nor that it looked for a CUDA driver."""
    code = (
        "from warp_partdr.cli import main\n"
        "from warp_partdr.solve.ellipsoids import stages\n"
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


def test_skin_is_shown_if_asked_for(run: Run, files: Path) -> None:
    """By default the mesh wears a suit, whose colours the file has."""
    for option, worn in (("", True), ("--bare", False)):
        assert run(f"fit photo.png --keypoints k.json --out out {option}")[0] == 0
        assert (b"COLOR_0" in Path("out", "detailed.glb").read_bytes()) == worn


def test_a_second_run_replaces_the_first_and_nothing_else(run: Run, files: Path) -> None:
    Path("out").mkdir()
    for name in ("report.json", "notes.txt", "parts.png"):
        Path("out", name).write_text("old")
    assert run(f"fit photo.png --keypoints k.json --out out {ALONE}")[0] == 0
    assert Path("out", "notes.txt").read_text() == "old"
    assert Path("out", "parts.png").read_text() == "old"  # not a file of this run
    assert "energy" in json.loads(Path("out", "report.json").read_text())
    assert {path.name for path in files.iterdir()} == {"photo.png", "p.png", "k.json", "out"}


def crop(width: int, height: int) -> None:
    for name in ("photo.png", "p.png"):
        Image.open(name).crop((0, 0, width, height)).save(name)


def two_people() -> None:
    me = keypoints()["keypoints"]
    other = [[0.5 * x, 0.5 * y, confidence] for x, y, confidence in me]
    write("k.json", {"format": "coco17", "keypoints": [other, me]})


def masks() -> None:
    person = ids() > 0
    stranger = np.zeros_like(person)
    stranger[:9, :9] = True
    np.save("masks.npy", np.stack([stranger, person]))


def by_name() -> dict[str, list[float]]:
    rows = dict(zip(skeleton("coco17").landmarks, keypoints()["keypoints"], strict=True))
    rows["neck"] = np.mean([rows["left_shoulder"], rows["right_shoulder"]], axis=0).tolist()
    return rows


def own_skeleton() -> None:
    rows = by_name()
    write("mine.json", {"name": "mine", "landmarks": [None, *(name for name in rows if "ear" not in name)]})
    write("k.json", {"keypoints": [[7, 7, 1], *(row for name, row in rows.items() if "ear" not in name)]})


def openpose_folder() -> None:
    Path("poses").mkdir()
    rows = by_name()
    flat = [value for name in skeleton("coco18").landmarks for value in rows[name]]
    write("poses/photo_keypoints.json", {"version": 1.1, "people": [{"pose_keypoints_2d": flat}]})
    write("poses/other_keypoints.json", {"version": 1.1, "people": []})


def whole_body() -> None:
    rows = [*keypoints()["keypoints"], *[[5.0, 5.0, 0.0]] * 116]
    instance = {"keypoints": [row[:2] for row in rows], "keypoint_scores": [row[2] for row in rows]}
    write("k.json", {"meta_info": {"dataset_name": "coco_wholebody"}, "instance_info": [instance]})


def ultralytics() -> None:
    x, y, visible = zip(*keypoints()["keypoints"], strict=True)
    write("k.json", [{"name": "person", "class": 0, "keypoints": {"x": x, "y": y, "visible": visible}}])


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
    "soft maps": (GOOD.replace("p.png", "maps.npy"), soft_maps),
    "silhouette": (GOOD.replace("cdcl14", "full1"), lambda: save_ids((ids() > 0) * np.uint8(255))),
    "masks by instance": (GOOD.replace("p.png", "masks.npy").replace("cdcl14", "full1"), masks),
    "float ids": (GOOD.replace("p.png", "p.npy"), lambda: np.save("p.npy", ids().astype(np.float32))),
    "own skeleton": (GOOD + " --format mine.json", own_skeleton),
    "OpenPose's folder": (GOOD.replace("k.json", "poses"), openpose_folder),
    "MMPose, whole body": (GOOD, whole_body),
    "Ultralytics": (GOOD, ultralytics),
    "own label set": (GOOD.replace("p.png", "p.npy").replace("cdcl14", "own.json"), own_labels),
    "labels.json beside the parts": (GOOD.replace(" --labels cdcl14", ""), describe_labels),
    "wide picture": (GOOD, lambda: crop(250, 128)),
    "gray photo": (GOOD, lambda: Image.open("photo.png").convert("L").save("photo.png")),
    "the second person": (GOOD + " --person 1", two_people),
    "the largest person": (GOOD, two_people),
    "cut off by the border": (GOOD, lambda: crop(96, 80)),
    "missing keypoints": (GOOD, lambda: change_keypoints(lambda rows: [row.__setitem__(2, 0) for row in rows[7:11]])),
}


@pytest.mark.parametrize("case", TAKEN)
def test_good_input_gives_all_files(case: str, run: Run, files: Path) -> None:
    line, prepare = TAKEN[case]
    prepare()
    clothed = case in ("everything", "keypoints alone", "wide picture", "model from a file")
    code, said, complaint = run(f"fit {line}" if clothed else f"fit {line} {ALONE}")
    assert (code, complaint) == (0, "")
    assert said.count("\n") == 2 + clothed
    # Of the ellipsoids, and of the mesh, bare and in clothes.
    assert said.count("F1") == 2 * (1 + 2 * clothed) * ("--parts" in line)
    assert said.count("in clothes foreground F1") == (clothed and "--parts" in line)
    expected = EVERY_FILE if clothed else set(save.RESULT_FILES)
    expected = expected - (set() if "--parts" in line else {"parts.png"})
    expected = expected | ({save.SMPLX_FILE} if "smpl" in line else set())
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
    if "--labels" in line:
        assert report["parts"]["label_set"] == Path(line.split("--labels ")[1].split()[0]).stem
    if clothed:
        detailed = json.loads(Path("out", "registration.json").read_text())
        assert detailed["model"] == ("smpl" if "smpl" in line else "anny")
        assert np.isfinite(list(detailed["losses"].values())).all()
        assert ("parts" in detailed) == ("parts_clothed" in detailed) == ("--parts" in line)
    if "person" in case:  # the small one's head is at half the height
        assert report["keypoints"]["mean_distance_px"] < 10
        joints = json.loads(Path("out", "body.json").read_text())["joints"]
        assert np.ptp(np.array(joints["pixels"])[:, 1]) > 70


def test_a_body_stands_before_a_known_camera(run: Run, files: Path) -> None:
    """The body stands before it, in metres; a detailed body, also one registered later, stands there, too."""
    assert run(f"fit {GOOD} --focal 300 --principal 50,60")[0] == 0
    described = json.loads(Path("out/body.json").read_text())
    assert described["camera"]["focal_px"] == 300
    assert described["camera"]["principal_px"] == [50, 60]
    pelvis = np.array(described["joints"]["points_m"][0])
    pixel = 300 * pelvis[:2] / pelvis[2] + [50, 60]
    np.testing.assert_allclose(pixel, described["joints"]["pixels"][0], atol=0.05)
    body = load_body("out/body.npz")
    np.testing.assert_allclose(body.translation, pelvis, atol=1e-3)
    assert run("register out/body.npz --parts p.png --labels cdcl14 --photo photo.png --out again")[0] == 0
    first, again = (json.loads(Path(f"{out}/registration.json").read_text()) for out in ("out", "again"))
    assert abs(first["parts"]["foreground_f1"] - again["parts"]["foreground_f1"]) < 0.06


def test_labels_of_all_20_parts_are_fitted(run: Run, files: Path) -> None:
    cdcl, names = label_set("cdcl14"), label_set("ellipbody20").group_names
    table = [0, *(1 + names.index(members[0]) for members in cdcl.groups.values())]
    np.save("p.npy", np.array(table, dtype=np.uint8)[cdcl.to_groups(ids())])
    assert run(f"fit {GOOD.replace('p.png', 'p.npy').replace('cdcl14', 'ellipbody20')} {ALONE}")[0] == 0
    assert json.loads(Path("out", "report.json").read_text())["parts"]["label_set"] == "ellipbody20"


def test_what_contradicts_itself_is_told(run: Run, files: Path) -> None:
    mirrored = [0, 1, 2, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13]  # left for right, in cdcl14
    save_ids(np.array(mirrored, dtype=np.uint8)[ids()])
    code, said, complaint = run(f"fit {GOOD} {ALONE}")
    told = "labels: left and right exchanged, say the keypoints; taken so"
    assert (code, complaint.splitlines()[0]) == (0, f"partdr: warning: {told}")
    assert "partdr:" not in said
    report = json.loads(Path("out", "report.json").read_text())
    assert told in report["warnings"]
    assert f"confidence {report['confidence']:.2f}" in said
    assert report["limbs"].keys() == {"head", "left_arm", "left_leg", "right_arm", "right_leg"}


def test_a_photo_takes_its_keypoints_by_name_out_of_many(run: Run, files: Path) -> None:
    """Anything odd in their file is told once, and stands in the report."""
    person = read_keypoints("k.json")[0]
    names = [*person.format.landmarks[::-1], "hat"]
    rows = [*np.column_stack([person.points, 6 * person.confidence])[::-1].tolist(), [1, 2, 3]]
    flat = [value for row in rows for value in row]
    data = {
        "images": [{"id": 1, "file_name": "a/x.png"}, {"id": 2, "file_name": "a/photo.png"}],
        "categories": [{"id": 1, "name": "person", "keypoints": names}],
        "annotations": [{"image_id": n, "category_id": 1, "keypoints": flat} for n in (1, 2)],
    }
    Path("many.json").write_text(json.dumps(data))
    code, _, complaint = run(f"fit photo.png --keypoints many.json --out out {ALONE}")
    told = json.loads(Path("out", "report.json").read_text())["warnings"]
    assert (code, complaint.splitlines()) == (0, [f"partdr: warning: {text}" for text in told])
    assert [text.split(" ")[1] for text in told] == ["hat", "scores"]
    code, _, complaint = run(f"fit --keypoints many.json --out out {ALONE}")
    assert (code, complaint.count("\n")) == (2, 1)
    assert "people of 2 pictures (a/x.png, a/photo.png)" in complaint


def test_every_stage_is_told(run: Run, files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[str, int, int]] = []

    class Recorder(progress.FitProgress):
        def __call__(self, stage: str, done: int, total: int) -> None:
            told.append((stage, done, total))

    monkeypatch.setattr(progress, "FitProgress", Recorder)
    monkeypatch.setitem(stages.STAGES["network"], "balanced", QUICK_FIT.stages)
    assert run(f"fit {GOOD} --set mesh.iterations=7")[0] == 0
    expected = [*(stage.name for stage in QUICK_FIT.stages), "mesh", "writing results"]
    assert [name for name, _ in groupby(stage for stage, _, _ in told)] == expected
    assert told[-2] == ("mesh", 7, 7)


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
