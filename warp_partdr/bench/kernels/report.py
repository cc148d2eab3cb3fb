"""Figures of ``partdr bench kernels``: a row for each thing that was timed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ..machine import in_words
from ..report import format_time, make_table, print_tables
from ..timing import Timing

if TYPE_CHECKING:
    from rich.console import Console

# Groups of rows in the order of the table.
TARGETS = "The paper's targets"
OTHERS = "Other renderers, batches and sizes"
KERNELS = "Kernels, each in its place in a run"
STARTS = "Starts"
PEER_ROWS = "Peers: the same mesh, the same target"
GROUPS = (TARGETS, OTHERS, KERNELS, STARTS, PEER_ROWS)

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

    @property
    def fastest(self) -> float | None:
        """The least disturbed run [s]; differences have none."""
        return None if self.how == "kernel" else self.timing.fastest

    @property
    def images_per_second(self) -> float | None:
        """Bodies a second."""
        return self.batch / self.timing.median if self.batch and self.timing.median > 0 else None

    def bandwidth_share(self, copy_bandwidth: float) -> float | None:
        """Bytes moved a second, as a share of ``copy_bandwidth`` [B/s]."""
        if self.moved is None or self.timing.median <= 0:
            return None
        return self.moved / self.timing.median / copy_bandwidth


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

    def find(self, name: str, renderer: str, batch: int, size: int) -> TimedRow | None:
        """The row of a run, if there is one; kernels and peers aside."""
        wanted = (name, renderer, batch, size)
        for row in self.rows:
            if row.group in (TARGETS, OTHERS) and (row.name, row.renderer, row.batch, row.size) == wanted:
                return row
        return None

    def as_dict(self) -> dict[str, Any]:
        """For JSON: seconds, bytes and shares, unrounded."""
        return {
            "device": self.device,
            "machine": self.machine,
            "copy_bandwidth_bytes_per_second": self.copy_bandwidth,
            "rows": [self._row_as_dict(row) for row in self.rows],
            "remarks": self.remarks,
            "notes": list(NOTES),
        }

    def _row_as_dict(self, row: TimedRow) -> dict[str, Any]:
        return {
            "group": row.group,
            "name": row.name,
            "renderer": row.renderer,
            "batch": row.batch,
            "size_px": row.size,
            "how": row.how,
            "median_s": row.timing.median,
            "spread_s": row.timing.spread,
            "fastest_s": row.fastest,
            "repeats": len(row.timing.seconds),
            "images_per_second": row.images_per_second,
            "moved_bytes": row.moved,
            "share_of_copy_bandwidth": row.bandwidth_share(self.copy_bandwidth),
            "memory_bytes": row.memory,
            "label_agreement": row.agreement,
        }


_HEADINGS = (
    *("", "renderer", "B", "px", "", "median", "spread", "fastest"),
    *("images/s", "moved [MB]", "of a copy", "memory [MB]", "agrees"),
)
_WORDS = (0, 1, 4)  # columns


def print_kernels(report: KernelReport, console: Console) -> None:
    """A table for each group of rows."""
    copies = f"A copy within the device reads and writes {report.copy_bandwidth / 1e9:.4g} GB/s"
    tables = []
    for group in GROUPS:
        cells = [_cells(row, report.copy_bandwidth) for row in report.rows if row.group == group]
        tables.append(make_table(group, _HEADINGS, cells, left=_WORDS))
    print_tables([in_words(report.machine), copies], tables, report.remarks, NOTES, console)


def _cells(row: TimedRow, copy_bandwidth: float) -> list[str]:
    several = len(row.timing.seconds) > 1
    return [
        row.name,
        row.renderer,
        str(row.batch or ""),
        str(row.size or ""),
        row.how,
        format_time(row.timing.median),
        format_time(row.timing.spread) if several else "",
        format_time(row.fastest) if row.fastest is not None and several else "",
        _number(row.images_per_second),
        _number(row.moved, 1e-6),
        _percent(row.bandwidth_share(copy_bandwidth), 0),
        _number(row.memory, 1e-6),
        _percent(row.agreement, 3),
    ]


def _number(value: float | None, scale: float = 1.0) -> str:
    if value is None:
        return ""
    value *= scale
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _percent(share: float | None, digits: int) -> str:
    return "" if share is None else f"{100 * share:.{digits}f} %"
