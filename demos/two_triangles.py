"""The paper's figure 3: a silhouette can't tell two triangles apart nor which is in front; part labels can.

    python demos/two_triangles.py [--out FILE] [--scenes N] [--depth-weight L] [--device cpu|cuda]

Two rigid triangles, A and B, start in the wrong places and in the wrong order. Adam moves them (x, y in pixels, z in
metres) until the picture equals the target, under three supervisions with the same start, learning rates and
iterations. Writes one picture; with --scenes it also counts how often random scenes reach their target.
"""

from __future__ import annotations

import textwrap
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import torch
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from PIL import Image
from triangle_scenes import (
    FULL,
    IMAGE_SIZE,
    ITERATIONS,
    PARTS,
    PARTS_WITHOUT_DEPTH,
    Outcome,
    Scenes,
    Supervision,
    fixed_scene,
    judge,
    optimize,
    random_scenes,
)

SHOWN = (0, 5, 15, 40, ITERATIONS)  # iterations
INK, FAINT, GROUND, GRAY = "#191919", "#5f5f5f", "#f2f2ee", "#7d7d7d"
# Red and blue that differ in any colour vision (P. Tol's "vibrant"); letters, words and dashes say the same again.
COLOURS = ("#cc3311", "#0077bb")
GOOD, BAD = "#007d50", "#be0028"
TITLE = f"Two rigid triangles, three supervisions: the same start, Adam and {ITERATIONS} iterations"
LEGEND = (
    "White line: edge in sight.   White dashes: edge behind the other triangle.   Black dots: edges of the target.   "
    "IoU: intersection over union, of the worse part and of the outline."
)


def draw_state(axes: Axes, vertices: torch.Tensor, goal: torch.Tensor) -> None:
    """Draw (6, 3) vertices, the nearer triangle over the farther: its hidden edges dashed, the goal's edges dotted."""
    corners, goals = (points[:, :2].cpu().reshape(2, 3, 2) for points in (vertices, goal))
    far, near = (0, 1) if vertices[0, 2] > vertices[3, 2] else (1, 0)
    for k in (far, near):
        axes.add_patch(Polygon(corners[k], facecolor=COLOURS[k], edgecolor="white", linewidth=1.5))
    for triangle in goals:
        axes.add_patch(Polygon(triangle, fill=False, edgecolor=INK, linestyle=(0, (1, 2)), linewidth=0.8))
    axes.add_patch(Polygon(corners[far], fill=False, edgecolor="white", linestyle=(0, (3, 2)), linewidth=1.5))
    for triangle, other, letter in zip(corners, corners.flip(0), "AB", strict=True):
        middle, distances = triangle.mean(0), (triangle - other.mean(0)).norm(dim=1)
        x, y = torch.lerp(middle, triangle[distances.argmax()], 0.35).tolist()  # where the other hides least
        axes.text(x, y, letter, color="white", ha="center", va="center")


def draw_silhouette(axes: Axes, _: torch.Tensor, goal: torch.Tensor) -> None:
    """Draw what the full silhouette tells of the goal (6, 3)."""
    for triangle in goal[:, :2].cpu().reshape(2, 3, 2):
        axes.add_patch(Polygon(triangle, facecolor=GRAY))


def make_panel(axes: Axes, caption: str, colour: str, *, framed: bool) -> None:
    """Lay out axes for one picture, whose y goes down, with a caption below and perhaps a frame."""
    axes.set(xlim=(0, IMAGE_SIZE[1]), ylim=(IMAGE_SIZE[0], 0), aspect="equal", xticks=[], yticks=[], facecolor=GROUND)
    axes.set_xlabel(caption, color=colour if framed else INK)
    axes.spines[:].set(visible=framed, color=colour, linewidth=3)


def verdict(outcome: Outcome) -> tuple[str, str]:
    """Outcome of one scene, in a word and in a few."""
    places = "right places" if outcome.in_place else "wrong places"
    order = "right order" if outcome.in_order else "wrong order"
    return "reached" if outcome.reached else "stalled", f"{places}, {order}"


