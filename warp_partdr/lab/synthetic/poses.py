"""Poses of EllipBody: the mean body in them, a check of its limbs, mirror images, and draws of the pose prior."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np
import torch

from ...body.pose_prior import FREE_PARTS, PosePrior, mirror_features, packaged_prior
from ...body.posing import Posed, pose
from ...body.rotations import rotation_from_axis_angle
from ...body.template import NUM_PARTS, PARENTS, PART_NAMES, template
from ...interop.device_cache import device_cache
from .rng import TorchRng

# Random vectors of 57 dimensions lie farther from the mean than frames of motion capture do (a median of 31 nats, those
# frames have 12): with this share of the deviations they are as likely. Nine frames of ten have at most so many nats.
SPREAD = 0.7
LIKELY = 22.0
OVER_LIMITS = 0.02  # [rad^2], a few degrees

Poses = tuple[torch.Tensor, torch.Tensor]  # rotation vectors (N, 20, 3) and up directions in the pelvis' frame (N, 3)
_MORE = 1.3  # times as many tries as are needed on average


def mean_body(rotations: torch.Tensor, orientation: torch.Tensor | None = None) -> Posed:
    """Mean adults of local rotations (B, 20, 3, 3) and orientations (B, 3, 3), or upright; the pelvis at the origin."""
    batch, sizes = len(rotations), mean_sizes(rotations.device, rotations.dtype)
    if orientation is None:
        orientation = torch.eye(3, dtype=rotations.dtype, device=rotations.device).expand(batch, 3, 3)
    sizes = tuple(values.expand(batch, -1) for values in sizes)
    return pose(orientation, rotations.new_zeros(batch, 3), rotations, *sizes, validate=False)


@device_cache(8)
def mean_sizes(device: torch.device, dtype: torch.dtype) -> tuple[torch.Tensor, ...]:
    """Lengths, shape (12,), and thicknesses, shape (15,), of the mean adult [m]."""
    mean = template().mean_lengths, template().mean_thicknesses
    return tuple(torch.from_numpy(sizes).to(device, dtype) for sizes in mean)


_LIMBS = [k for k, name in enumerate(PART_NAMES) if name.endswith(("forearm", "hand", "lower_leg", "foot"))]
_ALONG = np.linspace(-0.8, 1.0, 7)  # places on a bone, of its half length
_APART = np.array(
    [[part not in (limb, PARENTS[limb]) and PARENTS[part] != limb for part in range(NUM_PARTS)] for limb in _LIMBS]
)


def clear_poses(rotations: torch.Tensor) -> torch.Tensor:
    """True for poses (N, 20, 3) [rad] with no limb of a mean body inside a part that it doesn't hang on, shape (N,)."""
    posed = mean_body(rotation_from_axis_angle(rotations))
    along, apart = (torch.from_numpy(values).to(posed.centres.device) for values in (_ALONG, _APART))
    bones = posed.semi_axes[:, _LIMBS, :1] * posed.axes[:, _LIMBS, :, 0]
    points = posed.centres[:, _LIMBS, None] + along.to(bones)[:, None] * bones[:, :, None]  # (B, limbs, places, 3)
    offsets = points.flatten(1, 2)[:, None] - posed.centres[:, :, None]
    offsets = offsets @ posed.axes / posed.semi_axes[:, :, None]  # in the parts' own axes
    inside = offsets.square().sum(-1).unflatten(2, (len(_LIMBS), -1)).amin(-1) < 1.0  # (B, parts, limbs)
    return ~(inside & apart.T).flatten(1).any(1)


def mirrored(poses: Poses) -> Poses:
    """Poses with left and right exchanged."""
    rotations, ups = poses
    order, sign = (torch.from_numpy(values).to(rotations.device) for values in mirror_features())
    features = torch.cat([rotations[:, list(FREE_PARTS)].flatten(1), ups], dim=1)
    return _poses_of(features[:, order] * sign.to(features))


def mirrored_half(poses: Poses, rng: TorchRng) -> Poses:
    """Poses, half of them with left and right exchanged."""
    flip = rng.chance(0.5, len(poses[1]))
    rotations, ups = mirrored(poses)
    return torch.where(flip[:, None, None], rotations, poses[0]), torch.where(flip[:, None], ups, poses[1])


