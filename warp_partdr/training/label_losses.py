"""Losses of the label network: L_3D, L_proj, L_seg through PartDR, L_l, L_t (paper, section 3.4), rotations."""

from __future__ import annotations

import torch

from ..body.template import template
from ..network.landmarks import LANDMARKS
from ..network.predicted import Predicted
from ..render.ellipsoids import ellipsoid_label_loss
from ..synthetic.training_people import PeopleBatch
from .predicted_bodies import posed_landmarks


def body_losses(predicted: Predicted, people: PeopleBatch) -> dict[str, torch.Tensor]:
    """The terms by comparison with the truth of the same people, each a mean over the batch, without weights.

    * joints: mean absolute error of coordinates [m];
    * rotations: squared difference of a rotation matrix, mean over the parts;
    * proj: mean absolute error of projected landmarks [half-sides of the crop];
    * seg: L_seg as a share of the picture's pixels, with the "edges" gradient;
    * lengths: mean absolute logarithm of the ratio to the true ones;
    * thicknesses: mean squared logarithm of the ratio to the mean body's.
    """
    posed = predicted.posed()
    size = people.parts.shape[-1]
    turns = torch.cat([predicted.orientation[:, None], predicted.rotations], dim=1)
    true_turns = torch.cat([people.orientation[:, None], people.rotations], dim=1)
    seen = predicted.camera(2).project(posed_landmarks(posed, LANDMARKS))[..., :2] - 1
    seg, _ = ellipsoid_label_loss(posed, predicted.camera(size), people.parts, gradient="edges", validate=False)
    mean_thicknesses = torch.as_tensor(template().mean_thicknesses).to(predicted.thicknesses)
    return {
        "joints": (posed.joints - people.joints).abs().mean(),
        "rotations": (turns - true_turns).square().sum((2, 3)).mean(),
        "proj": (seen - people.points).abs().mean(),
        "seg": seg.mean() / size**2,
        "lengths": (predicted.lengths / people.lengths).log().abs().mean(),
        "thicknesses": (predicted.thicknesses / mean_thicknesses).log().square().mean(),
    }
