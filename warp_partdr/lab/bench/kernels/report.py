"""Figures of ``partdr bench kernels``: a row for each thing that was timed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ...tables import RecordColumn, format_time, print_tables, record_table
from ..machine import in_words
from ..timing import Timing
from .plan import GROUPS, Run

if TYPE_CHECKING:
    from rich.console import Console

_GRADIENTS = "Gradients by moves of parts, beside the derivative of the area that shows a wrong label"

NOTES = (
    "The spread is the interquartile range. graph: one replay of a captured graph, on the device's clock; call: from "
    "Python, until the device is done; step: the mean of 20 calls that follow one another, until the device is done; "
    "kernel: what it adds to a run, what clears memory for it included.",
    "Moved: the arrays that kernels are given, each byte once a kernel, whether or not all of it is touched; its share "
    "of what a copy within the device reaches. Arrays that stay in the cache can take it past 100 %.",
    "Memory: the same arrays, each byte once in all, for nothing else is allocated in a captured run; of calls into "
    "torch, its peak beside what was there before, on CUDA alone.",
    "On the CPU a graph of a renderer or of kernels runs on one core; calls share a batch among cores.",
    "Mesh rows that are graphs begin with projected vertices, exact ones with ellipsoids in the camera frame.",
)


def make_row(
    group: str,
    run: Run,
    how: str,
    timing: Timing,
    *,
    moved: int | None = None,
    memory: int | None = None,
    agreement: float | None = None,
) -> dict[str, Any]:
    """One thing that was timed, for JSON: seconds, bytes and shares.

    Args:
        group: Group, one of ``GROUPS``.
        run: Run that was timed. B and the picture are 0 where they mean nothing.
        how: Way of timing: "graph", "call", "step", "kernel" or "process", see ``NOTES``.
        timing: Durations of the run.
        moved: Size of the arrays given to kernels, each once a kernel [bytes].
        memory: Size of the same arrays, each once in all. For calls into torch, it is its peak [bytes].
        agreement: Share of pixels with the same label as our picture of the same mesh, for peers.
    """
    name, renderer, batch, size = run
    median = timing.median
    return {
        "group": group,
        "name": name,
        "renderer": renderer,
        "batch": batch,
        "size_px": size,
        "how": how,
        "median_s": median,
        "spread_s": timing.spread,
        "fastest_s": None if how == "kernel" else timing.fastest,
        "repeats": len(timing.seconds),
        "images_per_second": batch / median if batch and median > 0 else None,  # differences may be lost in noise
        "moved_bytes": moved,
        "memory_bytes": memory,
        "label_agreement": agreement,
    }


def copy_share(row: Mapping[str, Any], copy_bandwidth: float) -> float | None:
    """Share of what a copy within the device reaches [B/s] that a row's kernels do."""
    moved, median = row["moved_bytes"], row["median_s"]
    return None if moved is None or median <= 0 else moved / median / copy_bandwidth


def _number(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _megabytes(value: float) -> str:
    return _number(1e-6 * value)


_COLUMNS = (
    RecordColumn("", "name"),
    RecordColumn("renderer", "renderer"),
    RecordColumn("B", "batch", lambda batch: str(batch or "")),
    RecordColumn("px", "size_px", lambda size: str(size or "")),
    RecordColumn("", "how"),
    RecordColumn("median", "median_s", format_time),
    RecordColumn("spread", "spread_s", format_time),
    RecordColumn("fastest", "fastest_s", format_time),
    RecordColumn("images/s", "images_per_second", _number),
    RecordColumn("moved [MB]", "moved_bytes", _megabytes),
    RecordColumn("of a copy", "share_of_copy_bandwidth", lambda share: f"{100 * share:.0f} %"),
    RecordColumn("memory [MB]", "memory_bytes", _megabytes),
    RecordColumn("agrees", "label_agreement", lambda share: f"{100 * share:.3f} %"),
)
_WORDS = (0, 1, 4)  # columns
_OF_SEVERAL = ("spread_s", "fastest_s")  # empty where there is one run
_GRADIENT_COLUMNS = (
    RecordColumn("", "renderer"),
    RecordColumn("of", "mesh"),
    RecordColumn("cosine", "cosine", lambda value: f"{value:.4f}"),
    RecordColumn("length", "length", lambda value: f"{value:.3f}"),
)


def print_kernels(figures: Mapping[str, Any], console: Console) -> None:
    """A table for each group of rows."""
    copies = f"A copy within the device reads and writes {figures['copy_bandwidth_bytes_per_second'] / 1e9:.4g} GB/s"
    rows = [row if row["repeats"] > 1 else {**row, **dict.fromkeys(_OF_SEVERAL)} for row in figures["rows"]]
    tables = [
        record_table(group, _COLUMNS, [row for row in rows if row["group"] == group], left=_WORDS) for group in GROUPS
    ]
    if figures["gradients"]:
        tables.append(record_table(_GRADIENTS, _GRADIENT_COLUMNS, figures["gradients"], left=(0, 1)))
    print_tables([in_words(figures["machine"]), copies], tables, figures["remarks"], NOTES, console)
