"""Chart of the confidence in the bodies of a film's people. It does without matplotlib, which takes long to load."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..pipelines.film import Motion
from ..solve.confidence.model import packaged_model
from .palette import PEOPLE_COLOURS

if TYPE_CHECKING:
    from PIL.Image import Image

_SMOOTH = 2  # factor by which the chart is drawn larger, for smooth lines
_WIDTH, _HEIGHT = 900 * _SMOOTH, 380 * _SMOOTH
_LEFT, _RIGHT, _TOP, _BOTTOM = 62 * _SMOOTH, _WIDTH - 14 * _SMOOTH, 46 * _SMOOTH, _HEIGHT - 44 * _SMOOTH
_GRID, _LIMIT, _BELOW = (205, 205, 205), (200, 60, 20), (252, 236, 230)
_MOST_TICKS = 10


def confidence_chart(motions: Mapping[int, Motion], times: np.ndarray) -> Image:
    """Draw the confidence in the bodies of a film's people over time, a line a person, and the limit of warnings.

    A line is interrupted where the person was not found.

    Args:
        motions: Motions by the index of the person.
        times: Times of the film's frames [s], shape (F,).
    """
    from PIL import Image as PilImage
    from PIL import ImageDraw, ImageFont

    chart = PilImage.new("RGB", (_WIDTH, _HEIGHT), "white")
    draw = ImageDraw.Draw(chart)
    font, small = ImageFont.load_default(14 * _SMOOTH), ImageFont.load_default(12 * _SMOOTH)
    end = max(float(times[-1]), 1e-3)

    def at(time: float, probability: float) -> tuple[float, float]:
        return _LEFT + (_RIGHT - _LEFT) * time / end, _BOTTOM - (_BOTTOM - _TOP) * probability

    limit = packaged_model().least
    draw.rectangle([*at(0.0, limit), *at(end, 0.0)], fill=_BELOW)
    for probability in (0.0, 0.25, 0.5, 0.75, 1.0):
        draw.line([at(0.0, probability), at(end, probability)], fill=_GRID)
        draw.text((_LEFT - 6 * _SMOOTH, at(0.0, probability)[1]), f"{probability:g}", "black", small, anchor="rm")
    for time in _ticks(end):
        draw.text((at(time, 0.0)[0], _BOTTOM + 6 * _SMOOTH), f"{time:g}", "black", small, anchor="ma")
    draw.line([at(0.0, limit), at(end, limit)], fill=_LIMIT, width=_SMOOTH)
    title = "confidence in the body of"
    draw.text((_LEFT, 8 * _SMOOTH), title, "black", font)
    column = _LEFT + font.getlength(title) + 12 * _SMOOTH
    for index, (person, motion) in enumerate(motions.items()):
        red, green, blue = PEOPLE_COLOURS[index % len(PEOPLE_COLOURS)].tolist()
        for run in _runs(motion):
            values = zip(times[motion.frames[run]].tolist(), _probabilities(motion)[run].tolist(), strict=True)
            points = [at(*each) for each in values]
            draw.line(points, fill=(red, green, blue), width=2 * _SMOOTH, joint="curve")
            x, y = points[0]
            draw.ellipse([x - _SMOOTH, y - _SMOOTH, x + _SMOOTH, y + _SMOOTH], fill=(red, green, blue))
        name = f"person{person}"
        if column + font.getlength(name) < _RIGHT:  # colours of further people are seen in the lines alone
            draw.text((column, 8 * _SMOOTH), name, (red, green, blue), font)
        column += font.getlength(name) + 12 * _SMOOTH
    draw.rectangle([_LEFT, _TOP, _RIGHT, _BOTTOM], outline=(120, 120, 120), width=_SMOOTH)
    draw.text(((_LEFT + _RIGHT) / 2, _HEIGHT - 8 * _SMOOTH), "time [s]", "black", font, anchor="ms")
    return chart.resize((_WIDTH // _SMOOTH, _HEIGHT // _SMOOTH), PilImage.Resampling.LANCZOS)


def _probabilities(motion: Motion) -> np.ndarray:
    """Confidence in each frame of a motion, NaN where it is not known, shape (T,)."""
    return np.full(len(motion.frames), np.nan) if motion.confidence is None else motion.confidence.bodies


def _runs(motion: Motion) -> list[np.ndarray]:
    """Rows of a motion in runs of frames that follow one another and have a confidence."""
    rows = np.flatnonzero(np.isfinite(_probabilities(motion)))
    starts = np.flatnonzero(np.diff(motion.frames[rows]) > 1) + 1
    return [run for run in np.split(rows, starts) if len(run)]


def _ticks(end: float) -> list[float]:
    """Times from 0 to ``end`` at steps of 1, 2 or 5 times a power of ten [s], not too many."""
    power = 10.0 ** math.floor(math.log10(end / _MOST_TICKS))
    step = next(step for step in (power, 2 * power, 5 * power, 10 * power) if end / step <= _MOST_TICKS)
    return [index * step for index in range(math.floor(end / step) + 1)]
