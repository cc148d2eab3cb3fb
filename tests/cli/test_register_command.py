"""``partdr register``: the files it leaves, and with part labels, what it says of them."""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from helpers import commands
from helpers.commands import GOOD, Run, ids, save_ids
from helpers.files import body_file, save_npz
from PIL import Image

from warp_partdr.body.labels import label_set
from warp_partdr.models.anny import anny
from warp_partdr.models.load import load_model
from warp_partdr.models.model import detailed_mesh
from warp_partdr.models.smpl_parameters import from_smplx
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.results.save import DETAILED_FILES, SMPLX_FILE
from warp_partdr.solve.mesh.given_files import read_given

REGISTER = "register out/body.npz --out new --device cpu"
files, run = commands.files, commands.run  # fixtures


@pytest.fixture
def fitted(files: Path, run: Run) -> dict[str, Any]:
    """A fit of the example in the folder ``out``, and the report of its detailed body."""
    assert run(f"fit {GOOD} --device cpu")[0] == 0
    return json.loads(Path("out/registration.json").read_text())


def test_it_scores_the_person_alone(fitted: dict[str, Any], run: Run) -> None:
    """The scores are the same with another person in the picture and without."""
    shown = ids()
    apart = shown.copy()
    apart[2:50, :5] = 2
    code, said, _ = run(REGISTER)
    assert code == 0
    assert "F1" not in said
    assert "parts" not in json.loads(Path("new/registration.json").read_text())
    scores = []
    for image in (shown, apart):
        save_ids(image)
        code, said, _ = run(f"{REGISTER} --parts p.png --labels cdcl14")
        assert code == 0
        found = json.loads(Path("new/registration.json").read_text())["parts"]
        assert found["pixels"].pop("ignored", 0) == (image != shown).sum()
        assert f"foreground F1 {found['foreground_f1']:.3f}, part F1 {found['part_f1']:.3f}, " in said
        assert f"{100 * found['left_out']:.0f} % of the person left out; new" in said
        scores.append((found["foreground_f1"], found["part_f1"]))
    assert scores[1] == pytest.approx(scores[0], abs=2e-3)
    # The fit's mesh was drawn against the labels, this one was not.
    assert scores[0][0] < fitted["parts"]["foreground_f1"]


