"""The paper's figure 3: a silhouette can't tell two triangles apart nor which is in front; part labels can.

    python demos/two_triangles.py [--out FILE] [--scenes N] [--depth-weight L] [--device cpu|cuda]

Two rigid triangles, A and B, start in the wrong places and in the wrong order. Adam moves them (x, y in pixels, z in
metres) until the picture equals the target, under three supervisions with the same start, learning rates and
iterations. Writes one picture; with --scenes it also counts how often random scenes reach their target.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from warp_partdr.cameras import WeakPerspective
from warp_partdr.render.mesh import draw_mesh, mesh_label_loss
from warp_partdr.render.part_mesh import PartMesh

Font = ImageFont.ImageFont | ImageFont.FreeTypeFont

IMAGE_SIZE = (64, 80)  # (H, W)
NEAR_DEPTH, FAR_DEPTH = 2.0, 2.2  # [m] of the triangle in front and of the one behind, at the start and in the target

ITERATIONS = 200
LEARNING_RATE = 1.0  # [px] an iteration, at first
DEPTH_LEARNING_RATE = 0.02  # [m] an iteration: a tenth of the depth between the triangles
DECAY = 0.98  # of both learning rates, an iteration: steps end below a pixel

REACHED_IOU = 0.9  # of the worse part
REACHED_DISTANCE = 2.0  # [px] of the worse triangle


@dataclass(frozen=True)
class Supervision:
    """What the optimisation is told.

    Attributes:
        title: Name in the picture, in two lines.
        note: What the loss compares, in three.
        parts: Whether the target tells A from B, or both are one label.
        depth_weight: The paper's lambda (eq. 12); 0 takes the z gradient away.
    """

    title: str
    note: str
    parts: bool
    depth_weight: float

    @property
    def name(self) -> str:
        """The title in one line."""
        return self.title.replace("\n", " ")


FULL = Supervision(
    "Full\nsilhouette",
    "The target is one label.\nNothing tells A from B\nor which is in front.",
    parts=False,
    depth_weight=1.0,
)
PARTS_WITHOUT_DEPTH = Supervision(
    "Parts, no\ndepth gradient",
    "The target has two\nlabels; z stays as\nit was.",
    parts=True,
    depth_weight=0.0,
)
PARTS = Supervision(
    "Parts\n(PartDR)",
    "The target has two\nlabels; hidden parts\ncome forward (eq. 12).",
    parts=True,
    depth_weight=1.0,
)
SUPERVISIONS = (FULL, PARTS_WITHOUT_DEPTH, PARTS)


@dataclass(frozen=True)
class Scenes:
    """S scenes of two triangles each; vertices are (u [px], v [px], z [m]), A's three first.

    Attributes:
        mesh: A has label 1 and B has label 2.
        start: Vertices at the start, shape (S, 6, 3).
        goal: Vertices to be found, shape (S, 6, 3).
        target: Part labels of the goal, all that the optimisation sees, shape (S, H, W), uint8.
    """

    mesh: PartMesh
    start: torch.Tensor
    goal: torch.Tensor
    target: torch.Tensor


@dataclass(frozen=True)
class Outcome:
    """How near S scenes came to their goals, each of shape (S,).

    Attributes:
        iou: Intersection over union of the visible part, the worse of A and B.
        silhouette_iou: The same of the union of both.
        distance: Distance of a triangle from its place [px], the worse of A and B.
        in_order: Whether A is behind B.
    """

    iou: torch.Tensor
    silhouette_iou: torch.Tensor
    distance: torch.Tensor
    in_order: torch.Tensor

    @property
    def in_place(self) -> torch.Tensor:
        """Whether both triangles are where they should be, in whatever order, shape (S,)."""
        return self.distance < REACHED_DISTANCE

    @property
    def reached(self) -> torch.Tensor:
        """Whether the parts look as the target does, in the right order, shape (S,)."""
        return (self.iou > REACHED_IOU) & self.in_order


def triangles_mesh(device: torch.device | str) -> PartMesh:
    """A (label 1) and B (label 2)."""
    return PartMesh.from_faces(np.arange(6).reshape(2, 3), np.array([1, 2]), device=device)


def place(shapes: np.ndarray, centres: np.ndarray, depths: tuple[float, float]) -> np.ndarray:
    """Vertices (6, 3) from corners about the centre (2, 3, 2) [px], centres (2, 2) [px] and depths of A and B [m]."""
    depth = np.broadcast_to(np.array(depths)[:, None, None], (2, 3, 1))
    return np.concatenate([shapes + centres[:, None], depth], axis=2).reshape(6, 3).astype(np.float32)


def _scenes(starts: list[np.ndarray], goals: list[np.ndarray], device: torch.device | str) -> Scenes:
    mesh = triangles_mesh(device)
    start, goal = (torch.from_numpy(np.stack(vertices)).to(device) for vertices in (starts, goals))
    return Scenes(mesh, start, goal, draw_mesh(goal, mesh, WeakPerspective.identity(device), IMAGE_SIZE).labels)


def fixed_scene(device: torch.device | str = "cpu") -> Scenes:
    """The picture's scene: A starts in front of B, near B's place, and B near A's."""
    shapes = np.array([[(-15, 11), (14, 9), (1, -20)]] * 2, dtype=float)
    goal = place(shapes, np.array([(31, 30), (44, 36)]), (FAR_DEPTH, NEAR_DEPTH))
    start = place(shapes, np.array([(54, 28), (39, 42)]), (NEAR_DEPTH, FAR_DEPTH))
    return _scenes([start], [goal], device)


