"""The packaged example at a quarter of its size, the command with few steps, and files with faults."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from helpers.files import EXAMPLE
from helpers.quick import QUICK_FIT
from warp_partdr.cli import main
from warp_partdr.results import save
from warp_partdr.results.views import VIEWS
from warp_partdr.solve.ellipsoids import stages

GOOD = "photo.png --keypoints k.json --parts p.png --labels cdcl14 --out out"
ALONE = "--model none"  # no detailed model: that takes most of a quick fit's time
EVERY_FILE = {*save.RESULT_FILES, *save.DETAILED_FILES, VIEWS}
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
    monkeypatch.setitem(stages.STAGES["network"], "balanced", QUICK_FIT.stages)

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


def cut(name: str, share: float) -> None:
    data = Path(name).read_bytes()
    Path(name).write_bytes(data[: int(len(data) * share)])


def change_keypoints(change: Callable[[list[list[Any]]], object]) -> None:
    data = keypoints()
    change(data["keypoints"])
    write("k.json", data)


def move(x: float, y: float) -> None:
    change_keypoints(lambda rows: [row.__setitem__(slice(2), [row[0] + x, row[1] + y]) for row in rows])


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
