"""Transfer of EllipBody's pose to a detailed model: each limb points and twists as its ellipsoid does."""

from __future__ import annotations

from functools import cache

import torch

from ..body.landmarks import without_side
from ..body.posing import Posed
from ..body.rotations import (
    rotation_between,
    rotation_from_6d,
    rotation_from_axis_angle,
    rotation_to_6d,
    rotation_to_axis_angle,
)
from ..body.template import JOINT_NAMES, NUM_PARTS, PARENTS, PART_NAMES, template
from .model import Detailed, DetailedModel

# Parts whose bone has another direction in a model's rest pose than in EllipBody's.
_AIMED = ("upper_leg", "lower_leg", "upper_arm", "forearm")
# Of these, a model's bones lie a little askew in a body that stands as EllipBody does.
_TRUNK = ("abdomen", "chest", "neck", "shoulder")
# Where a part has several joints, the skin turns little by little: those of the trunk go halfway at the first one; the
# upper limbs go halfway there in twist alone, so that the bone's direction stays; the lower limbs' last joint goes
# halfway to the twist of the hand or foot.
_BENDING = ("abdomen", "chest", "neck")
_TWISTING_FIRST = ("upper_leg", "upper_arm")
_TWISTING_LAST = {"lower_leg": "foot", "forearm": "hand"}


def pose_from_ellipbody(
    model: DetailedModel, posed: Posed, shape: torch.Tensor | None = None, *, trunk_along: bool = False
) -> tuple[torch.Tensor, torch.Tensor]:
    """A detailed model's pose in which its limbs have the directions and twists of EllipBody's.

    Lengths may differ, so joints need not coincide: the middle of the hips does.

    Args:
        model: On the device and of the dtype of ``posed``.
        posed: EllipBodies.
        shape: Shape values of the model, (B, S), on which bones' directions at rest depend a little. Default 0.
        trunk_along: The trunk's bones have EllipBody's directions, too, as where its joints are a person's. By default
            they turn as EllipBody's do from rest, as where the pose is a person's.

    Returns:
        Local rotations, shape (B, J, 3, 3), and position of the root joint [m], shape (B, 3), for ``model.pose``.
    """
    batch = len(posed.rotations)
    rest = model.rest(posed.rotations.new_zeros(batch, model.num_shapes) if shape is None else shape)
    turned = rest_turns(model, rest, trunk_along=trunk_along)
    parts = dict(zip(PART_NAMES, (posed.rotations @ turned).unbind(1), strict=True))
    # The two hips are the pelvis; the mean is exact where they haven't been turned against each other.
    pelvis = rotation_from_6d(rotation_to_6d(parts["left_hip"] + parts["right_hip"]))

    carried = _carried_parts(model)
    world: list[torch.Tensor] = []
    for joint, parent in enumerate(model.parents):
        world.append(pelvis if parent < 0 else parts[carried[joint]] if joint in carried else world[parent])
    for (part, turn), above, joint in zip(parts.items(), PARENTS, model.part_joints, strict=True):
        kind = without_side(part)
        between = _joint_between(model, joint, carried)
        if between is None:
            continue
        start = pelvis if above < 0 else parts[PART_NAMES[above]]
        if kind in _BENDING:
            half = rotation_to_axis_angle(start.mT @ turn) / 2
            world[joint] = start @ rotation_from_axis_angle(half)
        elif kind in _TWISTING_FIRST:
            axis = rest.joints[:, between] - rest.joints[:, joint]
            world[joint] = turn @ _half_twist(start.mT @ turn, axis).mT
        elif kind in _TWISTING_LAST:
            end = part.replace(kind, _TWISTING_LAST[kind])
            axis = rest.joints[:, model.part_joints[PART_NAMES.index(end)]] - rest.joints[:, between]
            world[between] = turn @ _half_twist(turn.mT @ parts[end], axis)

    turns = torch.stack(world, dim=1)
    rotations = torch.cat([turns[:, :1], turns[:, list(model.parents[1:])].mT @ turns[:, 1:]], dim=1)
    hips = ("left_hip", "right_hip")
    middle = model.landmarks(rest, hips).mean(1) - rest.joints[:, 0]
    between_hips = posed.joints[:, [JOINT_NAMES.index(name) for name in hips]].mean(1)
    return rotations, between_hips - (pelvis @ middle[..., None])[..., 0]


def free_joints(model: DetailedModel) -> list[int]:
    """Joints that carry a part, and the root: those that refinements turn; others turn with them."""
    return sorted({0, *model.part_joints})


