"""``scripts/golden``: differences of results are found, measured and described, and files are read by their content."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts" / "golden"))

from differences import difference_between
from files import read_results

LENGTHS = np.array([0.5, 1.5, 300.0], dtype=np.float32)


def amount(before: np.ndarray, after: np.ndarray) -> float:
    """The size of a difference, which there must be."""
    difference = difference_between(before, after)
    assert difference is not None
    return difference.amount


def test_the_same_bits_are_no_difference() -> None:
    with_nan = np.array([np.nan, np.inf, -0.0])
    for value in (LENGTHS, with_nan, np.array("warning"), np.arange(3)):
        assert difference_between(value, value.copy()) is None


def test_metres_differ_by_millimetres_and_larger_numbers_by_thousandths() -> None:
    assert amount(LENGTHS, LENGTHS + np.float32([0.002, 0, 0])) == pytest.approx(2, rel=1e-3)
    assert amount(LENGTHS, LENGTHS + np.float32([0, 0, 0.3])) == pytest.approx(1, rel=1e-2)
    assert amount(np.array([0.0]), np.array([-0.0])) == 0


def test_what_no_tolerance_accepts_differs_infinitely() -> None:
    others = [LENGTHS[:2], LENGTHS.astype(float), np.array("text"), np.float32([0.5, np.nan, 300])]
    assert [amount(LENGTHS, other) for other in others] == [np.inf] * 4
    assert amount(np.array("one"), np.array("two")) == np.inf
    for pair in ((None, LENGTHS), (LENGTHS, None)):
        difference = difference_between(*pair)
        assert difference is not None
        assert difference.amount == np.inf


def test_pictures_differ_by_the_share_of_pixels_that_differ_visibly() -> None:
    picture = np.full((10, 10, 3), 100, dtype=np.uint8)
    faint, visible = picture + np.uint8(3), picture.copy()
    visible[0, :2, 1] = 200
    assert amount(picture, faint) == 0
    assert amount(picture, visible) == pytest.approx(2)
    assert amount(picture[..., 0], faint[..., 0]) == 100  # labels
    assert difference_between(picture[None], faint[None]) is None  # a film
    assert amount(picture[None], visible[None]) == pytest.approx(2)


def test_files_are_read_without_times_and_versions(tmp_path: Path) -> None:
    found = []
    for run, moved in enumerate((0.0, 0.0, 0.001)):
        folder = tmp_path / str(run)
        (folder / "person0").mkdir(parents=True)
        report = {"energy": {"seg": 10.0 + moved}, "seconds": run, "versions": {"torch": str(run)}, "warnings": ["a 1"]}
        (folder / "report.json").write_text(json.dumps(report))
        np.savez(folder / "person0" / "body.npz", joints=np.ones((2, 3)) + moved)
        Image.new("RGB", (4, 3), (run // 2 * 90, 0, 0)).save(folder / "overlay.png")
        mesh = trimesh.Trimesh([[moved, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], face_colors=[[9, 9, 9, 255]])
        mesh.export(folder / "mesh.ply")
        mesh.export(folder / "mesh.glb")
        mesh.export(folder / "mesh.obj")
        found.append(read_results(folder))
    first, again, other = found
    assert first.keys() == again.keys() == other.keys()
    assert [name for name in first if difference_between(first[name], again[name])] == []
    differing = {name: difference_between(first[name], other[name]) for name in first}
    amounts = {name: each.amount for name, each in differing.items() if each is not None}
    named = {"report.json, energy, numbers", "person0/body.npz, joints", "overlay.png, pixels", "mesh.ply, x"}
    assert named <= amounts.keys()
    assert {name.partition(",")[0] for name in amounts.keys() - named} == {"mesh.glb", "mesh.obj"}
    assert max(amount for name, amount in amounts.items() if "mesh" in name) == pytest.approx(1, rel=0.01)
    assert amounts["report.json, energy, numbers"] == pytest.approx(0.1, rel=0.01)
