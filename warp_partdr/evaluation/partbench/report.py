"""PartBench's report: tables, what was hoped for and found, and the worst fits drawn, in one HTML file."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from ... import metrics
from ...body.skeletons import MPJPE_SKELETON, skeleton
from ...inputs.sample import Sample
from ...results.palette import group_colours
from ...results.pictures import draw_keypoints
from ...synthetic.noise import LEVELS
from ..evaluate import Method, Report, tables
from ..scoring import Fitted, Score
from . import VERSION
from .samples import LABELS, source_name

if TYPE_CHECKING:
    from PIL.Image import Image

WORST = 10
DRAWN = "parts"  # the method whose worst fits are drawn
# Level, figure, its name, and the least or most that was hoped for.
TARGETS: tuple[tuple[str, str, str, float], ...] = (
    ("clean", "foreground_f1", "FB F1", 0.95),
    ("clean", "part_f1", "part F1", 0.88),
    ("clean", "pa_mpjpe_mm", "PA-MPJPE [mm]", 60.0),
    ("realistic", "part_f1", "part F1", 0.80),
    ("realistic", "pa_mpjpe_mm", "PA-MPJPE [mm]", 80.0),
)
# Each pair: what should be better, and than what.
ORDER = (
    ("parts", "full silhouette"),
    ("full silhouette", "keypoints only"),
    ("parts", "search"),
    ("network, 50 iterations", "network"),
    ("search", "search, no z gradient"),
    ("parts, Anny's mesh", "parts, Anny's mesh, no z gradient"),
)
_TRUE, _FITTED = (20, 70, 140), (200, 60, 20)
_STYLE = "body{font:15px sans-serif;margin:2em;max-width:1500px}pre{font-size:12px;line-height:1.15}img{display:block}"


def compare_to_targets(report: Report) -> list[str]:
    """Compare figures with what was hoped for, and methods with one another, a sentence each."""
    pooled = report.pooled()
    found = []
    for level, figure, name, goal in TARGETS:
        row = pooled.get(source_name(level), {}).get(DRAWN)
        if row is None or figure not in row:
            continue
        least = not figure.endswith("_mm")
        met = row[figure] >= goal if least else row[figure] < goal
        found.append(
            f"{level}, {DRAWN}: {name} {row[figure]:g}, hoped for {'at least' if least else 'under'} {goal:g}: "
            f"{'met' if met else 'not met'}"
        )
    return found + [
        sentence for level in LEVELS for better, worse in ORDER if (sentence := _compare(report, level, better, worse))
    ]


def _compare(report: Report, level: str, better: str, worse: str) -> str:
    """Differences between two methods on the same people at a level; empty unless there are both."""
    scores = {
        name: {
            score.sample: score for score in report.scores if (score.source, score.method) == (source_name(level), name)
        }
        for name in (better, worse)
    }
    people = sorted(scores[better].keys() & scores[worse].keys())
    if not people:
        return ""
    errors = np.array([[scores[name][person].pa_mpjpe for name in (better, worse)] for person in people])
    text = f"PA-MPJPE {_interval(errors[:, 0] - errors[:, 1], np.mean, '+.1f')} mm"
    pictures = [[scores[name][person].pixels for name in (better, worse)] for person in people]
    counts = np.array([[picture.parts for picture in pair if picture is not None] for pair in pictures])
    if counts.ndim == 4:
        gain = lambda sums: metrics.part_f1(sums[..., 0, :, :]) - metrics.part_f1(sums[..., 1, :, :])  # noqa: E731
        low, high = metrics.bootstrap_sum(counts, gain)
        text += f", part F1 {float(gain(counts.sum(0))):+.4f} ({low:+.4f} to {high:+.4f})"
    return f"{level}: {better} minus {worse}: {text}"


def _interval(values: np.ndarray, statistic: Any, style: str) -> str:
    low, high = metrics.bootstrap(values, statistic)
    return f"{float(statistic(values)):{style}} ({low:{style}} to {high:{style}})"


def write_report(
    path: Path,
    report: Report,
    samples: Sequence[Sample],
    methods: Mapping[str, Method],
    measured_with: Mapping[str, Any],
    *,
    device: str = "cpu",
) -> None:
    """Write tables, findings and the worst fits, which are fitted once more to be drawn.

    Args:
        path: Of the HTML file.
        report: Of ``evaluate`` on the samples by the methods.
        samples: Who was fitted.
        methods: By name.
        measured_with: Machine, versions and so on.
        device: "cpu" or a CUDA device.
    """
    console = Console(width=170, record=True, file=io.StringIO(), highlight=False)
    for table in tables(report):
        console.print(table)
    cases = []
    drawn = DRAWN if DRAWN in methods else next(iter(methods))
    for score in worst(report, drawn):
        sample = next(each for each in samples if (each.source, each.name) == (score.source, score.sample))
        caption = f"{score.source}: {score.sample}: PA-MPJPE {score.pa_mpjpe:.0f} mm, MPJPE {score.mpjpe:.0f} mm"
        cases.append(
            f"<h3>{html.escape(caption)}</h3>{_img(draw_case(sample, _refit(sample, methods[score.method], device)))}"
        )
    listed = "".join(f"<li>{html.escape(finding)}</li>" for finding in compare_to_targets(report))
    about = ", ".join(f"{key} {value}" for key, value in measured_with.items())
    path.write_text(
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>PartBench {VERSION}</title>'
        f"<style>{_STYLE}</style><h1>PartBench {VERSION}</h1><p>{html.escape(about)}</p>"
        f"{console.export_html(inline_styles=True, code_format='<pre>{code}</pre>')}"
        f"<h2>Hoped for, and found</h2><ul>{listed}</ul>"
        f"<h2>The worst fits of &ldquo;{html.escape(drawn)}&rdquo;, one a person</h2>"
        "<p>What the fit saw; the truth; the fit; joints from the person's side as the camera has it (blue: true, red: "
        f"fitted).</p>{''.join(cases)}</html>\n",
        encoding="utf-8",
    )


def worst(report: Report, method: str) -> list[Score]:
    """The fits of a method with the largest PA-MPJPE, worst first, each person once."""
    ordered = sorted((score for score in report.scores if score.method == method), key=lambda score: -score.pa_mpjpe)
    people: dict[str, Score] = {}
    for score in ordered:
        people.setdefault(score.sample, score)
    return list(people.values())[:WORST]


def _refit(sample: Sample, method: Method, device: str) -> Fitted:
    parts = None if sample.parts is None else method.see(sample.parts)
    return method.fit(sample.keypoints, parts, others=sample.others, options=method.options, device=device)


def draw_case(sample: Sample, result: Fitted) -> Image:
    """Labels and keypoints as seen, true labels, the fit's labels, and joints from the side, next to one another."""
    from PIL import Image as PilImage

    assert sample.parts is not None
    assert sample.target is not None
    colours = group_colours(LABELS.part_groups)
    fitted = LABELS.from_parts(result.draw(sample.target.shape).labels[0].cpu().numpy())
    tiles = [PilImage.fromarray(colours[groups]) for groups in (sample.parts.groups, sample.target, fitted)]
    draw_keypoints(tiles[0], sample.keypoints)
    tiles.append(_side_view(sample, result))
    shown = PilImage.new("RGB", (sum(tile.width for tile in tiles), max(tile.height for tile in tiles)), "white")
    left = 0
    for tile in tiles:
        shown.paste(tile, (left, 0))
        left += tile.width
    return shown


def _side_view(sample: Sample, result: Fitted, side: int = 320) -> Image:
    """True and fitted joints seen along the camera's x axis, pelvises together; the camera is on the left."""
    from PIL import Image as PilImage
    from PIL import ImageDraw

    assert sample.joints is not None
    picture = PilImage.new("RGB", (side, side), "white")
    draw = ImageDraw.Draw(picture)
    hips = [sample.joint_names.index(name) for name in ("left_hip", "right_hip")]
    both = [joints - joints[hips].mean(0) for joints in (sample.joints, result.landmarks(sample.joint_names))]
    scale = 0.45 * side / max(float(np.abs(joints).max()) for joints in both)
    for joints, colour in zip(both, (_TRUE, _FITTED), strict=True):
        points = joints[:, [2, 1]] * scale + side / 2
        for start, end in skeleton(MPJPE_SKELETON).edges:
            draw.line([*points[start].tolist(), *points[end].tolist()], fill=colour, width=3)
    return picture


def _img(picture: Image) -> str:
    buffer = io.BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<img alt="seen, true, fitted, from the side" src="data:image/png;base64,{data}">'
