"""Search for a fit's start: 2D keypoints and bone lengths give many 3D hypotheses.

A bone of known length that looks too short in a weak-perspective camera points toward the camera or away from it, and
its depth follows from how much too short it looks (Taylor, 2000). Each combination is one hypothesis: each limb bone
either way, the body turned either way, the trunk upright or leaning either way. A bone that is seen in its full length
has no depth, so it has only one way.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import torch

from ...body.lens import ray_rotations
from ...body.parameters import BodyParameters
from ...body.posing import LandmarkGather
from ...body.rotations import rotation_to_6d
from ...inputs.keypoints import confident
from ...inputs.observation import REFERENCE_SIZE, Observation
from .energy import Energy

AMBIGUOUS = 0.2  # least share of a bone's length in depth at which its two ways count as different
# Quantile of |bone in the picture| / length. Most bones look too short; noise makes a few look too long.
SCALE_QUANTILE = 0.85
_APART = 0.02  # [m], least mean distance of the joints of two bodies that are distinct

_LIMBS = tuple(
    (f"{side}_{start}", f"{side}_{end}")
    for start, end in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
    for side in ("left", "right")
)
_TRUNK = ("mid_hip", "neck")
_ACROSS = (("left_hip", "right_hip"), ("left_shoulder", "right_shoulder"))
_BODY_FRAME = torch.tensor([[1.0, 0.0, 0.0, 0.0, 1.0, 0.0]])  # 6D identity
_JOINTS = ("mid_hip", "neck", *dict.fromkeys(name for pair in (*_ACROSS, *_LIMBS) for name in pair))


def rest_positions(device: torch.device | str) -> dict[str, np.ndarray]:
    """Positions of the mean adult's joints in the rest pose, in the body frame, by name, shape (3,) each [m]."""
    upright = replace(BodyParameters.mean(1, device=device), orientation=_BODY_FRAME.to(device))
    points = LandmarkGather(_JOINTS, device)(upright.posed())[0].cpu().numpy()
    return dict(zip(_JOINTS, points, strict=True))


class Hypotheses(NamedTuple):
    """Starts for a fit of one person.

    Attributes:
        bodies: Bodies in the mean pose, placed and turned, B of them.
        targets: Positions of ``_JOINTS``, with depth, in crop coordinates (half-sides of the crop), shape (B, J, 3).
        known: True for the joints that are known, shape (J,), bool.
    """

    bodies: BodyParameters
    targets: torch.Tensor
    known: torch.Tensor


def hypothesize(observation: Observation, count: int, *, seed: int = 0) -> Hypotheses:
    """Make starts for a fit: cameras, orientations, and target depths of the joints.

    Args:
        observation: Keypoints of one person.
        count: Largest number of hypotheses. If there are more combinations, a random choice of them is taken.
        seed: Seed of the random choice.
    """
    rest = rest_positions(observation.points.device)
    flat = _joints_in_picture(observation)
    scale = _estimate_scale(flat, rest)
    depths = _depth_choices(flat, rest, scale, count, seed)

    known = np.array([name in flat for name in _JOINTS])
    targets = np.zeros((len(depths), len(_JOINTS), 3), dtype=np.float32)
    for j, name in enumerate(_JOINTS):
        if name in flat:
            targets[:, j, :2] = flat[name]
            targets[:, j, 2] = [depth[name] for depth in depths]
    device = observation.points.device
    bodies = BodyParameters.mean(len(depths), device=device)
    orientation = [_turn_trunk(target, known, rest) for target in targets]
    origin = flat.get("mid_hip", next(iter(flat.values())))
    return Hypotheses(
        replace(
            bodies,
            orientation=rotation_to_6d(torch.tensor(np.array(orientation), dtype=torch.float32, device=device)),
            log_scale=torch.full_like(bodies.log_scale, float(np.log(scale))),
            shift=torch.tensor(origin, dtype=torch.float32, device=device).repeat(len(depths), 1),
        ),
        torch.from_numpy(targets).to(device),
        torch.from_numpy(known).to(device),
    )


class LiftEnergy:
    """Energy that pulls the joints of each body to its hypothesis's positions and depths, beside the usual terms."""

    def __init__(self, energy: Energy, targets: torch.Tensor, known: torch.Tensor) -> None:
        """Add the target positions of B bodies to an energy.

        Args:
            energy: Energy of the B bodies.
            targets: Target positions in crop coordinates, shape (B, J, 3).
            known: True for the joints whose target counts, shape (B, J), bool.
        """
        self._energy = energy
        self._targets = targets
        self._known = known.float()[..., None]
        self._gather = LandmarkGather(_JOINTS, targets.device)

    def __call__(self, parameters: BodyParameters) -> dict[str, torch.Tensor]:
        """Evaluate the weighted terms by name, shape (B,) each."""
        points = self._gather(parameters.posed()) * parameters.log_scale.exp()[:, None, None]
        if (lens := self._energy.observations.lens) is not None:
            points = points @ ray_rotations(parameters, lens)  # targets are relative to the ray to the pelvis
        points = points - points[:, :1] * points.new_tensor([0.0, 0.0, 1.0])  # depths are relative to the hips
        points = points + torch.nn.functional.pad(parameters.shift, (0, 1))[:, None]
        lift = ((points - self._targets).abs() * self._known).sum((1, 2)) * (REFERENCE_SIZE / 2)
        terms = self._energy(parameters)
        return {"lift": self._energy.weights.proj * lift, **terms}


