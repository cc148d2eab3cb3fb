"""Retargeting keeps the directions of the mocap's own limbs, and people stand, face and bend as people do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.bodies import clips

from warp_partdr.body.template import BONE_STARTS, JOINT_NAMES, LOCKED_PARTS, NUM_PARTS, PART_NAMES
from warp_partdr.interop.checks import rotation_error
from warp_partdr.lab.synthetic import mocap, mocap_files

LIMBS = ("upper_leg", "lower_leg", "upper_arm", "forearm", "hand")


def directions(clip: mocap.Clip) -> np.ndarray:
    """Unit directions of EllipBody's bones, shape (F, 20, 3)."""
    joints = mocap.joint_positions(clip.global_orient, clip.rotations)
    bones = joints[:, 1:] - joints[:, BONE_STARTS]
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


def degrees_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((first * second).sum(-1), -1.0, 1.0)))


@pytest.mark.parametrize("source", ["expmap", "asf", "deepmimic"])
def test_limbs_point_where_the_mocaps_limbs_point(shared: Path, source: str) -> None:
    chosen = [clip for clip in clips(shared) if clip.name.startswith(source)][::5]
    assert chosen
    for clip in chosen:
        errors = degrees_between(directions(clip), clip.directions)
        for part, name in enumerate(PART_NAMES):
            if name.endswith(LIMBS) and not np.isnan(clip.directions[:, part]).all():
                assert errors[:, part].max() < 1.0, (clip.name, name)
            elif name.endswith("foot"):
                # A mocap foot ends at the ball, EllipBody's at the toes.
                assert errors[:, part].max() < 10.0, (clip.name, name)


def test_rotations_are_rotations_and_hips_are_locked(shared: Path) -> None:
    for clip in clips(shared):
        assert clip.rotations.shape == (len(clip), NUM_PARTS, 3, 3)
        assert rotation_error(torch.from_numpy(clip.rotations)).max() < 1e-9
        assert (clip.rotations[:, list(LOCKED_PARTS)] == np.eye(3)).all()


def test_walking_people_stand_upright_on_level_feet_that_point_ahead(shared: Path) -> None:
    walking = mocap.concatenate([clip for clip in clips(shared) if ".walking_" in clip.name][:20], "walking")
    assert np.median(walking.up_directions()[:, 1]) > 0.98
    joints = mocap.joint_positions(walking.global_orient, walking.rotations)
    height = {name: np.median(joints[:, j, 1]) for j, name in enumerate(JOINT_NAMES)}
    assert height["head_top"] > height["neck"] > height["spine"] > height["left_knee"] > height["left_ankle"]
    assert height["left_wrist"] < height["left_elbow"] < height["left_shoulder"]
    forward = walking.global_orient[:, :, 2]
    foot = directions(walking)[:, PART_NAMES.index("left_foot")]
    assert np.median((foot * forward).sum(-1)) > 0.7
    # Rolled feet would betray a wrong twist: the sole of the lower foot looks down.
    sole = walking.global_orient
    for part in ("left_upper_leg", "left_lower_leg", "left_foot"):
        sole = sole @ walking.rotations[:, PART_NAMES.index(part)]
    assert np.median(np.abs(sole[:, 1, 0])) < np.sin(np.radians(12))


def test_knees_bend_backward_and_elbows_forward(shared: Path) -> None:
    vectors = np.concatenate([clip.rotation_vectors() for clip in clips(shared)])
    for side, sign in (("left", -1.0), ("right", 1.0)):
        assert np.percentile(vectors[:, PART_NAMES.index(f"{side}_lower_leg"), 0], 1) > -0.1
        assert np.percentile(sign * vectors[:, PART_NAMES.index(f"{side}_forearm"), 1], 1) > -0.1


def test_mirroring_exchanges_the_sides_and_twice_is_nothing(shared: Path) -> None:
    clip = next(clip for clip in clips(shared) if clip.name == "asf.02_05")
    joints = mocap.joint_positions(clip.global_orient, clip.rotations)
    mirrored = clip.mirrored()
    mirrored_joints = mocap.joint_positions(mirrored.global_orient, mirrored.rotations)
    left, right = JOINT_NAMES.index("left_wrist"), JOINT_NAMES.index("right_wrist")
    np.testing.assert_allclose(mirrored_joints[:, left], joints[:, right] * [-1, 1, 1], atol=2e-3)
    np.testing.assert_allclose(mirrored.mirrored().rotations, clip.rotations, atol=1e-12)


