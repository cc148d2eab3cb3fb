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

    ``angle``, between its gradient of L_seg and the derivative of the wrongly labelled area at the start, is None where
    the true body isn't known, and where anything but all that the parts say is followed.
    """

    drawn: str  # renderer and gradient
    size: int  # of the picture [px]
    followed: str
    milliseconds: float  # of an iteration: of one at the start, then the median of the last
    angle: float | None  # [degrees]
    outline: float  # how far the farthest silhouette of the mesh is from the ellipsoid's at the start [px of 256]
    iterations: int = 0  # in the longest run
    f1: float | None = None  # of the drawn labels then; None without labels
    joints: float | None = None  # how far they are from the target's then [mm]; None of a photo


class Tradeoff:
    """The rows for one start and one target, in the order in which they were first tried; with another, none again."""

    def __init__(self, state: DemoState) -> None:
        self.state = state
        self._begin()

    def _begin(self) -> None:
        self.rows: dict[tuple[str, int, str], TradeoffRow] = {}
        self.current: tuple[str, int, str] | None = None
        self._start, self._target = self.state.start, self.state.target
        self._truth: tuple[People, torch.Tensor] | None = None

    def update(self, *, measure: bool) -> None:
        """Note how far the present setting has come; ``measure`` one that is new, which takes some iterations' time."""
        state = self.state
        if self._start is not state.start or self._target is not state.target:
            self._begin()
        key = _key(state.settings)
        if key not in self.rows:
            if not measure:
                return
            self.rows[key] = TradeoffRow(*key, _time(state), self._angle(), self._outline())
            if len(self.rows) > _MOST:
                del self.rows[next(iter(self.rows))]
        self.current, row = key, self.rows[key]
        row.milliseconds = state.milliseconds() or row.milliseconds
        if len(state.history) > row.iterations:  # a run that is repeated goes the same way
            row.iterations, row.f1, row.joints = len(state.history), state.part_f1, state.joint_error()

    def _angle(self) -> float | None:
        target, settings, start = self.state.target, self.state.settings, self.state.start
        if target.truth is None or target.posed is None or settings.supervision != "parts":
            return None
        if settings.offers_depth and not settings.has_depth:  # it is compared as it is by default
            return None
        if self._truth is None:
            labels = draw_truth(target.truth)
            people = People(ELLIPBODY, target.truth, labels, target.observation.points[None], target.posed.joints)
            self._truth = people, true_gradient(people, start)
        names = {gradient: name for name, gradient in GRADIENTS.items()}
        name = names[settings.gradient] if settings.level is None else f"mesh {settings.renderer}"
        people, true = self._truth
        angle = float(gradient_error(Setting(name, settings.size), people, start, true)["angle_deg"][0])
        return angle if np.isfinite(angle) else None

    @torch.no_grad()
    def _outline(self) -> float:
        level, start = self.state.settings.level, self.state.start
        if level is None:
            return 0.0
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