def _poses_of(features: torch.Tensor) -> Poses:
    """Rotation vectors and up directions of the prior's features (N, 57)."""
    rotations = features.new_zeros(len(features), NUM_PARTS, 3)
    rotations[:, list(FREE_PARTS)] = features[:, :-3].unflatten(1, (-1, 3))
    return rotations, features[:, -3:]


@lru_cache(maxsize=1)
def _pose_mixture() -> tuple[PosePrior, dict[str, np.ndarray]]:
    """The packaged prior, and the Gaussians in its file: each stands for its mirror image too."""
    path = resources.files("warp_partdr").joinpath("assets/pose_prior.npz")
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        mixture = {name: archive[name].astype(np.float64) for name in ("weights", "means", "whitening")}
    return PosePrior().to(dtype=torch.float64), mixture


def draw_from_prior(rng: np.random.Generator) -> Poses | None:
    """One draw of the prior's mixture, N = 1, float64; None if beyond the joint limits or less likely than most."""
    prior, mixture = _pose_mixture()
    component = rng.choice(len(mixture["weights"]), p=mixture["weights"] / mixture["weights"].sum())
    deviation = np.linalg.solve(mixture["whitening"][component], rng.standard_normal(len(mixture["means"][0])))
    features = mixture["means"][component] + SPREAD * deviation
    if rng.random() < 0.5:
        order, sign = mirror_features()
        features = features[order] * sign
    features[-3:] /= np.linalg.norm(features[-3:])
    poses = _poses_of(torch.from_numpy(features)[None])
    return None if prior.joint_limits(poses[0]) > OVER_LIMITS or prior(*poses) > LIKELY else poses


@dataclass(frozen=True)
class JointLimits:
    """Least and greatest components of rotation vectors [rad], shape (20, 3) each."""

    lower: torch.Tensor
    upper: torch.Tensor

    def clamp(self, rotations: torch.Tensor, parts: Sequence[int] = range(NUM_PARTS)) -> torch.Tensor:
        """Rotation vectors (..., P, 3) of P parts, within the limits."""
        return torch.minimum(torch.maximum(rotations, self.lower[list(parts)]), self.upper[list(parts)])


def joint_limits(device: torch.device, dtype: torch.dtype = torch.float32) -> JointLimits:
    """Limits of the packaged prior."""
    prior, _ = _pose_mixture()
    return JointLimits(*(limits.to(device, dtype) for limits in (prior.lower_limits, prior.upper_limits)))


class PriorSampler:
    """Draws of the packaged prior's mixture in batches; ``limits`` are its joints' limits, ``mean`` its mean pose."""

    def __init__(self, device: torch.device) -> None:
        prior, mixture = _pose_mixture()
        self._prior = packaged_prior(str(device))
        self.limits = joint_limits(device)
        self.mean = prior.mean_pose.float().to(device)
        self._weights, self._means, self._factors = (
            torch.from_numpy(values).float().to(device)
            for values in (mixture["weights"], mixture["means"], np.linalg.inv(mixture["whitening"]))
        )

    def draw(self, count: int, rng: TorchRng) -> Poses:
        """Poses as ``draw_from_prior`` has them, though none mirrored, N = ``count``."""

        def draw(tries: int) -> Poses:
            component = rng.choice(self._weights, tries)
            every = torch.einsum("kij,nj->nki", self._factors, rng.normal(tries, self._means.shape[1]))
            features = self._means[component] + SPREAD * every[torch.arange(tries, device=every.device), component]
            rotations, ups = _poses_of(features)
            ups = torch.nn.functional.normalize(ups, dim=1)
            good = (self._prior.joint_limits(rotations) <= OVER_LIMITS) & (self._prior(rotations, ups) <= LIKELY)
            return rotations[good], ups[good]

        return draw_enough(count, draw)


def draw_enough(count: int, draw: Callable[[int], Poses]) -> Poses:
    """Draw ``count`` poses by a function that tries a number of them and returns the good ones."""
    kept: list[Poses] = []
    tries = 2 * count + 16
    while count > 0:
        rotations, ups = draw(tries)
        kept.append((rotations[:count], ups[:count]))
        count -= len(kept[-1][1])
        # As many as are likely to be enough: on a GPU each further round takes as long as a large one.
        tries = round(_MORE * count * tries / max(len(ups), 1)) + 16
    return join_poses(kept)


def join_poses(poses: list[Poses]) -> Poses:
    """All poses in one batch."""
    rotations, ups = zip(*poses, strict=True)
    return torch.cat(rotations), torch.cat(ups)
