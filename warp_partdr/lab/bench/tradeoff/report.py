"""Figures of ``partdr bench tradeoff``, and the settings that no other one beats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from ...synthetic.tradeoff_people import ANNY, ELLIPBODY
from ...tables import estimate_mean
from ..renderers import LEVELS
from .plan import DISTANCE, Setting

KEYPOINTS_TOO, LABELS_ALONE = "keypoints and labels", "labels alone"
CONVERGED = 0.85  # part F1 of an EllipBody that a refinement has found
FLOAT32, FLOAT64, BFLOAT16 = "float32", "float64", "float32, result kept in bfloat16"


Row = dict[str, Any]  # of JSON; arrays hold a number for each person


@dataclass
class TradeoffReport:
    """All that was measured, in rows: of each renderer and picture size, unless said."""

    device: str  # "cpu" or a CUDA device
    machine: dict[str, str]  # machine and versions by name
    times: list[Row] = field(default_factory=list)  # of an iteration, of one body
    # All refinements: whose truth it is, what they see, setting, distance of starts [rad], ``score_bodies``,
    # ``own_part_f1`` (of meshes), and the seconds that an iteration took for each of all bodies at once.
    fits: list[Row] = field(default_factory=list)
    gradients: list[Row] = field(default_factory=list)  # ``gradient_error`` of EllipBodies, by distance, too
    precisions: list[Row] = field(default_factory=list)  # by numbers: ``score_bodies``, and how far from float32 [mm]
    qualities: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)  # whole fits by level and quality

    def time(self, setting: Setting) -> float:
        """Time of an iteration, of one body [s]."""
        seconds: float = _find(self.times, renderer=setting.name, size_px=setting.size)["seconds"]
        return seconds

    def fit(self, truth: str, setting: Setting, distance: float = DISTANCE, seen: str = KEYPOINTS_TOO) -> Row:
        """The refinements of a setting."""
        return _find(self.fits, truth=truth, seen=seen, distance_rad=distance, **setting.columns)

    def gradient(self, setting: Setting, distance: float = DISTANCE) -> Row:
        """The gradients of a setting; its iterations do not matter."""
        return _find(self.gradients, renderer=setting.name, size_px=setting.size, distance_rad=distance)

    def settings(self) -> list[Setting]:
        """Settings of the main table."""
        return [Setting(row["renderer"], row["size_px"]) for row in self.times]

    def iterations(self) -> list[int]:
        """Numbers of iterations that were run, the fewest first."""
        return sorted({row["iterations"] for row in self.fits})

    def as_dict(self) -> dict[str, Any]:
        """Contents of the report, for ``save_figures``."""
        return {**vars(self), "found": mesh_gains(self)}


def _find(rows: Sequence[Row], **columns: Any) -> Row:
    return next(row for row in rows if columns.items() <= row.items())


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
            for what, column in (("mesh itself", "own_part_f1"), ("ellipsoids", "part_f1")):
                gain = fits[1][column] - fits[0][column]
                step = f"{coarse} to E{LEVELS[fine]}: {estimate_mean(gain):+.4f}"
                said.append(f"{truth}: part F1 of the {what}, {step}")
    return said