def test_more_formats_are_of_the_set(fitted: dict[str, Any], run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pxr", reason="needs the extra 'usd'")
    assert run(f"{REGISTER} --to usda --to usdz")[0] == 0
    found = json.loads(Path("new/registration.json").read_text())["files"]
    assert {"detailed.usda", "detailed.usdz"} < found.keys()
    assert run(f"fit {GOOD} --device cpu --set also=usdz --out more")[0] == 0
    assert Path("more/detailed.usdz").read_bytes()[:2] == b"PK"
    monkeypatch.setenv("PATH", "")
    code, _, said = run(f"fit {GOOD} --device cpu --set also=fbx --out other")
    assert (code, "also: fbx: no command 'blender'" in said, Path("other").exists()) == (2, True, False)
    assert "with --model none" in run(f"fit {GOOD} --model none --set also=usdz --out other")[2]


def test_labels_of_another_picture_are_refused(fitted: dict[str, Any], run: Run) -> None:
    shown = ids()
    away = np.zeros_like(shown)
    away[:5, :5], away[:5, 5:8] = 1, 2
    Path("new").mkdir()
    Image.fromarray(shown).save("new/detailed.png")
    for image, name, says in (
        (away, "p.png", "--parts: no labelled pixel where the body is"),
        (shown[::2, ::2], "p.png", "body: 96x128; parts: 48x64"),
        (shown, "new/detailed.png", "would replace"),
    ):
        save_ids(image)
        code, _, complaint = run(f"{REGISTER} --parts {name} --labels cdcl14")
        assert code == 2
        assert says in complaint
    assert not Path("new/registration.json").exists()


def test_the_command_writes_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    monkeypatch.chdir(tmp_path)
    body_file().save("body.npz")
    Image.new("RGB", (300, 400), "white").save("photo.png")
    code, said, _ = run("register body.npz --photo photo.png --out detailed --device cpu")
    assert code == 0
    assert "detailed/detailed.png" in said
    assert {path.name for path in Path("detailed").iterdir()} == set(DETAILED_FILES)
    with Image.open("detailed/detailed.png") as shown:
        assert shown.size == (300, 400)
        assert shown.getpixel((299, 0)) == (255, 255, 255)
    with np.load("detailed/detailed.npz", allow_pickle=False) as saved:
        model = anny()
        takes = [name for name in inspect.signature(model.pose).parameters if name in saved]
        again = model.pose(**{name: torch.from_numpy(saved[name])[None] for name in takes})
    mesh = trimesh.load("detailed/detailed.ply", process=False)
    assert abs(np.ptp(again.vertices[0, :, 1].numpy()) - mesh.extents[1]) < 1e-4

    Image.new("RGB", (400, 300)).save("photo.png")
    for wrong, says in (
        ("--model nobody.npz", "--model: nobody.npz"),
        ("--model none", "--model: none"),
        ("--photo photo.png", "body: 300x400; photo: 400x300"),
        ("--out body.npz", "body.npz: Not a directory"),
    ):
        code, _, complaint = run(f"register body.npz {wrong}")
        assert code == 2
        assert says in complaint
    assert not Path("out").exists()


def test_a_model_of_smpl_leaves_its_own_parameters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    monkeypatch.chdir(tmp_path)
    body_file().save("body.npz")
    model = load_model(save_npz(Path("smpl.npz")))
    assert run("register body.npz --model smpl.npz --device cpu")[0] == 0
    assert {path.name for path in Path("out").iterdir()} == {*DETAILED_FILES, SMPLX_FILE}
    with np.load(f"out/{SMPLX_FILE}") as saved, np.load("out/detailed.npz") as detailed:
        found = model.pose(*from_smplx(model, saved, "saved")).vertices[0]
        numbers = (torch.from_numpy(detailed[name])[None] for name in ("shape", "rotations", "translation"))
        torch.testing.assert_close(found, model.pose(*numbers).vertices[0], atol=1e-5, rtol=0)
        assert saved["camera_scale"] == 100.0
        assert saved["image_size"].tolist() == [400, 300]
    # Grown parts are no body of SMPL's, and Anny has no such parameters: nothing old stays.
    for options in ("--model smpl.npz --grow", "--model anny"):
        assert run(f"register body.npz {options} --device cpu")[0] == 0
        assert {path.name for path in Path("out").iterdir()} == set(DETAILED_FILES)
    code, _, complaint = run(f"register body.npz --model out/{SMPLX_FILE} --device cpu")
    assert (code, "would replace" in complaint) == (2, True)


def test_another_methods_body_is_refined_against_labels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    monkeypatch.chdir(tmp_path)
    model = load_model(save_npz(Path("smpl.npz")))
    orientation = np.array([np.pi, 0.0, 0.0])  # y down, as cameras see it
    given = {"betas": np.zeros(10), "global_orient": orientation, "transl": np.array([0.0, 0.2, 4.0])}
    np.savez("regressed.npz", **given, focal_length=np.array(400.0))
    body, camera = read_given(Path("regressed.npz"), model, (240, 200))
    beside = body.moved(torch.tensor([[0.05, 0.0, 0.0]]))
    shown = draw_mesh(beside.detailed.vertices, detailed_mesh(model), camera, (240, 200)).labels[0].numpy()
    Image.fromarray(label_set("body14").part_groups[shown]).save("p.png")
    code, said, _ = run("register regressed.npz --model smpl.npz --parts p.png --labels body14 --device cpu")
    assert code == 0
    assert "foreground F1" in said
    assert {path.name for path in Path("out").iterdir()} == {*DETAILED_FILES, SMPLX_FILE}
    found, again = read_given(Path("out") / SMPLX_FILE, model, (240, 200))
    assert again.intrinsics[0].tolist() == pytest.approx(camera.intrinsics[0].tolist(), abs=1e-2)
    moved = (found.detailed.joints - body.detailed.joints).mean(1)[0].tolist()
    assert 0.02 < moved[0] < 0.08
    assert json.loads(Path("out/registration.json").read_text())["start"] == "regressed.npz"

    Path("empty.npz").write_bytes(b"")
    for wrong, says in (
        ("regressed.npz --model smpl.npz", "--parts: missing"),
        ("regressed.npz --parts p.png --labels body14", "model: anny; expected one of smpl, smplh, smplx"),
        ("regressed.npz --model smpl.npz --parts p.png --labels body14 --grow", "--inscribed, --grow: with"),
        ("empty.npz", "empty.npz"),
        ("p.json", "p.json"),
    ):
        code, _, complaint = run(f"register {wrong} --out new --device cpu")
        assert (code, says in complaint) == (2, True), complaint
    body_file().save("body.npz")
    assert "--keypoints: with body.npz, a fit's" in run("register body.npz --keypoints k.json --device cpu")[2]
