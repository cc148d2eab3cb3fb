"""What the label network learns from: L_3D, L_proj, L_seg through PartDR, L_l, L_t (paper, section 3.4), rotations."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ..body.template import template
from ..network.landmarks import LANDMARKS
from ..network.predicted import Predicted
from ..render.ellipsoids import ellipsoid_label_loss
from .posed_landmarks import landmarks


@dataclass(frozen=True)
class Truth:
    """What is known of B people in crops of side 2; a sample without a truth in 3D takes no part in those terms.

    Attributes:
        points: ``LANDMARKS`` in the crop, shape (B, 24, 2).
        points_weight: Of each, shape (B, 24).
        parts: Part labels 0 to 20, 255 where nothing is known, shape (B, S, S), uint8.
        joints: ``JOINT_NAMES``, camera frame, pelvis at 0 [m], shape (B, 21, 3).
        orientation: Shape (B, 3, 3).
        rotations: Local, shape (B, 20, 3, 3).
        lengths: [m], shape (B, 12).
        has_3d: 1 where the last four are known, shape (B,).
    """

    points: torch.Tensor
    points_weight: torch.Tensor
    parts: torch.Tensor
    joints: torch.Tensor
    orientation: torch.Tensor
    rotations: torch.Tensor
    lengths: torch.Tensor
    has_3d: torch.Tensor


def body_losses(predicted: Predicted, truth: Truth) -> dict[str, torch.Tensor]:
    """The terms, each a mean over the batch, without weights.

    * joints: mean absolute error of coordinates [m];
    * rotations: squared difference of a rotation matrix, mean over the parts;
    * proj: mean absolute error of projected landmarks [half-sides of the crop];
    * seg: L_seg as a share of the picture's pixels, with the "edges" gradient;
    * lengths: mean absolute logarithm of the ratio to the true ones;
    * thicknesses: mean squared logarithm of the ratio to the mean body's.
    """
    posed = predicted.posed()
    size = truth.parts.shape[-1]
    count = truth.has_3d.sum().clamp_min(1.0)

    def mean_3d(errors: torch.Tensor) -> torch.Tensor:
        return (errors.flatten(1).mean(1) * truth.has_3d).sum() / count

    turns = torch.cat([predicted.orientation[:, None], predicted.rotations], dim=1)
    true_turns = torch.cat([truth.orientation[:, None], truth.rotations], dim=1)
    seen = predicted.camera(2).project(landmarks(posed, LANDMARKS))[..., :2] - 1
    proj = (seen - truth.points).abs().mean(2) * truth.points_weight
    seg, _ = ellipsoid_label_loss(posed, predicted.camera(size), truth.parts, gradient="edges", validate=False)
    mean_thicknesses = torch.as_tensor(template().mean_thicknesses).to(predicted.thicknesses)
    return {
        "joints": mean_3d((posed.joints - truth.joints).abs()),
        "rotations": mean_3d((turns - true_turns).square().sum((2, 3))),
        "proj": proj.sum() / truth.points_weight.sum().clamp_min(1.0),
        "seg": seg.mean() / size**2,
        "lengths": mean_3d((predicted.lengths / truth.lengths).log().abs()),
        "thicknesses": (predicted.thicknesses / mean_thicknesses).log().square().mean(),
    }
