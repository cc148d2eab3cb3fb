"""EllipBody measured from a detailed body: the 20 ellipsoids that one would have on it, in its pose."""

from __future__ import annotations

import torch

from ..body.posing import pose
from ..body.rotations import rotation_between
from ..body.template import BONE_STARTS, JOINT_NAMES, LENGTH_NAMES, LOCKED_PARTS, PARENTS, PART_NAMES, template
from .growth import Growth
from .model import DetailedModel
from .pose import end_joints, rest_turns
from .registration import Registered
from .surfaces import vertex_parts

_LEFT_HIP, _RIGHT_HIP = PART_NAMES.index("left_hip"), PART_NAMES.index("right_hip")


def measure_ellipbody(body: Registered) -> tuple[torch.Tensor, ...]:
    """Arguments of ``pose`` for the EllipBodies of detailed bodies, in their frame.

    Lengths and thicknesses are measured at rest, sides averaged. Each bone has the direction that it has in the
    detailed body, and turns about it as that part of the body does; the pelvis' two are locked, and the line through
    the hips says where they point. The middle of all joints coincides.

    Returns:
        Orientation (B, 3, 3), position of the pelvis [m] (B, 3), local rotations (B, 20, 3, 3), ``LENGTH_NAMES`` [m]
        (B, 12), ``THICKNESS_NAMES`` [m] (B, 15).
    """
    model, shape = body.model, body.shape
    sizes = Growth(model, *vertex_parts(model), shape).measured(shape, body.stretches).exp()
    lengths, thicknesses = sizes[:, : len(LENGTH_NAMES)], sizes[:, len(LENGTH_NAMES) :]
    joints = model.landmarks(body.detailed, JOINT_NAMES)
    orientation, rotations = _rotations(body, joints)
    origin = joints.new_zeros(len(joints), 3)
    there = pose(orientation, origin, rotations, lengths, thicknesses, validate=False)
    return orientation, (joints - there.joints).mean(1), rotations, lengths, thicknesses


def statures(model: DetailedModel, shape: torch.Tensor) -> torch.Tensor:
    """Heights of standing people of shape values (B, S), shape (B,) [m]."""
    low, high = model.rest(shape).vertices[..., 1].aminmax(dim=1)
    return high - low


def _rotations(body: Registered, joints: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Orientation (B, 3, 3) and local rotations (B, 20, 3, 3) in which bones have the directions of these joints'."""
    world = body.detailed.transforms[..., :3, :3]
    turned = rest_turns(body.model, body.rest(), trunk_along=True)
    carried = world[:, end_joints(body.model)] @ turned.mT
    directions = torch.from_numpy(template().rest_directions).to(joints)
    bones = joints[:, 1:] - joints[:, BONE_STARTS]
    hips = directions[_LEFT_HIP] - directions[_RIGHT_HIP], bones[:, _LEFT_HIP] - bones[:, _RIGHT_HIP]
    orientation = rotation_between(world[:, 0] @ hips[0], hips[1]) @ world[:, 0]
    found: list[torch.Tensor] = []
    for part in range(len(PART_NAMES)):
        if part in LOCKED_PARTS:
            found.append(orientation)
            continue
        before = carried[:, part]
        found.append(rotation_between(before @ directions[part], bones[:, part]) @ before)
    above = [orientation if parent < 0 else found[parent] for parent in PARENTS]
    return orientation, torch.stack(above, dim=1).mT @ torch.stack(found, dim=1)
