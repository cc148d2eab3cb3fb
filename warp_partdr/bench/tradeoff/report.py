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
        scores: Their nearness to the truth.
        own_part_f1: Of meshes, the part F1 of the mesh itself, shape (N,).
        seconds: That an iteration took for each of all bodies at once.
    """

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
    moved_mm: float
    seconds: float


@dataclass
class TradeoffReport:
    """All that was measured.

    Attributes:
        device: "cpu" or a CUDA device.
        machine: Machine and versions by name.
        times: Of an iteration, of one body, by renderer and picture size.
        fits: All refinements, by whose truth it is (``ELLIPBODY`` or ``ANNY``), what they see (``KEYPOINTS_TOO`` or
            ``LABELS_ALONE``), setting, and distance of starts from the truth [rad].
        gradients: Of EllipBodies, by renderer, picture size and distance from the truth [rad].
        precisions: Other numbers than float32.
        qualities: Figures of whole fits (``scoring.summarise``) by PartBench's level and quality.
    """

    device: str
    machine: dict[str, str]
    times: dict[tuple[str, int], Timing] = field(default_factory=dict)
    fits: dict[tuple[str, str, Setting, float], Fit] = field(default_factory=dict)
    gradients: dict[tuple[str, int, float], GradientError] = field(default_factory=dict)
    precisions: list[Precision] = field(default_factory=list)
    qualities: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)

    def time(self, setting: Setting) -> float:
        """Of an iteration, of one body [s]."""
        return self.times[setting.name, setting.size].median

    def fit(self, truth: str, setting: Setting, distance: float = DISTANCE, seen: str = KEYPOINTS_TOO) -> Fit:
        """The refinements of a setting."""
        return self.fits[truth, seen, setting, distance]

    def gradient(self, setting: Setting) -> GradientError:
        """The gradients of a setting at ``DISTANCE``; its iterations do not matter."""
        return self.gradients[setting.name, setting.size, DISTANCE]

    def settings(self) -> list[Setting]:
        """Those of the main table."""
        return [Setting(name, size) for name, size in self.times]

    def iterations(self) -> list[int]:
        """Those that were run, from the fewest."""
        return sorted({setting.iterations for _, _, setting, _ in self.fits})

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
            "fits": [
                {
                    "truth": truth,
                    "seen": seen,
                    "renderer": setting.name,
                    "size_px": setting.size,
                    "iterations": setting.iterations,
                    "distance_rad": distance,
                    **vars(fit.scores),
                    "own_part_f1": fit.own_part_f1,
                    "batch_seconds": fit.seconds,
                }
                for (truth, seen, setting, distance), fit in self.fits.items()
            ],
            "gradients": [
                {"renderer": name, "size_px": size, "distance_rad": distance, **vars(error)}
                for (name, size, distance), error in self.gradients.items()
            ],
            "precisions": [
                {
                    "renderer": row.name,
                    "numbers": row.numbers,
                    **vars(row.scores),
                    "moved_mm": row.moved_mm,
                    "seconds": row.seconds,
                }
                for row in self.precisions
            ],
            "qualities": self.qualities,
            "found": mesh_gains(self),
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
        for coarse, fine in pairwise(LEVELS):
            fits = [report.fit(truth, Setting(name)) for name in (coarse, fine)]
            for what, values in (
                ("part F1 of the mesh itself", [fit.own_part_f1 for fit in fits]),
                ("part F1 of the ellipsoids", [fit.scores.part_f1 for fit in fits]),
            ):
                gain = np.diff(np.array(values), axis=0)[0]
                low, high = bootstrap_sum(gain / len(gain), lambda sums: sums)
                said.append(
                    f"{truth}: {what}, {coarse} to E{LEVELS[fine]}: {gain.mean():+.4f} ({low:+.4f} to {high:+.4f})"
                )
    return said
