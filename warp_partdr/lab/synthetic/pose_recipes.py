"""Poses of PartBench's people: drawn from the pose prior, or put together so that they hide parts of themselves.

EllipBody's rotation vectors; +x of a joint bends it forward (the trunk), backward (the knee) or turns the leg back, and
the left arm, which points to +x at rest, comes down about -z, twists about x and bends the elbow about -y.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from ...body.rotations import rotation_from_axis_angle, rotation_to_axis_angle
from ...body.template import LOCKED_PARTS, NUM_PARTS, PART_NAMES
from .poses import clear_poses, draw_from_prior, joint_limits

_JITTER = 0.12  # [rad], of every joint of a pose put together
_TOUCHING_JITTER = 0.03  # [rad], where hands are to stay on the body
_LEAN = 0.08  # [rad], of its pelvis

Bends = dict[str, tuple[float, float, float]]


class Pose(NamedTuple):
    """Rotation vectors [rad], shape (20, 3); up, seen from the pelvis, shape (3,); turn from the camera [rad]."""

    rotations: np.ndarray
    up: np.ndarray
    yaw: float


def _arm(down: float, forward: float, inward: float, bend: float) -> Bends:
    """Rotation vectors of a left arm: lowered, then swung forward, turned about itself and bent [degrees]."""
    upper = _turn(-forward, 0, 0) @ _turn(0, 0, -down) @ _turn(inward, 0, 0)
    vector = np.degrees(rotation_to_axis_angle(upper).numpy())
    return {"upper_arm": (vector[0], vector[1], vector[2]), "forearm": (0.0, -bend, 0.0)}


def _turn(x: float, y: float, z: float) -> torch.Tensor:
    return rotation_from_axis_angle(torch.tensor([x, y, z], dtype=torch.float64).deg2rad())


def _leg(forward: float, outward: float, bend: float, ankle: float = 0.0) -> Bends:
    return {"upper_leg": (-forward, 0.0, outward), "lower_leg": (bend, 0.0, 0.0), "foot": (ankle, 0.0, 0.0)}


@dataclass(frozen=True)
class _Recipe:
    """Degrees: limbs of either side as if it were the left one, the trunk, the pelvis' lean and the yaw's range."""

    left: Bends
    right: Bends
    trunk: float = 0.0  # bend forward of abdomen and chest each
    lean: float = 0.0  # of the pelvis, forward
    yaw: tuple[float, float] = (-180.0, 180.0)
    jitter: float = _JITTER  # [rad], of every joint


def _crossed_arms(rng: np.random.Generator) -> _Recipe:
    low, high = (_arm(68, forward, 55, bend) for forward, bend in ((20, 95), (36, 100)))
    return _Recipe(low | _leg(2, 5, 5), high | _leg(0, 5, 3), trunk=3, yaw=(-70, 70))


def _sitting(rng: np.random.Generator) -> _Recipe:
    legs = [_leg(rng.uniform(75, 95), rng.uniform(3, 15), rng.uniform(70, 100)) for _ in range(2)]
    arms = [_arm(72, rng.uniform(10, 30), rng.uniform(0, 30), rng.uniform(30, 70)) for _ in range(2)]
    return _Recipe(arms[0] | legs[0], arms[1] | legs[1], trunk=rng.uniform(0, 12), lean=rng.uniform(-10, 5))


def _crouching(rng: np.random.Generator) -> _Recipe:
    hip, knee = rng.uniform(95, 115), rng.uniform(105, 130)
    leg = _leg(hip, rng.uniform(8, 18), knee, -15)
    arms = [_arm(65, rng.uniform(35, 75), rng.uniform(0, 40), rng.uniform(15, 60)) for _ in range(2)]
    return _Recipe(arms[0] | leg, arms[1] | leg, trunk=rng.uniform(10, 20), lean=rng.uniform(15, 30))


def _arm_before_torso(rng: np.random.Generator) -> _Recipe:
    across = _arm(75, rng.uniform(15, 40), rng.uniform(30, 65), rng.uniform(80, 110))
    other = _arm(rng.uniform(60, 85), rng.uniform(-10, 20), 0, rng.uniform(5, 40))
    return _Recipe(across | _leg(5, 6, 8), other | _leg(0, 4, 4), yaw=(-110, 110))


def _walking_away(rng: np.random.Generator) -> _Recipe:
    step, swing = rng.uniform(18, 32), rng.uniform(15, 35)
    left = _arm(78, -swing, 10, rng.uniform(5, 25)) | _leg(step, 1, rng.uniform(5, 20))
    right = _arm(78, swing, 10, rng.uniform(15, 45)) | _leg(-0.6 * step, 1, rng.uniform(15, 45))
    return _Recipe(left, right, trunk=2, lean=3, yaw=(130, 230))


def _bending_down(rng: np.random.Generator) -> _Recipe:
    legs = [_leg(rng.uniform(45, 65), rng.uniform(2, 8), rng.uniform(5, 30)) for _ in range(2)]
    arms = [_arm(72, rng.uniform(45, 80), 10, rng.uniform(5, 40)) for _ in range(2)]
    return _Recipe(arms[0] | legs[0], arms[1] | legs[1], trunk=rng.uniform(12, 22), lean=rng.uniform(35, 55))


def _hanging(rng: np.random.Generator) -> Bends:
    return _arm(rng.uniform(70, 82), rng.uniform(-15, 20), rng.uniform(0, 30), rng.uniform(5, 35))


def _at_ease(rng: np.random.Generator) -> tuple[Bends, Bends]:
    """Legs of somebody who stands on one of them more than on the other."""
    eased = _leg(rng.uniform(4, 20), rng.uniform(2, 10), rng.uniform(12, 38), rng.uniform(-5, 10))
    return _leg(rng.uniform(-3, 3), rng.uniform(1, 6), rng.uniform(0, 6)), eased


def _standing_at_ease(rng: np.random.Generator) -> _Recipe:
    first, second = _at_ease(rng)
    return _Recipe(_hanging(rng) | first, _hanging(rng) | second, trunk=rng.uniform(-2, 6))


def _hands_on_hips(rng: np.random.Generator) -> _Recipe:
    first, second = _at_ease(rng)
    arms = [_arm(rng.uniform(50, 66), rng.uniform(-55, -47), 7, rng.uniform(103, 114)) for _ in range(2)]
    return _Recipe(arms[0] | first, arms[1] | second, jitter=_TOUCHING_JITTER)


def _phone_at_ear(rng: np.random.Generator) -> _Recipe:
    first, second = _at_ease(rng)
    raised = _arm(rng.uniform(52, 60), rng.uniform(100, 110), rng.uniform(40, 52), rng.uniform(119, 123))
    return _Recipe(raised | first, _hanging(rng) | second, jitter=_TOUCHING_JITTER)


def _hands_clasped(rng: np.random.Generator) -> _Recipe:
    first, second = _at_ease(rng)
    down, more = rng.uniform(64, 68), rng.uniform(-2, 2)
    arms = [_arm(down, forward, 90, bend + more) for forward, bend in ((24, 85), (34, 79))]
    return _Recipe(arms[0] | first, arms[1] | second, jitter=_TOUCHING_JITTER)


def _hands_behind_back(rng: np.random.Generator) -> _Recipe:
    first, second = _at_ease(rng)
    arms = [_arm(86, rng.uniform(-62, -50), rng.uniform(30, 50), bend) for bend in (68, 80)]
    return _Recipe(arms[0] | first, arms[1] | second, trunk=rng.uniform(-4, 4), jitter=_TOUCHING_JITTER)


def _legs_crossed(rng: np.random.Generator) -> _Recipe:
    over = _leg(rng.uniform(92, 104), rng.uniform(-18, -10), rng.uniform(60, 85), 10)
    under = _leg(rng.uniform(74, 84), rng.uniform(-2, 5), rng.uniform(80, 98))
    arms = [_arm(72, rng.uniform(5, 30), rng.uniform(0, 30), rng.uniform(30, 70)) for _ in range(2)]
    return _Recipe(arms[0] | over, arms[1] | under, trunk=rng.uniform(0, 12), lean=rng.uniform(-12, 5))


def _kneeling(rng: np.random.Generator) -> _Recipe:
    down = _leg(rng.uniform(-5, 20), rng.uniform(2, 12), rng.uniform(95, 120), 20)
    up = _leg(rng.uniform(75, 92), rng.uniform(2, 15), rng.uniform(75, 95))
    return _Recipe(_hanging(rng) | down, _hanging(rng) | up, trunk=rng.uniform(0, 15), lean=rng.uniform(-5, 15))


def _kicking(rng: np.random.Generator) -> _Recipe:
    leg = _leg(rng.uniform(60, 92), rng.uniform(0, 20), rng.uniform(5, 40), 25)
    arms = [_arm(rng.uniform(15, 55), rng.uniform(-15, 50), 0, rng.uniform(15, 65)) for _ in range(2)]
    return _Recipe(arms[0] | leg, arms[1] | _leg(rng.uniform(-6, 6), 3, 10), lean=rng.uniform(-15, 0))


def _serving(rng: np.random.Generator) -> _Recipe:
    first, second = _at_ease(rng)
    high = _arm(rng.uniform(-84, -65), rng.uniform(-15, 10), rng.uniform(-100, -80), rng.uniform(8, 35))
    back = _arm(rng.uniform(-25, 10), rng.uniform(-20, 10), rng.uniform(-70, -30), rng.uniform(80, 115))
    return _Recipe(high | first, back | second, trunk=rng.uniform(-9, 0), lean=rng.uniform(-8, 8))


POSES: dict[str, Callable[[np.random.Generator], _Recipe]] = {
    "crossed arms": _crossed_arms,
    "sitting": _sitting,
    "crouching": _crouching,
    "arm before torso": _arm_before_torso,
    "walking away": _walking_away,
    "bending down": _bending_down,
    "standing at ease": _standing_at_ease,
    "hands on hips": _hands_on_hips,
    "phone at ear": _phone_at_ear,
    "hands clasped": _hands_clasped,
    "hands behind back": _hands_behind_back,
    "legs crossed": _legs_crossed,
    "kneeling": _kneeling,
    "kicking": _kicking,
    "serving": _serving,
}


def _reclining(rng: np.random.Generator) -> _Recipe:
    legs = [_leg(rng.uniform(20, 80), rng.uniform(0, 20), rng.uniform(5, 90)) for _ in range(2)]
    arms = [_arm(rng.uniform(45, 85), rng.uniform(-25, 40), rng.uniform(0, 30), rng.uniform(5, 90)) for _ in range(2)]
    return _Recipe(arms[0] | legs[0], arms[1] | legs[1], trunk=rng.uniform(0, 15), lean=rng.uniform(-75, -25))


def _riding(rng: np.random.Generator) -> _Recipe:
    """Pose of a rider who is seen from a side."""
    legs = [_leg(rng.uniform(45, 75), rng.uniform(18, 32), rng.uniform(45, 85), -10) for _ in range(2)]
    arms = [_arm(75, rng.uniform(15, 35), rng.uniform(10, 40), rng.uniform(50, 85)) for _ in range(2)]
    aside = rng.choice([-1.0, 1.0]) * rng.uniform(55, 125)
    return _Recipe(arms[0] | legs[0], arms[1] | legs[1], trunk=rng.uniform(0, 10), yaw=(aside, aside))


def _on_one_leg(rng: np.random.Generator) -> _Recipe:
    """Pose with a lower leg that is hidden behind the thigh."""
    raised = _leg(rng.uniform(-10, 25), rng.uniform(0, 10), rng.uniform(75, 120), 20)
    first, _ = _at_ease(rng)
    return _Recipe(_hanging(rng) | raised, _hanging(rng) | first, trunk=rng.uniform(-2, 8), yaw=(-35, 35))


LYING = "lying"  # any pose of the prior, on its back, front or side
TILTED_POSES = ("prior", LYING, "reclining", "sitting")
_RECIPES = POSES | {"reclining": _reclining, "riding": _riding, "on one leg": _on_one_leg}


def draw_pose(kind: str, rng: np.random.Generator) -> Pose:
    """A random pose of a kind, "prior", a key of ``POSES`` or one of ``TILTED_POSES``, no limb inside another part."""
    while True:
        drawn = _from_prior(rng) if kind in ("prior", LYING) else _from_recipe(kind, rng)
        if drawn is not None and clear_poses(torch.from_numpy(drawn.rotations)[None].float()):
            return drawn._replace(up=_level(rng)) if kind == LYING else drawn


def _level(rng: np.random.Generator) -> np.ndarray:
    """A direction upward of somebody who lies, about square to the trunk."""
    up = rng.standard_normal(3) * [1.0, 0.2, 1.0]
    return up / np.linalg.norm(up)


def _from_prior(rng: np.random.Generator) -> Pose | None:
    drawn = draw_from_prior(rng)
    if drawn is None:
        return None
    return Pose(drawn[0][0].numpy(), drawn[1][0].numpy(), rng.uniform(-np.pi, np.pi))


def _from_recipe(kind: str, rng: np.random.Generator) -> Pose:
    recipe = _RECIPES[kind](rng)
    sides = [recipe.left, recipe.right] if rng.random() < 0.5 else [recipe.right, recipe.left]
    rotations = np.zeros((NUM_PARTS, 3))
    for side, bends in zip(("left", "right"), sides, strict=True):
        mirror = np.array([1.0, 1.0, 1.0] if side == "left" else [1.0, -1.0, -1.0])
        for part, bend in bends.items():
            rotations[PART_NAMES.index(f"{side}_{part}")] = np.radians(bend) * mirror
    for part in ("abdomen", "chest"):
        rotations[PART_NAMES.index(part), 0] = np.radians(recipe.trunk)
    jitter = recipe.jitter * rng.standard_normal((NUM_PARTS, 3))
    jitter[list(LOCKED_PARTS)] = 0.0
    lean = np.array([np.radians(recipe.lean), 0.0, 0.0]) + _LEAN * rng.standard_normal(3) * [1.0, 0.0, 1.0]
    up = rotation_from_axis_angle(torch.from_numpy(lean)).numpy()[1]  # R^T (0, 1, 0)
    held = joint_limits(torch.device("cpu"), torch.float64).clamp(torch.from_numpy(rotations + jitter)).numpy()
    return Pose(held, up, np.radians(rng.uniform(*recipe.yaw)))