def draw_picture(scenes: Scenes, courses: dict[Supervision, torch.Tensor]) -> Figure:
    """A row for each supervision, a column for each of ``SHOWN``, the target last; one scene."""
    figure = Figure(figsize=(16, 8.4), layout="constrained")
    figure.suptitle(TITLE, x=0.01, ha="left", size=16)
    figure.supxlabel(LEGEND, color=FAINT, size=11)
    rows = figure.subplots(len(courses), len(SHOWN) + 2)
    heads = ["start", *(f"iteration {k}" for k in SHOWN[1:-1]), f"end ({SHOWN[-1]})", "target"]
    for axes, head in zip(rows[0, 1:], heads, strict=True):
        axes.set_title(head)
    for (words, *panels, target), (supervision, course) in zip(rows, courses.items(), strict=True):
        words.set_axis_off()
        words.text(0, 0.65, textwrap.fill(supervision.name, 16), size=13)
        words.text(0, 0.6, textwrap.fill(supervision.note, 25), color=FAINT, va="top")
        for axes, k in zip(panels, SHOWN, strict=True):
            outcome = judge(scenes, course[k])
            is_end = k == SHOWN[-1]
            said = "\n".join(verdict(outcome)) if is_end else f"{'B' if outcome.in_order else 'A'} in front"
            overlaps = f"IoU {float(outcome.iou):.2f}, outline {float(outcome.silhouette_iou):.2f}"
            make_panel(axes, f"{said}\n{overlaps}", GOOD if outcome.reached else BAD, framed=is_end)
            draw_state(axes, course[k, 0], scenes.goal[0])
        labels, draw = ("two labels", draw_state) if supervision.parts else ("one label", draw_silhouette)
        make_panel(target, f"what the loss sees:\n{labels}", GOOD, framed=True)
        draw(target, scenes.goal[0], scenes.goal[0])
    return figure


def count_table(count: int, supervisions: tuple[Supervision, ...], device: str) -> str:
    """Table, in Markdown, of the random scenes of either kind that end right, out of ``count``."""
    lines = [f"| of {count} scenes | supervision | in place | in order | reached |", "|---|---|---:|---:|---:|"]
    for kind, alike in (("alike, exchanged", True), ("different, anywhere", False)):
        scenes = random_scenes(count, alike=alike, device=device)
        for supervision in supervisions:
            outcome = judge(scenes, optimize(scenes, supervision)[-1])
            sums = [int(yes.sum()) for yes in (outcome.in_place, outcome.in_order, outcome.reached)]
            lines.append(f"| {kind} | {supervision.name} | {' | '.join(map(str, sums))} |")
    return "\n".join(lines)


def main(
    out: Path = Path("out/two_triangles.png"),
    scenes: Annotated[int, typer.Option(min=0, metavar="N")] = 0,
    depth_weight: Annotated[float, typer.Option(metavar="LAMBDA")] = 1,
    device: str = "cpu",
) -> None:
    """Draw the fixed scene as a PNG; also count N random scenes of each kind. LAMBDA is that of eq. 12."""
    if out.suffix != ".png":
        raise typer.BadParameter(f"--out: {out}; expected a name that ends with .png")
    supervisions = (FULL, PARTS_WITHOUT_DEPTH, replace(PARTS, depth_weight=depth_weight))
    fixed = fixed_scene(device)
    courses = {supervision: optimize(fixed, supervision) for supervision in supervisions}
    out.parent.mkdir(parents=True, exist_ok=True)
    draw_picture(fixed, courses).savefig(out, dpi=110)
    Image.open(out).convert("RGB").quantize(255).save(out, optimize=True)
    for supervision, course in courses.items():
        print(f"{supervision.name}: {': '.join(verdict(judge(fixed, course[-1])))}")
    print(f"Picture: {out}")
    if scenes:
        print(count_table(scenes, supervisions, device))


if __name__ == "__main__":
    typer.run(main)