def _joints_in_picture(observation: Observation) -> dict[str, np.ndarray]:
    """Positions of those ``_JOINTS`` that confident keypoints show, in crop coordinates, by name, shape (2,) each."""
    points = observation.points.cpu().numpy()
    is_confident = confident(observation.confidence.cpu().numpy()[None])[0]
    flat = {name: points[i] for i, name in enumerate(observation.landmarks) if is_confident[i]}
    for middle, (left, right) in zip(_TRUNK, _ACROSS, strict=True):
        if left in flat and right in flat:
            flat.setdefault(middle, (flat[left] + flat[right]) / 2)
    return flat


def _estimate_scale(flat: dict[str, np.ndarray], rest: dict[str, np.ndarray]) -> float:
    """Scale of the person in the crop [half-sides of the crop per metre]."""
    pairs = [pair for pair in (*_LIMBS, _TRUNK, *_ACROSS) if pair[0] in flat and pair[1] in flat]
    ratios = [np.linalg.norm(flat[a] - flat[b]) / np.linalg.norm(rest[a] - rest[b]) for a, b in pairs]
    if ratios and max(ratios) > 0:
        return float(np.quantile(ratios, SCALE_QUANTILE))
    extent = np.ptp(np.array(list(flat.values())), axis=0).max()
    return max(float(extent), 0.1)  # without limbs, the extent of the joints is taken for a metre


def _depth_choices(
    flat: dict[str, np.ndarray], rest: dict[str, np.ndarray], scale: float, count: int, seed: int
) -> list[dict[str, float]]:
    """Depth of each joint relative to the hips, by name, for each combination [half-sides of the crop]."""

    def hidden(a: str, b: str) -> float:
        """Depth between a bone's ends [half-sides of the crop]; 0 if an end is missing, or the bone lies across."""
        if a not in flat or b not in flat:
            return 0.0
        full = scale * np.linalg.norm(rest[a] - rest[b])
        depth = np.sqrt(max(full**2 - np.sum((flat[a] - flat[b]) ** 2), 0.0))
        return float(depth) if depth > AMBIGUOUS * full else 0.0

    lean, limbs = hidden(*_TRUNK), [hidden(*pair) for pair in _LIMBS]
    across = [hidden(*pair) for pair in _ACROSS]
    choices = [
        (0.0, lean, -lean) if lean else (0.0,),
        (1.0, -1.0) if any(across) else (1.0,),
        *[(depth, -depth) if depth else (0.0,) for depth in limbs],
    ]
    combinations = list(product(*choices))
    if len(combinations) > count:
        picked = np.random.default_rng(seed).choice(len(combinations), count, replace=False)
        combinations = [combinations[i] for i in sorted(picked)]
    depths = []
    for trunk, turn, *bones in combinations:
        depth = {"mid_hip": 0.0, "neck": trunk}
        for middle, (left, right), half in zip(_TRUNK, _ACROSS, across, strict=True):
            depth[left] = depth[middle] + turn * half / 2
            depth[right] = depth[middle] - turn * half / 2
        for (start, end), bone in zip(_LIMBS, bones, strict=True):
            depth[end] = depth[start] + bone
        depths.append(depth)
    return depths


def _turn_trunk(target: np.ndarray, known: np.ndarray, rest: dict[str, np.ndarray]) -> np.ndarray:
    """Find the rotation that brings the rest pose's trunk nearest to the target's trunk (Kabsch).

    If fewer than three joints of the trunk are known, the body faces the camera.
    """
    trunk = (_JOINTS.index(name) for name in ("left_hip", "right_hip", "left_shoulder", "right_shoulder", "neck"))
    index = [joint for joint in trunk if known[joint]]
    if len(index) < 3:
        return np.diag([1.0, -1.0, -1.0])
    source = np.array([rest[_JOINTS[i]] for i in index])
    image = target[index].astype(np.float64)
    source, image = source - source.mean(0), image - image.mean(0)
    u, _, vt = np.linalg.svd(image.T @ source)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def distinct(bodies: BodyParameters, energies: torch.Tensor, count: int) -> torch.Tensor:
    """Indices of the ``count`` best bodies, best first. Bodies whose joints are less than 2 cm apart count as one."""
    order = energies.argsort()
    joints = bodies.select(order).posed().joints.detach()
    distances = (joints[:, None] - joints[None]).norm(dim=-1).mean(-1).cpu().numpy()
    kept: list[int] = []
    for i in range(len(order)):
        if len(kept) == count:
            break
        if all(distances[i, j] >= _APART for j in kept):
            kept.append(i)
    return order[torch.tensor(kept, device=order.device)]
