"""Ground that a scene's people stand on. It decides whether a person is large and far away, or small and near.

A body that grows while it moves away from a single camera keeps its picture, but its feet leave the ground. So the
sizes of people, which the network does not know exactly, and an unknown plane are found together from the lowest points
of feet. People who jump or lie, or whose feet are hidden, count less.
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
# Standard deviations.
_SIZE_DEVIATION = 0.1  # of the logarithm of a size that the network predicts
_FOOT_DEVIATION = 0.03  # [m], height of the lowest point of a standing foot above the ground
_LEAN_DEVIATION = 0.15  # [rad], angle between a standing body and the normal of the ground
_TILT_DEVIATION = 0.35  # [rad], angle between a camera and the horizon
_STANDING = 0.9  # share of people who stand, before anything is known about them
_ELSEWHERE = 2.0  # [m], range of heights over which the lowest points of all other people are spread evenly
_MOST = 0.7  # largest change of the logarithm of a size: twice as large
_ROUNDS = 30  # iterations of expectation maximization


@dataclass(frozen=True)
class Standing:
    """Bodies that may stand, relative to the camera, along the world's axes, float64.

    Attributes:
        feet: Points of the feet of N bodies [m], shape (N, F, 3).
        ups: Unit vectors from the ankles to the middle of the trunk, shape (N, 3).
        confidence: Confidence that the feet are visible, 0 to 1, shape (N,).
        people: Index of the person of each body, shape (N,).
    """

    feet: np.ndarray
    ups: np.ndarray
    confidence: np.ndarray
    people: np.ndarray

    @classmethod
    def of(cls, landmarks: np.ndarray, confidence: np.ndarray, people: np.ndarray) -> Standing:
        """Bodies with these ``STANDING_LANDMARKS`` relative to the camera [m], shape (N, 10, 3)."""
        feet, ankles, trunk = np.split(landmarks, [len(FEET), len(FEET) + len(_ANKLES)], axis=1)
        ups = trunk.mean(1) - ankles.mean(1)
        return cls(feet, ups / np.linalg.norm(ups, axis=1, keepdims=True), confidence, people)


@dataclass(frozen=True)
class Grounded:
    """Ground under people, and their sizes.

    Attributes:
        ground: Ground in the world, or relative to the camera if the feet were given so.
        sizes: Logarithms of the factors by which people grow about the camera, shape (P,).
        shares: Probability that each body stands, shape (N,).
    """

    ground: Ground
    sizes: np.ndarray
    shares: np.ndarray


def find_ground(bodies: Standing, level: np.ndarray, given: Ground | None = None) -> Grounded:
    """Finds the most probable ground and sizes.

    Sizes, leans, feet and the tilt of the camera have normal errors. Each body either stands or is anywhere
    (expectation maximization). Each step is a linear least squares problem in two turns of the normal, the offset, and
    the sizes.

    Args:
        bodies: Bodies of all people in all frames.
        level: Direction that is up if the camera is held level, shape (3,).
        given: Ground relative to the camera, if it is known.
    """
    owners = np.eye(int(bodies.people.max()) + 1)[bodies.people]
    rows = np.arange(len(owners))
    sizes = np.zeros(owners.shape[1])
    shares = bodies.confidence
    normal, offset = (np.asarray(level, dtype=np.float64), None) if given is None else (given.normal, given.offset)
    for _ in range(_ROUNDS):
        factors = np.exp(owners @ sizes)
        feet = bodies.feet * factors[:, None, None]
        lowest = feet[rows, (feet @ normal).argmin(1)]
        heights = lowest @ normal
        offset = float(np.median(heights)) if offset is None else offset
        shares = _shares(bodies, heights / factors - offset, normal, offset)
        turns = np.linalg.svd(normal[None])[2][1:]
        plane = np.column_stack([lowest @ turns.T, -np.ones(len(rows)), heights[:, None] * owners])
        tilts = np.column_stack([turns.T, np.zeros((3, 1 + len(sizes)))])
        growth = np.column_stack([np.zeros((len(sizes), 3)), np.eye(len(sizes))])
        foot_weights = np.sqrt(shares) / _FOOT_DEVIATION
        lean_weights = np.repeat(np.sqrt(shares) / _LEAN_DEVIATION, 3)
        left = [plane * foot_weights[:, None], np.tile(tilts, (len(rows), 1)) * lean_weights[:, None]]
        right = [(offset - heights) * foot_weights, (bodies.ups - normal).ravel() * lean_weights]
        left += [tilts / _TILT_DEVIATION, growth / _SIZE_DEVIATION]
        right += [(level - normal) / _TILT_DEVIATION, -sizes / _SIZE_DEVIATION]
        unknown = np.arange(0 if given is None else 3, 3 + len(sizes))
        step = np.zeros(3 + len(sizes))
        step[unknown] = np.linalg.lstsq(np.concatenate(left)[:, unknown], np.concatenate(right), rcond=None)[0]
        normal = normal + step[:2] @ turns
        offset = offset + float(step[2])
        normal = normal / np.linalg.norm(normal)
        sizes = np.clip(sizes + step[3:], -_MOST, _MOST)
    assert offset is not None
    return Grounded(Ground(normal, offset), sizes, shares)


def _shares(bodies: Standing, heights: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Probabilities that bodies stand, given the heights of their feet above the ground before they grow [m], (N,)."""
    leans = np.linalg.norm(bodies.ups - normal, axis=1) / _LEAN_DEVIATION
    deviation = math.hypot(_FOOT_DEVIATION, offset * _SIZE_DEVIATION)
    stands = np.exp(-((heights / deviation) ** 2 + leans**2) / 2) / (math.sqrt(2 * math.pi) * deviation)
    return bodies.confidence * _STANDING * stands / (_STANDING * stands + (1 - _STANDING) / _ELSEWHERE)