def random_scenes(count: int, seed: int, *, alike: bool, device: torch.device | str = "cpu") -> Scenes:
    """Scenes whose target shows 30 to 80 % of A and whose start shows 20 to 95 % of B.

    Args:
        count: S.
        seed: Of the random numbers.
        alike: Both triangles have one shape and each starts near the other's place (within 6 px along either axis);
            otherwise shapes differ and each triangle starts anywhere.
        device: Where the scenes go.
    """
    rng = np.random.default_rng(seed)
    height, width = IMAGE_SIZE
    starts: list[np.ndarray] = []
    goals: list[np.ndarray] = []
    while len(starts) < count:
        angles, radii = np.sort(rng.uniform(0, 2 * np.pi, (2, 3)), axis=1), rng.uniform(10, 18, (2, 3))
        shapes = radii[..., None] * np.stack([np.cos(angles), np.sin(angles)], axis=2)
        shapes -= shapes.mean(axis=1, keepdims=True)
        if alike:
            shapes[1] = shapes[0]
        centres, start_centres = rng.uniform(18, (width - 18, height - 18), (2, 2, 2))
        if alike:
            start_centres = centres[::-1] + rng.uniform(-6, 6, (2, 2))
        goal = place(shapes, centres, (FAR_DEPTH, NEAR_DEPTH))
        start = place(shapes, start_centres, (NEAR_DEPTH, FAR_DEPTH))
        if _is_fair(start, goal, device):
            starts.append(start)
            goals.append(goal)
    return _scenes(starts, goals, device)


def _is_fair(start: np.ndarray, goal: np.ndarray, device: torch.device | str) -> bool:
    """Whether nothing is a sliver or out of the picture, and the triangles overlap as ``random_scenes`` says."""
    both = np.stack([start, goal])
    edges = np.diff(both.reshape(4, 3, 3)[..., :2], axis=1)
    areas = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) / 2
    if areas.min() < 150 or both[..., :2].min() < 0 or (both[..., :2] > IMAGE_SIZE[::-1]).any():
        return False
    vertices = torch.from_numpy(both).to(device)
    camera = WeakPerspective.identity(device)
    labels = draw_mesh(vertices, triangles_mesh(device), camera, IMAGE_SIZE).labels.cpu().numpy()
    shown_b, shown_a = (labels[0] == 2).sum() / areas[1], (labels[1] == 1).sum() / areas[2]
    return bool(0.2 < shown_b < 0.95 and 0.3 < shown_a < 0.8)


def optimize(scenes: Scenes, supervision: Supervision) -> torch.Tensor:
    """Move each triangle as a whole toward the target.

    Args:
        scenes: Start and target of S scenes, optimised side by side.
        supervision: What of the target the loss shows.

    Returns:
        Vertices before each iteration and after the last, shape (ITERATIONS + 1, S, 6, 3).
    """
    mesh, target = scenes.mesh, scenes.target
    if not supervision.parts:
        mesh, target = mesh.relabel({1: 1, 2: 1}), target.clamp(max=1)
    count, device = len(scenes.start), scenes.start.device
    camera = WeakPerspective.identity(device)
    shift = torch.zeros(count, 2, 1, 2, device=device, requires_grad=True)  # [px]
    advance = torch.zeros(count, 2, 1, 1, device=device, requires_grad=True)  # [m]
    # Adam divides each coordinate's gradient by its own size, so neither lambda nor the loss's scale has to be chosen.
    optimizer = torch.optim.Adam(
        [{"params": [shift], "lr": LEARNING_RATE}, {"params": [advance], "lr": DEPTH_LEARNING_RATE}]
    )
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, DECAY)

    def vertices() -> torch.Tensor:
        return (scenes.start.view(count, 2, 3, 3) + torch.cat([shift, advance], dim=3)).flatten(1, 2)

    course = [vertices().detach()]
    for iteration in range(ITERATIONS):
        is_first = iteration == 0  # the target stays, so one look at its labels is enough
        options = {"depth_weight": supervision.depth_weight, "validate": is_first}
        loss, _ = mesh_label_loss(vertices(), mesh, camera, target, **options)
        optimizer.zero_grad()
        loss.sum().backward()
        optimizer.step()
        schedule.step()
        course.append(vertices().detach())
    return torch.stack(course)


def judge(scenes: Scenes, vertices: torch.Tensor) -> Outcome:
    """Compare vertices of shape (S, 6, 3) with the goal."""
    labels = draw_mesh(vertices, scenes.mesh, WeakPerspective.identity(vertices.device), IMAGE_SIZE).labels

    def iou(have: torch.Tensor, want: torch.Tensor) -> torch.Tensor:
        return (have & want).sum((1, 2)) / (have | want).sum((1, 2))

    moved = (vertices - scenes.goal)[:, ::3, :2]  # one corner tells of the whole triangle: it is rigid
    return Outcome(
        iou=torch.minimum(*(iou(labels == part, scenes.target == part) for part in (1, 2))),
        silhouette_iou=iou(labels > 0, scenes.target > 0),
        distance=moved.norm(dim=2).amax(1),
        in_order=vertices[:, 0, 2] > vertices[:, 3, 2],
    )


# --- picture -----------------------------------------------------------------------------------------------------

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
    """What became of one scene, in a word and in a few."""
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
    """How many of ``count`` random scenes of either kind end right, as a Markdown table."""
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
