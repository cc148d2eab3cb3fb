"""``partdr scene``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scenes import commands
from scenes.commands import Run
from scenes.files import EXAMPLE
from scenes.films import write_film

from warp_partdr.inputs.films import film_facts

run = commands.run  # a fixture
QUICK = "--device cpu --set mesh.iterations=5 --set mesh.size=96"
SIDE, FOCAL, AWAY, BESIDE = 256, 300.0, 3.0, 0.5  # [px], [px], [m], [m] from one camera to the other


@pytest.fixture
def films(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """A cardboard person AWAY from two cameras side by side; the width of the films [px]."""
    monkeypatch.chdir(tmp_path)
    picture = Image.open(EXAMPLE / "photo.png").convert("RGB")
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
    code, said, complaint = run(f"scene left.mp4 right.mp4 --cameras rig.json --out out {QUICK}")
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
    assert {"overlay.mp4", "overlay1.mp4", "person0.npz", "person0.glb", "person0.bvh"} == set(report["files"])
    assert film_facts("out/overlay1.mp4").frames == 4
    # The other way around, the world is the other camera's; the order of films says nothing about names.
    code, _, complaint = run(f"scene right.mp4 left.mp4 --cameras rig.json --out other {QUICK}")
    assert (code, complaint) == (0, "")
    turned = json.loads(Path("other", "people.json").read_text())
    assert turned["views"][1]["translation"] == pytest.approx([BESIDE, 0, 0])


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("scene left.mp4 left.mp4 --cameras rig.json", ["FILM: the same one twice"]),
        ("scene left.mp4 none.mp4 --cameras rig.json", ["none.mp4"]),
        ("scene left.mp4 --cameras none.toml", ["none.toml: No such file"]),
        ("scene left.mp4 right.mp4 --cameras one.json", ["one.json: cameras left; expected one a film: left, right"]),
        ("scene left.mp4 right.mp4", ["--cameras"]),
        ("scene left.mp4 right.mp4 --cameras rig.json --min-score 2", ["--min-score: 2"]),
    ],
)
def test_faults(run: Run, films: int, line: str, words: list[str]) -> None:
    rig = json.loads(Path("rig.json").read_text())["cameras"]
    Path("one.json").write_text(json.dumps({"cameras": {"left": rig["left"]}}))
    code, said, complaint = run(f"{line} --out out --device cpu")
    assert (code, said) == (2, "")
    for word in words:
        assert word in complaint
    assert not Path("out").exists()
