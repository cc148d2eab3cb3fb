"""The paper's "PartDR + SMPL", with Anny: after EllipBody's fit, the detailed mesh itself is drawn and refined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...body.landmarks import annotated
from ...body.rotations import rotation_from_axis_angle
from ...cameras import WeakPerspective
from ...clothing.anny import PHENOTYPE_ANCHORS, anny, anny_shape
from ...clothing.model import Detailed
from ...clothing.pose import pose_from_ellipbody
from ...fit.fitting import fit_body
from ...fit.options import FitOptions
from ...fit.result import FitResult
from ...inputs.keypoints import Keypoints2D
from ...inputs.observation import REFERENCE_SIZE, resize_nearest
from ...inputs.part_labels import PartLabels
from ...refinement.stepper import rate_share
from ...render.mesh import PartImage, draw_mesh, mesh_label_loss
from ...render.options import DEFAULT_DEPTH_WEIGHT
from ...synthetic.people import anny_mesh

_SIZE = 128  # [px], side of the drawn crop
_ITERATIONS = 60
_RATE = 0.02  # of angles [rad], camera [half-sides of the crop] and, times 5, of shape values
_SHAPE_RATE = 5.0
_SHAPE_WEIGHT = 0.5  # of a shape value squared: their variance is 1
_BEND_WEIGHT = 30.0  # of the square of what a joint turns away from EllipBody's pose [rad]
_START = {"gender": 0.5, "age": 0.7, "muscle": 0.5, "weight": 0.5, "height": 0.38, "proportions": 0.5}  # 1.65 m tall


@dataclass(frozen=True)
class AnnyFit:
    """A fitted Anny body; does what a ``FitResult`` does for scores."""

    first: FitResult  # EllipBody's fit, where it started
    body: Detailed  # the body in the camera frame, B = 1 [m]
    camera: WeakPerspective  # in pixels of the full picture, B = 1

    @property
    def vertices(self) -> np.ndarray:
        """Shape (V, 3) [m]."""
        return self.body.vertices[0].cpu().numpy()

    def landmarks(self, names: Sequence[str]) -> np.ndarray:
        """Landmarks in the camera frame, shape (L, 3) [m]."""
        return anny(self.camera.scale.device).landmarks(self.body, names)[0].cpu().numpy()

    def draw(self, image_size: tuple[int, int]) -> PartImage:
        """The body's 20 parts in the full picture."""
        return draw_mesh(self.body.vertices, anny_mesh(self.camera.scale.device), self.camera, image_size)


def fit_anny(
    keypoints: Keypoints2D,
    parts: PartLabels,
    *,
    others: Sequence[Keypoints2D] = (),
    options: FitOptions,
    depth_weight: float = DEFAULT_DEPTH_WEIGHT,
    device: str = "cpu",
) -> AnnyFit:
    """Fit EllipBody as ``fit_body`` does, but for its last stage; instead refine Anny's shape and pose from there.

    Minimises L_proj and L_seg with the fit's weights, and squares that hold shape and pose back.
    """
    first = fit_body(keypoints, parts, others=others, options=options.without_outline(), device=device)
    seen, weights, model = first.observation, options.weights, anny(first.posed.joints.device)
    assert seen.labels is not None
    mesh = anny_mesh(model.faces.device).relabel(parts.label_set.part_groups)
    target = resize_nearest(seen.labels, _SIZE)[None]
    names = annotated(seen.landmarks, model.landmark_names)
    expected = (seen.points + 1) * (REFERENCE_SIZE / 2)

    people = torch.tensor([[_START[name] for name in PHENOTYPE_ANCHORS]], device=model.faces.device)
    shape = anny_shape(people).detach().requires_grad_()
    with torch.no_grad():
        rotations, translation = pose_from_ellipbody(model, first.posed, shape)
    joints = sorted({0, *model.part_joints})
    turns = torch.zeros(1, len(joints), 3, device=shape.device, requires_grad=True)
    log_scale, shift = (each.clone().requires_grad_() for each in (first.parameters.log_scale, first.parameters.shift))
    groups = [{"params": [turns, log_scale, shift], "lr": _RATE}, {"params": [shape], "lr": _RATE * _SHAPE_RATE}]
    optimizer = torch.optim.Adam(groups)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: rate_share(step, _ITERATIONS))

    def pose() -> Detailed:
        turned = rotations.clone()
        turned[:, joints] = rotations[:, joints] @ rotation_from_axis_angle(turns)
        return model.pose(shape, turned, translation)

    def camera(size: int) -> WeakPerspective:
        return WeakPerspective(log_scale.exp() * (size / 2), (shift + 1) * (size / 2))

    for _ in range(_ITERATIONS):
        body = pose()
        places = camera(REFERENCE_SIZE).project(model.landmarks(body, names))[..., :2]
        proj = ((places - expected).abs().sum(-1) * seen.confidence).sum()
        losses = mesh_label_loss(body.vertices, mesh, camera(_SIZE), target, depth_weight=depth_weight, validate=False)
        held = _SHAPE_WEIGHT * shape.square().sum() + _BEND_WEIGHT * turns[:, 1:].square().sum()
        loss = weights.proj * proj + weights.seg * (REFERENCE_SIZE / _SIZE) ** 2 * losses[0].sum() + held
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        return AnnyFit(first, pose(), camera(first.crop.size[0]).in_full(first.crop))
