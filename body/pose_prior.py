"""Pose prior: a Gaussian mixture and soft joint limits learned from motion capture.

2D keypoints and part labels can't distinguish a bone that points toward the camera from one that points away; the
prior prefers the likelier. ``scripts/learn_pose_prior.py`` learns ``assets/pose_prior.npz`` from CMU's motion capture
(mocap.cs.cmu.edu, created with funding from NSF EIA-0196217) and DeepMimic's clips.
"""

from __future__ import annotations

from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

import numpy as np
import torch

from ..errors import InputError
from ..files.array_files import read_npz
from ..interop.device_cache import device_cache
from .landmarks import mirror_order
from .template import LOCKED_PARTS, NUM_PARTS, PART_NAMES

# The features: rotation vectors of these parts in this order, then the up direction in the pelvis' frame.
FREE_PARTS: tuple[int, ...] = tuple(part for part in range(NUM_PARTS) if part not in LOCKED_PARTS)
NUM_FEATURES = 3 * len(FREE_PARTS) + 3


def mirror_features() -> tuple[np.ndarray, np.ndarray]:
    """Order and sign, shape (57,) each, that mirror a pose: ``mirrored = features[:, order] * sign``."""
    twins = mirror_order([PART_NAMES[part] for part in FREE_PARTS])
    order = np.append((3 * twins[:, None] + np.arange(3)).ravel(), NUM_FEATURES - 3 + np.arange(3))
    # A reflection in x turns a rotation vector (a, b, c) into (a, -b, -c), and a direction (a, b, c) into (-a, b, c).
    sign = np.append(np.tile([1.0, -1.0, -1.0], len(FREE_PARTS)), [-1.0, 1.0, 1.0])
    return order, sign


def up_direction(global_orient: torch.Tensor) -> torch.Tensor:
    """Direction of up in the pelvis's frame, if the camera is level, shape (B, 3), of its rotation there (y down)."""
    return -global_orient[..., 1, :]


class PosePrior(torch.nn.Module):
    """Negative log-likelihood of body poses, and a penalty on joints bent too far.

    The mixture's components come in mirrored pairs, so a pose and its mirror image are equally likely. Both functions
    are differentiable everywhere, and NaN in gives NaN out. Inputs are converted to the dtype of the prior, which
    ``PosePrior().to(device, dtype)`` sets like that of any other module (float32 at first).

    Attributes:
        mean_pose: Mean rotation vectors [rad], shape (20, 3).
        mean_up: Mean up direction in the pelvis' frame, shape (3,).
        exemplars: Rotation vectors [rad] of poses that represent the motion capture, most frequent first, (N, 20, 3).
        exemplar_ups: Upward direction of each exemplar in the pelvis' frame, shape (N, 3).
        lower_limits: Least rotation vector components that cost nothing [rad], shape (20, 3).
        upper_limits: Greatest rotation vector components that cost nothing [rad], shape (20, 3).

    Examples:
        >>> from warp_partdr import PART_NAMES, PosePrior
        >>> prior = PosePrior()
        >>> poses, up = prior.mean_pose.repeat(2, 1, 1), prior.mean_up.repeat(2, 1)
        >>> poses[1, PART_NAMES.index("left_lower_leg"), 0] = -1.0  # a knee that is bent the wrong way [rad]
        >>> natural, wrong = prior(poses, up)
        >>> bool(wrong > natural)
        True
        >>> bool(prior.joint_limits(poses)[1] > 0.5)
        True
    """

    mean_pose: torch.Tensor
    mean_up: torch.Tensor
    exemplars: torch.Tensor
    exemplar_ups: torch.Tensor
    lower_limits: torch.Tensor
    upper_limits: torch.Tensor
    _whitening: torch.Tensor  # (K * 57, 57), inverse Cholesky factors of the covariances
    _whitened_means: torch.Tensor  # (K, 57)
    _log_weights: torch.Tensor  # (K,), with the normalisation of each Gaussian

    def __init__(self, path: Path | str | None = None) -> None:
        """Load a file of ``scripts/learn_pose_prior.py``, the packaged one by default.

        Raises:
            InputError: If the file isn't such a prior.
        """
        super().__init__()
        data = _read(resources.files("warp_partdr").joinpath("assets/pose_prior.npz") if path is None else Path(path))
        order, sign = mirror_features()
        means, whitening = data["means"], data["whitening"]
        # W m(x - mu) = (W with its columns mirrored) (x - m(mu)): the twin of a component needs no storage.
        means = np.concatenate([means, means[:, order] * sign])
        whitening = np.concatenate([whitening, whitening[:, :, order] * sign])
        half = np.log(data["weights"]) + np.log(np.diagonal(data["whitening"], axis1=1, axis2=2)).sum(1)
        log_weights = np.concatenate([half, half])

        # The offset makes the most likely component's mean 0.
        distances = np.einsum("kij,lkj->lki", whitening, means[:, None] - means[None])
        exponents = log_weights - 0.5 * (distances**2).sum(-1)
        top = exponents.max(1, keepdims=True)
        log_weights -= (top[:, 0] + np.log(np.exp(exponents - top).sum(1))).max()

        buffers = {
            "_whitening": whitening.reshape(-1, NUM_FEATURES),
            "_whitened_means": np.einsum("kij,kj->ki", whitening, means),
            "_log_weights": log_weights,
        }
        names = ("mean_pose", "mean_up", "exemplars", "exemplar_ups", "lower_limits", "upper_limits")
        for name, values in (buffers | {name: data[name] for name in names}).items():
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32))

    def forward(self, rotation_vectors: torch.Tensor, up: torch.Tensor) -> torch.Tensor:
        """Negative log-likelihood of poses; 0 is about the best there is, each nat above is e times less likely.

        All components of the mixture count (log-sum-exp), so the result is smooth where the nearest one changes.

        Args:
            rotation_vectors: Local rotations as axis times angle [rad], shape (B, 20, 3). The hips don't count.
            up: Direction of up in the pelvis's frame, shape (B, 3); see `up_direction`.

        Returns:
            Negative log-likelihoods [nats], shape (B,).

        Raises:
            ValueError: If a shape is wrong.
        """
        self._check("rotation_vectors", rotation_vectors, (NUM_PARTS, 3))
        self._check("up", up, (3,))
        if len(up) != len(rotation_vectors):
            raise ValueError(f"up: batch {len(up)}; expected {len(rotation_vectors)} as rotation_vectors has")
        dtype = self._whitening.dtype
        # The locked hips come first, so the free parts are a slice.
        free = rotation_vectors[:, FREE_PARTS[0] :].flatten(1)
        features = torch.cat([free.to(dtype), up.to(dtype)], dim=1)
        whitened = (features @ self._whitening.T).view(-1, *self._whitened_means.shape) - self._whitened_means
        return -torch.logsumexp(self._log_weights - 0.5 * whitened.square().sum(-1), dim=-1)

    def joint_limits(self, rotation_vectors: torch.Tensor) -> torch.Tensor:
        """Squared excess of joint angles over the range of motion capture, summed over components.

        Args:
            rotation_vectors: Local rotations as axis times angle [rad], shape (B, 20, 3).

        Returns:
            Penalties [rad^2], shape (B,); 0 inside the limits.

        Raises:
            ValueError: If the shape is wrong.
        """
        self._check("rotation_vectors", rotation_vectors, (NUM_PARTS, 3))
        vectors = rotation_vectors.to(self.lower_limits.dtype)
        excess = torch.relu(self.lower_limits - vectors) + torch.relu(vectors - self.upper_limits)
        return excess.square().sum((1, 2))

    def _check(self, name: str, values: torch.Tensor, shape: tuple[int, ...]) -> None:
        if not isinstance(values, torch.Tensor):
            raise TypeError(f"{name}: {type(values).__name__}; expected a torch.Tensor")
        if values.layout != torch.strided or values.device != self._whitening.device:
            raise ValueError(f"{name}: {values.layout} on {values.device}; expected dense on {self._whitening.device}")
        if tuple(values.shape[1:]) != shape or values.ndim != len(shape) + 1:
            expected = ", ".join(["B", *(str(size) for size in shape)])
            raise ValueError(f"{name}: shape {tuple(values.shape)}; expected ({expected})")


