"""Figures of ``partdr bench kernels``: a row for each thing that was timed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ..machine import in_words
from ..report import format_time, make_table, print_tables
from ..timing import Timing
from .plan import GROUPS

if TYPE_CHECKING:
    from rich.console import Console

NOTES = (
    "The spread is the interquartile range. graph: one replay of a captured graph, on the device's clock; call: from "
    "Python, until the device is done; kernel: what it adds to a run, what clears memory for it included.",
    "Moved: the arrays that kernels are given, each byte once a kernel, whether or not all of it is touched; its share "
    "of what a copy within the device reaches. Arrays that stay in the cache can take it past 100 %.",
    "Memory: the same arrays, each byte once in all, for nothing else is allocated in a captured run; of calls into "
    "torch, its peak beside what was there before, on CUDA alone.",
    "On the CPU a graph of a renderer or of kernels runs on one core; calls share a batch among cores.",
    "Mesh rows that are graphs begin with projected vertices, exact ones with ellipsoids in the camera frame.",
)


@dataclass(frozen=True)
class TimedRow:
    """One thing that was timed.

    Attributes:
        group: One of ``GROUPS``.
        name: What was run.
        renderer: By its name.
        batch: B, the number of bodies; 0 where that means nothing.
        size: Side of the picture [px]; 0 where that means nothing.
        how: "graph", "call", "kernel" or "process", see ``NOTES``.
        timing: Its durations.
        moved: Size of the arrays given to kernels, each once a kernel [bytes].
        memory: Size of the same arrays, each once in all; of calls into torch, its peak [bytes].
        agreement: Share of pixels with the same label as our picture of the same mesh: of peers.
    """

    group: str
    name: str
    renderer: str
    batch: int
    size: int
    how: str
    timing: Timing
    moved: int | None = None
    memory: int | None = None
    agreement: float | None = None

    def as_dict(self, copy_bandwidth: float) -> dict[str, Any]:
        """For JSON: seconds, bytes, and shares; ``copy_bandwidth`` in B/s."""
        median = self.timing.median
        rate = 1 / median if median > 0 else None  # differences may be lost in noise
        return {
            "group": self.group,
            "name": self.name,
            "renderer": self.renderer,
            "batch": self.batch,
            "size_px": self.size,
            "how": self.how,
            "median_s": median,
            "spread_s": self.timing.spread,
            "fastest_s": None if self.how == "kernel" else self.timing.fastest,
            "repeats": len(self.timing.seconds),
            "images_per_second": self.batch * rate if self.batch and rate else None,
            "moved_bytes": self.moved,
            "share_of_copy_bandwidth": self.moved * rate / copy_bandwidth if self.moved is not None and rate else None,
            "memory_bytes": self.memory,
            "label_agreement": self.agreement,
        }


@dataclass
class KernelReport:
    """All that was measured.

    Attributes:
        device: "cpu" or a CUDA device.
        machine: Machine and versions by name.
        copy_bandwidth: Of a copy within the device, bytes read and written [B/s].
        rows: What was timed.
        remarks: One line for each thing that could not be.
    """

    device: str
    machine: dict[str, str]
    copy_bandwidth: float
    rows: list[TimedRow] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """For JSON: seconds, bytes and shares, unrounded."""
        return {
            "device": self.device,
            "machine": self.machine,
            "copy_bandwidth_bytes_per_second": self.copy_bandwidth,
            "rows": [row.as_dict(self.copy_bandwidth) for row in self.rows],
            "remarks": self.remarks,
            "notes": list(NOTES),
        }


def _number(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _megabytes(value: float) -> str:
    return _number(1e-6 * value)


_COLUMNS: tuple[tuple[str, str, Callable[[Any], str]], ...] = (  # heading, name in the JSON, format
    ("", "name", str),
    ("renderer", "renderer", str),
    ("B", "batch", lambda batch: str(batch or "")),
    ("px", "size_px", lambda size: str(size or "")),
    ("", "how", str),
    ("median", "median_s", format_time),
    ("spread", "spread_s", format_time),
    ("fastest", "fastest_s", format_time),
    ("images/s", "images_per_second", _number),
    ("moved [MB]", "moved_bytes", _megabytes),
    ("of a copy", "share_of_copy_bandwidth", lambda share: f"{100 * share:.0f} %"),
    ("memory [MB]", "memory_bytes", _megabytes),
    ("agrees", "label_agreement", lambda share: f"{100 * share:.3f} %"),
)
_WORDS = (0, 1, 4)  # columns
_OF_SEVERAL = ("spread_s", "fastest_s")  # empty where there is one run


def print_kernels(report: KernelReport, console: Console) -> None:
    """A table for each group of rows."""
    copies = f"A copy within the device reads and writes {report.copy_bandwidth / 1e9:.4g} GB/s"
    rows = [row.as_dict(report.copy_bandwidth) for row in report.rows]
    headings = [heading for heading, _, _ in _COLUMNS]
    tables = [
        make_table(group, headings, [_cells(row) for row in rows if row["group"] == group], left=_WORDS)
        for group in GROUPS
    ]
    print_tables([in_words(report.machine), copies], tables, report.remarks, NOTES, console)


def _cells(row: dict[str, Any]) -> list[str]:
    hidden = _OF_SEVERAL if row["repeats"] == 1 else ()
    return ["" if row[key] is None or key in hidden else form(row[key]) for _, key, form in _COLUMNS]
