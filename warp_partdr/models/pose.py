"""Transfer of EllipBody's pose to a detailed model: each limb points and twists as its ellipsoid does."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import NamedTuple

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
from ..body.template import BONE_STARTS, JOINT_NAMES, NUM_PARTS, PARENTS, PART_NAMES, template
from ..interop.captured_call import call_as_graph
from ..interop.device_cache import device_cache
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
_HIPS = slice(1, 3)  # of ``JOINT_NAMES``


class _Sharing(NamedTuple):
    """Turns of a model's joints, as indices: 0 to 19 of parts, 20 of the pelvis, then of K joints that go halfway.

    A joint that goes halfway turns as part ``bases`` does and then half the way to ``tips``: all of it where it is
    ``bent``, else the twist about the line from joint ``starts`` to joint ``ends``.
    """

    turns: torch.Tensor  # of joints that turn against their parents, shape (T,); the root isn't one
    above: torch.Tensor  # of their parents, shape (T,)
    order: torch.Tensor  # of all joints: 0 the root, 1 to T those that turn, T + 1 the others, shape (J,)
    bases: torch.Tensor  # shape (K,), as the others
    tips: torch.Tensor
    bent: torch.Tensor
    starts: torch.Tensor
    ends: torch.Tensor


def pose_from_ellipbody(
    model: DetailedModel, posed: Posed, shape: torch.Tensor | None = None, *, trunk_along: bool = False
) -> tuple[torch.Tensor, torch.Tensor]:
    """Pose a detailed model so that its limbs have the directions and twists of EllipBody's.

    The lengths of limbs may differ. So joints need not coincide; only the middle of the hips does.

    Args:
        model: The model, on the device and of the dtype of ``posed``.
        posed: B EllipBodies.
        shape: Shape values of the model, (B, S), on which bones' directions at rest depend a little. Default 0.
        trunk_along: The trunk's bones have EllipBody's directions, too, as where its joints are a person's. By default
            they turn as EllipBody's do from rest, as where the pose is a person's.

    Returns:
        Local rotations, shape (B, J, 3, 3), and position of the root joint [m], shape (B, 3), for ``model.pose``.

    Raises:
        ValueError: If ``shape`` has another number of shape values than the model.

    Examples:
        >>> import torch
        >>> from warp_partdr import BodyParameters, anny, pose_from_ellipbody
        >>> model, posed = anny(), BodyParameters.mean(1).posed()
        >>> rotations, translation = pose_from_ellipbody(model, posed)
        >>> model.pose(torch.zeros(1, model.num_shapes), rotations, translation).joints.shape
        torch.Size([1, 104, 3])
    """
    if shape is None:
        shape = posed.rotations.new_zeros(len(posed.rotations), model.num_shapes)
    rotations, translation = call_as_graph(_pose_limbs, (posed.rotations, posed.joints, shape), model, trunk_along)
    return rotations, translation


def _pose_limbs(
    turns: torch.Tensor, joints: torch.Tensor, shape: torch.Tensor, model: DetailedModel, trunk_along: bool
) -> tuple[torch.Tensor, torch.Tensor]:
    """Compute ``pose_from_ellipbody`` from the rotations (B, 20, 3, 3) and joints (B, 21, 3) of EllipBodies."""
    marks, rest = model.rest_landmarks(shape, _marks(model))
    parts = turns @ _turns_at_rest(model, marks, trunk_along)
    # The two hips are the pelvis; the mean is exact where they haven't been turned against each other.
    pelvis = rotation_from_6d(rotation_to_6d(parts[:, 0] + parts[:, 1]))[:, None]
    sharing = _sharing(model)
    frames = torch.cat([parts, pelvis], dim=1)
    bases = frames[:, sharing.bases]
    ways = rotation_to_axis_angle(bases.mT @ frames[:, sharing.tips])
    twists = _half_twists(ways, rest[:, sharing.ends] - rest[:, sharing.starts])
    halves = rotation_from_axis_angle(torch.where(sharing.bent[:, None], ways / 2, twists))
    frames = torch.cat([frames, bases @ halves], dim=1)

    turned = frames[:, sharing.above].mT @ frames[:, sharing.turns]
    still = torch.eye(3, dtype=rest.dtype, device=rest.device).expand_as(pelvis)
    rotations = torch.cat([pelvis, turned, still], dim=1)[:, sharing.order]
    middle = marks[:, _HIPS].mean(1) - rest[:, 0]
    return rotations, joints[:, _HIPS].mean(1) - (pelvis[:, 0] @ middle[..., None])[..., 0]


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
    return _turns_at_rest(model, model.landmarks(rest, _marks(model)), trunk_along)


def _turns_at_rest(model: DetailedModel, marks: torch.Tensor, trunk_along: bool) -> torch.Tensor:
    """Rotation of each part from rest to EllipBody's rest pose, found by landmarks as ``rest_turns`` does.

    ``marks`` are where the landmarks ``_marks`` of bodies at rest lie, shape (B, L, 3).
    """
    return call_as_graph(_find_turns, (marks,), model, trunk_along)[0]


def _find_turns(marks: torch.Tensor, model: DetailedModel, trunk_along: bool) -> tuple[torch.Tensor]:
    """Compute ``_turns_at_rest``."""
    aimed = (*_AIMED, *_TRUNK) if trunk_along else _AIMED
    joints, ends = marks[:, : len(JOINT_NAMES)].unbind(1), marks[:, len(JOINT_NAMES) :]
    bones = [joint - joints[start] for joint, start in zip(joints[1:], BONE_STARTS, strict=True)]
    directions, palms = _rest_frames(marks.device, marks.dtype)
    # The last one is the pelvis, for parts that hang on it.
    turns = [torch.eye(3, dtype=marks.dtype, device=marks.device).expand(len(marks), 3, 3)] * (NUM_PARTS + 1)
    framed = _framed_hands(model)
    for parts in _levels((*aimed, "hand"), framed):
        inherited = torch.stack([turns[PARENTS[part]] for part in parts], dim=1)
        turned = (inherited @ torch.stack([bones[part] for part in parts], dim=1)[..., None])[..., 0]
        aims = torch.stack([directions[part] for part in parts]).expand_as(turned)
        found = rotation_between(turned, aims) @ inherited
        for part, turn in zip(parts, found.unbind(1), strict=True):
            turns[part] = turn
    if framed:
        hands = torch.stack([bones[part] for part in framed], dim=1)
        found = torch.stack([palms[part] for part in framed]) @ _frame(hands, ends[:, 1::2] - ends[:, ::2]).mT
        for part, turn in zip(framed, found.unbind(1), strict=True):
            turns[part] = turn
    return (torch.stack(turns[:-1], dim=1),)


@lru_cache(maxsize=16)
def _marks(model: DetailedModel) -> tuple[str, ...]:
    """Landmarks that say how a model's parts lie at rest: joints, then both ends of the palms that it knows."""
    sides = (PART_NAMES[part].removesuffix("_hand") for part in _framed_hands(model))
    return *JOINT_NAMES, *(f"{side}_{finger}" for side in sides for finger in ("pinky", "index"))


