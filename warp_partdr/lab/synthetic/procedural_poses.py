"""Broad and plausible poses put together from ranges of joints.

EllipBody's rotation vectors [rad]; +x of a joint bends the trunk forward, the knee backward and turns the leg back, and
the left arm, which points to +x at rest, comes down about -z and forward about -y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch

from ...body.rotations import rotation_between, rotation_from_axis_angle, rotation_to_axis_angle
from ...body.template import NUM_PARTS, PART_NAMES, template
from .poses import Poses
from .rng import TorchRng


def _parts(*names: str) -> list[int]:
    return [PART_NAMES.index(name) for name in names]


_TRUNK = _parts("abdomen", "chest", "neck", "head")
_LEFT_ARM = _parts("left_shoulder", "left_upper_arm", "left_forearm", "left_hand")
_LEFT_LEG = _parts("left_upper_leg", "left_lower_leg", "left_foot")
_RIGHT_ARM, _RIGHT_LEG = ([part + 1 for part in parts] for parts in (_LEFT_ARM, _LEFT_LEG))
LIMBS = (_TRUNK, _LEFT_ARM, _RIGHT_ARM, [*_LEFT_LEG, *_RIGHT_LEG])

_Span = tuple[float, float]


class _Leg(NamedTuple):
    """Ranges [degrees]: of the thigh from hanging, forward and outward, of the knee, and of the foot, toes down."""

    forward: _Span
    outward: _Span
    knee: _Span
    foot: _Span
    turn: _Span = (-12, 28)  # of the thigh about itself, toes outward


class _Stance(NamedTuple):
    """Ranges of both legs; ``lean`` is the pelvis' [degrees] forward, ``alike`` the chance that both do the same."""

    weight: float
    lean: _Span
    first: _Leg
    second: _Leg
    alike: float = 0.0


_STRAIGHT = _Leg((-8, 12), (-3, 14), (0, 18), (-8, 10))
_EASED = _Leg((-5, 28), (-5, 20), (5, 50), (-15, 25))
_ON_ONE_LEG = _Leg((-25, 80), (-10, 40), (10, 115), (-15, 40))
_STEPPING = _Leg((5, 60), (-5, 15), (0, 70), (-20, 20))
_BEHIND = _Leg((-32, 5), (-5, 15), (0, 80), (-15, 30))
_SEATED = _Leg((60, 105), (-5, 35), (30, 125), (-20, 25))
_ON_CHAIR = _Leg((65, 108), (-14, 30), (20, 130), (-20, 30), (-25, 38))
_CROSSED_OVER = _Leg((88, 112), (-26, -8), (40, 100), (-10, 35))
_CROSSED_UNDER = _Leg((68, 92), (-6, 10), (65, 105), (-15, 15))
_ANKLE_ON_KNEE = _Leg((80, 112), (25, 50), (85, 135), (-20, 20), (25, 48))
_CROSS_LEGGED = _Leg((75, 118), (25, 50), (105, 142), (0, 45), (5, 45))
_DEEP = _Leg((55, 115), (0, 45), (75, 142), (-35, 0))
_KNEELING = _Leg((-15, 45), (-3, 25), (70, 140), (0, 45))
_LUNGING = _Leg((55, 105), (-3, 30), (50, 125), (-20, 10))
_RAISED = _Leg((30, 115), (-10, 45), (0, 110), (-10, 45))
_SPREAD_OUT = _Leg((-15, 35), (12, 48), (0, 60), (-20, 20))
_BENT = _Leg((-15, 20), (-3, 18), (0, 40), (-15, 10))
_LOOSE = _Leg((-15, 110), (-5, 40), (0, 135), (-20, 45))
_KICKING = _Leg((55, 122), (-15, 45), (0, 60), (-10, 48))
_STRETCHED_BACK = _Leg((-60, -15), (-5, 25), (0, 100), (0, 48))
_TUCKED = _Leg((20, 120), (-5, 40), (40, 142), (-10, 45))


class _Arm(NamedTuple):
    """Ranges [degrees].

    Of an upper arm above the horizontal, from sideways to forward, and about itself, inward, and of the elbow.
    """

    up: _Span
    forward: _Span
    inward: _Span
    bend: _Span


_HANGING = _Arm((-88, -55), (-60, 100), (-30, 60), (0, 60))
_AT_EASE = _Arm((-90, -66), (-40, 100), (-25, 60), (2, 50))
_AT_TABLE = _Arm((-89, -40), (20, 110), (0, 85), (40, 122))
_ANYWHERE = _Arm((-88, 75), (-30, 115), (-60, 75), (0, 125))
_BEFORE_TRUNK = _Arm((-85, -20), (10, 95), (0, 80), (50, 125))
_OVERHEAD = _Arm((25, 76), (-10, 110), (-60, 60), (0, 90))
_DRAWN_BACK = _Arm((-40, 40), (-45, 20), (-75, 20), (30, 125))
_AHEAD = _Arm((-45, 35), (50, 115), (-40, 60), (0, 70))


