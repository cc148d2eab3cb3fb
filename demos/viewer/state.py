"""The demo without a picture: a body, its target, and the refinement between them one step at a time."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch

from ..body.labels import BACKGROUND, IGNORE, label_set
from ..body.template import LENGTH_NAMES, PART_NAMES, THICKNESS_NAMES
from ..ellipsoid_passes import Gradient
from ..ellipsoids import draw_ellipsoids
from ..energy import Energy, resize_nearest
from ..errors import InputError
from ..export import ellipbody_scene
from ..mesh import ellipbody_mesh
from ..metrics import confusion, mpjpe, part_f1
from ..output import body_file
from ..palette import IGNORE_COLOUR, group_colours
from ..parameters import BodyParameters
from ..pose_prior import PosePrior
from ..posing import Posed
from ..refinement import SHAPE_RATE, SIZES, rate_share
from ..render import DEFAULT_DEPTH_WEIGHT, rasterize_parts
from .targets import Target, read_body

Supervision = Literal["keypoints", "silhouette", "parts"]
RendererName = Literal["exact", "E0", "E1", "E2", "E3"]
DRAWN_SIZES = (64, 128, 256, 512)  # [px]
_FINAL_RATE = 0.1
_BACKGROUND_COLOUR = 250
_RIGHT_COLOUR = 226
_UNKNOWN_COLOUR = 238
_TIMED = 15  # the last so many iterations tell the time of one


@dataclass(frozen=True)
class Settings:
    """How the refinement looks at its target.

    Attributes:
        supervision: Beside the keypoints: nothing, the whole silhouette, or the parts.
        depth_gradient: Whether PartDR's z gradient counts; it needs parts.
        renderer: "exact" ellipsoids, or their mesh of a level.
        gradient: Of the exact renderer; a mesh has PartDR's alone.
        size: Side of the drawn crop [px].
        steps: Iterations over which the learning rate falls to a tenth; it stays there.
        learning_rate: As in ``refine``, whose own is for starts that are nearer.

    Raises:
        InputError: If a value is none of its choices.
    """

    supervision: Supervision = "parts"
    depth_gradient: bool = True
    renderer: RendererName = "exact"
    gradient: Gradient = "partdr"
    size: int = 256
    steps: int = 100
    learning_rate: float = 0.06

    def __post_init__(self) -> None:
        choices: dict[str, tuple[Any, ...]] = {
            "supervision": get_args(Supervision),
            "renderer": get_args(RendererName),
            "gradient": get_args(Gradient),
            "size": DRAWN_SIZES,
        }
        for name, allowed in choices.items():
            if (value := getattr(self, name)) not in allowed:
                raise InputError(f"{name}: {value}; expected one of {', '.join(map(str, allowed))}")
        if self.steps < 1:
            raise InputError(f"steps: {self.steps}; expected 1 or more")
        if not 0 < self.learning_rate <= 1:
            raise InputError(f"learning_rate: {self.learning_rate}; expected a positive number up to 1")

    @property
    def level(self) -> int | None:
        """Subdivisions of the mesh; None for exact ellipsoids."""
        return None if self.renderer == "exact" else int(self.renderer[1])


class DemoState:
    """A body on its way to a target.

    Args:
        start: Where it begins, B = 1.
        target: What it is to reach.
        settings: How it gets there.

    Attributes:
        start: Where ``restart`` goes back to.
        body: Where it is.
        target: What it is to reach.
        settings: How it gets there; ``configure`` changes them.
        history: Energy before each step so far.

    Raises:
        InputError: If the settings need labels that the target has not.
    """

    def __init__(self, start: BodyParameters, target: Target, settings: Settings | None = None) -> None:
        self.start = self.body = start
        self.target = target
        self.settings = settings or Settings()
        self.prior = PosePrior()
        self.history: list[float] = []
        self._check_labels(target)
        self.restart()

    def configure(self, **changes: Any) -> None:
        """Change some of the ``Settings``; the body stays where it is, and its history begins anew.

        Raises:
            InputError: If a value is none of its choices, or needs labels that the target has not; nothing changes.
        """
        before = self.settings
        self.settings = replace(self.settings, **changes)
        try:
            self._check_labels(self.target)
        except InputError:
            self.settings = before
            raise
        self._begin()

    def _check_labels(self, target: Target) -> None:
        if self.settings.supervision != "keypoints" and target.observation.labels is None:
            raise InputError(
                f"supervision: {self.settings.supervision}, without part labels; expected --parts FILE, or keypoints, "
                "which need none"
            )

    def aim(self, target: Target) -> None:
        """Take another target, from the same start.

        Raises:
            InputError: If the settings need labels that it has not; nothing changes.
        """
        self._check_labels(target)
        self.target = target
        self.restart()

    def reset(self, body: BodyParameters) -> None:
        """Start from another body."""
        self.start = body.detach()
        self.restart()

    def restart(self) -> None:
        """Go back to the start."""
        self.body = self.start
        self._begin()

    def _begin(self) -> None:
        self._moved()
        self.body = self.body.leaves()
        rate = self.settings.learning_rate
        groups = [
            {"params": tensor, "lr": rate * (SHAPE_RATE if name in SIZES else 1.0)}
            for name, tensor in self.body.tensors().items()
        ]
        self._adam = torch.optim.Adam(groups)
        self._schedule = torch.optim.lr_scheduler.LambdaLR(
            self._adam, lambda step: rate_share(min(step, self.settings.steps), self.settings.steps, _FINAL_RATE)
        )
        self.history = []
        self._times: deque[float] = deque(maxlen=_TIMED)
        self.energy = self._make_energy()

    def _make_energy(self) -> Energy:
        seen, settings = self.target.observation, self.settings
        if settings.supervision == "keypoints":
            seen = replace(seen, labels=None, label_set=None)
        elif settings.supervision == "silhouette" and seen.labels is not None:
            person = (seen.labels != BACKGROUND) & (seen.labels != IGNORE)
            seen = replace(seen, labels=seen.labels.masked_fill(person, 1), label_set=label_set("full1"))
        return Energy(
            seen,
            size=settings.size,
            prior=self.prior,
            renderer="exact" if settings.level is None else "mesh",
            subdivisions=settings.level or 0,
            gradient=settings.gradient,
            depth_weight=DEFAULT_DEPTH_WEIGHT if settings.depth_gradient else 0.0,
        )

    def step(self) -> None:
        """One iteration of the refinement: what ``refine`` does, with nothing ahead of it decided."""
        began = time.perf_counter()
        total = torch.stack(list(self.energy(self.body).values())).sum()
        self._adam.zero_grad(set_to_none=True)
        total.backward()
        self._adam.step()
        self._schedule.step()
        with torch.no_grad():
            for name in SIZES:
                low, high = self.bounds(name)
                self.body.tensors()[name].clamp_(low, high)
        self._moved()
        self._times.append(time.perf_counter() - began)
        self.history.append(float(total.detach()))

    def _moved(self) -> None:
        self._posed: Posed | None = None
        self._drawn: np.ndarray | None = None

    def play(self, count: int) -> None:
        """So many steps."""
        for _ in range(count):
            self.step()

    def bounds(self, name: str) -> tuple[torch.Tensor, torch.Tensor]:
        """Smallest and largest "lengths" or "thicknesses" [m], shape (1, 12) or (1, 15) each."""
        low, high = SIZES[name]
        return low * self._mean.tensors()[name], high * self._mean.tensors()[name]

    @cached_property
    def _mean(self) -> BodyParameters:
        return BodyParameters.mean(1)

    def set_length(self, name: str, metres: float) -> None:
        """Change one of ``LENGTH_NAMES``, within 60 and 140 % of the mean adult's; the edited body is the new start."""
        self._set_size("lengths", LENGTH_NAMES, name, metres)

    def set_thickness(self, name: str, metres: float) -> None:
        """Change one of ``THICKNESS_NAMES``, within 40 and 160 % of the mean adult's; the same."""
        self._set_size("thicknesses", THICKNESS_NAMES, name, metres)

    def _set_size(self, field: str, names: tuple[str, ...], name: str, metres: float) -> None:
        index = _index(field, names, name)
        low, high = self.bounds(field)
        values = self.body.tensors()[field].detach().clone()
        values[0, index] = min(max(metres, float(low[0, index])), float(high[0, index]))
        self.reset(replace(self.body.detach(), **{field: values}))

    def set_rotation(self, part: str, axis: int, radians: float) -> None:
        """Change a component of a part's rotation vector, within what joints allow; the edited body is the new start.

        Args:
            part: One of ``PART_NAMES``; the hips don't turn.
            axis: 0 to 2.
            radians: Wanted component.
        """
        index = _index("part", PART_NAMES, part)
        low, high = self.prior.lower_limits[index, axis], self.prior.upper_limits[index, axis]
        rotations = self.body.rotations.detach().clone()
        rotations[0, index, axis] = min(max(radians, float(low)), float(high))
        self.reset(replace(self.body.detach(), rotations=rotations))

    @torch.no_grad()
    def posed(self) -> Posed:
        """Where the body's ellipsoids are, in the camera frame [m], without gradient."""
        if self._posed is None:
            self._posed = self.body.posed()
        return self._posed

    @torch.no_grad()
    def drawn(self) -> np.ndarray:
        """Group ids of the body as the renderer of the settings draws it, shape (size, size), uint8."""
        if self._drawn is None:
            size, level, groups = self.settings.size, self.settings.level, self.target.label_set.part_groups
            posed, camera = self.posed(), self.body.camera(size)
            if level is None:
                shown = draw_ellipsoids(posed, camera, (size, size), part_labels=groups[1:].tolist(), validate=False)
                self._drawn = shown.labels[0].numpy()
            else:
                mesh = ellipbody_mesh(level).relabel(groups)
                points = camera.project(posed.vertices(level))
                self._drawn = rasterize_parts(points, mesh, (size, size), validate=False).labels[0].numpy()
        return self._drawn

    def wanted(self) -> np.ndarray | None:
        """Group ids of the target, shape (size, size), uint8; None without labels."""
        labels = self.target.observation.labels
        return None if labels is None else resize_nearest(labels, self.settings.size).numpy()

    def pictures(self) -> dict[str, np.ndarray]:
        """Body, target and difference by these names, in the parts' colours, RGB, shape (size, size, 3), uint8.

        In the difference, a wrong pixel has the colour that it should have; what should be background is dark.
        """
        colours = group_colours(self.target.label_set.part_groups)
        colours[BACKGROUND], colours[IGNORE] = _BACKGROUND_COLOUR, _UNKNOWN_COLOUR
        drawn, wanted = self.drawn(), self.wanted()
        shown = {"body": colours[drawn]}
        if wanted is None:
            blank = np.full_like(shown["body"], _BACKGROUND_COLOUR)
            return shown | {"target": blank, "difference": blank}
        counted = wanted != IGNORE
        difference = np.full_like(shown["body"], _BACKGROUND_COLOUR)
        difference[counted & (wanted > 0)] = _RIGHT_COLOUR
        wrong = counted & (drawn != wanted)
        difference[wrong] = np.where(wanted[wrong, None] > 0, colours[wanted[wrong]], IGNORE_COLOUR)
        return shown | {"target": colours[wanted], "difference": difference}

    def forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the losses of keypoints and labels pull each ellipsoid: minus their gradient at its centre.

        Returns:
            Centres in the camera frame [m], and the pull [a metre], shape (20, 3) each.
        """
        body, posed = self.body.detach(), self.posed()
        posed = replace(posed, centres=posed.centres.clone().requires_grad_())
        loss = self.energy.weights.proj * self.energy.reprojection(body, posed)
        if self.energy.target is not None:
            loss = loss + self.energy.weights.seg * self.energy.segmentation(body, posed)
        loss.sum().backward()
        assert posed.centres.grad is not None
        return posed.centres.detach()[0].numpy(), -posed.centres.grad[0].numpy()

    def milliseconds(self) -> float | None:
        """Median time of the last iterations; None before the first."""
        return float(np.median(self._times)) * 1000 if self._times else None

    def part_f1(self) -> float | None:
        """Part F1 of what is drawn against the target; None without labels."""
        wanted = self.wanted()
        if wanted is None:
            return None
        return float(part_f1(confusion(self.drawn(), wanted, self.target.label_set.num_groups + 1)))

    def joint_error(self) -> float | None:
        """Mean distance of the joints to the target body's, pelvis on pelvis [mm]; None of a photo."""
        if self.target.posed is None:
            return None
        return float(mpjpe(self.posed().joints, self.target.posed.joints, centre_on=(0,))) * 1000

    def save(self, path: str | Path) -> None:
        """Write the body as ``body.npz``, or as coloured meshes where the name ends with .glb.

        Raises:
            InputError: If it can't be written.
        """
        size = self.settings.size
        try:
            if Path(path).suffix == ".glb":
                ellipbody_scene(self.body.detach().posed()).export(path)
            else:
                body_file(self.body, self.body.detach().camera(size), (size, size)).save(path)
        except OSError as error:
            raise InputError(f"{path}: {error.strerror or error}; expected a file in a folder that is there") from error

    def load(self, path: str | Path) -> None:
        """Start from the body of a ``body.npz``; see ``read_body``."""
        self.reset(read_body(path))


def _index(kind: str, names: tuple[str, ...], name: str) -> int:
    if name not in names:
        raise InputError(f"{kind}: {name!r}; expected one of {', '.join(names)}")
    return names.index(name)
