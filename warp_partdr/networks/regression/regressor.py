"""Regressor at the end of all networks: from features to EllipBody and its camera (paper, section 3.4).

A multilayer perceptron of residual blocks takes the features and the last estimate and returns a correction of it, a
few times from the mean body on (iterative error feedback, as in HMR). With ``feedback`` it also sees how far that
estimate's landmarks are from the keypoints. Rotations are two columns made orthonormal by Gram-Schmidt; sizes are
factors of the mean body's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from ...body.parameters import BodyParameters
from ...body.pose_prior import FREE_PARTS, packaged_prior
from ...body.rotations import rotation_from_6d, rotation_from_axis_angle, rotation_to_6d
from ...body.template import LENGTH_NAMES, LOCKED_PARTS, THICKNESS_NAMES, template
from ...errors import check_whole
from ...interop.custom_operations import register_operation
from .landmarks import LANDMARKS
from .predicted import Predicted, posed_landmarks

_MAX_LOG_SIZE = 1.0  # sizes stay within e of the mean body's
_MAX_LOG_SCALE = 2.0  # a person of 1.7 m fills a crop at about 0
MISFITS = 2 * len(LANDMARKS)  # numbers that ``feedback`` adds to the inputs, the last of these
_FARTHEST = 1.0  # [half-sides of the crop]: misfits beyond are cut
_USUAL = 0.1  # [half-sides of the crop]: a misfit as large as the other inputs
_NUM_SIZES = len(LENGTH_NAMES) + len(THICKNESS_NAMES)
_HEADS: dict[str, int] = {
    "orientation": 6,
    "rotations": 6 * len(FREE_PARTS),
    "lengths": len(LENGTH_NAMES),
    "thicknesses": len(THICKNESS_NAMES),
    "camera": 3,  # log_scale, shift
}
_GROUPS = [6 * (1 + len(FREE_PARTS)), _NUM_SIZES, 3]  # of an estimate, the orientation with rotations, sizes together


@dataclass(frozen=True)
class RegressorConfig:
    """Sizes of a regressor; the paper's by default."""

    width: int = 1024  # of the layers
    blocks: int = 2  # residual blocks of two layers each
    iterations: int = 3  # corrections of the estimate
    dropout: float = 0.1  # share of activations that training drops
    feedback: bool = False  # each correction sees how far the estimate is from the keypoints

    def __post_init__(self) -> None:
        check_whole("width", self.width, 1, 4096)
        check_whole("blocks", self.blocks, 0, 32)
        check_whole("iterations", self.iterations, 1, 32)


class Regressor(nn.Module):
    """Network from ``features`` numbers of a person to a body."""

    mean: torch.Tensor  # where the iterations begin
    sizes: torch.Tensor  # lengths and thicknesses of the mean body [m]
    locked: torch.Tensor  # rotations of the hips

    def __init__(self, features: int, config: RegressorConfig) -> None:
        super().__init__()
        self.features, self.feedback = features, config.feedback
        self.first = _Layer(features + sum(_HEADS.values()) + MISFITS * config.feedback, config)
        self.blocks = nn.ModuleList(
            nn.ModuleList([_Layer(config.width, config), _Layer(config.width, config)]) for _ in range(config.blocks)
        )
        self.heads = nn.ModuleDict({name: nn.Linear(config.width, size) for name, size in _HEADS.items()})
        for head in self.heads.values():  # the first estimates lie about the mean
            assert isinstance(head, nn.Linear)
            nn.init.normal_(head.weight, std=1e-3)
            nn.init.zeros_(head.bias)
        self.iterations = config.iterations
        constants = template()
        sizes = np.concatenate([constants.mean_lengths, constants.mean_thicknesses])
        self.register_buffer("mean", _mean_estimate(), persistent=False)
        self.register_buffer("sizes", torch.from_numpy(sizes).float(), persistent=False)
        self.register_buffer("locked", torch.eye(3).expand(1, len(LOCKED_PARTS), 3, 3).clone(), persistent=False)

    def forward(self, features: torch.Tensor, keypoints: torch.Tensor | None = None) -> Predicted:
        """Bodies of features (B, F), and of keypoints as networks see them, (B, 24, 3), for those with ``feedback``."""
        estimate = self.mean.expand(len(features), -1)
        for iteration in range(self.iterations):
            known = [features, estimate.to(features.dtype)]
            if self.feedback:
                assert keypoints is not None
                known.append(_found_misfits(self._bodies(estimate), keypoints).to(features.dtype))
            hidden = self.first(torch.cat(known, dim=1), iteration)
            for block in self.blocks:
                first, second = block.children()
                hidden = hidden + second(first(hidden, iteration), iteration)
            correction = torch.cat([self.heads[name](hidden) for name in _HEADS], dim=1)
            estimate = estimate + correction.float()
        return self._bodies(estimate)

    def _bodies(self, estimate: torch.Tensor) -> Predicted:
        turns, logarithms, camera = estimate.split(_GROUPS, dim=1)
        orientation, free = rotation_from_6d(turns.unflatten(1, (-1, 6))).tensor_split([1], dim=1)
        sizes = (_MAX_LOG_SIZE * torch.tanh(logarithms / _MAX_LOG_SIZE)).exp() * self.sizes
        return Predicted(
            orientation=orientation[:, 0],
            rotations=torch.cat([self.locked.expand(len(free), -1, -1, -1), free], dim=1),  # the hips come first
            lengths=sizes[:, : len(LENGTH_NAMES)],
            thicknesses=sizes[:, len(LENGTH_NAMES) :],
            log_scale=camera[:, 0].clamp(-_MAX_LOG_SCALE, _MAX_LOG_SCALE),
            shift=camera[:, 1:],
        )