@dataclass(frozen=True)
class Repertoire:
    """Ranges of poses of a kind."""

    stances: tuple[_Stance, ...]
    arms: tuple[tuple[float, _Arm], ...]  # each with its weight
    bend: _Span  # of the back forward, from the likeliest to the least likely [degrees]
    turn: float  # of the back sideways, of the widest
    lying: float = 0.0  # share of all: any side up, any legs
    overturned: float = 0.0  # share of these: whatever is up, the head below too


BROAD = Repertoire(
    stances=(
        _Stance(0.14, (-8, 10), _STRAIGHT, _STRAIGHT),
        _Stance(0.16, (-5, 25), _STEPPING, _BEHIND),
        _Stance(0.10, (-25, 20), _SEATED, _SEATED, alike=0.5),
        _Stance(0.12, (0, 50), _DEEP, _DEEP, alike=0.6),
        _Stance(0.10, (-10, 30), _KNEELING, _LUNGING),
        _Stance(0.05, (-10, 40), _KNEELING, _KNEELING, alike=0.7),
        _Stance(0.08, (-20, 20), _RAISED, _STRAIGHT),
        _Stance(0.06, (-10, 20), _SPREAD_OUT, _SPREAD_OUT, alike=0.3),
        _Stance(0.12, (25, 95), _BENT, _BENT, alike=0.4),
        _Stance(0.07, (-80, -25), _SEATED, _RAISED, alike=0.5),  # reclining
    ),
    arms=((0.3, _HANGING), (0.4, _ANYWHERE), (0.3, _BEFORE_TRUNK)),
    bend=(-12, 50),
    turn=1.0,
    lying=0.16,
    overturned=0.2,
)
# People in photos stand, on one leg more than on the other, and do little with their arms.
STANDING = Repertoire(
    stances=(
        _Stance(0.33, (-7, 8), _STRAIGHT, _STRAIGHT, alike=0.3),
        _Stance(0.36, (-7, 8), _STRAIGHT, _EASED),
        _Stance(0.06, (-7, 20), _STRAIGHT, _ON_ONE_LEG),
        _Stance(
            0.25, (-5, 12), _Leg((3, 32), (-5, 12), (0, 30), (-15, 15)), _Leg((-30, 3), (-5, 12), (0, 60), (-10, 30))
        ),
    ),
    arms=((0.50, _AT_EASE), (0.15, _HANGING), (0.23, _BEFORE_TRUNK), (0.12, _ANYWHERE)),
    bend=(-10, 26),
    turn=0.6,
)
SEATED = Repertoire(
    stances=(
        _Stance(0.50, (-25, 25), _ON_CHAIR, _ON_CHAIR, alike=0.6),
        _Stance(0.14, (-20, 15), _CROSSED_OVER, _CROSSED_UNDER),
        _Stance(0.06, (-20, 15), _ANKLE_ON_KNEE, _CROSSED_UNDER),
        _Stance(0.12, (-20, 25), _CROSS_LEGGED, _CROSS_LEGGED, alike=0.5),
        _Stance(0.08, (15, 70), _TUCKED, _STEPPING),  # on a bicycle
        _Stance(0.10, (-45, 5), _RAISED, _RAISED, alike=0.6),  # on the floor
    ),
    arms=((0.45, _AT_TABLE), (0.20, _HANGING), (0.20, _BEFORE_TRUNK), (0.15, _ANYWHERE)),
    bend=(-10, 48),
    turn=0.8,
)
SPORT = Repertoire(
    stances=(
        _Stance(0.20, (-25, 30), _KICKING, _EASED),
        _Stance(0.22, (0, 60), _LUNGING, _STRETCHED_BACK),
        _Stance(0.16, (-10, 45), _LUNGING, _SPREAD_OUT),
        _Stance(0.08, (-20, 30), _KICKING, _STRETCHED_BACK),  # splits and leaps
        _Stance(0.08, (-20, 45), _SPREAD_OUT, _SPREAD_OUT, alike=0.7),
        _Stance(0.12, (-20, 50), _TUCKED, _TUCKED, alike=0.6),
        _Stance(0.14, (-25, 20), _STRAIGHT, _EASED),  # serves and throws
    ),
    arms=((0.30, _OVERHEAD), (0.20, _DRAWN_BACK), (0.20, _AHEAD), (0.30, _ANYWHERE)),
    bend=(-25, 45),
    turn=1.0,
    lying=0.10,
    overturned=0.8,  # handstands, cartwheels, somersaults
)
_LYING_LOOSE = 0.6  # of those who lie, the others' legs are as they would stand


