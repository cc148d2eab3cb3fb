"""Ground that a scene's people stand on, which says who is large and far and who is small and near.

A body that grows as it goes away from a single camera looks as before, but its feet leave the ground. So sizes that the
network is not sure of, and a plane that nobody knows, are found together from the lowest points of feet. Whoever jumps,
lies, or whose feet are not seen counts less.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...inputs.keypoints import Keypoints2D
from ...inputs.scene import Ground
from ..mesh.feet import FEET
from ..mesh.observed_body import ObservedBody
from .depth_order import grown
from .plan import ScenePlan
from .start import gather_scene

_ANKLES = ("left_ankle", "right_ankle")
STANDING_LANDMARKS = (*FEET, *_ANKLES, "pelvis", "neck")
_SIZE_SPREAD = 0.1  # of the logarithm of a size that the network sees
_FOOT_SPREAD = 0.03  # [m], of the lowest point of a foot that stands
_LEAN_SPREAD = 0.15  # [rad], of a standing body against the plane's normal
_TILT_SPREAD = 0.35  # [rad], of a camera against the horizon
_STANDING = 0.9  # share of people, before anything is known of them
_ELSEWHERE = 2.0  # [m], over which the lowest points of all others are anywhere
_MOST = 0.7  # of the logarithm of a size: twice as large
_ROUNDS = 30


@dataclass(frozen=True)
class Standing:
    """Bodies that may stand, about the camera that sees them, in the world's axes, float64.

    Attributes:
        feet: Points of the feet of N bodies [m], shape (N, F, 3).
        ups: From the feet to the middle of the trunk, of length 1, shape (N, 3).
        seen: How surely the feet are seen, 0 to 1, shape (N,).
        people: Whose body each is, from 0 on, shape (N,).
    """

    feet: np.ndarray
    ups: np.ndarray
    seen: np.ndarray
    people: np.ndarray

    @classmethod
    def of(cls, landmarks: np.ndarray, seen: np.ndarray, people: np.ndarray) -> Standing:
        """Bodies of ``STANDING_LANDMARKS`` about the camera [m], shape (N, 10, 3)."""
        feet, ankles, trunk = np.split(landmarks, [len(FEET), len(FEET) + len(_ANKLES)], axis=1)
        ups = trunk.mean(1) - ankles.mean(1)
        return cls(feet, ups / np.linalg.norm(ups, axis=1, keepdims=True), seen, people)


@dataclass(frozen=True)
class Grounded:
    """Ground under people, and their sizes.

    Attributes:
        ground: Of the world, or about the camera as the feet are.
        sizes: Logarithms of factors by which people grow, about the camera, shape (P,).
        shares: How surely each body stands, 0 to 1, shape (N,).
    """

    ground: Ground
    sizes: np.ndarray
    shares: np.ndarray


def find_ground(bodies: Standing, level: np.ndarray, given: Ground | None = None) -> Grounded:
    """The most probable ground and sizes.

    Sizes, leans, feet and the camera's tilt have normal errors; a body stands, or is anywhere (expectation
    maximization). Each of the steps is linear least squares in two turns of the normal, the offset, and the sizes.

    Args:
        bodies: Of all people and frames.
        level: Up, if the camera is held level, shape (3,).
        given: A ground that is known, about the camera.
    """
    who = np.eye(int(bodies.people.max()) + 1)[bodies.people]
    rows, sizes, shares = np.arange(len(who)), np.zeros(who.shape[1]), bodies.seen
    normal, offset = (np.asarray(level, dtype=np.float64), None) if given is None else (given.normal, given.offset)
    for _ in range(_ROUNDS):
        factors = np.exp(who @ sizes)
        feet = bodies.feet * factors[:, None, None]
        lowest = feet[rows, (feet @ normal).argmin(1)]
        heights = lowest @ normal
        offset = float(np.median(heights)) if offset is None else offset
        shares = _shares(bodies, heights / factors - offset, normal, offset)
        turns = np.linalg.svd(normal[None])[2][1:]
        plane = np.column_stack([lowest @ turns.T, -np.ones(len(rows)), heights[:, None] * who])
        tilts = np.column_stack([turns.T, np.zeros((3, 1 + len(sizes)))])
        grows = np.column_stack([np.zeros((len(sizes), 3)), np.eye(len(sizes))])
        told = np.sqrt(shares) / _FOOT_SPREAD
        upright = np.repeat(np.sqrt(shares) / _LEAN_SPREAD, 3)
        left = [plane * told[:, None], np.tile(tilts, (len(rows), 1)) * upright[:, None]]
        right = [(offset - heights) * told, (bodies.ups - normal).ravel() * upright]
        left += [tilts / _TILT_SPREAD, grows / _SIZE_SPREAD]
        right += [(level - normal) / _TILT_SPREAD, -sizes / _SIZE_SPREAD]
        unknown = np.arange(0 if given is None else 3, 3 + len(sizes))
        step = np.zeros(3 + len(sizes))
        step[unknown] = np.linalg.lstsq(np.concatenate(left)[:, unknown], np.concatenate(right), rcond=None)[0]
        normal, offset = normal + step[:2] @ turns, offset + float(step[2])
        normal, sizes = normal / np.linalg.norm(normal), np.clip(sizes + step[3:], -_MOST, _MOST)
    assert offset is not None
    return Grounded(Ground(normal, offset), sizes, shares)


def _shares(bodies: Standing, off: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Probabilities that bodies stand whose feet are so far off the ground before they grow [m], shape (N,)."""
    leans = np.linalg.norm(bodies.ups - normal, axis=1) / _LEAN_SPREAD
    spread = math.hypot(_FOOT_SPREAD, offset * _SIZE_SPREAD)
    stands = np.exp(-((off / spread) ** 2 + leans**2) / 2) / (math.sqrt(2 * math.pi) * spread)
    return bodies.seen * _STANDING * stands / (_STANDING * stands + (1 - _STANDING) / _ELSEWHERE)