@device_cache(8)
def packaged_prior(device: str) -> PosePrior:
    """The packaged prior on a device, kept: to read it takes a while, and graphs that are kept read its memory."""
    with torch.inference_mode(False):
        return PosePrior().to(device)


# Shapes in the file; K pairs of components, N exemplars. Float32; float16 for the exemplars.
_SHAPES: dict[str, tuple[int | str, ...]] = {
    "means": ("K", NUM_FEATURES),  # component means; each stands for its mirror image too
    "whitening": ("K", NUM_FEATURES, NUM_FEATURES),  # lower triangular W, covariance = inv(W) inv(W)^T
    "weights": ("K",),  # of a component and of its twin each
    "mean_pose": (NUM_PARTS, 3),
    "mean_up": (3,),
    "exemplars": ("N", NUM_PARTS, 3),
    "exemplar_ups": ("N", 3),
    "lower_limits": (NUM_PARTS, 3),
    "upper_limits": (NUM_PARTS, 3),
    "rest_directions": (NUM_PARTS, 3),  # of the template the prior was learned for
}


def _read(path: Path | Traversable) -> dict[str, np.ndarray]:
    """Read the file's arrays as float64 and check them."""
    description = "a file of scripts/learn_pose_prior.py"
    data: dict[str, np.ndarray] = {}
    for key, values in read_npz(path, tuple(_SHAPES), expected=description).items():
        if values.dtype.kind != "f":
            raise InputError(f"{path}: {key} is of {values.dtype}; expected {description}")
        data[key] = values.astype(np.float64)
    sizes: dict[str, int] = {}
    for key, shape in _SHAPES.items():
        length = len(data[key]) if data[key].ndim else 0
        expected = tuple(sizes.setdefault(size, length) if isinstance(size, str) else size for size in shape)
        if data[key].shape != expected:
            raise InputError(f"{path}: {key} has shape {data[key].shape}; expected {expected}")
        if not np.isfinite(data[key]).all():
            raise InputError(f"{path}: {key} is not finite; expected {description}")
    return data
