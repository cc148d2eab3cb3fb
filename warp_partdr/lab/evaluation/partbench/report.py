"""PartBench's report: tables, methods compared with one another, and the worst fits drawn, in one HTML file."""

from __future__ import annotations

import html
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw
from rich.console import Console

from ....body.skeletons import MPJPE_SKELETON, skeleton
from ....files.html_pages import html_page, picture_element
from ....inputs.sample import Sample
from ....results.overlays import draw_keypoints
from ....results.palette import group_colours
from ....solve.ellipsoids.result import FitResult
from ...synthetic.scene_people import SceneSample
from ..evaluate import Evaluated, Fitting, Report, tables
from ..pairs import compare_pairs
from ..scoring import Score
from . import VERSION
from .crossed import CROSSED_METHODS, MIRRORED
from .methods import KNOWN_CAMERA, NO_FLIPS
from .samples import source_name
from .scene_pictures import draw_scene_case
from .scenes import SMOOTHED, SMOOTHED_APART

WORST = 10
DRAWN = ("parts", MIRRORED, "scene")  # methods whose worst fits are drawn
# Each pair: what should be better, and than what.
ORDER = (
    ("parts", "full silhouette"),
    ("full silhouette", "keypoints only"),
    ("parts", "search"),
    (KNOWN_CAMERA, "parts"),
    ("parts", NO_FLIPS),
    *((MIRRORED, name) for name in CROSSED_METHODS if name != MIRRORED),
    ("network, 50 iterations", "network"),
    ("search", "search, no z gradient"),
    ("parts, Anny's mesh", "parts, Anny's mesh, PartDR's rule"),
    ("scene", "each alone"),
    ("scene", "scene, no ground"),
    ("scene", "scene, no exchanges"),
    ("scene, z gradient, no exchanges", "scene, no z gradient, no exchanges"),
    ("scene", "scene, feet slide"),
    *(("scene", name) for name in (*SMOOTHED, *SMOOTHED_APART)),
    ("scene", "first camera alone"),
)
_TRUE, _FITTED = (20, 70, 140), (200, 60, 20)
_STYLE = "body{font:15px sans-serif;margin:2em;max-width:1500px}pre{font-size:12px;line-height:1.15}img{display:block}"


def compare_methods(report: Report) -> Iterator[str]:
    """Differences between methods on the same people, with 95 % intervals: a sentence for each level and pair."""
    for source, sentence in compare_pairs(report, ORDER):
        yield f"{source.removeprefix(source_name(''))}: {sentence}"


def write_report(
    path: Path,
    report: Report,
    samples: Sequence[Evaluated],
    methods: Mapping[str, Fitting],
    measured_with: Mapping[str, Any],
    *,
    device: str = "cpu",
) -> None:
    """Write tables, findings and the worst fits, which are fitted once more to be drawn, as HTML.

    Args:
        path: Path of the file.
        report: Report that ``evaluate`` returned for ``samples`` and ``methods``.
        samples: People that were fitted.
        methods: Methods by name.
        measured_with: Facts about the machine, versions and so on.
        device: Device, "cpu" or a CUDA device.
    """
    console = Console(width=170, record=True, file=io.StringIO(), highlight=False)
    for table in tables(report):
        console.print(table)
    cases = []
    fitted = dict.fromkeys(score.method for score in report.scores)
    drawn = [name for name in DRAWN if name in fitted] or list(fitted)[:1]
    for score in (each for name in drawn for each in worst(report, name)):
        sample = next(each for each in samples if (each.source, each.name) == (score.source, score.sample))
        caption = f"{score.source}: {score.sample}: PA-MPJPE {score.pa_mpjpe:.0f} mm, MPJPE {score.mpjpe:.0f} mm"
        result = methods[score.method].fit_sample(sample, device)
        if isinstance(sample, Sample):
            picture = draw_case(sample, result)
        else:
            assert isinstance(sample, SceneSample)
            picture = draw_scene_case(sample, result)
        cases.append(f"<h3>{html.escape(caption)}</h3>{_img(picture)}")
    listed = "".join(f"<li>{html.escape(finding)}</li>" for finding in compare_methods(report))
    about = ", ".join(f"{key} {value}" for key, value in measured_with.items())
    body = (
        f"<h1>PartBench {VERSION}</h1><p>{html.escape(about)}</p>"
        f"{console.export_html(inline_styles=True, code_format='<pre>{code}</pre>')}"
        f"<h2>Differences on the same people</h2><ul>{listed}</ul>"
        f"<h2>The worst fits of &ldquo;{html.escape(' and '.join(drawn))}&rdquo;, one a person</h2>"
        "<p>What the fit saw; the truth; the fit; joints from the person's side as the camera has it, of scenes from "
        f"above (blue: true, red: fitted).</p>{''.join(cases)}"
    )
    path.write_text(html_page(f"PartBench {VERSION}", _STYLE, body), encoding="utf-8")


def worst(report: Report, method: str) -> list[Score]:
    """The fits of a method with the largest PA-MPJPE, worst first, each person once."""
    ordered = sorted((score for score in report.scores if score.method == method), key=lambda score: score.pa_mpjpe)
    people = {score.sample: score for score in ordered}  # of several, the last
    return sorted(people.values(), key=lambda score: -score.pa_mpjpe)[:WORST]


def draw_case(sample: Sample, result: FitResult) -> Image.Image:
    """Labels and keypoints as seen, true labels, the fit's labels, and joints from the side, next to one another."""
    labels = sample.target_set
    assert labels is not None
    assert sample.parts is not None
    assert sample.target is not None
    colours = group_colours(labels.part_groups)
    seen = Image.fromarray(group_colours(sample.parts.label_set.part_groups)[sample.parts.groups])
    draw_keypoints(seen, sample.keypoints)
    fitted = labels.from_parts(result.draw(sample.target.shape).labels[0].cpu().numpy())
    side = np.asarray(_side_view(sample, result, seen.height))
    return Image.fromarray(np.hstack([np.asarray(seen), colours[sample.target], colours[fitted], side]))


def _side_view(sample: Sample, result: FitResult, side: int) -> Image.Image:
    """True and fitted joints seen along the camera's x axis, pelvises together; the camera is on the left."""
    assert sample.joints is not None
    picture = Image.new("RGB", (side, side), "white")
    draw = ImageDraw.Draw(picture)
    hips = [sample.joint_names.index(name) for name in ("left_hip", "right_hip")]
    both = [joints - joints[hips].mean(0) for joints in (sample.joints, result.landmarks(sample.joint_names))]
    scale = 0.45 * side / max(float(np.abs(joints).max()) for joints in both)
    for joints, colour in zip(both, (_TRUE, _FITTED), strict=True):
        points = joints[:, [2, 1]] * scale + side / 2
        for start, end in skeleton(MPJPE_SKELETON).edges:
            draw.line([*points[start].tolist(), *points[end].tolist()], fill=colour, width=3)
    return picture


def _img(picture: Image.Image) -> str:
    buffer = io.BytesIO()
    picture.save(buffer, "PNG", optimize=True)
    return picture_element(buffer.getvalue(), "png", "seen, true, fitted, from the side")
