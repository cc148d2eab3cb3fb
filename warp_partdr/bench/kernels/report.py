"""Figures as a table on the screen and as JSON on disk."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

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

TABLE_WIDTH = 165  # [characters]; narrower ones lose columns

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
class Row:
    """One thing that was timed.

    Attributes:
        group: One of ``GROUPS``.
        name: What was run.
        renderer: With which renderer.
        batch: B, how many bodies; 0 where that means nothing.
        size: Side of the picture [px]; 0 where that means nothing.
        how: "graph", "call", "kernel" or "process", see ``NOTES``.
        timing: How long it took.
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
class Report:
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
    rows: list[Row] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    @property
    def heading(self) -> str:
        """Machine and versions in a line."""
        return ", ".join(f"{key} {value}" for key, value in self.machine.items())

    def find(self, name: str, renderer: str, batch: int, size: int) -> Row | None:
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

    def _row_as_dict(self, row: Row) -> dict[str, Any]:
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


def save_json(report: Report, path: Path) -> None:
    """Write all figures."""
    path.write_text(json.dumps(report.as_dict(), indent=1) + "\n", encoding="utf-8")


def print_report(report: Report, console: Console) -> None:
    """A table for each group of rows."""
    from rich.markup import escape

    console.print(escape(report.heading))
    console.print(f"A copy within the device reads and writes {report.copy_bandwidth / 1e9:.4g} GB/s")
    for group in GROUPS:
        rows = [row for row in report.rows if row.group == group]
        if rows:
            console.print()
            console.print(_table(group, rows, report.copy_bandwidth))
    console.print()
    for line in (*report.remarks, *NOTES):
        console.print(escape(line), style="dim" if line in NOTES else None)


def _table(group: str, rows: Sequence[Row], copy_bandwidth: float) -> Any:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=group, title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    columns = [
        "",
        "renderer",
        "B",
        "px",
        "",
        "median",
        "spread",
        "fastest",
        "images/s",
        "moved [MB]",
        "of a copy",
        "memory [MB]",
        "agrees",
    ]
    cells = [
        [
            row.name,
            row.renderer,
            str(row.batch or ""),
            str(row.size or ""),
            row.how,
            format_time(row.timing.median),
            format_time(row.timing.spread) if len(row.timing.seconds) > 1 else "",
            format_time(row.fastest) if row.fastest is not None and len(row.timing.seconds) > 1 else "",
            _number(row.images_per_second),
            _number(row.moved, 1e-6),
            _percent(row.bandwidth_share(copy_bandwidth), 0),
            _number(row.memory, 1e-6),
            _percent(row.agreement, 3),
        ]
        for row in rows
    ]
    used = [index for index in range(len(columns)) if any(line[index] for line in cells)]
    for index in used:
        table.add_column(columns[index], justify="left" if index in (0, 1, 4) else "right", no_wrap=True)
    for line in cells:
        table.add_row(*(line[index] for index in used))
    return table


def format_time(seconds: float) -> str:
    """In the unit that suits: "12.3 µs", "4.56 ms", "7.89 s"."""
    for unit, scale in (("s", 1.0), ("ms", 1e-3)):
        if abs(seconds) >= scale:
            return f"{seconds / scale:.3g} {unit}" if abs(seconds) < 1e3 * scale else f"{seconds / scale:.0f} {unit}"
    return f"{max(seconds, 0.0) * 1e6:.3g} µs"


def _number(value: float | None, scale: float = 1.0) -> str:
    if value is None:
        return ""
    value *= scale
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _percent(share: float | None, digits: int) -> str:
    return "" if share is None else f"{100 * share:.{digits}f} %"
