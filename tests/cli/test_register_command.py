"""``partdr register``: the files it leaves, and with part labels, what it says of them."""

from __future__ import annotations

import inspect
import json
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from scenes.files import EXAMPLE, body_file
from typer.testing import CliRunner

from warp_partdr.body.labels import label_set
from warp_partdr.cli.main import app
from warp_partdr.clothing import registration
from warp_partdr.clothing.anny import anny
from warp_partdr.clothing.registration import RegistrationWeights, register
from warp_partdr.errors import InputError
from warp_partdr.fit.fitting import fit_body
from warp_partdr.fit.options import FitOptions
from warp_partdr.fit.stages import Stage
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.part_labels import read_parts, read_photo
from warp_partdr.results.save import DETAILED_FILES, save_fit, save_registered

LABELS = label_set("cdcl14")


@pytest.fixture
def fitted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, few_steps: None) -> dict[str, object]:
    """A fit of the packaged example in the folder ``fit``, and the report of its detailed body; p.png holds labels."""
    monkeypatch.chdir(tmp_path)
    torch.set_num_threads(1)
    person, parts = read_keypoints(EXAMPLE / "keypoints.json")[0], read_parts(EXAMPLE / "parts.png", LABELS)
    result = fit_body(person, parts, options=FitOptions(stages=(Stage("labels", 2, 4, 0.02, 64),)))
    photo = read_photo(EXAMPLE / "photo.png")
    save_fit(result, "fit", photo=photo)
    options = registration.RegistrationOptions(RegistrationWeights.fitted(), growth=False)
    registered = register(result.posed, anny(), options=options)
    Image.open(EXAMPLE / "parts.png").save("p.png")
    return save_registered(registered, "fit", result.camera, photo.shape[:2], evidence=result.evidence)


def call(*options: str) -> str:
    line = ["register", "fit/body.npz", "--out", "new", "--device", "cpu", *options]
    done = CliRunner().invoke(app, line)
    if isinstance(done.exception, InputError):
        raise done.exception
    assert done.exit_code == 0, done.output
    return done.output


def test_it_says_what_the_fit_said(fitted: dict[str, object]) -> None:
    """Also with somebody else in the picture."""
    assert "F1" not in call()
    assert "parts" not in json.loads(Path("new/registration.json").read_text())
    ids = np.array(Image.open("p.png"))
    apart = ids.copy()
    apart[5:200, 2:20] = 2
    for shown in (ids, apart):
        Image.fromarray(shown).save("p.png")
        said = call("--parts", "p.png", "--labels", "cdcl14")
        found, expected = json.loads(Path("new/registration.json").read_text())["parts"], fitted["parts"]
        assert found["pixels"].pop("ignored") == (shown != ids).sum()
        assert expected["pixels"].pop("ignored", 0) == 0
        assert abs(found["foreground_f1"] - expected["foreground_f1"]) < 2e-3
        assert abs(found["part_f1"] - expected["part_f1"]) < 2e-3
        assert f"foreground F1 {found['foreground_f1']:.3f}, part F1 {found['part_f1']:.3f}, " in said
        assert f"{100 * found['left_out']:.0f} % of the person left out; new" in said


def test_labels_of_another_picture_are_refused(fitted: dict[str, object]) -> None:
    ids = np.array(Image.open("p.png"))
    away = np.zeros_like(ids)
    away[:20, :20], away[:20, 20:30] = 1, 2
    Image.fromarray(away).save("p.png")
    with pytest.raises(InputError, match="--parts: no labelled pixel where the body is"):
        call("--parts", "p.png", "--labels", "cdcl14")
    Image.fromarray(ids[::2, ::2]).save("p.png")
    with pytest.raises(InputError, match="body: 384x512; parts: 192x256"):
        call("--parts", "p.png", "--labels", "cdcl14")
    Path("new").mkdir()
    Image.fromarray(ids).save("new/detailed.png")
    with pytest.raises(InputError, match="would replace"):
        call("--parts", "new/detailed.png", "--labels", "cdcl14")
    assert not Path("new/registration.json").exists()


def test_the_command_writes_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    body_file().save(tmp_path / "body.npz")
    monkeypatch.chdir(tmp_path)
    Image.new("RGB", (300, 400), "white").save("photo.png")
    line = ["register", "body.npz", "--photo", "photo.png", "--out", "detailed", "--device", "cpu"]
    done = CliRunner().invoke(app, line)
    assert done.exit_code == 0, done.output
    assert "detailed/detailed.png" in done.output
    names = {path.name for path in (tmp_path / "detailed").iterdir()}
    assert names == set(DETAILED_FILES)
    with Image.open("detailed/detailed.png") as shown:
        assert shown.size == (300, 400)
        assert shown.getpixel((299, 0)) == (255, 255, 255)
    with np.load(tmp_path / "detailed" / "detailed.npz", allow_pickle=False) as saved:
        model = anny()
        takes = [name for name in inspect.signature(model.pose).parameters if name in saved]
        again = model.pose(**{name: torch.from_numpy(saved[name])[None] for name in takes})
    mesh = trimesh.load(tmp_path / "detailed" / "detailed.ply", process=False)
    assert abs(np.ptp(again.vertices[0, :, 1].numpy()) - mesh.extents[1]) < 1e-4

    Image.new("RGB", (400, 300)).save("photo.png")
    for wrong, says in (
        (["--model", "nobody.npz"], "--model: nobody.npz"),
        (["--model", "none"], "--model: none"),
        (["--photo", "photo.png"], "body: 300x400; photo: 400x300"),
        (["--out", "body.npz"], "body.npz: Not a directory"),
    ):
        refused = CliRunner().invoke(app, ["register", "body.npz", *wrong])
        assert isinstance(refused.exception, InputError)
        assert says in str(refused.exception)
    assert not (tmp_path / "out").exists()
