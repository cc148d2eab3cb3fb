"""Figures of ``partdr bench tradeoff``, and the settings that no other one beats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from ...metrics import bootstrap_sum
from ...synthetic.tradeoff_people import ANNY, ELLIPBODY
from ..renderers import LEVELS
from ..timing import Timing
from .fits import Scores
from .gradient import GradientError
from .plan import DISTANCE, Setting

KEYPOINTS_TOO, LABELS_ALONE = "keypoints and labels", "labels alone"
CONVERGED = 0.85  # part F1 of an EllipBody that a refinement has found
FLOAT32, FLOAT64, BFLOAT16 = "float32", "float64", "float32, result kept in bfloat16"


@dataclass(frozen=True)
class Fit:
    """One setting's refinements of some people.

    Attributes:
        truth: ``ELLIPBODY`` or ``ANNY``.
        seen: ``KEYPOINTS_TOO`` or ``LABELS_ALONE``.
        setting: Their renderer, gradient, picture size and iterations.
        distance: Of starts from the truth [rad].
        scores: Their nearness to the truth.
        own_part_f1: Of meshes, the part F1 of the mesh itself, shape (N,).
        seconds: That an iteration took for each of all bodies at once.
    """

    truth: str
    seen: str
    setting: Setting
    distance: float
    scores: Scores
    own_part_f1: np.ndarray | None
    seconds: float

    @property
    def found(self) -> float:
        """Share of people that were found."""
        return float(np.mean(self.scores.part_f1 >= CONVERGED))


@dataclass(frozen=True)
class Precision:
    """A refinement in torch with numbers of a kind, and how far its joints end from float32's [mm], mean."""

    name: str
    numbers: str
    scores: Scores
    moved: float
    seconds: float


@dataclass
class TradeoffReport:
    """All that was measured.

    Attributes:
        device: "cpu" or a CUDA device.
        machine: Machine and versions by name.
        times: Of an iteration, of one body, by renderer and picture size.
        fits: All refinements.
        gradients: Of EllipBodies, by renderer, picture size and distance from the truth [rad].
        precisions: Other numbers than float32.
        qualities: Figures of whole fits (``scoring.summarise``) by PartBench's level and quality.
    """

    device: str
    machine: dict[str, str]
    times: dict[tuple[str, int], Timing] = field(default_factory=dict)
    fits: list[Fit] = field(default_factory=list)
    gradients: dict[tuple[str, int, float], GradientError] = field(default_factory=dict)
    precisions: list[Precision] = field(default_factory=list)
    qualities: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)

    def time(self, setting: Setting) -> float:
        """Of an iteration, of one body [s]."""
        return self.times[setting.name, setting.size].median

    def fit(self, truth: str, setting: Setting, distance: float = DISTANCE, seen: str = KEYPOINTS_TOO) -> Fit | None:
        """The refinements of a setting, if it was run."""
        wanted = (truth, seen, setting, distance)
        return next((fit for fit in self.fits if (fit.truth, fit.seen, fit.setting, fit.distance) == wanted), None)

    def gradient(self, setting: Setting, distance: float = DISTANCE) -> GradientError | None:
        """The gradients of a setting, if they were found; its iterations do not matter."""
        return self.gradients.get((setting.name, setting.size, distance))

    def settings(self) -> list[Setting]:
        """Those of the main table."""
        return [Setting(name, size) for name, size in self.times]

    def as_dict(self) -> dict[str, Any]:
        """For ``save_figures``."""
        return {
            "device": self.device,
            "machine": self.machine,
            "times": [
                {
                    "renderer": name,
                    "size_px": size,
                    "seconds": timing.median,
                    "fastest_of_each_person_s": list(timing.seconds),
                }
                for (name, size), timing in self.times.items()
            ],
            "fits": [_fit_as_dict(fit) for fit in self.fits],
            "gradients": [
                {
                    "renderer": name,
                    "size_px": size,
                    "distance_rad": distance,
                    "angle_deg": error.angle,
                    "length_ratio": error.ratio,
                }
                for (name, size, distance), error in self.gradients.items()
            ],
            "precisions": [
                {
                    "renderer": row.name,
                    "numbers": row.numbers,
                    **_scores_as_dict(row.scores),
                    "moved_mm": row.moved,
                    "seconds": row.seconds,
                }
                for row in self.precisions
            ],
            "qualities": self.qualities,
            "found": mesh_gains(self),
        }


def _scores_as_dict(scores: Scores) -> dict[str, Any]:
    return {"part_f1": scores.part_f1, "accuracy": scores.accuracy, "joint_error_mm": scores.joint_error}


def _fit_as_dict(fit: Fit) -> dict[str, Any]:
    return {
        "truth": fit.truth,
        "seen": fit.seen,
        "renderer": fit.setting.name,
        "size_px": fit.setting.size,
        "iterations": fit.setting.iterations,
        "distance_rad": fit.distance,
        **_scores_as_dict(fit.scores),
        "own_part_f1": fit.own_part_f1,
        "batch_seconds": fit.seconds,
    }


def front(points: Sequence[tuple[float, float]]) -> set[int]:
    """Indices of points (time, error) that no other beats: at most as slow, at most as wrong, and less of one."""
    return {
        index
        for index, (time, error) in enumerate(points)
        if not any(t <= time and e <= error and (t, e) != (time, error) for t, e in points)
    }


def mesh_gains(report: TradeoffReport) -> list[str]:
    """Part F1 that a mesh of the next level gains, E0 to E3, on the same people: one line a step."""
    said = []
    for truth in (ELLIPBODY, ANNY):
        fits = [report.fit(truth, Setting(name)) for name in LEVELS]
        known = [fit for fit in fits if fit is not None and fit.own_part_f1 is not None]
        for coarse, fine in pairwise(known):
            for what, gain in (
                ("part F1 of the mesh itself", _gain(fine.own_part_f1, coarse.own_part_f1)),
                ("part F1 of the ellipsoids", _gain(fine.scores.part_f1, coarse.scores.part_f1)),
            ):
                said.append(f"{truth}: {what}, {coarse.setting.name} to E{LEVELS[fine.setting.name]}: {gain}")
    return said


def _gain(fine: np.ndarray | None, coarse: np.ndarray | None) -> str:
    assert fine is not None
    assert coarse is not None
    gain = fine - coarse
    low, high = bootstrap_sum(gain, lambda sums: sums / len(gain))
    return f"{gain.mean():+.4f} ({low:+.4f} to {high:+.4f})"
