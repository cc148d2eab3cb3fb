"""The tutorial scripts of demos/ run and write their pictures, and what they show is so; the docs' pictures, too."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "demos"), str(ROOT / "scripts")]

import fit_photo  # noqa: E402  they lie in demos/
import own_loss  # noqa: E402
import pictures  # noqa: E402  it lies in scripts/
import render_gradient  # noqa: E402
import train_from_labels  # noqa: E402


def check_pictures(folder, names):
    """There are these, and something is on each."""
    assert sorted(path.name for path in folder.iterdir()) == sorted(names)
    for name in names:
        picture = np.asarray(Image.open(folder / name).convert("RGB"))
        assert 0.005 < (picture < 250).any(-1).mean() < 1, name


@pytest.mark.parametrize(
    ("demo", "iterations", "names"),
    [
        (render_gradient, 25, "body.png target.png gradient.png gradient_mesh.png descent.png"),
        (own_loss, 40, "before.png after.png loss.png"),
    ],
)
def test_descents_of_demos_halve_the_loss_and_leave_their_pictures(tmp_path, demo, iterations, names):
    losses = demo.main(tmp_path, size=96, iterations=iterations)
    assert losses[-1] < 0.5 * losses[0]
    check_pictures(tmp_path, names.split())


def test_the_demo_of_a_photo_lowers_its_loss_and_leaves_its_pictures(tmp_path):
    result = fit_photo.main(tmp_path, quality="fast")
    assert result.history[-1][-1] < result.history[-1][0]
    check_pictures(tmp_path, ["overlay.png", "parts.png", "loss.png", "turntable.png", "keypoints_or_labels.png"])


def test_own_loss_is_the_iou():
    """Two parts: one half right, one that is not there and not wanted."""
    wanted = torch.zeros(1, 2, 2, 2)
    wanted[0, 0, 0] = 1
    maps = torch.zeros(1, 2, 2, 2)
    maps[0, 0, 0, 0] = 1
    assert float(own_loss.iou_loss(maps, wanted)) == pytest.approx(0.5)
    assert float(own_loss.iou_loss(wanted, wanted)) == 0


def test_the_demo_of_training_learns_from_labels_alone(tmp_path):
    losses, (before, after) = train_from_labels.main(tmp_path, size=32, batch=12, steps=120)
    assert np.mean(losses[-10:]) < 0.75 * np.mean(losses[:10])
    assert after < 0.75 * before  # of angles that it was never told
    check_pictures(tmp_path, ["loss.png", "people.png"])


def test_train_from_labels_turns_both_sides_alike():
    """The same number lifts both arms: what the network predicts means the same on either side."""
    joints = train_from_labels.bodies(torch.tensor([[0.5, 0.2, 0.3] * 2])).posed().joints[0]
    left, right = joints[[15, 17, 9]], joints[[16, 18, 10]]  # elbow, wrist, knee
    torch.testing.assert_close(left[:, 1:], right[:, 1:], atol=1e-4, rtol=0)
    assert (left[:2, 1] < joints[6, 1]).all()  # above the shoulder: y is down


def test_pictures_of_the_docs_are_all_told_where_they_come_from():
    """Each is drawn by ``make pictures`` or measured, each is shown somewhere, and no page shows another one."""
    drawn = [name for names, _ in pictures.DRAWN for name in names]
    kept = {path.name for path in pictures.IMAGES.iterdir()}
    assert sorted([*drawn, *pictures.MADE_ELSEWHERE]) == sorted(kept)
    pages = [pictures.ROOT / "README.md", *(pictures.ROOT / "docs").rglob("*.md")]
    shown = {name for page in pages for name in re.findall(r"images/([\w.-]+\.(?:png|gif))", page.read_text())}
    assert shown == kept


def test_a_picture_is_made_and_compared(tmp_path, capsys):
    options = ["two_triangles.png", "--out", str(tmp_path)]
    assert pictures.main(options) == 0
    assert capsys.readouterr().out.endswith("KiB, new\n")
    assert pictures.difference(tmp_path / "two_triangles.png", pictures.IMAGES / "two_triangles.png") < 0.02
    assert pictures.difference(tmp_path / "two_triangles.png", pictures.IMAGES / "demo.gif") == 1


def test_a_picture_that_fails_is_left(tmp_path, capsys):
    (tmp_path / "two_triangles.png").write_bytes(b"as it was")
    assert not pictures.make(("two_triangles.png",), ("-c", "raise SystemExit('no picture')"), tmp_path)
    assert "two_triangles.png: left as it was; -c raise SystemExit('no picture'): no picture" in capsys.readouterr().out
    assert (tmp_path / "two_triangles.png").read_bytes() == b"as it was"