def stand_on_ground(
    plan: ScenePlan, observed_bodies: Sequence[ObservedBody]
) -> tuple[list[ObservedBody], Grounded | None]:
    """Resizes people so that they stand on one ground.

    Bodies are unchanged if the ground cannot tell their sizes: with several views the depth is known, people with known
    shapes do not grow, and a single person on an unknown ground can have any size.

    Returns:
        The resized bodies, and the ground in the world. The ground is None if bodies are unchanged.
    """
    scene = plan.scene
    alone = scene.num_people == 1 and scene.ground is None
    if not plan.options.ground or len(scene.views) > 1 or scene.shapes or alone:
        return list(observed_bodies), None
    view = scene.views[0]
    rotation = view.rotation.double().cpu().numpy()
    translation = view.translation.double().cpu().numpy()
    eye = -rotation.T @ translation
    given = None if scene.ground is None else Ground(scene.ground.normal, -float(scene.ground.heights(eye)))
    bodies = _standing(plan, observed_bodies, eye)
    if not bodies.confidence.any():
        return list(observed_bodies), None
    found = find_ground(bodies, rotation.T @ [0.0, -1.0, 0.0], given)
    ground = Ground(found.ground.normal, found.ground.offset + float(found.ground.normal @ eye))
    resized = [grown(observed, math.exp(found.sizes[observed.person])) for observed in observed_bodies]
    return resized, Grounded(ground, found.sizes, found.shares)


def _standing(plan: ScenePlan, observed_bodies: Sequence[ObservedBody], eye: np.ndarray) -> Standing:
    """Bodies from which the fit starts, relative to the position of the only camera."""
    scene = plan.scene
    people = gather_scene(plan, observed_bodies)
    names = plan.energy.drawn.model.landmark_names
    points = plan.energy.place(people, people.at_rest()).points.double().cpu().numpy() - eye
    confidence = np.zeros(len(points))
    for observed in observed_bodies:
        row = observed.person * scene.num_frames + observed.frame
        confidence[row] = ankle_confidence(observed.source.keypoints)
    wanted = [names.index(name) for name in STANDING_LANDMARKS]
    return Standing.of(points[:, wanted], confidence, np.arange(len(points)) // scene.num_frames)


def ankle_confidence(keypoints: Keypoints2D) -> float:
    """Mean confidence of a person's ankles, 0 if the keypoint format has none."""
    marked = [name.endswith(_ANKLES) for name in keypoints.format.marks]
    return float(keypoints.confidence[marked].mean()) if any(marked) else 0.0
