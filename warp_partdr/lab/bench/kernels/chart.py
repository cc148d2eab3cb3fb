"""Time per body on a logarithmic axis: a line for each run and each kernel, a mark for each B."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from ....results.figure_parts import empty_figure
from ..machine import in_words
from .plan import CALLS, KERNELS, OTHERS, TARGETS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LINE = 0.2  # [inches] height of a line
_MARKS = (("o", "black"), ("s", "white"), ("^", "0.6"), ("D", "black"))  # shape and filling of each B


def draw_kernel_chart(figures: Mapping[str, Any]) -> Figure:
    """Whole runs on the left, their kernels on the right; told apart without colour.

    Pictures of another size than most have no marks.
    """
    rows = [row for row in figures["rows"] if row["group"] in (TARGETS, CALLS, OTHERS, KERNELS) and row["median_s"] > 0]
    sizes = [row["size_px"] for row in rows]
    rows = [row for row in rows if row["size_px"] == max(set(sizes), key=sizes.count)]
    runs = sorted((row for row in rows if row["group"] != KERNELS), key=itemgetter("renderer"))
    panels = [
        _group(runs, "name", "renderer"),
        _group([row for row in rows if row["group"] == KERNELS], "renderer", "name"),
    ]
    batches = sorted({row["batch"] for row in rows})
    longest = max(1, *map(len, panels))
    figure = empty_figure(15, 1.5 + _LINE * longest)
    figure.supxlabel(in_words(figures["machine"]), fontsize=8)
    for axes, lines in zip(figure.subplots(1, 2), panels, strict=True):
        _draw_panel(axes, lines, batches)
        axes.set_ylim(longest - 0.5, -0.5)
    if rows:
        handles, labels = figure.axes[0].get_legend_handles_labels()
        title = "pictures of {size_px} by {size_px} px".format(**rows[0])
        figure.legend(handles, labels, title=title, loc="outside upper left", ncols=len(batches), frameon=False)
    return figure


_Row = Mapping[str, Any]
_Lines = dict[tuple[str, str], list[_Row]]  # (heading, name): rows that differ in B alone; a heading has none


def _group(rows: Sequence[_Row], heading: str, name: str) -> _Lines:
    """Lines, those of one heading together."""
    lines: _Lines = {}
    for title in dict.fromkeys(map(itemgetter(heading), rows)):
        lines[title, ""] = []
        for row in rows:
            if row[heading] == title:
                lines.setdefault((title, row[name]), []).append(row)
    return lines


def _draw_panel(axes: Axes, lines: _Lines, batches: Sequence[int]) -> None:
    points = [(line, row) for line, rows in enumerate(lines.values()) for row in rows]
    for index, (batch, (shape, filling)) in enumerate(zip(batches, _MARKS, strict=False)):
        shown = [(line, row) for line, row in points if row["batch"] == batch]
        axes.plot(
            [1e6 * row["median_s"] / batch for _, row in shown],
            [line + 0.16 * (index - (len(batches) - 1) / 2) for line, _ in shown],  # marks of each B lower
            linestyle="",
            marker=shape,
            markersize=5,
            markerfacecolor=filling,
            markeredgecolor="black",
            label=f"B = {batch}",
        )
    axes.set(xscale="log", xlabel="median time per body [microseconds]")
    axes.set_yticks(range(len(lines)), [name or title for title, name in lines], fontsize=8)
    for label, (_, name) in zip(axes.get_yticklabels(), lines, strict=True):
        label.set_fontweight("normal" if name else "bold")
    axes.grid(color="0.85")
