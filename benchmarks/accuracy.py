"""Quality of fits, and what part labels add: keypoints only, full silhouette, and parts, by the same fit.

    python benchmarks/accuracy.py [--people FOLDER] [--pictures FOLDER] [--jobs 2] [--out FILE.json]

Prints one table for each of two sources and, with --out, writes every fit's figures:

* the packaged example: exact labels and keypoints, true 3D joints;
* --people: photos ``N.jpg`` with ``N.parts.png`` (ids of cdcl14) and ``N.keypoints.json``: scored against the labels
  that were fitted, for there are no others. With labels as input, that says how well a body can follow them.

Figures: PA-MPJPE and MPJPE (pelvis-centred) over the 14 LSP joints; F1 after grouping into LSP's six parts, counts
pooled over pictures of original size, pixels to be ignored left out: foreground (mean of background and person), parts
(mean of 7 classes); distance of the confident keypoints as a share of the person's height. With --out also 95 %
intervals, bootstrapped over people. Times are of single fits, kernels compiled; with --jobs above 1, fits slow each
other down.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from rich.box import MARKDOWN
from rich.console import Console
from rich.table import Table

from warp_partdr.bench.machine import about
from warp_partdr.body.labels import label_set
from warp_partdr.body.skeletons import MPJPE_SKELETON, skeleton
from warp_partdr.cli.progress import FitProgress
from warp_partdr.evaluation.datasets import read_folder
from warp_partdr.evaluation.evaluate import Method, evaluate, no_labels, one_thread, silhouette
from warp_partdr.evaluation.scoring import summarise
from warp_partdr.fit.options import FitOptions
from warp_partdr.fit.result import FitResult
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.keypoints import choose_person
from warp_partdr.inputs.part_labels import read_parts, read_photo
from warp_partdr.inputs.person import person_crop
from warp_partdr.inputs.sample import Sample
from warp_partdr.results.palette import group_colours
from warp_partdr.results.pictures import turntable_views
from warp_partdr.results.save import draw_overlay

LABELS = label_set("cdcl14")
JOINTS = skeleton(MPJPE_SKELETON).landmarks

TILE = 360  # [px], side of a picture in a contact sheet
VIEWS = {  # turn about the vertical, tilt [degrees]
    "as in the photo": (0.0, 0.0),
    "from the photo's left": (-90.0, 0.0),
    "from the photo's right": (90.0, 0.0),
    "from above": (0.0, 90.0),
}

# What a fit gets to see, and how it goes. Joints are compared without the outline stage, which costs some accuracy.
SUPERVISIONS: dict[str, Method] = {
    "keypoints only": Method(no_labels),
    "silhouette, no outline": Method(silhouette, FitOptions().without_outline()),
    "parts, no outline": Method(options=FitOptions().without_outline()),
    "full silhouette": Method(silhouette),
    "parts, background trusted": Method(options=FitOptions(trust_background=True)),
    "parts, labels first": Method(options=FitOptions().labels_first()),
    "the same, background trusted": Method(options=FitOptions(trust_background=True).labels_first()),
    "parts": Method(),
}


def read_example() -> list[Sample]:
    folder = Path(str(resources.files("warp_partdr"))) / "assets" / "example"
    parts = read_parts(folder / "parts.png", LABELS)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["joints"][MPJPE_SKELETON]
    if tuple(truth["names"]) != JOINTS:
        raise SystemExit(f"{folder / 'truth.json'}: joints {truth['names']}; expected {', '.join(JOINTS)}")
    return [
        Sample(
            source="example",
            name="example",
            keypoints=choose_person(read_keypoints(folder / "keypoints.json"), parts.groups),
            parts=parts,
            target=parts.groups,
            joints=np.array(truth["points_m"]),
            picture=folder / "photo.png",
        )
    ]


def save_sheet(folder: Path, sample: Sample, supervision: str, result: FitResult) -> None:
    if supervision == "parts" and sample.picture is not None:
        contact_sheet(sample, result).save(folder / f"{sample.name}.png", optimize=True)


def contact_sheet(sample: Sample, result: FitResult) -> Image.Image:
    """Above: photo, overlay, target and rendered parts; below: the body from four sides."""
    assert isinstance(sample.picture, Path)
    assert sample.target is not None
    photo = read_photo(sample.picture)
    shown = LABELS.part_groups[result.draw(sample.target.shape).labels[0].numpy()]
    colours = group_colours(LABELS.part_groups)
    overlay = draw_overlay(result, sample.target.shape, photo).resize(photo.shape[1::-1])
    tiles = {
        "photo": Image.fromarray(photo),
        "overlay": overlay,
        "target parts": Image.fromarray(colours[sample.target]),
        "result parts": Image.fromarray(colours[shown]),
    }
    x0, y0, x1, y1 = person_crop(sample.keypoints, sample.target)
    side = max(x1 - x0, y1 - y0)
    left, top = (x0 + x1 - side) // 2, (y0 + y1 - side) // 2  # Beyond the picture, PIL crops black.
    tiles = {
        title: image.crop((left, top, left + side, top + side)).resize((TILE, TILE)) for title, image in tiles.items()
    }
    views = turntable_views(result.posed, tuple(VIEWS.values()), TILE)
    tiles |= {title: Image.fromarray(view) for title, view in zip(VIEWS, views, strict=True)}

    columns, bar = len(tiles) // 2, 20
    sheet = Image.new("RGB", (columns * TILE, 2 * (TILE + bar)), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    for index, (title, image) in enumerate(tiles.items()):
        x, y = index % columns * TILE, index // columns * (TILE + bar)
        draw.text((x + 4, y + 1), title, fill="black", font=font)
        sheet.paste(image, (x, y + bar))
    return sheet


COLUMNS: dict[str, Callable[[dict[str, Any]], str]] = {
    "PA-MPJPE [mm]": lambda row: f"{row['pa_mpjpe_mm']:.1f}",
    "MPJPE [mm]": lambda row: f"{row['mpjpe_mm']:.0f}",
    "foreground F1": lambda row: f"{row['foreground_f1']:.3f}",
    "part F1": lambda row: f"{row['part_f1']:.3f}",
    "undisputed: foreground": lambda row: f"{row['undisputed_foreground_f1']:.3f}",
    "part": lambda row: f"{row['undisputed_part_f1']:.3f}",
    "keypoints off [% of height]": lambda row: f"{100 * row['keypoint_distance']:.1f}",
    "hypotheses": lambda row: f"{row['hypotheses']:.0f}",
    "time [s]": lambda row: f"{row['seconds']:.1f}",
}
JOINT_COLUMNS = ("PA-MPJPE [mm]", "MPJPE [mm]")


def table(title: str, rows: dict[tuple[str, str], dict[str, Any]]) -> Table:
    """A table in Markdown; keys of rows are (person, supervision), of which the person may be empty everywhere."""
    summaries = list(rows.values())
    shown = [name for name in COLUMNS if "mpjpe_mm" in summaries[0] or name not in JOINT_COLUMNS]
    people = any(person for person, _ in rows)
    result = Table(title=title, title_justify="left", title_style="bold", box=MARKDOWN)
    for name in [*(["person"] if people else []), "fitted to"]:
        result.add_column(name, no_wrap=True)
    for name in shown:
        result.add_column(name, justify="right", no_wrap=True)
    for (person, supervision), summary in rows.items():
        cells = [COLUMNS[name](summary) for name in shown]
        result.add_row(*([person] if people else []), supervision, *cells)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=Path, metavar="FOLDER", help="photos with labels and keypoints")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="write a contact sheet of each photo")
    parser.add_argument("--jobs", type=int, default=1, help="fits at a time; more than 1 makes each take longer")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="write all figures")
    arguments = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"  # for the processes to come
    one_thread()

    samples = {"The packaged example": read_example()}
    if arguments.people is not None:
        samples["Photos, against the labels given"] = list(read_folder(arguments.people, LABELS))
    for title, found in samples.items():
        if not found:
            parser.error(f"{title}: nobody in the folder given")
    visit = None
    if arguments.pictures is not None:
        arguments.pictures.mkdir(parents=True, exist_ok=True)
        visit = partial(save_sheet, arguments.pictures)
    measured_with = {**about(), "jobs": arguments.jobs}
    with FitProgress() as progress:
        everybody = [sample for group in samples.values() for sample in group]
        report = evaluate(everybody, SUPERVISIONS, jobs=arguments.jobs, visit=visit, progress=progress)
    for failure in report.failures:
        print(f"{failure.source}: {failure.sample}: {failure.method}: {failure.reason}")

    console = Console(width=200, highlight=False, markup=False)
    console.print(", ".join(f"{key} {value}" for key, value in measured_with.items()))
    summaries: dict[str, dict[str, Any]] = {}
    for title, group in samples.items():
        source = group[0].source
        mine = [score for score in report.scores if score.source == source]
        pooled = {name: summarise([score for score in mine if score.method == name]) for name in SUPERVISIONS}
        rows = {("", name): summary for name, summary in pooled.items()}
        if source != "example":
            single = {(score.sample, score.method): summarise([score]) for score in mine}
            rows = single | {("all", name): summary for name, summary in pooled.items()}
        console.print()
        console.print(table(title, rows))
        summaries[source] = pooled

    if arguments.out is not None:
        fits = [
            {"source": score.source, "person": score.sample, "fitted to": score.method, **summarise([score])}
            for score in report.scores
        ]
        # The options are there to be read, not to be parsed: they change.
        figures = {"about": measured_with, "options": repr(FitOptions()), "pooled": summaries, "fits": fits}
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