class _Layer(nn.Module):
    """Linear, batch normalisation, ReLU, dropout; each iteration's activations have statistics of their own."""

    def __init__(self, size: int, config: RegressorConfig) -> None:
        super().__init__()
        self.linear = nn.Linear(size, config.width, bias=False)
        self.norms = nn.ModuleList(nn.BatchNorm1d(config.width) for _ in range(config.iterations))
        self.dropout = nn.Dropout(config.dropout)

    def forward(self, values: torch.Tensor, iteration: int) -> torch.Tensor:
        activated: torch.Tensor = self.dropout(torch.relu(self.norms[iteration](self._multiplied(values))))
        return activated

    def _multiplied(self, values: torch.Tensor) -> torch.Tensor:
        # A person and the mirror image, whom fits ask about alone: this order takes half the time on CPUs.
        if len(values) == 2 and not self.training:
            return (self.linear.weight @ values.T).T
        return self.linear(values)


@torch.no_grad()
def misfits(bodies: Predicted, keypoints: torch.Tensor) -> torch.Tensor:
    """Ways from the bodies' landmarks to the keypoints, 0 to those that are missing, shape (B, 48).

    No gradient flows back: a correction is to be learned from what is seen, not what is seen from the correction.
    """
    with torch.autocast(keypoints.device.type, enabled=False):
        landmarks = posed_landmarks(bodies.posed(), LANDMARKS)[..., :2]
        drawn = bodies.log_scale.exp()[:, None, None] * landmarks + bodies.shift[:, None]
        ways = (keypoints[..., :2].float() - drawn).clamp(-_FARTHEST, _FARTHEST) / _USUAL
    return torch.where(keypoints[..., 2:] > 0, ways, 0.0).flatten(1)


def _found_misfits(bodies: Predicted, keypoints: torch.Tensor) -> torch.Tensor:
    """``misfits``, of which ``torch.compile`` makes no graph: kernels pose bodies faster than what is traced.

    ``torch.compiler.disable`` would do the same, but imports torch's compiler in every process, in half a second.
    """
    if not torch.compiler.is_compiling():
        return misfits(bodies, keypoints)
    sizes, camera = (bodies.lengths, bodies.thicknesses), (bodies.log_scale, bodies.shift)
    tensors = [tensor.detach() for tensor in (bodies.orientation, bodies.rotations, *sizes, *camera)]
    found: torch.Tensor = torch.ops.warp_partdr.misfits(tensors, keypoints.detach())
    return found


def _misfits(bodies: Sequence[torch.Tensor], keypoints: torch.Tensor) -> torch.Tensor:
    orientation, rotations, lengths, thicknesses, log_scale, shift = bodies
    return misfits(Predicted(orientation, rotations, lengths, thicknesses, log_scale, shift), keypoints)


register_operation(
    "misfits(Tensor[] bodies, Tensor keypoints) -> Tensor",
    _misfits,
    lambda bodies, keypoints: keypoints.new_empty(keypoints.shape[0], MISFITS, dtype=torch.float32),
)


def _mean_estimate() -> torch.Tensor:
    """The mean adult in the mean pose, facing the camera, in the order of the heads; sizes as logarithms of factors."""
    mean = BodyParameters.mean(1)
    turns = rotation_to_6d(rotation_from_axis_angle(packaged_prior("cpu").mean_pose[list(FREE_PARTS)]))
    return torch.cat([mean.orientation[0], turns.flatten(), torch.zeros(_NUM_SIZES + 3)])
