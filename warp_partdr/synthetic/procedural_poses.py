"""Broad and plausible poses put together from ranges of joints.

EllipBody's rotation vectors [rad]; +x of a joint bends the trunk forward, the knee backward and turns the leg back, and
the left arm, which points to +x at rest, comes down about -z and forward about -y.
"""

from __future__ import annotations

from typing import NamedTuple

import torch

from ..body.rotations import rotation_between, rotation_from_axis_angle, rotation_to_axis_angle
from ..body.template import NUM_PARTS, PART_NAMES, template
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


class _Stance(NamedTuple):
    """Ranges of both legs; ``lean`` is the pelvis' [degrees] forward, ``alike`` the chance that both do the same."""

    weight: float
    lean: _Span
    first: _Leg
    second: _Leg
    alike: float = 0.0


_STRAIGHT = _Leg((-8, 12), (-3, 14), (0, 18), (-8, 10))
_STEPPING = _Leg((5, 60), (-5, 15), (0, 70), (-20, 20))
_BEHIND = _Leg((-32, 5), (-5, 15), (0, 80), (-15, 30))
_SEATED = _Leg((60, 105), (-5, 35), (30, 125), (-20, 25))
_DEEP = _Leg((55, 115), (0, 45), (75, 142), (-35, 0))
_KNEELING = _Leg((-15, 45), (-3, 25), (70, 140), (0, 45))
_LUNGING = _Leg((55, 105), (-3, 30), (50, 125), (-20, 10))
_RAISED = _Leg((30, 115), (-10, 45), (0, 110), (-10, 45))
_SPREAD_OUT = _Leg((-15, 35), (12, 48), (0, 60), (-20, 20))
_BENT = _Leg((-15, 20), (-3, 18), (0, 40), (-15, 10))
_LOOSE = _Leg((-15, 110), (-5, 40), (0, 135), (-20, 45))
_STANCES = (
    _Stance(0.20, (-8, 10), _STRAIGHT, _STRAIGHT),
    _Stance(0.20, (-5, 25), _STEPPING, _BEHIND),
    _Stance(0.16, (-25, 20), _SEATED, _SEATED, alike=0.5),
    _Stance(0.10, (0, 50), _DEEP, _DEEP, alike=0.6),
    _Stance(0.08, (-10, 30), _KNEELING, _LUNGING),
    _Stance(0.04, (-10, 40), _KNEELING, _KNEELING, alike=0.7),
    _Stance(0.08, (-20, 20), _RAISED, _STRAIGHT),
    _Stance(0.06, (-10, 20), _SPREAD_OUT, _SPREAD_OUT, alike=0.3),
    _Stance(0.10, (25, 95), _BENT, _BENT, alike=0.4),
    _Stance(0.08, (-80, -25), _SEATED, _RAISED, alike=0.5),  # reclining
)
_LYING = 0.16  # of all: any side up, any legs
_OVERTURNED = 0.2  # of these: whatever is up, the head below too


def draw_procedural(count: int, rng: TorchRng) -> Poses:
    """Broad and plausible poses put together from ranges of joints; limits and self-penetration are not looked at."""
    rotations = torch.zeros(count, NUM_PARTS, 3, device=rng.device)
    lean, rotations[:, _LEFT_LEG], rotations[:, _RIGHT_LEG] = _legs(count, rng)
    ups = rotation_from_axis_angle(torch.stack([lean, _between(count, rng, -4, 4), 0.1 * rng.normal(count)], 1))[:, 1]
    lying = rng.chance(_LYING, count)
    for parts, flip in ((_LEFT_LEG, 1.0), (_RIGHT_LEG, -1.0)):
        leg = _one_leg(_LOOSE, count, rng) * ups.new_tensor([1.0, flip, flip])
        rotations[:, parts] = torch.where(lying[:, None, None], leg, rotations[:, parts])
    level = rng.normal(count, 3)
    level[:, 1] *= torch.where(rng.chance(_OVERTURNED, count), 1.0, 0.25)
    ups = torch.where(lying[:, None], torch.nn.functional.normalize(level, dim=1), ups)
    rotations[:, _TRUNK] = _trunk(count, rng)
    rotations[:, _LEFT_ARM] = _arm(count, rng)
    rotations[:, _RIGHT_ARM] = _arm(count, rng) * torch.tensor([1.0, -1.0, -1.0], device=rng.device)
    return rotations, ups


