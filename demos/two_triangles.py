"""The paper's figure 3: a silhouette can't tell two triangles apart nor which is in front; part labels can.

    python demos/two_triangles.py [--out FILE] [--scenes N] [--depth-weight L] [--device cpu|cuda]

Two rigid triangles, A and B, start in the wrong places and in the wrong order. Adam moves them (x, y in pixels, z in
metres) until the picture equals the target, under three supervisions with the same start, learning rates and
iterations. Writes one picture; with --scenes it also counts how often random scenes reach their target.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
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

from warp_partdr.cameras import WeakPerspective
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import PartMesh

Font = ImageFont.ImageFont | ImageFont.FreeTypeFont

SHOWN = (0, 5, 15, 40, ITERATIONS)  # iterations
SCALE = 3  # of a panel to the optimised picture
FINE = 3  # further, while drawing
PAPER, INK, FAINT = (255, 255, 255), (25, 25, 25), (95, 95, 95)
GROUND = (242, 242, 238)
# Red and blue that differ in any colour vision (P. Tol's "vibrant"); letters, words and dashes say the same again.
COLOURS = np.array([GROUND, (204, 51, 17), (0, 119, 187)], dtype=np.uint8)
ONE_COLOUR = np.array([GROUND, (125, 125, 125), (125, 125, 125)], dtype=np.uint8)
GOOD, BAD = (0, 125, 80), (190, 0, 40)
MARGIN, GAP, HEAD, SIDE, CAPTION, FOOT = 20, 12, 84, 208, 92, 40  # [px]
TITLE = f"Two rigid triangles, three supervisions: the same start, Adam and {ITERATIONS} iterations"
LEGEND = (
    "White line: edge in sight.   White dashes: edge behind the other triangle.   Black dots: edges of the target.   "
    "IoU: intersection over union, of the worse part and of the outline."
)


def panel(scenes: Scenes, vertices: torch.Tensor) -> Image.Image:
    """One state (6, 3) as the renderer shows it; hidden edges are dashed and the goal's outlines dotted."""
    picture, labels = _render(scenes.mesh, vertices, COLOURS)
    draw = ImageDraw.Draw(picture)
    for triangle in _corners(scenes.goal[0]):
        _outline(draw, triangle, INK, width=FINE, period=(2, 5))
    corners = _corners(vertices)
    for part, triangle in enumerate(corners, start=1):
        _outline(draw, triangle, PAPER, width=2 * FINE, hidden=(labels != part) & (labels > 0))
    font = ImageFont.load_default(18 * FINE)
    for triangle, other, letter in ((corners[0], corners[1], "A"), (corners[1], corners[0], "B")):
        draw.text(_middle(triangle, other, picture.size), letter, PAPER, font, anchor="mm")
    return _reduce(picture)


def silhouette_panel(scenes: Scenes) -> Image.Image:
    """The goal as the full silhouette tells it."""
    return _reduce(_render(scenes.mesh, scenes.goal[0], ONE_COLOUR)[0])


def _render(mesh: PartMesh, vertices: torch.Tensor, colours: np.ndarray) -> tuple[Image.Image, np.ndarray]:
    size = (IMAGE_SIZE[0] * SCALE * FINE, IMAGE_SIZE[1] * SCALE * FINE)
    camera = WeakPerspective(torch.full((1,), float(SCALE * FINE)), torch.zeros(1, 2)).to(vertices.device)
    labels = draw_mesh(vertices[None], mesh, camera, size).labels[0].cpu().numpy()
    return Image.fromarray(colours[labels]), labels