@lru_cache(maxsize=16)
def _framed_hands(model: DetailedModel) -> tuple[int, ...]:
    """Hands whose palms a model knows, as parts."""
    known = {*model.landmark_names}
    sides = [side for side in ("left", "right") if {f"{side}_index", f"{side}_pinky"} <= known]
    return tuple([PART_NAMES.index(f"{side}_hand") for side in sides])


@cache
def _levels(kinds: tuple[str, ...], framed: tuple[int, ...]) -> list[list[int]]:
    """Parts of some kinds, but for ``framed`` ones, by the number of such parts in a row that they hang on."""
    depths: dict[int, int] = {}
    for part, (name, parent) in enumerate(zip(PART_NAMES, PARENTS, strict=True)):
        if without_side(name) in kinds and part not in framed:
            depths[part] = 1 + depths.get(parent, -1)
    return [[part for part in depths if depths[part] == level] for level in range(1 + max(depths.values()))]


@device_cache(8)
def _rest_frames(device: torch.device, dtype: torch.dtype) -> tuple[torch.Tensor, dict[int, torch.Tensor]]:
    """Directions of EllipBody's bones at rest, shape (20, 3), and axes of its hands, whose palms are down."""
    with torch.inference_mode(False):  # kept for calls outside of it, too
        directions = torch.from_numpy(template().rest_directions)
        hands = [PART_NAMES.index(f"{side}_hand") for side in ("left", "right")]
        forward = directions.new_tensor([0.0, 0.0, 1.0])
        palms = {hand: _frame(directions[hand], forward).to(device, dtype) for hand in hands}
        return directions.to(device, dtype), palms


@device_cache(16)
def _sharing(model: DetailedModel) -> _Sharing:
    carried = _carried_parts(model)
    sources: list[int] = []
    for joint, parent in enumerate(model.parents):
        inherited = NUM_PARTS if parent < 0 else sources[parent]
        sources.append(PART_NAMES.index(carried[joint]) if joint in carried else inherited)
    halfway: dict[int, tuple[int, int, bool, int, int]] = {}
    for part, (name, above, joint) in enumerate(zip(PART_NAMES, PARENTS, model.part_joints, strict=True)):
        kind, start = without_side(name), NUM_PARTS if above < 0 else above
        between = _joint_between(model, joint, carried)
        if between is None:
            continue
        if kind in _BENDING:
            halfway[joint] = start, part, True, joint, between
        elif kind in _TWISTING_FIRST:
            halfway[joint] = part, start, False, joint, between
        elif kind in _TWISTING_LAST:
            end = PART_NAMES.index(name.replace(kind, _TWISTING_LAST[kind]))
            halfway[between] = part, end, False, between, model.part_joints[end]
    for index, joint in enumerate(halfway):
        sources[joint] = NUM_PARTS + 1 + index
    turning = [joint for joint, parent in enumerate(model.parents) if joint and sources[joint] != sources[parent]]
    order = [turning.index(joint) + 1 if joint in turning else len(turning) + 1 for joint in range(model.num_joints)]
    with torch.inference_mode(False):  # kept for calls outside of it, too
        columns = torch.tensor([*halfway.values()], dtype=torch.long).reshape(-1, 5).T.tolist()
        turns = [[sources[joint], sources[model.parents[joint]]] for joint in turning]
        rows = *map(list, zip(*turns, strict=True)), [0, *order[1:]], *columns
        found = _Sharing(*(torch.tensor(row, dtype=torch.long, device=model.faces.device) for row in rows))
        return found._replace(bent=found.bent.bool())


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


def _half_twists(ways: torch.Tensor, axes: torch.Tensor) -> torch.Tensor:
    """Half of that part of rotation vectors that turns about ``axes`` (swing-twist decomposition), (B, K, 3) each."""
    axes = torch.nn.functional.normalize(axes, dim=-1)
    angles = ways.norm(dim=-1, keepdim=True)
    along = (ways * axes).sum(-1, keepdim=True) / angles.clamp(min=1e-12)
    return axes * torch.atan2(along * (angles / 2).sin(), (angles / 2).cos())
