"""Poses for training keep to the limits, come from their side of the split, and are broad."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scenes.bodies import bank, clips

from warp_partdr.body.landmarks import mirror_order
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.template import JOINT_NAMES, LOCKED_PARTS, NUM_PARTS, PART_NAMES
from warp_partdr.errors import InputError
from warp_partdr.synthetic.mocap import is_held_out
from warp_partdr.synthetic.pose_sampler import PoseBank, PoseSampler, pack_poses
from warp_partdr.synthetic.poses import clear_poses, mean_body, mirrored_half
from warp_partdr.synthetic.procedural_poses import draw_procedural
from warp_partdr.synthetic.rng import TorchRng


def test_packed_poses_keep_clips_apart(shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = shared / "data" / "mocap"
    monkeypatch.setattr("warp_partdr.synthetic.pose_sampler.load_clips", lambda folder: clips(shared))
    path = tmp_path / "poses.npz"
    pack_poses(folder, path)
    assert path.stat().st_size < 3e6
    train, test = (PoseBank.read(path, held_out=held_out) for held_out in (False, True))
    frames = [clip.rotation_vectors().astype(np.float16) for clip in clips(shared) if is_held_out(clip)]
    held_out = {frame.tobytes() for frame in np.concatenate(frames)}
    assert all(pose.tobytes() in held_out for pose in test.rotations.half().numpy())
    assert not any(pose.tobytes() in held_out for pose in train.rotations.half().numpy())
    direct = PoseBank.read(folder, held_out=True)
    torch.testing.assert_close(test.rotations, direct.rotations, atol=2e-3, rtol=0)
    torch.testing.assert_close(test.ups, direct.ups, atol=2e-3, rtol=0)


def test_files_that_hold_no_poses_are_named(tmp_path: Path) -> None:
    (tmp_path / "bad.npz").write_bytes(b"nothing of the sort")
    for name, count in (("odd", 3), ("good", 2)):
        arrays = {"rotations": np.zeros((2, 20, 3)), "ups": np.ones((count, 3)), "held_out": np.zeros(2, dtype=bool)}
        np.savez(tmp_path / f"{name}.npz", **arrays)
    assert len(PoseBank.read(tmp_path / "good.npz").ups) == 2
    for name, error in (
        ("bad", r"bad\.npz"),
        ("odd", "ups"),
        ("good", "held out"),
        ("none", r"none\.npz: No such file"),
    ):
        with pytest.raises(InputError, match=error):
            PoseBank.read(tmp_path / f"{name}.npz", held_out=True)


def test_poses_keep_to_the_limits_and_pass_through_nothing(device: str) -> None:
    rotations, ups = PoseSampler(bank(), device=device, pool=400).draw(600)
    assert rotations.shape == (600, NUM_PARTS, 3)
    assert (rotations[:, list(LOCKED_PARTS)] == 0).all()
    assert PosePrior().to(device).joint_limits(rotations).max() < 1e-9
    assert clear_poses(rotations).all()
    torch.testing.assert_close(ups.norm(dim=1), torch.ones(600, device=device))
    assert len(rotations.flatten(1).unique(dim=0)) == 600


def test_each_kind_alone_makes_poses(device: str) -> None:
    sampler = PoseSampler(bank(), device=device, pool=4)
    for kind in (sampler._captured, sampler._prior.draw, sampler._mixed, draw_procedural):
        rotations, _ = sampler._make(kind, 40, TorchRng(0, device))
        assert len(rotations) == 40
        assert rotations.std(0)[PART_NAMES.index("left_upper_arm")].max() > 0.2


def test_a_hand_in_the_belly_is_not_clear(device: str) -> None:
    rotations = torch.zeros(2, NUM_PARTS, 3, device=device)
    rotations[1, PART_NAMES.index("left_upper_arm"), 2] = -np.pi / 2  # hanging down
    rotations[1, PART_NAMES.index("left_forearm"), 2] = -np.pi / 2  # and across, through the trunk
    assert clear_poses(rotations).tolist() == [True, False]


def test_half_of_the_poses_are_mirrored(device: str) -> None:
    rotations, ups = PoseSampler(bank(), device=device, pool=64).draw(64)
    mirrored, mirrored_ups = mirrored_half((rotations, ups), TorchRng(0, device))
    joints, others = (mean_body(rotation_from_axis_angle(values)).joints for values in (rotations, mirrored))
    flipped = joints[:, mirror_order(JOINT_NAMES)] * joints.new_tensor([-1.0, 1.0, 1.0])
    same = (others - joints).abs().flatten(1).amax(1) < 1e-5
    swapped = (others - flipped).abs().flatten(1).amax(1) < 1e-5
    assert (same ^ swapped).all()
    assert 0.3 < swapped.float().mean() < 0.7
    torch.testing.assert_close(mirrored_ups[swapped], ups[swapped] * ups.new_tensor([-1.0, 1.0, 1.0]))


def test_procedural_poses_are_broad(device: str) -> None:
    rotations, ups = draw_procedural(2000, TorchRng(0, device))
    joints = mean_body(rotation_from_axis_angle(rotations)).joints
    wrist, knee = (joints[:, JOINT_NAMES.index(name)] for name in ("left_wrist", "left_knee"))
    assert wrist[:, 1].quantile(0.03) < 0.05
    assert wrist[:, 1].quantile(0.97) > 0.6
    assert wrist[:, 2].quantile(0.9) > 0.3
    assert wrist[:, 0].quantile(0.05) < 0.0  # across
    assert knee[:, 2].quantile(0.9) > 0.3
    assert 0.02 < (ups[:, 1] < 0.3).float().mean() < 0.25
    torch.testing.assert_close(ups.norm(dim=1), torch.ones_like(ups[:, 0]))