def draw_procedural(count: int, rng: TorchRng, repertoire: Repertoire = BROAD) -> Poses:
    """Broad and plausible poses put together from ranges of joints; limits and self-penetration are not looked at."""
    rotations = torch.zeros(count, NUM_PARTS, 3, device=rng.device)
    lean, rotations[:, _LEFT_LEG], rotations[:, _RIGHT_LEG] = _legs(repertoire.stances, count, rng)
    ups = rotation_from_axis_angle(torch.stack([lean, _between(count, rng, -4, 4), 0.1 * rng.normal(count)], 1))[:, 1]
    lying = rng.chance(repertoire.lying, count)
    loose = lying & rng.chance(_LYING_LOOSE, count)
    for parts, flip in ((_LEFT_LEG, 1.0), (_RIGHT_LEG, -1.0)):
        leg = _one_leg(_LOOSE, count, rng) * ups.new_tensor([1.0, flip, flip])
        rotations[:, parts] = torch.where(loose[:, None, None], leg, rotations[:, parts])
    level = rng.normal(count, 3)
    level[:, 1] *= torch.where(rng.chance(repertoire.overturned, count), 1.0, 0.25)
    ups = torch.where(lying[:, None], torch.nn.functional.normalize(level, dim=1), ups)
    rotations[:, _TRUNK] = _trunk(repertoire, count, rng)
    rotations[:, _LEFT_ARM] = _arm(repertoire.arms, count, rng)
    rotations[:, _RIGHT_ARM] = _arm(repertoire.arms, count, rng) * torch.tensor([1.0, -1.0, -1.0], device=rng.device)
    return rotations, ups


def _between(count: int, rng: TorchRng, low: float, high: float) -> torch.Tensor:
    """Degrees in, radians out, shape (count,)."""
    return torch.deg2rad(rng.uniform(count, low=low, high=high))


def _one_leg(leg: _Leg, count: int, rng: TorchRng) -> torch.Tensor:
    """Rotation vectors of a left leg, shape (count, 3, 3)."""
    forward, outward, knee, foot, turn = (_between(count, rng, *span) for span in leg)
    toes = _between(count, rng, -10, 20)
    zero = torch.zeros_like(turn)
    return torch.stack([-forward, turn, outward, knee, zero, zero, foot, toes, zero], dim=1).unflatten(1, (3, 3))


def _legs(stances: Sequence[_Stance], count: int, rng: TorchRng) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The pelvis' lean forward [rad], shape (count,), and vectors of left and right leg, shape (count, 3, 3) each."""
    which = rng.choice([stance.weight for stance in stances], count)
    drawn = []
    for stance in stances:
        lean = _between(count, rng, *stance.lean)
        first, second = (_one_leg(leg, count, rng) for leg in (stance.first, stance.second))
        second = torch.where(rng.chance(stance.alike, count, 1, 1), first + 0.1 * rng.normal(count, 3, 3), second)
        drawn.append(torch.cat([lean[:, None], first.flatten(1), second.flatten(1)], dim=1))
    chosen = torch.stack(drawn, dim=1)[torch.arange(count, device=rng.device), which]
    lean, left, right = chosen[:, 0], chosen[:, 1:10].unflatten(1, (3, 3)), chosen[:, 10:].unflatten(1, (3, 3))
    bent = torch.zeros_like(left)
    bent[:, 0, 0] = -lean  # thighs are where they are said to be from the vertical, not from the pelvis
    return lean, left + bent, right * right.new_tensor([1.0, -1.0, -1.0]) + bent


def _trunk(repertoire: Repertoire, count: int, rng: TorchRng) -> torch.Tensor:
    """Rotation vectors of abdomen, chest, neck and head, shape (count, 4, 3)."""
    (least, most), wide = repertoire.bend, repertoire.turn
    forward = torch.deg2rad(least + (most - least) * rng.uniform(count).square())
    back = torch.stack([forward, *(wide * _between(count, rng, -span, span) for span in (30, 28))], dim=1)
    skull = torch.stack([_between(count, rng, *span) for span in ((-40, 45), (-65, 65), (-25, 25))], dim=1)
    share = rng.uniform(count, 1, low=0.3, high=0.7)
    return torch.stack([share * back, (1 - share) * back, 0.5 * skull, 0.5 * skull], dim=1)


def _arm(arms: Sequence[tuple[float, _Arm]], count: int, rng: TorchRng) -> torch.Tensor:
    """Rotation vectors of a left shoulder, upper arm, forearm and hand, shape (count, 4, 3)."""
    which = rng.choice([weight for weight, _ in arms], count)
    drawn = torch.stack([torch.stack([_between(count, rng, *span) for span in arm]) for _, arm in arms], dim=-1)
    up, forward, inward, bend = drawn.gather(-1, which.expand(4, count)[..., None])[..., 0]
    direction = torch.stack([up.cos() * forward.cos(), up.sin(), up.cos() * forward.sin()], dim=1)
    rest = direction.new_tensor(template().rest_directions[_parts("left_upper_arm")[0]]).expand_as(direction)
    upper = rotation_to_axis_angle(rotation_between(rest, direction) @ rotation_from_axis_angle(rest * inward[:, None]))
    tilt = _between(count, rng, -10, 55)
    zero = torch.zeros_like(tilt)
    forearm = torch.stack([zero, -bend * tilt.cos(), bend * tilt.sin()], dim=1)
    shoulder = torch.stack([zero, _between(count, rng, -12, 8), 0.25 * up.clamp(min=0)], dim=1)
    hand = rng.normal(count, 3) * torch.deg2rad(direction.new_tensor([30.0, 18.0, 18.0]))
    return torch.stack([shoulder, upper, forearm, hand], dim=1)
