"""Hands of touching poses are where their gesture wants them, on the skin and not in it."""

from __future__ import annotations

import pytest
import torch

from warp_partdr.body.landmarks import mirror_order
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.template import PART_NAMES
from warp_partdr.lab.synthetic.poses import Poses, clear_poses, joint_limits, mean_body, mirrored
from warp_partdr.lab.synthetic.procedural_poses import SEATED, STANDING, draw_procedural
from warp_partdr.lab.synthetic.rng import TorchRng
from warp_partdr.lab.synthetic.touching_poses import GESTURES, touching

NAMES = list(GESTURES)
HANDS = [PART_NAMES.index(f"{side}_hand") for side in ("left", "right")]
ARMS = [PART_NAMES.index(f"left_{name}") for name in ("shoulder", "upper_arm", "forearm", "hand")]
BOTH_ARMS = ARMS + [part + 1 for part in ARMS]


def untouched(count: int, device: str) -> Poses:
    rng, half = TorchRng(2, device), count // 2
    standing, seated = draw_procedural(half, rng, STANDING), draw_procedural(count - half, rng, SEATED)
    limits = joint_limits(torch.device(device))
    return limits.clamp(torch.cat([standing[0], seated[0]])), torch.cat([standing[1], seated[1]])


def touched(count: int, device: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Rotation vectors of poses that are clear, and their gestures."""
    limits = joint_limits(torch.device(device))
    (rotations, _), which = touching(untouched(count, device), limits, TorchRng(3, device))
    good = (which >= 0) & clear_poses(rotations)
    return rotations[good], which[good]


def depth_over(rotations: torch.Tensor, part: str) -> torch.Tensor:
    """Distances of both hands' middles from a part's skin, along the ray from its middle [m], shape (N, 2)."""
    posed, index = mean_body(rotation_from_axis_angle(rotations)), PART_NAMES.index(part)
    offsets = posed.centres[:, HANDS] - posed.centres[:, None, index]
    inside = (offsets @ posed.axes[:, index] / posed.semi_axes[:, None, index]).norm(dim=-1)
    return offsets.norm(dim=-1) * (1 - 1 / inside)


def test_every_gesture_is_made() -> None:
    _, which = touched(12_000, "cpu")
    assert set(which.tolist()) == set(range(len(GESTURES)))


@pytest.mark.parametrize(
    ("gesture", "part", "hands"),
    [
        ("hand at face", "head", 1),
        ("hand at ear", "head", 1),
        ("hand on belly", "abdomen", 1),
        ("hands on hips", "abdomen", 2),
    ],
)
def test_hands_touch_but_do_not_enter(gesture: str, part: str, hands: int, device: str) -> None:
    rotations, which = touched(6000, device)
    depth = depth_over(rotations[which == NAMES.index(gesture)], part)[:, :hands]
    assert len(depth) > 5
    assert depth.min() > 0.0
    assert depth.max() < 0.14  # parts overlap, and palms are 25 mm above the skin


def test_hands_behind_the_back_are_behind_it(device: str) -> None:
    rotations, which = touched(8000, device)
    rotations = rotations[which == NAMES.index("hands behind back")]
    posed, trunk = mean_body(rotation_from_axis_angle(rotations)), PART_NAMES.index("abdomen")
    hands = (posed.centres[:, HANDS] - posed.centres[:, [trunk]]) @ posed.rotations[:, trunk]
    assert len(hands) > 5
    assert (hands[..., 2] < -0.08).all()
    assert ((hands[:, 0] - hands[:, 1]).norm(dim=1) < 0.09).all()  # one on the other


def test_only_arms_move_and_they_keep_to_the_limits(device: str) -> None:
    poses, limits = untouched(500, device), joint_limits(torch.device(device))
    (rotations, ups), which = touching(poses, limits, TorchRng(0, device))
    others = [part for part in range(len(PART_NAMES)) if part not in BOTH_ARMS]
    assert torch.equal(ups, poses[1])
    assert torch.equal(rotations[:, others], poses[0][:, others])
    right = [part + 1 for part in ARMS]
    one = torch.tensor([GESTURES[name].second is None for name in NAMES], device=device)[which.clamp(min=0)] & (
        which >= 0
    )
    assert one.any()
    assert torch.equal(rotations[one][:, right], poses[0][one][:, right])
    assert (rotations == limits.clamp(rotations)).all()
    assert 0.2 < (which >= 0).float().mean() < 0.9


def test_mirroring_twice_changes_nothing(device: str) -> None:
    poses = untouched(8, device)
    again = mirrored(mirrored(poses))
    assert torch.equal(again[0], poses[0])
    assert torch.equal(again[1], poses[1])
    centres, others = (mean_body(rotation_from_axis_angle(each[0])).centres for each in (poses, mirrored(poses)))
    flipped = centres[:, mirror_order(PART_NAMES)] * centres.new_tensor([-1.0, 1.0, 1.0])
    torch.testing.assert_close(others, flipped, atol=1e-5, rtol=0)


@pytest.mark.parametrize("count", [0, 1])
def test_few_bodies_touch_themselves_as_well(count):
    rotations, ups = untouched(4, "cpu")
    (found, _), which = touching(
        (rotations[:count], ups[:count]), joint_limits(torch.device("cpu")), TorchRng(0, "cpu")
    )
    assert (len(found), len(which)) == (count, count)


def test_poses_of_other_shapes_and_dtypes_are_refused():
    rotations, ups = untouched(4, "cpu")
    limits, rng = joint_limits(torch.device("cpu")), TorchRng(0, "cpu")
    for wrong, name in (
        ((rotations.double(), ups), "rotations"),
        ((rotations[:, :3], ups), "rotations"),
        ((rotations, ups[:2]), "ups"),
    ):
        with pytest.raises(ValueError, match=f"{name}: "):
            touching(wrong, limits, rng)