def test_held_out_frames_come_from_held_out_clips_of_every_kind(shared: Path) -> None:
    held_out = [clip for clip in clips(shared) if mocap.is_held_out(clip)]
    names = {clip.name for clip in held_out}
    assert set(mocap.HELD_OUT) <= names
    assert not any(name.startswith("expmap.train") for name in names)
    frames = mocap_files.held_out_frames(shared / "data" / "mocap", 40)
    assert len(frames) == 40
    pool = np.concatenate([clip.rotations.reshape(len(clip), -1) for clip in held_out])
    for rotations in frames.rotations.reshape(40, -1)[::5]:
        assert np.abs(pool - rotations).max(1).min() == 0.0


def test_hands_that_are_turned_around_are_put_straight() -> None:
    rotations = np.tile(np.eye(3), (4, NUM_PARTS, 1, 1))
    hand, arm = PART_NAMES.index("right_hand"), PART_NAMES.index("right_upper_arm")
    half_turn, bend = np.diag([1.0, -1.0, -1.0]), mocap.rotation_matrices(np.array([0.0, 0.0, 1.2]))
    rotations[:, arm] = bend
    rotations[1, hand], rotations[2, hand], rotations[3, arm] = half_turn, bend, half_turn
    clip = mocap.Clip("clip", np.tile(np.eye(3), (4, 1, 1)), rotations, np.full((4, NUM_PARTS, 3), np.nan))
    assert len(mocap.without_errors(clip)) == 2
    sound = mocap.straightened(clip)
    assert (sound.rotations[1, hand] == np.eye(3)).all()
    assert (sound.rotations[2, hand] == bend).all()
    assert (sound.rotations[:, arm] == clip.rotations[:, arm]).all()
    assert len(mocap.without_errors(sound)) == 3  # an arm that is turned around is an error still
    assert (clip.rotations[1, hand] == half_turn).all()


def test_windows_leave_out_limbs_that_turn_around() -> None:
    rotations = np.tile(np.eye(3), (60, 20, 1, 1))
    still = mocap.Clip("still", rotations[:, 0], rotations, np.zeros((60, 20, 3)), np.zeros((60, 3)))
    assert [len(each) for each in mocap.smooth_windows(still, 20)] == [20, 20, 20]
    rotations[25, PART_NAMES.index("left_forearm")] = mocap.rotation_matrices(np.array([0.0, np.pi, 0.0]))
    windows = mocap.smooth_windows(still, 20)
    assert [len(each) for each in windows] == [20, 20]
    np.testing.assert_array_equal(windows[1].rotations, rotations[26:46])  # after it
    assert windows[0].positions.shape == (20, 3)
    assert mocap.smooth_windows(still, 61) == []


def test_held_out_windows_are_smooth_and_of_every_kind(shared: Path) -> None:
    windows = mocap_files.held_out_windows(shared / "data" / "mocap", 2.0)
    assert len(windows) > 20
    assert all(len(each) == 60 and mocap.is_held_out(each) for each in windows)
    assert len({each.name.partition("_")[0] for each in windows[:5]}) == 5
    walking = next(each for each in windows if "walking" in each.name)
    steps = np.diff(walking.positions, axis=0)
    assert 0.8 < np.linalg.norm(steps.mean(0)) * mocap_files.FRAME_RATE < 1.8  # [m/s]
    assert 0.8 < walking.positions[:, 1].mean() < 1.1  # [m] above the ground
    for each in windows[::6]:
        joints = mocap.joint_positions(each.global_orient, each.rotations)
        assert np.linalg.norm(np.diff(joints, 2, axis=0), axis=-1).mean(1).max() < 0.02


def test_a_folder_without_mocap_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"cmu_expmap\.npz"):
        mocap_files.load_clips(tmp_path)
