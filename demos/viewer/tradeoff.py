"""Tradeoff of speed and accuracy: time and errors of each setting tried from the same start to the same target."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import torch

from ..bench.renderers import GRADIENTS
from ..bench.tradeoff.gradient import gradient_error, true_gradient
from ..bench.tradeoff.plan import Setting
from ..inputs.observation import REFERENCE_SIZE
from ..render.subdivisions import silhouette_error
from ..synthetic.tradeoff_people import ELLIPBODY, People, draw_truth
from .settings import Settings
from .state import DemoState

_MOST = 8  # rows that are kept


@dataclass
class TradeoffRow:
    """One setting: what can be said of it at the start, and how far it came.

    Attributes:
        drawn: Renderer and gradient.
        size: Side of the picture [px].
        followed: What is followed.
        milliseconds: Of an iteration: of one at the start, then the median of the last.
        angle: Between its gradient of L_seg and the derivative of the wrongly labelled area [degrees], at the start;
            None where the true body isn't known, and where anything but all that the parts say is followed.
        outline: How far the farthest silhouette of the mesh is from the ellipsoid's [px of 256], at the start.
        iterations: How many it was followed for from the start, in the longest run.
        f1: Part F1 of the drawn labels then; None without labels.
        joints: How far joints are from the target's then [mm]; None of a photo.
    """

    drawn: str
    size: int
    followed: str
    milliseconds: float
    angle: float | None
    outline: float
    iterations: int = 0
    f1: float | None = None
    joints: float | None = None


class Tradeoff:
    """The rows for one start and one target; with another of them they begin anew.

    Args:
        state: What is looked at.

    Attributes:
        rows: By what tells them apart, in the order in which they were first tried.
        current: Which of them is the present one.
    """

    def __init__(self, state: DemoState) -> None:
        self.state = state
        self.rows: dict[tuple[str, int, str], TradeoffRow] = {}
        self.current: tuple[str, int, str] | None = None
        self._pair: tuple[object, object] | None = None
        self._truth: tuple[People, torch.Tensor] | None = None

    def update(self, *, measure: bool) -> None:
        """Note how far the present setting has come.

        Args:
            measure: Whether a setting that is new is measured now, which takes some iterations' time.
        """
        state, pair = self.state, (self.state.start, self.state.target)
        if self._pair is None or any(old is not new for old, new in zip(self._pair, pair, strict=True)):
            self.rows, self.current, self._pair, self._truth = {}, None, pair, None
        key = _key(state.settings)
        if key not in self.rows:
            if not measure:
                return
            self.rows[key] = TradeoffRow(*key, _time(state), self._angle(), self._outline())
            while len(self.rows) > _MOST:
                del self.rows[next(iter(self.rows))]
        self.current = key
        row = self.rows[key]
        row.milliseconds = state.milliseconds() or row.milliseconds
        if len(state.history) > row.iterations:  # a run that is repeated goes the same way
            row.iterations, row.f1, row.joints = len(state.history), state.part_f1(), state.joint_error()

    def _angle(self) -> float | None:
        target, settings = self.state.target, self.state.settings
        if target.truth is None or target.posed is None or settings.supervision != "parts":
            return None
        if settings.offers_depth and not settings.has_depth:  # it is compared as it is by default
            return None
        if self._truth is None:
            labels = draw_truth(target.truth)
            people = People(ELLIPBODY, target.truth, labels, target.observation.points[None], target.posed.joints)
            self._truth = people, true_gradient(people, self.state.start)
        names = {gradient: name for name, gradient in GRADIENTS.items()}
        name = names[settings.gradient] if settings.level is None else f"mesh {settings.renderer}"
        people, true = self._truth
        angle = float(gradient_error(Setting(name, settings.size), people, self.state.start, true).angle[0])
        return angle if np.isfinite(angle) else None

    def _outline(self) -> float:
        level, start = self.state.settings.level, self.state.start
        if level is None:
            return 0.0
        with torch.no_grad():
            return float(silhouette_error(start.posed(), start.camera(REFERENCE_SIZE), level).max())


def _key(settings: Settings) -> tuple[str, int, str]:
    depth = " + z" if settings.has_depth else ""
    return settings.drawn, settings.size, settings.supervision + depth


def _time(state: DemoState) -> float:
    """Of an iteration without its step [ms]: the second one, for the first may load kernels."""
    for _ in range(2):
        body = state.start.leaves()
        began = time.perf_counter()
        torch.stack(list(state.energy(body).values())).sum().backward()
    return (time.perf_counter() - began) * 1000
