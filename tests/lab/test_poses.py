"""Poses for training keep to the limits, come from their side of the split, and are broad."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.bodies import bank, clips

from warp_partdr.body.landmarks import mirror_order
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.body.rotations import rotation_from_axis_angle, rotation_to_axis_angle
from warp_partdr.body.template import JOINT_NAMES, LOCKED_PARTS, NUM_PARTS, PART_NAMES
from warp_partdr.errors import InputError
from warp_partdr.lab.synthetic.mocap import is_held_out, straightened
from warp_partdr.lab.synthetic.pose_sampler import POSE_KINDS, PoseBank, PoseSampler, _jitter, pack_poses
from warp_partdr.lab.synthetic.poses import Poses, clear_poses, mean_body, mirrored_half
from warp_partdr.lab.synthetic.procedural_poses import LIMBS, SEATED, SPORT, STANDING, draw_procedural
from warp_partdr.lab.synthetic.rng import TorchRng


def test_packed_poses_keep_clips_apart(shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = shared / "data" / "mocap"
    monkeypatch.setattr("warp_partdr.lab.synthetic.pose_sampler.load_clips", lambda folder: clips(shared))
    path = tmp_path / "poses.npz"
    pack_poses(folder, path)
    assert path.stat().st_size < 3e6
    train, test = (PoseBank.read(path, held_out=held_out) for held_out in (False, True))
    frames = [straightened(clip).rotation_vectors().astype(np.float16) for clip in clips(shared) if is_held_out(clip)]
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


@pytest.mark.parametrize("kind", POSE_KINDS)
def test_each_kind_alone_makes_poses(kind: str, device: str) -> None:
    rotations, ups = PoseSampler(bank(), device=device, pool=4)._make(kind, 60, TorchRng(0, device))
    assert rotations.shape == (60, NUM_PARTS, 3)
    assert rotations.std(0)[PART_NAMES.index("left_upper_arm")].max() > 0.2
    assert PosePrior().to(device).joint_limits(rotations).max() < 1e-9
    assert clear_poses(rotations).all()
    torch.testing.assert_close(ups.norm(dim=1), torch.ones(60, device=device))


def test_kinds_have_their_shares_and_most_people_stand_upright() -> None:
    assert sum(POSE_KINDS.values()) == pytest.approx(1.0)
    asked: list[tuple[str, int]] = []

    class Counting(PoseSampler):
        def _make(self, kind: str, count: int, rng: TorchRng) -> Poses:
            asked.append((kind, count))
            return super()._make(kind, count, rng)

    rotations, ups = Counting(bank(), pool=1000).draw(1000)
    assert asked == [(kind, pytest.approx(1000 * share)) for kind, share in POSE_KINDS.items()]
    thighs = rotation_from_axis_angle(
        rotations[:, [PART_NAMES.index(f"{side}_upper_leg") for side in ("left", "right")]]
    )
    down = (-thighs[..., 1] * ups[:, None]).sum(-1)  # of thighs, 1 where they hang
    assert 0.4 < ((down < -0.8).all(1) & (ups[:, 1] > 0.8)).float().mean() < 0.8
    assert 0.08 < ((down > -0.6).all(1) & (ups[:, 1] > 0.6)).float().mean() < 0.4  # sit, squat and kneel
    assert 0.01 < (ups[:, 1] < 0.3).float().mean() < 0.15  # lie, and worse


def test_a_seed_says_what_comes(device: str) -> None:
    first, again, other = (PoseSampler(bank(), device=device, pool=300, seed=seed).draw(350) for seed in (4, 4, 5))
    assert torch.equal(first[0], again[0])
    assert torch.equal(first[1], again[1])
    assert not torch.equal(first[0], other[0])


def test_varied_poses_are_near_captured_ones_but_none_of_them() -> None:
    poses = bank()
    sampler = PoseSampler(poses, pool=4)
    rotations, ups = sampler._varied(400, TorchRng(1, "cpu"))
    arm = PART_NAMES.index("left_upper_arm")
    turned = rotation_from_axis_angle(rotations[:, arm])[:, None]
    captured = rotation_from_axis_angle(poses.rotations[:, arm])
    angles = rotation_to_axis_angle(turned.mT @ captured).norm(dim=-1).amin(1)
    assert angles.min() > 1e-4
    assert angles.quantile(0.9) < 0.6
    mean = sampler._prior.mean[arm]
    spread, theirs = ((each[:, arm] - mean).norm(dim=1) for each in (rotations, poses.rotations))
    assert spread.max() > 1.05 * theirs.max()  # exaggerated
    torch.testing.assert_close(ups.norm(dim=1), torch.ones(400))


def test_one_limb_of_some_poses_is_loosened() -> None:
    jitter = _jitter(3000, TorchRng(0, "cpu"))
    assert (jitter[:, list(LOCKED_PARTS)] == 0).all()
    loud = torch.stack([jitter[:, parts].square().mean((1, 2)).sqrt() > 0.1 for parts in LIMBS], dim=1)
    assert 0.15 < loud.any(1).float().mean() < 0.35
    assert (loud.sum(1) > 1).float().mean() < 0.02
    assert jitter[~loud.any(1)].abs().max() < 0.5


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


def test_repertoires_differ(device: str) -> None:
    thigh = PART_NAMES.index("left_upper_leg")
    raised, high = {}, {}
    for name, repertoire in (("standing", STANDING), ("seated", SEATED), ("sport", SPORT)):
        rotations, ups = draw_procedural(1000, TorchRng(0, device), repertoire)
        joints = mean_body(rotation_from_axis_angle(rotations)).joints
        down = -rotation_from_axis_angle(rotations[:, thigh])[:, :, 1]
        raised[name] = float(((down * ups).sum(1) > -0.5).float().mean())
        high[name] = float((joints[:, JOINT_NAMES.index("left_wrist"), 1] > 0.6).float().mean())
    assert raised["standing"] < 0.1 < 0.3 < raised["sport"] < raised["seated"]
    assert high["standing"] < 0.15 < 0.2 < high["sport"]
