"""Search for a fit's start: 2D keypoints and bone lengths give many 3D hypotheses.

Seen by a weak-perspective camera, a bone of known length points toward the viewer or away from it by as much as it
looks too short (Taylor, 2000). Every combination is one hypothesis: each limb bone either way, the body turned either
way, the trunk upright or leaning either way. Bones seen in full length have no second way.
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

AMBIGUOUS = 0.2  # share of a bone's length that must be hidden in depth for its two ways to differ
SCALE_QUANTILE = 0.85  # of |bone in the picture| / length: most bones look too short, noise makes a few look too long
_APART = 0.02  # [m] mean distance of joints

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
    """Joints of the mean adult in the rest pose, body frame [m]."""
    upright = replace(BodyParameters.mean(1, device=device), orientation=_BODY_FRAME.to(device))
    points = LandmarkGather(_JOINTS, device)(upright.posed())[0].cpu().numpy()
    return dict(zip(_JOINTS, points, strict=True))


class Hypotheses(NamedTuple):
    """Starts for a fit of one person.

    Attributes:
        bodies: Bodies in the mean pose, placed and turned, B of them.
        targets: Positions of ``_JOINTS`` in crop coordinates, depth in the same unit, shape (B, J, 3).
        known: True for the joints that are known, shape (J,), bool.
    """

    bodies: BodyParameters
    targets: torch.Tensor
    known: torch.Tensor


def hypothesize(observation: Observation, count: int, *, seed: int = 0) -> Hypotheses:
    """Make starts for a fit: cameras, orientations, and target depths of the joints.

    At most ``count`` hypotheses: a random choice (``seed``) of all combinations where there are more.
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
    """Energy of keypoints with a depth, which pulls bodies into their hypotheses, with pose prior and joint limits."""

    def __init__(self, energy: Energy, targets: torch.Tensor, known: torch.Tensor) -> None:
        """Take target positions (B, J, 3) of B bodies, of which those that are ``known`` count, shape (B, J), bool."""
        self._energy = energy
        self._targets = targets
        self._known = known.float()[..., None]
        self._gather = LandmarkGather(_JOINTS, targets.device)

    def __call__(self, parameters: BodyParameters) -> dict[str, torch.Tensor]:
        """Weighted terms by name, shape (B,)."""
        points = self._gather(parameters.posed()) * parameters.log_scale.exp()[:, None, None]
        if (lens := self._energy.observations.lens) is not None:
            points = points @ ray_rotations(parameters, lens)  # as seen along the ray to the pelvis
        points = points - points[:, :1] * points.new_tensor([0.0, 0.0, 1.0])  # depth counts from the hips
        points = points + torch.nn.functional.pad(parameters.shift, (0, 1))[:, None]
        lift = ((points - self._targets).abs() * self._known).sum((1, 2)) * (REFERENCE_SIZE / 2)
        terms = self._energy(parameters)
        return {"lift": self._energy.weights.proj * lift, **terms}


def _joints_in_picture(observation: Observation) -> dict[str, np.ndarray]:
    """Positions of the joints that hypotheses are made of, as far as keypoints show them, crop coordinates."""
    points = observation.points.cpu().numpy()
    sure = confident(observation.confidence.cpu().numpy()[None])[0]
    flat = {name: points[i] for i, name in enumerate(observation.landmarks) if sure[i]}
    for middle, (left, right) in zip(_TRUNK, _ACROSS, strict=True):
        if left in flat and right in flat:
            flat.setdefault(middle, (flat[left] + flat[right]) / 2)
    return flat


def _estimate_scale(flat: dict[str, np.ndarray], rest: dict[str, np.ndarray]) -> float:
    """Half-sides of the crop a metre."""
    pairs = [pair for pair in (*_LIMBS, _TRUNK, *_ACROSS) if pair[0] in flat and pair[1] in flat]
    ratios = [np.linalg.norm(flat[a] - flat[b]) / np.linalg.norm(rest[a] - rest[b]) for a, b in pairs]
    if ratios and max(ratios) > 0:
        return float(np.quantile(ratios, SCALE_QUANTILE))
    extent = np.ptp(np.array(list(flat.values())), axis=0).max()
    return max(float(extent), 0.1)  # nobody's limbs are seen: what is seen may be a metre


def _depth_choices(
    flat: dict[str, np.ndarray], rest: dict[str, np.ndarray], scale: float, count: int, seed: int
) -> list[dict[str, float]]:
    """Depth of each joint under each combination, from the hips, in crop units."""

    def hidden(a: str, b: str) -> float:
        """Depth between a bone's ends [crop units]; 0 if one is missing or the bone is seen in full length."""
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
    """Rotation that brings the rest pose's trunk nearest to the target's (Kabsch); facing the camera without one."""
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
    """Indices of the ``count`` best bodies, best first; two whose joints are less than 2 cm apart are one."""
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