def _between(count: int, rng: TorchRng, low: float, high: float) -> torch.Tensor:
    """Degrees in, radians out, shape (count,)."""
    return torch.deg2rad(rng.uniform(count, low=low, high=high))


def _one_leg(leg: _Leg, count: int, rng: TorchRng) -> torch.Tensor:
    """Rotation vectors of a left leg, shape (count, 3, 3)."""
    forward, outward, knee, foot = (_between(count, rng, *span) for span in leg)
    turn, toes = _between(count, rng, -12, 28), _between(count, rng, -10, 20)
    zero = torch.zeros_like(turn)
    return torch.stack([-forward, turn, outward, knee, zero, zero, foot, toes, zero], dim=1).unflatten(1, (3, 3))


def _legs(count: int, rng: TorchRng) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The pelvis' lean forward [rad], shape (count,), and vectors of left and right leg, shape (count, 3, 3) each."""
    which = rng.choice([stance.weight for stance in _STANCES], count)
    drawn = []
    for stance in _STANCES:
        lean = _between(count, rng, *stance.lean)
        first, second = (_one_leg(leg, count, rng) for leg in (stance.first, stance.second))
        second = torch.where(rng.chance(stance.alike, count, 1, 1), first + 0.1 * rng.normal(count, 3, 3), second)
        drawn.append(torch.cat([lean[:, None], first.flatten(1), second.flatten(1)], dim=1))
    chosen = torch.stack(drawn, dim=1)[torch.arange(count, device=rng.device), which]
    lean, left, right = chosen[:, 0], chosen[:, 1:10].unflatten(1, (3, 3)), chosen[:, 10:].unflatten(1, (3, 3))
    bent = torch.zeros_like(left)
    bent[:, 0, 0] = -lean  # thighs are where they are said to be from the vertical, not from the pelvis
    return lean, left + bent, right * right.new_tensor([1.0, -1.0, -1.0]) + bent


def _trunk(count: int, rng: TorchRng) -> torch.Tensor:
    """Rotation vectors of abdomen, chest, neck and head, shape (count, 4, 3)."""
    forward = torch.deg2rad(-12 + 62 * rng.uniform(count).square())
    back = torch.stack([forward, _between(count, rng, -30, 30), _between(count, rng, -28, 28)], dim=1)
    skull = torch.stack([_between(count, rng, *span) for span in ((-40, 45), (-65, 65), (-25, 25))], dim=1)
    share = rng.uniform(count, 1, low=0.3, high=0.7)
    return torch.stack([share * back, (1 - share) * back, 0.5 * skull, 0.5 * skull], dim=1)


# An upper arm's direction: above the horizontal, and from sideways to forward; its turn about itself, inward; and the
# elbow's bend [degrees].
_ARMS = (
    (0.3, (-88, -55), (-60, 100), (-30, 60), (0, 60)),  # hanging
    (0.4, (-88, 75), (-30, 115), (-60, 75), (0, 125)),  # anywhere
    (0.3, (-85, -20), (10, 95), (0, 80), (50, 125)),  # hands before the trunk
)


def _arm(count: int, rng: TorchRng) -> torch.Tensor:
    """Rotation vectors of a left shoulder, upper arm, forearm and hand, shape (count, 4, 3)."""
    which = rng.choice([arm[0] for arm in _ARMS], count)
    drawn = torch.stack([torch.stack([_between(count, rng, *s) for s in spans]) for _, *spans in _ARMS], dim=-1)
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
