"""Poses of people with hands on their body: on hips, face and knees, folded, clasped, behind the back, in pockets.

An arm reaches a place on the skin of EllipBody by two bones of known length. Where the elbow is on its circle, how the
elbow's axis lies and which side of the hand touches is drawn anew a few times; what fits the joint limits and passes
through no trunk is taken. All is written for left arms: for right ones the body is mirrored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch

from ...body.posing import Posed
from ...body.rotations import rotation_from_axis_angle, rotation_to_axis_angle
from ...body.template import JOINT_NAMES, PART_NAMES
from ...interop.checks import check_tensor
from .poses import JointLimits, Poses, mean_body, mirrored
from .rng import TorchRng

_TRIES = 12  # of each arm
_SPREAD = 0.22  # of a place's direction
_ABOVE_SKIN = 0.006  # [m]
_STEP, _STEPS = 0.012, 8  # [m], outward, where parts overlap
_MISSED = 0.02  # [m], how far off a hand may end up
_OVER_LIMITS = 0.05  # [rad]
_HINGE = (0.0, 0.5)  # tilt of the elbow's axis in the upper arm [rad]
_LOW_ELBOW = 0.4  # how much lower elbows are preferred to chance
_PALM = 0.7  # how much palms on the body are preferred to chance
_SHRUG = (5.0, 14.0, 9.0)  # of the shoulder, at most [degrees]
_ELBOW_SIDE = (0.25, -1.0, -0.35)  # where elbows are when nothing is swivelled: down, outward and back
_ROUNDS = 3
_ALONG_SKIN = 0.85  # of the forearm's slope towards the skin, hands leave out so much
_STRETCHED = 0.998  # an arm that is straighter than this has no elbow's axis

_SHOULDER, _UPPER, _FOREARM, _HAND = (
    PART_NAMES.index(f"left_{name}") for name in ("shoulder", "upper_arm", "forearm", "hand")
)
_JOINT = JOINT_NAMES.index("left_shoulder")
_TRUNK_AND_THIGHS = "left_hip right_hip abdomen chest neck head left_upper_leg right_upper_leg".split()
_IN_THE_WAY = [PART_NAMES.index(name) for name in _TRUNK_AND_THIGHS]


class Place(NamedTuple):
    """A place of a left hand's middle: over a part's skin in a direction from its middle."""

    part: str
    direction: tuple[float, float, float]  # left, up and ahead at rest, on the part stretched to a sphere
    gap: tuple[float, float] = (0.0, 0.0)  # range of the distance to the hand [m]


@dataclass(frozen=True)
class Gesture:
    """Gesture of one hand or of two.

    The second hand's place is given as if it were the left hand, too, and the first one the right.
    """

    weight: float
    first: Place
    second: Place | None = None


_WAIST = Place("abdomen", (1.0, -0.4, 0.15))
_HIP = Place("left_hip", (1.0, 0.4, 0.3))
_POCKET = Place("left_upper_leg", (0.8, 0.62, 0.45))
_BACK_POCKET = Place("left_hip", (0.75, -0.1, -1.0))
_BELLY = Place("abdomen", (0.1, -0.4, 1.0))
_LOWER_BACK = Place("abdomen", (0.1, -0.5, -1.0))
_KNEE = Place("left_upper_leg", (0.1, -0.85, 0.55))
_THIGH = Place("left_upper_leg", (0.15, -0.35, 1.0))
_FACE = Place("head", (0.35, -0.45, 0.9))
_EAR = Place("head", (1.0, -0.15, 0.1))
_NAPE = Place("head", (0.35, -0.35, -1.0))
_AHEAD = Place("chest", (0.2, -0.3, 1.0), (0.1, 0.35))
_ON_HAND = Place("right_hand", (0.0, -1.0, 0.0))
_ON_BACK_OF_HAND = Place("right_hand", (0.0, 1.0, 0.0))

GESTURES: dict[str, Gesture] = {
    "hands on hips": Gesture(0.09, _WAIST, _WAIST),
    "hand on hip": Gesture(0.1, _HIP),
    "hands in pockets": Gesture(0.06, _POCKET, _POCKET),
    "hand in pocket": Gesture(0.05, _POCKET),
    "hands in back pockets": Gesture(0.015, _BACK_POCKET, _BACK_POCKET),
    "hand at face": Gesture(0.07, _FACE),
    "hand at ear": Gesture(0.055, _EAR),
    "hand over eyes": Gesture(0.012, Place("head", (0.35, 0.6, 0.9))),
    "hand on head": Gesture(0.015, Place("head", (0.5, 1.0, 0.0))),
    "hands behind head": Gesture(0.1, _NAPE, _NAPE),
    "hands at face": Gesture(0.06, _FACE, _FACE),
    "arms folded": Gesture(0.25, Place("chest", (-0.8, -0.7, 0.7)), Place("right_upper_arm", (-0.5, 0.5, 0.8))),
    "hand on other arm": Gesture(0.06, Place("right_upper_arm", (-0.2, 0.0, 1.0))),
    "hand on other forearm": Gesture(0.03, Place("right_forearm", (0.0, 0.2, 1.0))),
    "hands clasped": Gesture(0.14, Place("abdomen", (-0.1, -0.8, 1.0), (0.0, 0.2)), _ON_BACK_OF_HAND),
    "hands together": Gesture(0.04, Place("chest", (-0.1, -0.4, 1.0), (0.03, 0.3)), _ON_HAND),
    "hands behind back": Gesture(0.15, _LOWER_BACK, _ON_BACK_OF_HAND),
    "hand behind back": Gesture(0.07, _LOWER_BACK),
    "hands on back": Gesture(0.06, _LOWER_BACK, Place("abdomen", (0.7, -0.3, -0.9))),
    "hand on belly": Gesture(0.03, _BELLY),
    "hand on chest": Gesture(0.025, Place("chest", (-0.2, 0.1, 1.0))),
    "hand on shoulder": Gesture(0.02, Place("right_shoulder", (-0.5, 0.7, 0.6))),
    "thing held": Gesture(0.06, _AHEAD, _AHEAD),
    "hands overhead": Gesture(0.06, Place("head", (-0.1, 1.0, 0.1), (0.02, 0.3)), _ON_HAND),
    "hands on knees": Gesture(0.12, _KNEE, _KNEE),
    "hands on thighs": Gesture(0.09, _THIGH, _THIGH),
    "hand on shin": Gesture(0.05, Place("left_lower_leg", (0.3, 0.2, 1.0))),
}


def touching(poses: Poses, limits: JointLimits, rng: TorchRng) -> tuple[Poses, torch.Tensor]:
    """Poses with arms that do one of ``GESTURES`` each, and which, shape (N,): the index, or -1 where none fits.

    Args:
        poses: Rotation vectors (N, 20, 3) and up directions (N, 3) of bodies, whose other parts stay as they are.
        limits: The joints' limits, which the arms keep.
        rng: Source of chance.

    Raises:
        ValueError: If a shape, dtype or device differs.
    """
    rotations, ups = poses
    check_tensor("rotations", rotations, (None, len(PART_NAMES), 3), dtypes=(torch.float32,))
    check_tensor("ups", ups, (len(rotations), 3), dtypes=(torch.float32,), like=("rotations", rotations))
    gestures = tuple(GESTURES.values())
    which = rng.choice([gesture.weight for gesture in gestures], len(ups))
    rotations, reached = _reach_places(rotations, [gesture.first for gesture in gestures], which, limits, rng)
    turned, _ = mirrored((rotations, ups))
    seconds = [gesture.second or gesture.first for gesture in gestures]
    turned, also = _reach_places(turned, seconds, which, limits, rng)
    both = torch.tensor([gesture.second is not None for gesture in gestures], device=rng.device)[which]
    rotations = torch.where(both[:, None, None], mirrored((turned, ups))[0], rotations)
    return (rotations, ups), torch.where(reached & (also | ~both), which, -1)


def _reach_places(
    rotations: torch.Tensor, places: list[Place], which: torch.Tensor, limits: JointLimits, rng: TorchRng
) -> tuple[torch.Tensor, torch.Tensor]:
    """Rotation vectors (N, 20, 3) with left hands at the places that ``which`` (N,) chooses, and a mask of success."""
    count, tries = len(rotations), (len(rotations), _TRIES)
    rotations = rotations.clone()
    shrug = torch.deg2rad(rotations.new_tensor(_SHRUG))
    rotations[:, _SHOULDER] = shrug * rng.uniform(count, 3, low=-1.0, high=1.0)
    posed = mean_body(rotation_from_axis_angle(rotations))
    goal, normal = _over_skin(posed, places, which, rng)
    arm = _two_bones(posed, goal, normal, rng.uniform(*tries, low=-torch.pi, high=torch.pi))
    palm = torch.where(rng.chance(0.5, *tries), 1.0, -1.0)
    vectors = _arm_vectors(posed, arm, normal, rng.uniform(*tries, low=_HINGE[0], high=_HINGE[1]), palm)

    held = limits.clamp(vectors, [_UPPER, _FOREARM, _HAND])
    over = (vectors - held)[:, :, :2].abs().flatten(2).amax(-1)  # a hand may turn less than asked for
    points = torch.stack([arm.elbow, *(arm.elbow.lerp(arm.wrist, share) for share in (0.35, 0.7, 1.0))], dim=2)
    good = (over < _OVER_LIMITS) & arm.bent & ~_in_the_way(posed, points)
    height = arm.elbow[..., 1] - posed.joints[:, _JOINT, None, 1]
    cost = rng.uniform(*tries) + _LOW_ELBOW * height / posed.semi_axes[:, _UPPER, :1] - _PALM * (palm > 0)
    best = torch.where(good, cost, torch.inf).argmin(1)
    rotations[:, [_UPPER, _FOREARM, _HAND]] = held[torch.arange(count, device=rng.device), best]
    hand = mean_body(rotation_from_axis_angle(rotations)).centres[:, _HAND]
    return rotations, good.any(1) & ((hand - goal).norm(dim=-1) < _MISSED)


class _ReachingArm(NamedTuple):
    """Arms that reach, several tries for each of N bodies."""

    elbow: torch.Tensor  # shape (N, tries, 3) [m]
    wrist: torch.Tensor  # likewise
    hand: torch.Tensor  # direction of the hand, likewise
    bent: torch.Tensor  # False where the arm is too short, or too long, shape (N, tries), bool


def _over_skin(
    posed: Posed, places: list[Place], which: torch.Tensor, rng: TorchRng
) -> tuple[torch.Tensor, torch.Tensor]:
    """Targets of left hands' middles, about one of ``places`` each, and the skin's normals there, (N, 3) each."""
    row, device = torch.arange(len(which), device=which.device), which.device
    parts = torch.tensor([PART_NAMES.index(place.part) for place in places], device=device)[which]
    directions, gaps = (
        torch.tensor([getattr(place, name) for place in places], device=device)[which] for name in ("direction", "gap")
    )
    directions = directions + _SPREAD * rng.normal(len(which), 3)
    axes, sizes = posed.axes[row, parts], posed.semi_axes[row, parts]
    unit = _unit((axes.mT @ posed.rotations[row, parts] @ directions[..., None])[..., 0])
    normal = _unit((axes @ (unit / sizes)[..., None])[..., 0])
    skin = posed.centres[row, parts] + (axes @ (unit * sizes)[..., None])[..., 0]
    thickness = posed.semi_axes[:, _HAND, 2:] + _ABOVE_SKIN
    gap = gaps[:, :1] + (gaps[:, 1:] - gaps[:, :1]) * rng.uniform(len(which), 1)
    over = thickness + gap + _STEP * torch.arange(_STEPS, device=device)
    points = skin[:, None] + over[..., None] * normal[:, None]  # (N, steps, 3)
    free = ~_in_the_way(posed, points[:, :, None], thickness[..., None] - _ABOVE_SKIN / 2)
    return points[row, free.int().argmax(1)], normal


def _two_bones(posed: Posed, goal: torch.Tensor, normal: torch.Tensor, swivel: torch.Tensor) -> _ReachingArm:
    """Arms whose hands' middles are at ``goal`` (N, 3), along the skin, with elbows turned by ``swivel`` (N, tries)."""
    shoulder, goal, normal = posed.joints[:, _JOINT, None], goal[:, None], normal[:, None]
    upper, lower, half_hand = (
        2 * posed.semi_axes[:, _UPPER, :1],
        2 * posed.semi_axes[:, _FOREARM, :1],
        posed.semi_axes[:, _HAND, :1],
    )
    hand = _unit(goal - shoulder).expand(*swivel.shape, 3)
    aside = goal.new_tensor(_ELBOW_SIDE)
    for _ in range(_ROUNDS):  # the hand's direction follows from the forearm's, and moves the wrist
        wrist = goal - half_hand[..., None] * hand
        distance = (wrist - shoulder).norm(dim=-1)
        towards = (wrist - shoulder) / distance[..., None]
        inside = (upper.square() - lower.square() + distance.square()) / (2 * distance)
        radius = (upper.square() - inside.square()).clamp(min=0).sqrt()
        first = _unit(aside - (aside * towards).sum(-1, keepdim=True) * towards)
        second = torch.linalg.cross(towards, first)
        out = swivel.cos()[..., None] * first + swivel.sin()[..., None] * second
        elbow = shoulder + inside[..., None] * towards + radius[..., None] * out
        last, forearm = hand, _unit(wrist - elbow)
        hand = _unit(forearm - _ALONG_SKIN * (forearm * normal).sum(-1, keepdim=True) * normal)
    return _ReachingArm(elbow, wrist, last, inside.abs() < _STRETCHED * upper)


