"""The demo without a picture: a body, its target, and the refinement between them one step at a time."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..body.labels import BACKGROUND, IGNORE, label_set
from ..body.parameters import BodyParameters
from ..body.pose_prior import PosePrior
from ..body.posing import Posed
from ..body.template import LENGTH_NAMES, PART_NAMES, THICKNESS_NAMES
from ..errors import InputError
from ..metrics import mpjpe, part_f1
from ..refinement.energy import Energy
from ..refinement.stepper import Refinement, size_bounds
from ..render.renderers import Renderer, RendererMesh
from ..results.ellipbody_files import ellipbody_scene
from ..results.save import body_file
from .settings import Settings
from .targets import BACKGROUND_COLOUR, Target, TargetPicture, picture_colours, read_body, target_picture
from .view import VIEW, seen_as, view_of

SIZE_NAMES = {"lengths": LENGTH_NAMES, "thicknesses": THICKNESS_NAMES}
_TIMED = 15  # the last so many iterations tell the time of one
_OUTLINE_LEVEL = 2  # of the mesh whose vertices stand for the outline of exact ellipsoids


@dataclass(frozen=True)
class _HeldVertices(Posed):
    """A body whose vertices are given, so that a gradient can be taken in them."""

    held: torch.Tensor

    def vertices(self, subdivisions: int = _OUTLINE_LEVEL) -> torch.Tensor:
        return self.held


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
        self._seen: Target | None = None  # the target of those pictures
        self._target_pictures: dict[int, TargetPicture | None] = {}  # by their size
        _check_labels(self.settings, target)
        self.restart()

    def configure(self, **changes: Any) -> None:
        """Change some of the ``Settings`` and go back to the start, so that runs can be compared; else do nothing.

        Args:
            changes: The new values.

        Raises:
            InputError: If a value is none of its choices, or needs labels that the target has not; nothing changes.
        """
        settings = replace(self.settings, **changes)
        _check_labels(settings, self.target)
        if settings != self.settings:
            self.settings = settings
            self.restart()

    def set_target(self, target: Target) -> None:
        """Take another target, from the same start.

        Raises:
            InputError: If the settings need labels that it has not; nothing changes.
        """
        _check_labels(self.settings, target)
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
        settings = self.settings
        self.energy = self._make_energy(settings.drawn_by())
        self._refinement = Refinement(
            self.body, self.energy, iterations=settings.steps, learning_rate=settings.learning_rate
        )
        self.body = self._refinement.bodies
        self.history: list[float] = []
        self._times: deque[float] = deque(maxlen=_TIMED)
        self._outline_energy: Energy | None = None
        if self._seen is not self.target:
            self._seen, self._target_pictures = self.target, {}
        if (size := self.settings.size) not in self._target_pictures:
            self._target_pictures[size] = target_picture(self.target, size)

    def _make_energy(self, renderer: Renderer) -> Energy:
        seen, settings = self.target.observation, self.settings
        if settings.supervision == "keypoints":
            seen = replace(seen, labels=None, label_set=None)
        elif settings.supervision == "silhouette" and seen.labels is not None:
            person = (seen.labels != BACKGROUND) & (seen.labels != IGNORE)
            seen = replace(seen, labels=seen.labels.masked_fill(person, 1), label_set=label_set("full1"))
        return Energy(seen, size=settings.size, prior=self.prior, renderer=renderer)

    def step(self) -> None:
        """One iteration of the refinement."""
        began = time.perf_counter()
        self._refinement.step()
        self._moved()
        self._times.append(time.perf_counter() - began)
        self.history.append(float(self._refinement.history[-1]))

    def _moved(self) -> None:
        self._posed: Posed | None = None
        self._drawn: np.ndarray | None = None
        self._part_f1: float | None = None

    def play(self, count: int) -> None:
        """So many steps."""
        for _ in range(count):
            self.step()

    def bounds(self, name: str) -> tuple[torch.Tensor, torch.Tensor]:
        """Smallest and largest "lengths" or "thicknesses" [m], shape (1, 12) or (1, 15) each."""
        return size_bounds(name, "cpu")

    def set_size(self, field: str, name: str, metres: float) -> None:
        """Change a length or thickness, within the bounds about the mean adult's; the edited body is the new start.

        Args:
            field: "lengths" or "thicknesses".
            name: One of ``SIZE_NAMES[field]``.
            metres: The new size.
        """
        index = _index(field, SIZE_NAMES[field], name)
        low, high = self.bounds(field)
        values = self.body.tensors()[field].detach().clone()
        values[0, index] = min(max(metres, float(low[0, index])), float(high[0, index]))
        self.reset(replace(self.body.detach(), **{field: values}))

    def set_rotation(self, part: str, axis: int, radians: float) -> None:
        """Change a component of a part's rotation vector, within what joints allow; the edited body is the new start.

        Args:
            part: One of ``PART_NAMES``; the hips don't turn.
            axis: 0 to 2.
            radians: The new component.
        """
        index = _index("part", PART_NAMES, part)
        low, high = self.prior.lower_limits[index, axis], self.prior.upper_limits[index, axis]
        rotations = self.body.rotations.detach().clone()
        rotations[0, index, axis] = min(max(radians, float(low)), float(high))
        self.reset(replace(self.body.detach(), rotations=rotations))

    def view(self) -> dict[str, float]:
        """View of the body: the numbers of ``VIEW``."""
        return view_of(self.body)

    def set_view(self, name: str, value: float) -> None:
        """Change one of the numbers of ``VIEW``, within its bounds; the edited body is the new start."""
        _index("view", tuple(VIEW), name)
        _, low, high = VIEW[name]
        self.reset(seen_as(self.body, {**self.view(), name: min(max(value, low), high)}))

    @torch.no_grad()
    def posed(self) -> Posed:
        """The posed body, in the camera frame [m], without gradient."""
        if self._posed is None:
            self._posed = self.body.posed()
        return self._posed

    @torch.no_grad()
    def drawn(self) -> np.ndarray:
        """Group ids of the body as the renderer of the settings draws it, shape (size, size), uint8."""
        if self._drawn is None:
            size, groups = self.settings.size, self.target.label_set.part_groups[1:].tolist()
            renderer, camera = self.settings.drawn_by(), self.body.camera(size)
            shown = renderer.draw(self.posed(), camera, (size, size), part_labels=groups, validate=False)
            self._drawn = shown.labels[0].numpy()
        return self._drawn

    def target_labels(self) -> np.ndarray | None:
        """Group ids of the target, shape (size, size), uint8; None without labels."""
        target = self._target_pictures[self.settings.size]
        return None if target is None else target.labels

    def pictures(self) -> dict[str, np.ndarray]:
        """Body, target and difference by these names, in the parts' colours, RGB, shape (size, size, 3), uint8.

        In the difference, a wrong pixel has the colour that it should have; what should be background is dark.
        """
        drawn, target = self.drawn(), self._target_pictures[self.settings.size]
        shown = {"body": picture_colours(self.target).take(drawn, axis=0)}
        if target is None:
            blank = np.full_like(shown["body"], BACKGROUND_COLOUR)
            return shown | {"target": blank, "difference": blank}
        return shown | {"target": target.picture, "difference": target.difference(drawn)}

    def forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Pull of the losses of keypoints and labels on each ellipsoid: minus their gradient at its centre.

        Returns:
            Centres in the camera frame [m], and the pull [a metre], shape (20, 3) each.
        """
        body, posed = self.body.detach(), self.posed()
        posed = replace(posed, centres=posed.centres.clone().requires_grad_())
        torch.stack(list(self.energy.terms(body, posed, ("proj", "seg")).values())).sum().backward()
        assert posed.centres.grad is not None
        return posed.centres.detach()[0].numpy(), -posed.centres.grad[0].numpy()

    def outline_forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Pull of the loss of labels on the vertices of the mesh, most of them on its silhouettes.

        Of exact ellipsoids, the vertices are those of level 2, with PartDR's gradient.

        Returns:
            Those with a pull in the camera frame [m], and their pull [a metre], shape (N, 3) each; N = 0 where no
            labels are followed.
        """
        level = self.settings.level
        if self._outline_energy is None:
            mesh = self._make_energy(RendererMesh(_OUTLINE_LEVEL, depth_weight=self.settings.depth_weight))
            self._outline_energy = mesh if level is None else self.energy
        energy = self._outline_energy
        if energy.target is None:
            return np.zeros((0, 3)), np.zeros((0, 3))
        posed = self.posed()
        vertices = posed.vertices(_OUTLINE_LEVEL if level is None else level).requires_grad_()
        loss = energy.segmentation(self.body.detach(), _HeldVertices(**vars(posed), held=vertices))
        (slope,) = torch.autograd.grad(energy.weights.seg * loss.sum(), vertices)
        pulled = (slope[0] != 0).any(1)
        return vertices.detach()[0, pulled].numpy(), -slope[0, pulled].numpy()

    def milliseconds(self) -> float | None:
        """Median time of the last iterations; None before the first."""
        return float(np.median(self._times)) * 1000 if self._times else None

    def part_f1(self) -> float | None:
        """Part F1 of what is drawn against the target; None without labels."""
        labels = self.target_labels()
        if labels is None:
            return None
        if self._part_f1 is None:
            # As ``confusion`` counts, which takes 30 times as long to check and to mask; ignored pixels come last.
            classes = self.target.label_set.num_groups + 1
            counts = np.bincount((labels.astype(np.uint16) * classes + self.drawn()).ravel(), minlength=classes**2)
            self._part_f1 = float(part_f1(counts[: classes**2].reshape(classes, classes)))
        return self._part_f1

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


def _check_labels(settings: Settings, target: Target) -> None:
    if settings.supervision != "keypoints" and target.observation.labels is None:
        raise InputError(
            f"supervision: {settings.supervision}, without part labels; expected --parts FILE, or keypoints, which "
            "need none"
        )


def _index(kind: str, names: tuple[str, ...], name: str) -> int:
    if name not in names:
        raise InputError(f"{kind}: {name!r}; expected one of {', '.join(names)}")
    return names.index(name)