def _reduce(picture: Image.Image) -> Image.Image:
    return picture.resize((picture.width // FINE, picture.height // FINE), Image.Resampling.LANCZOS)


def _corners(vertices: torch.Tensor) -> np.ndarray:
    """Corners of A and B in the enlarged picture, shape (2, 3, 2) [px]."""
    return vertices[:, :2].cpu().numpy().reshape(2, 3, 2) * (SCALE * FINE)


def _middle(triangle: np.ndarray, other: np.ndarray, size: tuple[int, int]) -> tuple[float, float]:
    """The place for a triangle's letter: deep inside what it does not share with the other, if there is any."""
    masks = []
    for corners in (triangle, other):
        mask = Image.new("1", (size[0] // FINE, size[1] // FINE))
        ImageDraw.Draw(mask).polygon([tuple(corner / FINE) for corner in corners], fill=1)
        masks.append(np.array(mask))
    alone = masks[0] & ~masks[1]
    inside = alone if alone.sum() > 200 else masks[0]
    while inside.any():
        rows, columns = np.nonzero(inside)
        shrunk = inside.copy()
        for axis in (0, 1):
            for step in (-1, 1):
                shrunk &= np.roll(inside, step, axis)
        inside = shrunk
    return columns.mean() * FINE, rows.mean() * FINE


def _outline(
    draw: ImageDraw.ImageDraw,
    triangle: np.ndarray,
    colour: tuple[int, int, int],
    width: int,
    period: tuple[int, int] = (4, 8),
    hidden: np.ndarray | None = None,
) -> None:
    """Draw edges in short steps, the first of each ``period`` only; with ``hidden`` (H, W), all where it is false."""
    centre = triangle.mean(0)
    for start, end in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        steps = int(np.linalg.norm(end - start) / FINE)
        points = start + np.linspace(0, 1, steps + 1)[:, None] * (end - start)
        for k in range(steps):
            is_drawn = k % period[1] < period[0]
            if hidden is not None:
                column, row = points[k] + (centre - points[k]) * 0.05  # just inside the edge
                row, column = np.clip((row, column), 0, np.array(hidden.shape) - 1).astype(int)
                is_drawn = is_drawn or not hidden[row, column]
            if is_drawn:
                draw.line([*points[k], *points[k + 1]], colour, width)


def verdict(outcome: Outcome) -> tuple[str, str]:
    """Outcome of one scene, in a word and in a few."""
    places = "right places" if outcome.in_place else "wrong places"
    order = "right order" if outcome.in_order else "wrong order"
    return "reached" if outcome.reached else "stalled", f"{places}, {order}"


def draw_picture(scenes: Scenes, courses: dict[Supervision, torch.Tensor]) -> Image.Image:
    """A row for each supervision, a column for each of ``SHOWN``, the target last; one scene."""
    width, height = IMAGE_SIZE[1] * SCALE, IMAGE_SIZE[0] * SCALE
    lefts = [MARGIN + SIDE + k * (width + GAP) for k in range(len(SHOWN) + 1)]
    lefts[-1] += 2 * GAP
    tops = [MARGIN + HEAD + k * (height + CAPTION) for k in range(len(courses))]
    picture = Image.new("RGB", (lefts[-1] + width + MARGIN, tops[-1] + height + CAPTION + FOOT), PAPER)
    draw = ImageDraw.Draw(picture)
    title, head, text = (ImageFont.load_default(size) for size in (26, 22, 18))

    def caption(left: int, line: int, words: str, colour: tuple[int, int, int], font: Font) -> None:
        draw.text((left + width / 2, top + height + 24 + 24 * line), words, colour, font, anchor="ms")

    def box(left: int, colour: tuple[int, int, int]) -> None:
        draw.rectangle((left - 5, top - 5, left + width + 4, top + height + 4), None, colour, 5)

    draw.text((MARGIN, MARGIN), TITLE, INK, title)
    draw.text((MARGIN + SIDE, picture.height - FOOT), LEGEND, FAINT, text)
    heads = ["start", *(f"iteration {k}" for k in SHOWN[1:-1]), f"end ({SHOWN[-1]})", "target"]
    for left, words in zip(lefts, heads, strict=True):
        draw.text((left + width / 2, MARGIN + HEAD - 14), words, INK, head, anchor="ms")
    for top, (supervision, course) in zip(tops, courses.items(), strict=True):
        draw.multiline_text((MARGIN, top), supervision.title, INK, head, spacing=6)
        draw.multiline_text((MARGIN, top + 72), supervision.note, FAINT, text, spacing=6)
        for left, k in zip(lefts, SHOWN, strict=False):
            outcome = judge(scenes, course[k])
            picture.paste(panel(scenes, course[k, 0]), (left, top))
            overlaps = f"IoU {float(outcome.iou):.2f}, outline {float(outcome.silhouette_iou):.2f}"
            if k < SHOWN[-1]:
                caption(left, 0, f"{'B' if outcome.in_order else 'A'} in front", INK, text)
                caption(left, 1, overlaps, INK, text)
                continue
            word, reason = verdict(outcome)
            colour = GOOD if outcome.reached else BAD
            box(left, colour)
            caption(left, 0, word, colour, head)
            caption(left, 1, reason, colour, text)
            caption(left, 2, overlaps, colour, text)
        goal = panel(scenes, scenes.goal[0]) if supervision.parts else silhouette_panel(scenes)
        picture.paste(goal, (lefts[-1], top))
        box(lefts[-1], GOOD)
        caption(lefts[-1], 0, "what the loss sees:", INK, text)
        caption(lefts[-1], 1, "two labels" if supervision.parts else "one label", INK, text)
    return picture


# --- command line --------------------------------------------------------------------------------------------------


def count_table(count: int, supervisions: tuple[Supervision, ...], device: str) -> str:
    """Table, in Markdown, of the random scenes of either kind that end right, out of ``count``."""
    lines = [
        f"| of {count} scenes | supervision | in place | in order | reached |",
        "|---|---|---:|---:|---:|",
    ]
    for kind, alike in (("alike, exchanged", True), ("different, anywhere", False)):
        scenes = random_scenes(count, 0, alike=alike, device=device)
        for supervision in supervisions:
            outcome = judge(scenes, optimize(scenes, supervision)[-1])
            sums = [int(yes.sum()) for yes in (outcome.in_place, outcome.in_order, outcome.reached)]
            lines.append(f"| {kind} | {supervision.name} | {' | '.join(map(str, sums))} |")
    return "\n".join(lines)


def main() -> None:
    """Draw the fixed scene; count random ones if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/two_triangles.png"), help="PNG; default: %(default)s")
    parser.add_argument(
        "--scenes", type=int, default=0, metavar="N", help="also count over N random scenes of each kind"
    )
    parser.add_argument(
        "--depth-weight", type=float, default=1.0, metavar="LAMBDA", help="eq. 12; default: %(default)s"
    )
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="default: %(default)s")
    arguments = parser.parse_args()
    if arguments.scenes < 0:
        parser.error(f"--scenes: {arguments.scenes}; expected 0 or more")
    if arguments.out.suffix != ".png":
        parser.error(f"--out: {arguments.out}; expected a name that ends with .png")
    supervisions = (FULL, PARTS_WITHOUT_DEPTH, replace(PARTS, depth_weight=arguments.depth_weight))
    scenes = fixed_scene(arguments.device)
    courses = {supervision: optimize(scenes, supervision) for supervision in supervisions}
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    draw_picture(scenes, courses).quantize(255).save(arguments.out, optimize=True)
    for supervision, course in courses.items():
        print(f"{supervision.name}: {': '.join(verdict(judge(scenes, course[-1])))}")
    print(f"Picture: {arguments.out}")
    if arguments.scenes:
        print(count_table(arguments.scenes, supervisions, arguments.device))


if __name__ == "__main__":
    main()