def _arm_vectors(
    posed: Posed, arm: _ReachingArm, normal: torch.Tensor, tilt: torch.Tensor, palm: torch.Tensor
) -> torch.Tensor:
    """Rotation vectors of upper arms, forearms and hands, shape (N, tries, 3, 3).

    Of elbows whose axis is tilted by ``tilt`` (N, tries) [rad], and hands with the palm on the skin where ``palm``
    (N, tries) is 1, with the back where it is -1.
    """
    upper, lower = _unit(arm.elbow - posed.joints[:, _JOINT, None]), _unit(arm.wrist - arm.elbow)
    across = torch.linalg.cross(upper, lower)
    bend = torch.atan2(across.norm(dim=-1), (upper * lower).sum(-1))
    zero, one = torch.zeros_like(tilt), torch.ones_like(tilt)
    axis = torch.stack([zero, -tilt.cos(), tilt.sin()], dim=-1)
    turn = _frame(upper, _unit(across)) @ _frame(torch.stack([one, zero, zero], dim=-1), axis).mT
    forearm = bend[..., None] * axis
    back = _unit(normal[:, None] - (normal[:, None] * arm.hand).sum(-1, keepdim=True) * arm.hand)
    hand = (turn @ rotation_from_axis_angle(forearm)).mT @ _frame(arm.hand, palm[..., None] * back)
    upper_arm = posed.rotations[:, None, _SHOULDER].mT @ turn
    return torch.stack([rotation_to_axis_angle(upper_arm), forearm, rotation_to_axis_angle(hand)], dim=2)


def _unit(vectors: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.normalize(vectors, dim=-1)


def _frame(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Rotations whose columns are two perpendicular directions (..., 3) and what is square to both, (..., 3, 3)."""
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


def _in_the_way(posed: Posed, points: torch.Tensor, margin: torch.Tensor | float = 0.0) -> torch.Tensor:
    """True where one of points (N, tries, P, 3) is inside the trunk, a thigh or the head, or nearer, (N, tries)."""
    offsets = points[:, None] - posed.centres[:, _IN_THE_WAY, None, None]  # (N, parts, tries, P, 3)
    sizes = posed.semi_axes[:, _IN_THE_WAY] + margin
    offsets = offsets.flatten(2, 3) @ posed.axes[:, _IN_THE_WAY] / sizes[:, :, None]
    inside = (offsets.square().sum(-1) < 1.0).unflatten(2, points.shape[1:3])
    return inside.any(3).any(1)