def stand_on_ground(plan: ScenePlan, looks: Sequence[ObservedBody]) -> tuple[list[ObservedBody], Grounded | None]:
    """Sights whose bodies grew, and the ground in the world; None where it can't tell anything.

    Several views know the depth, people whose shapes are known do not grow, and of one person on any ground all sizes
    are as good.
    """
    scene = plan.scene
    alone = scene.num_people == 1 and scene.ground is None
    if not plan.options.ground or len(scene.views) > 1 or scene.shapes or alone:
        return list(looks), None
    view = scene.views[0]
    turn, move = (each.double().cpu().numpy() for each in (view.rotation, view.translation))
    eye = -turn.T @ move
    given = scene.ground
    about = None if given is None else Ground(given.normal, -float(given.heights(eye)))
    bodies = _standing(plan, looks, eye)
    if not bodies.seen.any():
        return list(looks), None
    found = find_ground(bodies, turn.T @ [0.0, -1.0, 0.0], about)
    ground = Ground(found.ground.normal, found.ground.offset + float(found.ground.normal @ eye))
    grew = [grown(look, math.exp(found.sizes[look.sight.person])) for look in looks]
    return grew, Grounded(ground, found.sizes, found.shares)


def _standing(plan: ScenePlan, looks: Sequence[ObservedBody], eye: np.ndarray) -> Standing:
    """Bodies where the fit starts, about the eye of the one camera."""
    scene, people = plan.scene, gather_scene(plan, looks)
    names = plan.energy.drawn.model.landmark_names
    points = plan.energy.place(people, people.at_rest()).points.double().cpu().numpy() - eye
    seen = np.zeros(len(points))
    for look in looks:
        seen[look.sight.person * scene.num_frames + look.sight.frame] = feet_seen(look.sight.keypoints)
    wanted = [names.index(name) for name in STANDING_LANDMARKS]
    return Standing.of(points[:, wanted], seen, np.arange(len(points)) // scene.num_frames)


def feet_seen(keypoints: Keypoints2D) -> float:
    """Mean confidence of a person's ankles, 0 if the format has none."""
    marked = [name.endswith(_ANKLES) for name in keypoints.format.marks]
    return float(keypoints.confidence[marked].mean()) if any(marked) else 0.0
