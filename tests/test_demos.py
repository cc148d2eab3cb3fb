"""The tutorial scripts of demos/ run, write their pictures, and what they show is so."""

import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

DEMOS = Path(__file__).resolve().parents[1] / "demos"
sys.path.insert(0, str(DEMOS))

import fit_photo  # noqa: E402  they lie in demos/
import own_loss  # noqa: E402
import render_gradient  # noqa: E402
import train_from_labels  # noqa: E402


def check_pictures(folder, names):
    """There are these, and something is on each."""
    assert sorted(path.name for path in folder.iterdir()) == sorted(names)
    for name in names:
        picture = np.asarray(Image.open(folder / name).convert("RGB"))
        assert 0.005 < (picture < 250).any(-1).mean() < 1, name


def test_render_gradient(tmp_path):
    losses = render_gradient.main(["--out", str(tmp_path), "--size", "96", "--iterations", "25"])
    assert losses[-1] < 0.5 * losses[0]
    check_pictures(tmp_path, ["body.png", "target.png", "gradient.png", "gradient_mesh.png", "descent.png"])


def test_fit_photo(tmp_path):
    result = fit_photo.main(["--out", str(tmp_path), "--quality", "fast"])
    assert result.history[-1][-1] < result.history[-1][0]
    check_pictures(tmp_path, ["overlay.png", "parts.png", "loss.png", "turntable.png", "keypoints_or_labels.png"])


def test_own_loss(tmp_path):
    losses = own_loss.main(["--out", str(tmp_path), "--size", "96", "--iterations", "40"])
    assert losses[-1] < 0.5 * losses[0]
    check_pictures(tmp_path, ["before.png", "after.png", "loss.png"])


def test_own_loss_is_the_iou():
    """Two parts: one half right, one that is not there and not wanted."""
    wanted = torch.zeros(1, 2, 2, 2)
    wanted[0, 0, 0] = 1
    maps = torch.zeros(1, 2, 2, 2)
    maps[0, 0, 0, 0] = 1
    assert float(own_loss.iou_loss(maps, wanted)) == pytest.approx(0.5)
    assert float(own_loss.iou_loss(wanted, wanted)) == 0


def test_train_from_labels(tmp_path):
    options = ["--size", "32", "--batch", "12", "--steps", "120"]
    losses, (before, after) = train_from_labels.main(["--out", str(tmp_path), *options])
    assert np.mean(losses[-10:]) < 0.75 * np.mean(losses[:10])
    assert after < 0.75 * before  # of angles that it was never told
    check_pictures(tmp_path, ["loss.png", "people.png"])


def test_train_from_labels_turns_both_sides_alike():
    """The same number lifts both arms: what the network predicts means the same on either side."""
    joints = train_from_labels.bodies(torch.tensor([[0.5, 0.2, 0.3] * 2])).posed().joints[0]
    left, right = joints[[15, 17, 9]], joints[[16, 18, 10]]  # elbow, wrist, knee
    torch.testing.assert_close(left[:, 1:], right[:, 1:], atol=1e-4, rtol=0)
    assert (left[:2, 1] < joints[6, 1]).all()  # above the shoulder: y is down
