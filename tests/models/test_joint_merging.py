"""Detailed models of few joints: the same body wherever only those turn that stayed."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from helpers.bodies import walker

from warp_partdr.body.template import PART_NAMES
from warp_partdr.models.anny import anny
from warp_partdr.models.joint_merging import merge_joints
from warp_partdr.models.joint_turns import turn_joints
from warp_partdr.models.model import DetailedModel
from warp_partdr.models.pose import free_joints, pose_from_ellipbody, turning_joints


def model_with_bends(bends: bool) -> DetailedModel:
    whole = anny()
    if not bends:
        return whole
    size = 9 * (whole.num_joints - 1), 3 * whole.num_vertices
    return replace(whole, pose_directions=1e-3 * torch.randn(*size, generator=torch.Generator().manual_seed(0)))


@pytest.mark.parametrize("bends", [False, True])
def test_the_same_body_turns_with_fewer_joints(bends):
    whole = model_with_bends(bends)
    turning = turning_joints(whole)
    few = merge_joints(whole, turning)
    assert few.num_joints == len(turning) < whole.num_joints / 3
    shape = torch.linspace(-1.5, 1.5, whole.num_shapes)[None]
    rotations, place = pose_from_ellipbody(whole, walker().posed(), shape)
    free = torch.tensor(free_joints(whole))
    turns = 0.3 * torch.randn(1, len(free), 3, generator=torch.Generator().manual_seed(1))
    rotations = turn_joints(rotations, free, turns)
    assert [few.joint_names[joint] for joint in free_joints(few)] == [whole.joint_names[joint] for joint in free]
    want, have = whole.pose(shape, rotations, place), few.pose(shape, rotations[:, turning], place)
    torch.testing.assert_close(have.vertices[:, : whole.num_vertices], want.vertices, atol=1e-5, rtol=0)
    torch.testing.assert_close(have.joints, want.joints[:, turning], atol=1e-5, rtol=0)
    names = whole.landmark_names
    torch.testing.assert_close(few.landmarks(have, names), whole.landmarks(want, names), atol=1e-5, rtol=0)


def test_parts_stay_with_their_joints():
    whole, few = anny(), merge_joints(anny(), turning_joints(anny()))
    assert few.bone_of_part == whole.bone_of_part
    assert set(few.bone_of_part) == set(PART_NAMES)
    torch.testing.assert_close(few.skin_weights.sum(1), torch.ones(few.num_vertices), atol=1e-5, rtol=0)


def test_a_joint_that_carries_a_part_can_not_go():
    whole = anny()
    left_out = [joint for joint in turning_joints(whole) if joint != whole.part_joints[3]]
    with pytest.raises(ValueError, match=rf"kept: without joints \[{whole.part_joints[3]}\]"):
        merge_joints(whole, left_out)
