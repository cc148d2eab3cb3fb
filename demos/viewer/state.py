"""The demo without a picture: a body, its target, and the refinement between them one step at a time."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..body.labels import BACKGROUND, IGNORE, label_set
from ..body.parameters import BodyParameters
from ..body.pose_prior import PosePrior
from ..body.posing import Posed
from ..errors import InputError
from ..metrics import mpjpe, part_f1
from ..render.mesh import mesh_label_loss
from ..render.renderers import labelled_mesh
from ..results.ellipbody_files import ellipbody_glb
from ..results.save import body_file
from ..solve.ellipsoids.energy import Energy
from ..solve.ellipsoids.stepper import SIZES, Refinement, rate_share, size_bounds
from .settings import Settings
from .targets import Target, difference_picture, group_picture, target_labels, target_picture
from .view import VIEW, seen_as, view_of

_TIMED = 15  # the last so many iterations tell the time of one
_COMPARED = 20  # iterations whose mean energy is compared with that of as many before them
_STILL_FALLING = 0.01  # least share of the energy by which it then falls in a refinement that goes on
_OUTLINE_LEVEL = 2  # of the mesh whose vertices stand for the outline of exact ellipsoids


class DemoState:
    """A body (B = 1) on its way from a start to a target, and the energy before each step so far, ``history``.

    An InputError, where settings need labels that a target has not, changes nothing.
    """

    def __init__(self, start: BodyParameters, target: Target, settings: Settings | None = None) -> None:
        self.start = start
        self.target = target
        self.settings = settings or Settings()
        self.prior = PosePrior()
        _check_labels(self.settings, target)
        self.restart()

    def configure(self, **changes: Any) -> None:
        """Change some of the ``Settings`` and go back to the start, so that runs can be compared; else do nothing."""
        settings = replace(self.settings, **changes)
        _check_labels(settings, self.target)
        if settings != self.settings:
            self.settings = settings
            self.restart()

    def set_target(self, target: Target) -> None:
        """Take another target, from the same start."""
        _check_labels(self.settings, target)
        self.target = target
        self.restart()

    def reset(self, body: BodyParameters) -> None:
        """Start from another body."""
        self.start = body.detach()
        self.restart()

    def restart(self) -> None:
        """Go back to the start."""
        observation, settings = self.target.observation, self.settings
        if settings.supervision == "keypoints":
            observation = replace(observation, labels=None, label_set=None)
        elif settings.supervision == "silhouette" and observation.labels is not None:
            person = (observation.labels != BACKGROUND) & (observation.labels != IGNORE)
            observation = replace(
                observation, labels=observation.labels.masked_fill(person, 1), label_set=label_set("full1")
            )
        self.energy = Energy(observation, size=settings.size, prior=self.prior, renderer=settings.drawn_by)
        self._refinement = Refinement(
            self.start, self.energy, iterations=settings.steps, learning_rate=settings.learning_rate
        )
        self.body = self._refinement.bodies
        self.history: list[float] = []
        self._times: list[float] = []
        self._moved()

    def step(self) -> None:
        """One iteration of the refinement."""
        began = time.perf_counter()
        self._refinement.step(rate_share(len(self.history), self.settings.steps))
        self._moved()
        self._times.append(time.perf_counter() - began)
        self.history.append(float(self._refinement.history[-1]))

    @property
    def settled(self) -> bool:
        """True if the body's sizes are somebody's, so that a detailed body can be registered to it.

        On its way to a photo, single parts are much too thin or too thick.
        """
        return self.target.truth is not None or self.converged

    @property
    def converged(self) -> bool:
        """True if the mean energy of the last 20 iterations is less than 1 % below that of the 20 before them."""
        if len(self.history) < 2 * _COMPARED:
            return False
        last = float(np.mean(self.history[-_COMPARED:]))
        before = float(np.mean(self.history[-2 * _COMPARED : -_COMPARED]))
        return last > (1 - _STILL_FALLING) * before

    def _moved(self) -> None:
        """Forget what was computed of the body where it was."""
        for name in ("posed", "placed", "drawn", "part_f1"):
            vars(self).pop(name, None)

    def bounds(self, field: str) -> tuple[torch.Tensor, torch.Tensor]:
        """Smallest and largest "lengths", "thicknesses" [m] or "rotations" [rad], each as one body has them."""
        if field in SIZES:
            low, high = size_bounds(field, "cpu")
            return low[0], high[0]
        return self.prior.lower_limits, self.prior.upper_limits

    def set_number(self, field: str, index: int | tuple[int, int], value: float) -> None:
        """Change one of the body's numbers [m] or [rad] within its ``bounds``; the edited body is the new start."""
        low, high = self.bounds(field)
        values = self.body.tensors()[field].detach().clone()
        values[0][index] = min(max(value, float(low[index])), float(high[index]))
        self.reset(replace(self.body.detach(), **{field: values}))

    def share(self, field: str) -> float:
        """Mean ratio of the body's "lengths" or "thicknesses" to the mean adult's."""
        return float((self.body.tensors()[field].detach() / BodyParameters.mean(1).tensors()[field]).mean())

    def set_share(self, field: str, share: float) -> None:
        """Change all "lengths" or "thicknesses" by one factor, so that their mean ratio is ``share``.

        Each stays within its ``bounds``. The edited body is the new start.
        """
        low, high = size_bounds(field, "cpu")
        values = self.body.tensors()[field].detach() * (share / self.share(field))
        self.reset(replace(self.body.detach(), **{field: values.clamp(low, high)}))

    def set_view(self, name: str, value: float) -> None:
        """Change one of the numbers of ``VIEW``, within its bounds; the edited body is the new start."""
        _, low, high = VIEW[name]
        self.reset(seen_as(self.body, {**view_of(self.body), name: min(max(value, low), high)}))

    @cached_property
    @torch.no_grad()
    def posed(self) -> Posed:
        """The posed body, in the camera frame [m] with the pelvis at the origin, without gradient."""
        return self.body.posed()

    @cached_property
    @torch.no_grad()
    def placed(self) -> Posed:
        """The posed body before the target's camera [m]; as ``posed`` where the target has no lens."""
        return self.energy.place(self.body.detach(), self.posed, self.settings.size)[0]

    @property
    def lens(self) -> tuple[float, float, float] | None:
        """Focal length and principal point (x, y) of the target's camera in the crop's coordinates; None without."""
        lens = self.target.observation.lens
        return None if lens is None else (float(lens[0]), float(lens[1]), float(lens[2]))

    @torch.no_grad()
    def in_crop(self, points: np.ndarray) -> np.ndarray:
        """Places in the crop, (N, 2), -1 to 1 and y down, of points in the frame of ``posed``, (N, 3) [m]."""
        moved = torch.from_numpy(points).to(self.posed.joints) + (self.placed.joints - self.posed.joints)[0, :1]
        camera = self.energy.place(self.body.detach(), self.posed, 2)[1]
        return (camera.project(moved[None])[0, :, :2] - 1).numpy()

    @cached_property
    @torch.no_grad()
    def drawn(self) -> np.ndarray:
        """Group ids of the body as the renderer of the settings draws it, shape (size, size), uint8."""
        size, groups = self.settings.size, self.target.label_set.part_groups[1:].tolist()
        placed, camera = self.energy.place(self.body.detach(), self.posed, size)
        renderer = self.settings.drawn_by
        return renderer.draw(placed, camera, (size, size), part_labels=groups, validate=False).labels[0].numpy()

    def pictures(self) -> dict[str, np.ndarray]:
        """Body, target and difference by these names, in the parts' colours, RGB, shape (size, size, 3), uint8."""
        return {
            "body": group_picture(self.target, self.drawn),
            "target": target_picture(self.target, self.settings.size),
            "difference": difference_picture(self.target, self.drawn),
        }

    def forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Centres of the ellipsoids (20, 3) [m], and minus the gradient of the losses of keypoints and labels there."""
        centres = self.posed.centres.clone().requires_grad_()
        terms = self.energy.terms(self.body.detach(), replace(self.posed, centres=centres), ("proj", "seg"))
        (slope,) = torch.autograd.grad(torch.stack(list(terms.values())).sum(), centres)
        return centres.detach()[0].numpy(), -slope[0].numpy()

    def outline_forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices of the mesh that labels pull, (N, 3) [m], most of them on silhouettes, and their pull.

        Of exact ellipsoids, they are those of level 2, with PartDR's gradient. N = 0 where no labels are followed.
        """
        energy, level = self.energy, self.settings.level
        if energy.target is None or energy.observation.label_set is None:
            return np.zeros((0, 3)), np.zeros((0, 3))
        level = _OUTLINE_LEVEL if level is None else level
        groups = tuple(energy.observation.label_set.part_groups[1:].tolist())
        placed, camera = energy.place(self.body.detach(), self.posed, energy.size)
        vertices = placed.vertices(level).requires_grad_()
        mesh, weight = labelled_mesh(level, groups, vertices.device), energy.renderer.depth_weight
        loss, _ = mesh_label_loss(vertices, mesh, camera, energy.target, depth_weight=weight, validate=False)
        (slope,) = torch.autograd.grad(energy.weights.seg * loss.sum(), vertices)
        pulled = (slope[0] != 0).any(1)
        moved = (placed.joints - self.posed.joints)[0, :1]
        return (vertices.detach()[0, pulled] - moved).numpy(), -slope[0, pulled].numpy()

    def milliseconds(self) -> float | None:
        """Median time of the last iterations; None before the first."""
        return float(np.median(self._times[-_TIMED:])) * 1000 if self._times else None

    @cached_property
    def part_f1(self) -> float | None:
        """Part F1 of what is drawn against the target; None without labels."""
        if (labels := target_labels(self.target, self.settings.size)) is None:
            return None
        # As ``confusion`` counts, which takes 30 times as long to check and to mask; ignored pixels come last.
        classes = self.target.label_set.num_groups + 1
        counts = np.bincount((labels.astype(np.uint16) * classes + self.drawn).ravel(), minlength=classes**2)
        return float(part_f1(counts[: classes**2].reshape(classes, classes)))

    def joint_error(self) -> float | None:
        """Mean distance of the joints to the target body's, pelvis on pelvis [mm]; None of a photo."""
        if self.target.posed is None:
            return None
        return float(mpjpe(self.posed.joints, self.target.posed.joints, centre_on=(0,))) * 1000

    def save(self, body: Path, meshes: Path) -> None:
        """Write the body as ``body.npz``, and as coloured meshes, whose name ends with .glb."""
        size = self.settings.size
        body_file(self.body, self.body.detach().camera(size), (size, size)).save(body)
        meshes.write_bytes(ellipbody_glb(self.posed))


def _check_labels(settings: Settings, target: Target) -> None:
    if settings.supervision != "keypoints" and target.observation.labels is None:
        raise InputError(
            f"supervision: {settings.supervision}, without part labels; expected --parts FILE, or keypoints, which "
            "need none"
        )
