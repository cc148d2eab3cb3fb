"""Tradeoff of speed and accuracy: time and errors of each setting tried from the same start to the same target."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ..inputs.observation import REFERENCE_SIZE
from ..lab.bench.renderers import GRADIENTS
from ..lab.bench.tradeoff.gradient import gradient_error, true_gradient
from ..lab.bench.tradeoff.plan import Setting
from ..lab.synthetic.tradeoff_people import ELLIPBODY, People, draw_truth
from ..render.subdivisions import silhouette_error
from .overlay import Overlay
from .settings import Settings
from .state import DemoState
from .style import ACCENT, FAINT, INK, PAPER

_MOST = 8  # rows that are kept
_WIDE, _TALL, _LETTER, _LINE = 372, 186, 11, 16  # [px] of the table where its letters have this size
_WORDS = 2  # columns of words, which begin at x; the others end there

# Of each column: two lines of its head, x [px], the row's attribute and how it is written.
_COLUMNS: tuple[tuple[str, str, int, str, str], ...] = (
    ("drawn,", "gradient", 0, "drawn", "{}"),
    ("follows", "", 88, "followed", "{}"),
    ("", "px", 168, "size", "{}"),
    ("ms an", "iter.", 204, "milliseconds", "{:.1f}"),
    ("grad.", "off", 237, "angle", "{:.0f}°"),
    ("outline", "off, px", 279, "outline", "{:.1f}"),
    ("", "iter.", 305, "iterations", "{}"),
    ("", "F1", 334, "f1", "{:.2f}"),
    ("joints", "mm", 363, "joints", "{:.0f}"),
)


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


class TradeoffTable:
    """The rows of a tradeoff, painted in a view as large as they fit in."""

    def __init__(self, renderer: Any, tradeoff: Tradeoff) -> None:
        self._overlay, self._renderer, self._tradeoff = Overlay(renderer), renderer, tradeoff
        self._shown: list[tuple[list[str], str]] = []  # lines and their colours

    def update(self) -> None:
        """Paint the lines that have changed."""
        size = tuple(self._renderer.GetSize())
        if not self._renderer.GetDraw() or min(size) < 1:
            return
        if size != self._overlay.size:
            self._scale = min(size[0] / _WIDE, size[1] / _TALL)
            self._overlay.begin((size[0], size[1]), max(_LETTER * self._scale, 1))
            self._shown = []
        lines = [(["Tried from this start to this target:"], INK)]
        lines += [([first for first, *_ in _COLUMNS], FAINT), ([second for _, second, *_ in _COLUMNS], FAINT)]
        for key, row in self._tradeoff.rows.items():
            values = [(getattr(row, name), style) for *_, name, style in _COLUMNS]
            texts = ["-" if value is None else style.format(value) for value, style in values]
            lines.append((texts, ACCENT if key == self._tradeoff.current else INK))
        lines += [([], INK)] * (len(self._shown) - len(lines))  # where there were more
        changed = [k for k, line in enumerate(lines) if line not in self._shown[k : k + 1]]
        for k in changed:
            self._paint(k, *lines[k])
        if changed:
            self._shown = lines
            self._overlay.show()

    def _paint(self, index: int, texts: list[str], colour: str) -> None:
        draw, scale, top = self._overlay.draw, self._scale, _LINE * index + (4 if index > 2 else 0)
        draw.rectangle((0, scale * top, scale * _WIDE, scale * (top + _LINE) - 1), fill=PAPER)
        for k, (text, column) in enumerate(zip(texts, _COLUMNS, strict=False)):
            place = scale * (column[2] + 4), scale * (top + 1)
            draw.text(place, text, colour, self._overlay.font, anchor="la" if k < _WORDS else "ra")


def _key(settings: Settings) -> tuple[str, int, str]:
    depth = " + z" if settings.has_depth else ""
    return settings.drawn, settings.size, settings.supervision + depth


def _time(state: DemoState) -> float:
    """Time of an iteration without its step [ms].

    The second iteration is measured, for the first one may load kernels.
    """
    for _ in range(2):
        body = state.start.leaves()
        began = time.perf_counter()
        torch.stack(list(state.energy(body).values())).sum().backward()
    return (time.perf_counter() - began) * 1000
