"""Error of each estimator's gradient of L_seg against the derivative of the area that shows a wrong label."""

from __future__ import annotations

import numpy as np
import torch

from ....body.parameters import BodyParameters
from ....inputs.observation import REFERENCE_SIZE, resize_nearest
from ....solve.ellipsoids.stepper import SHAPE_RATE
from ...synthetic.tradeoff_people import TRUTH_SIZE, People
from ..renderers import COVERAGE
from .fits import one_by_one
from .plan import Setting

# Adam moves lengths and thicknesses [m] that much slower than angles [rad]: so one of their units counts as less.
_STEPS = {"lengths": SHAPE_RATE, "thicknesses": SHAPE_RATE}


def gradient_error(
    setting: Setting, people: People, bodies: BodyParameters, true: torch.Tensor
) -> dict[str, np.ndarray]:
    """Errors of a setting's estimate at a body for each person, over all numbers of a body and its camera.

    Args:
        setting: Renderer and picture.
        people: N people.
        bodies: Bodies, one for each person.
        true: True gradient, as ``true_gradient`` returns it.

    Returns:
        ``angle_deg`` between the two gradients and ``length_ratio``, shape (N,) each.
    """
    found = _gradient(setting, bodies, resize_nearest(people.labels, setting.size))
    cosine = torch.nn.functional.cosine_similarity(found, true, dim=1)
    angle, ratio = torch.rad2deg(cosine.clamp(-1, 1).acos()), found.norm(dim=1) / true.norm(dim=1)
    return {"angle_deg": angle.cpu().numpy(), "length_ratio": ratio.cpu().numpy()}


def true_gradient(people: People, bodies: BodyParameters) -> torch.Tensor:
    """The derivative of the area in which a body for each person shows a wrong label, shape (N, P).

    That is the coverage gradient in pictures as fine as the truth: 3 to 24 samples a side of a pixel. They are large,
    so they are drawn one at a time.
    """
    pairs = zip(one_by_one(bodies), people.labels.split(1), strict=True)
    return torch.cat([_gradient(Setting(COVERAGE, TRUTH_SIZE), body, labels) for body, labels in pairs])


def _gradient(setting: Setting, bodies: BodyParameters, labels: torch.Tensor) -> torch.Tensor:
    """Gradient of L_seg [pixels of a 256 px picture], in the unit of a step of each number, shape (B, P)."""
    leaves = bodies.leaves()
    loss, _ = setting.renderer.label_loss(leaves.posed(), leaves.camera(setting.size), labels)
    names = leaves.tensors()
    grads = torch.autograd.grad((REFERENCE_SIZE / setting.size) ** 2 * loss.sum(), list(names.values()))
    rows = [_STEPS.get(name, 1.0) * grad.reshape(len(grad), -1) for name, grad in zip(names, grads, strict=True)]
    return torch.cat(rows, dim=1)
