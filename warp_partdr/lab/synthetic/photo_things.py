"""Things that hide parts of people in photos: tables, wheelchairs and what riders sit on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...body.skeletons import MPJPE_JOINTS
from ...body.template import PART_NAMES
from .partbench_people import COCO, Person

_HIPS = [COCO.landmarks.index(name) for name in ("left_hip", "right_hip")]
_KNEES = [COCO.landmarks.index(name) for name in ("left_knee", "right_knee")]
_ANKLES = [MPJPE_JOINTS.index(name) for name in ("left_ankle", "right_ankle")]
_LEG_ENDS = ("upper_leg", "lower_leg", "foot")
_WHEEL, _RIM, _SPOKE = 0.31, 0.025, 0.006  # [m], radius of a wheel, half of its rim's width and of a spoke's
_SPOKES = 6
_PANEL = 0.12  # [m], height of the panel beside the seat
_BARREL = (0.55, 0.28)  # [m], half of the length and of the height of what a rider sits on


@dataclass(frozen=True)
class Thing:
    """Thing in a picture.

    Attributes:
        mask: Flags of its pixels, shape (H, W), bool.
        colours: RGB of all pixels, shape (H, W, 3), float64.
    """

    mask: np.ndarray
    colours: np.ndarray


class Paint:
    """Colours of things in a picture of a size (H, W)."""

    def __init__(self, size: tuple[int, ...], rng: np.random.Generator) -> None:
        self.size = size[0], size[1]
        self.rng = rng

    def thing(self, mask: np.ndarray) -> Thing:
        """Thing of a random colour with grain, which becomes lighter to the right."""
        height, width = self.size
        shades = self.rng.normal(0, 8, (height, width, 1)) + np.linspace(0, 30, width)[None, :, None]
        return Thing(mask, (self.rng.uniform(0, 255, 3) + shades).clip(0, 255))

    def grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Columns, shape (1, W), and rows, shape (H, 1), of the pixels."""
        height, width = self.size
        return np.arange(width)[None] + 0.5, np.arange(height)[:, None] + 0.5


def bench_thing(paint: Paint, people: np.ndarray) -> Thing:
    """Table or bench before people, whose pixels are flagged, shape (H, W)."""
    rng, (height, width) = paint.rng, paint.size
    top = int(np.quantile(np.nonzero(people)[0], rng.uniform(0.3, 0.8)))
    left, right = (0, width) if rng.random() < 0.5 else np.sort(rng.integers(0, width, 2)).tolist()
    bottom = height if rng.random() < 0.6 else min(height, top + int(rng.uniform(0.1, 0.5) * height))
    mask = np.zeros(paint.size, dtype=bool)
    mask[top:bottom, left:right] = True
    return paint.thing(mask)


def chair_thing(paint: Paint, person: Person) -> Thing:
    """Wheels of a wheelchair on both sides of a seated person, and a panel beside the seat."""
    columns, rows = paint.grid()
    points, metre = person.keypoints(COCO), person.height / person.stature
    mask = np.zeros(paint.size, dtype=bool)
    hips, knees = points[_HIPS], points[_KNEES]
    wide = np.linalg.norm(hips[0] - hips[1]) / (0.25 * metre)  # 1 where the person is seen from the front
    flat = float(np.clip(1.0 - wide, 0.25, 1.0))  # of a wheel that is seen askew
    turn = paint.rng.uniform(0, np.pi)
    for hip, knee in zip(hips, knees, strict=True):
        away = hip - hips.mean(axis=0)
        middle = hip + 0.8 * away + np.array([0.0, 0.08 * metre])
        across, down = (columns - middle[0]) / flat, rows - middle[1]
        distance = np.hypot(across, down)
        mask |= np.abs(distance - _WHEEL * metre) < _RIM * metre
        for number in range(_SPOKES):
            angle = turn + np.pi * number / _SPOKES
            line = np.abs(across * np.sin(angle) - down * np.cos(angle)) < max(_SPOKE * metre, 0.7)
            mask |= line & (distance < _WHEEL * metre)
        low, high = np.sort([hip[0], hip[0] + 0.6 * (knee[0] - hip[0])])
        mask |= (columns > low) & (columns < high) & (np.abs(rows - hip[1] - 0.04 * metre) < _PANEL / 2 * metre)
    return paint.thing(mask)


def mount_thing(paint: Paint, person: Person) -> Thing:
    """Trunk of what a rider sits on, which hides the far leg; the near leg hides it."""
    columns, rows = paint.grid()
    points, metre = person.keypoints(COCO), person.height / person.stature
    hips = points[_HIPS].mean(axis=0)
    length = _BARREL[0] * metre * paint.rng.uniform(0.8, 1.3)
    height = _BARREL[1] * metre * paint.rng.uniform(0.8, 1.2)
    middle = hips + np.array([paint.rng.uniform(-0.2, 0.2) * metre, 0.9 * height])
    mask = ((columns - middle[0]) / length) ** 2 + ((rows - middle[1]) / height) ** 2 < 1
    left, right = person.joints[_ANKLES, 2]
    far = "right" if left < right else "left"
    hidden = np.isin(person.parts, [0, *_labels(far)])
    return paint.thing(mask & hidden)


def _labels(side: str) -> list[int]:
    """Part labels of a leg."""
    return [PART_NAMES.index(f"{side}_{name}") + 1 for name in _LEG_ENDS]