def end_joints(model: DetailedModel) -> list[int]:
    """Joint of each of the 20 parts that turns as the part's far end does, where several share its turn."""
    ends: list[int] = []
    for part, joint in zip(PART_NAMES, model.part_joints, strict=True):
        between = _joint_between(model, joint, _carried_parts(model))
        ends.append(joint if between is None or without_side(part) in _TWISTING_LAST else between)
    return ends


def turning_joints(model: DetailedModel) -> list[int]:
    """Joints that ``pose_from_ellipbody`` or refinements turn against their parents, in order, the root first."""
    between = {_joint_between(model, joint, _carried_parts(model)) for joint in model.part_joints}
    return sorted({joint for joint in between if joint is not None}.union(free_joints(model)))


def rest_turns(model: DetailedModel, rest: Detailed, *, trunk_along: bool = False) -> torch.Tensor:
    """Rotation of each part from the model's rest pose to EllipBody's, shape (B, 20, 3, 3)."""
    aimed = (*_AIMED, *_TRUNK) if trunk_along else _AIMED
    like = rest.joints
    identity = torch.eye(3, dtype=like.dtype, device=like.device).expand(len(like), 3, 3)
    directions = torch.from_numpy(template().rest_directions).to(like).expand(len(like), -1, -1)
    known = dict(zip(model.landmark_names, model.landmarks(rest, model.landmark_names).unbind(1), strict=True))
    bones = {part: known[JOINT_NAMES[part + 1]] - known[JOINT_NAMES[PARENTS[part] + 1]] for part in range(NUM_PARTS)}
    turns = [identity] * NUM_PARTS
    hands = [
        (PART_NAMES.index(f"{side}_hand"), known[f"{side}_index"] - known[f"{side}_pinky"])
        for side in ("left", "right")
        if {f"{side}_index", f"{side}_pinky"} <= known.keys()
    ]
    framed = {part for part, _ in hands}
    for parts in _levels():
        some = [part for part in parts if without_side(PART_NAMES[part]) in (*aimed, "hand") and part not in framed]
        if some:
            inherited = torch.stack([turns[PARENTS[part]] for part in some])
            turned = (inherited @ torch.stack([bones[part] for part in some])[..., None])[..., 0]
            found = rotation_between(turned, directions[:, some].transpose(0, 1)) @ inherited
            turns = [found[some.index(part)] if part in some else turn for part, turn in enumerate(turns)]
    for part, across in hands:
        forward = torch.tensor([0.0, 0.0, 1.0]).to(like).expand_as(across)  # EllipBody's palms are down
        turns[part] = _frame(directions[:, part], forward) @ _frame(bones[part], across).mT
    return torch.stack(turns, dim=1)


@cache
def _levels() -> list[list[int]]:
    """Parts by the number of parts between them and the pelvis."""
    depths: list[int] = []
    for parent in PARENTS:
        depths.append(0 if parent < 0 else 1 + depths[parent])
    return [[part for part, depth in enumerate(depths) if depth == level] for level in range(1 + max(depths))]


def _carried_parts(model: DetailedModel) -> dict[int, str]:
    """Part that each joint carries, but for the root."""
    return {joint: part for joint, part in zip(model.part_joints, PART_NAMES, strict=True) if joint != 0}


def _joint_between(model: DetailedModel, joint: int, carried: dict[int, str]) -> int | None:
    """Child of a part's joint that carries no part but has a descendant that does."""
    leading = set()
    for other in carried:
        while (other := model.parents[other]) >= 0:
            leading.add(other)
    children = [child for child, parent in enumerate(model.parents) if parent == joint]
    return next((child for child in children if child in leading and child not in carried), None)


def _frame(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Right-handed orthonormal axes as columns, along ``first``, then toward ``second``, shape (B, 3, 3)."""
    return rotation_from_6d(torch.cat([first, second], dim=-1))


def _half_twist(rotation: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Half of that part of a rotation that turns about ``axis`` (swing-twist decomposition), shape (B, 3, 3)."""
    axis = torch.nn.functional.normalize(axis, dim=-1)
    vector = rotation_to_axis_angle(rotation)
    angle = vector.norm(dim=-1, keepdim=True)
    along = (vector * axis).sum(-1, keepdim=True) / angle.clamp(min=1e-12)
    return rotation_from_axis_angle(axis * torch.atan2(along * (angle / 2).sin(), (angle / 2).cos()))
