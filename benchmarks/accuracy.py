"""How good fits are, and what part labels add: keypoints only, full silhouette, and parts, by the same fit.

    python benchmarks/accuracy.py [--people FOLDER] [--anny FOLDER] [--pictures FOLDER] [--jobs 2] [--out FILE.json]

Prints one table for each of three sources and, with --out, writes every fit's figures:

* the packaged example: exact labels and keypoints, true 3D joints;
* --anny: people made by ``benchmarks/anny_people.py``: fitted to noisy labels and keypoints, scored against the clean
  labels and the true 3D joints;
* --people: photos ``N.jpg`` with ``N.parts.png`` (ids of cdcl14) and ``N.keypoints.json``: scored against the labels
  that were fitted, for there are no others. With labels as input, that says how well a body can follow them.

Figures: PA-MPJPE and MPJPE (pelvis-centred) over the 14 LSP joints; F1 after grouping into LSP's six parts, counts
pooled over pictures of original size, pixels to be ignored left out: foreground (mean of background and person), parts
(mean of 7 classes); distance of the confident keypoints as a share of the person's height. In brackets: 95 % intervals,
bootstrapped over people. Times are of single fits, kernels compiled; with --jobs above 1, fits slow each other down.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import torch
import warp as wp
from PIL import Image, ImageDraw, ImageFont
from rich.box import MARKDOWN
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn
from rich.table import Table

from warp_partdr import metrics
from warp_partdr.bench.machine import about
from warp_partdr.body.labels import BACKGROUND, IGNORE, label_set, regroup
from warp_partdr.body.skeletons import MPJPE_SKELETON, skeleton
from warp_partdr.fitting import FitOptions, FitResult, fit_body
from warp_partdr.inputs import (
    Keypoints2D,
    PartLabels,
    choose_person,
    person_crop,
    person_height,
    read_keypoints,
    read_parts,
    read_photo,
    select_person,
)
from warp_partdr.kernels.threads import set_num_threads
from warp_partdr.missing_labels import ignore_missing_limbs
from warp_partdr.output import draw_overlay
from warp_partdr.palette import group_colours
from warp_partdr.pictures import turntable

LABELS = label_set("cdcl14")
LSP6 = label_set("lsp6")
TO_LSP6 = regroup(LABELS, LSP6)  # from group ids, shape (256,)
PARTS_TO_LSP6 = TO_LSP6[LABELS.part_groups]  # from rendered part labels, by way of the same groups, shape (21,)
JOINTS = skeleton(MPJPE_SKELETON).landmarks
HIPS = [JOINTS.index("left_hip"), JOINTS.index("right_hip")]

RESAMPLES = 10_000  # of the bootstrap
CONFIDENCE = 0.95
TILE = 360  # [px], side of a picture in a contact sheet
VIEWS = {  # turn about the vertical, tilt [degrees]
    "as in the photo": (0.0, 0.0),
    "from the photo's left": (-90.0, 0.0),
    "from the photo's right": (90.0, 0.0),
    "from above": (0.0, 90.0),
}


def silhouette(parts: PartLabels) -> PartLabels:
    """All parts as one; what is to be ignored stays so."""
    person = (parts.groups != BACKGROUND) & (parts.groups != IGNORE)
    return PartLabels(label_set("full1"), np.where(person, 1, parts.groups).astype(np.uint8))


def _same(parts: PartLabels) -> PartLabels:
    return parts


def _nothing(parts: PartLabels) -> None:
    return None


# What a fit gets to see, and how it goes. Joints are compared without the outline stage, which costs some accuracy.
SUPERVISIONS: dict[str, tuple[Callable[[PartLabels], PartLabels | None], FitOptions]] = {
    "keypoints only": (_nothing, FitOptions()),
    "silhouette, no outline": (silhouette, FitOptions().without_outline()),
    "parts, no outline": (_same, FitOptions().without_outline()),
    "full silhouette": (silhouette, FitOptions()),
    "parts, background trusted": (_same, FitOptions(trust_background=True)),
    "parts, labels first": (_same, FitOptions().labels_first()),
    "the same, background trusted": (_same, FitOptions(trust_background=True).labels_first()),
    "parts": (_same, FitOptions()),
}


@dataclass(frozen=True)
class Case:
    """One person to fit.

    Attributes:
        source: "example", "anny" or "people".
        name: Of the person within the source.
        keypoints: What is fitted,
        parts: and the labels (cdcl14).
        target: The labels that the fit is scored against, group ids of cdcl14, 255 = ignore, shape (H, W).
        others: Other people's keypoints in the picture.
        joints: True 3D joints, LSP-14, camera frame [m], shape (14, 3); None if nobody knows.
        photo: File of the picture.
    """

    source: str
    name: str
    keypoints: Keypoints2D
    parts: PartLabels
    target: np.ndarray
    others: tuple[Keypoints2D, ...] = ()
    joints: np.ndarray | None = None
    photo: Path | None = None


@dataclass(frozen=True)
class Score:
    """How good one fit is.

    Attributes:
        source: Of the case.
        case: Its name.
        supervision: One of ``SUPERVISIONS``.
        counts: Pixels by (target, rendered) class of LSP's six parts, background first, shape (7, 7).
        undisputed: The same without background that confident keypoints contradict (``ignore_missing_limbs``).
        keypoints: Distance of each confident keypoint, as a share of the person's height, shape (K,).
        pa_mpjpe: [mm], NaN if the true joints are not known.
        mpjpe: [mm], the same.
        hypotheses: How many starts there were.
        seconds: Wall time.
    """

    source: str
    case: str
    supervision: str
    counts: np.ndarray
    undisputed: np.ndarray
    keypoints: np.ndarray
    pa_mpjpe: float
    mpjpe: float
    hypotheses: int
    seconds: float


def read_example() -> list[Case]:
    folder = Path(str(resources.files("warp_partdr"))) / "assets" / "example"
    parts = read_parts(folder / "parts.png", LABELS)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["joints"][MPJPE_SKELETON]
    if tuple(truth["names"]) != JOINTS:
        raise SystemExit(f"{folder / 'truth.json'}: joints {truth['names']}; expected {', '.join(JOINTS)}")
    return [
        Case(
            source="example",
            name="example",
            keypoints=choose_person(read_keypoints(folder / "keypoints.json"), parts.groups),
            parts=parts,
            target=parts.groups,
            joints=np.array(truth["points_m"]),
            photo=folder / "photo.png",
        )
    ]


def read_anny(folder: Path) -> list[Case]:
    cases = []
    for path in sorted(folder.glob("person_*.npz")):
        with np.load(path, allow_pickle=False) as person:
            keypoints = person["keypoints"].astype(np.float32)
            cases.append(
                Case(
                    source="anny",
                    name=path.stem,
                    keypoints=Keypoints2D("coco17", keypoints[:, :2], keypoints[:, 2]),
                    parts=PartLabels(LABELS, LABELS.to_groups(person["cdcl14_noisy"])),
                    target=LABELS.to_groups(person["cdcl14"]),
                    joints=person[MPJPE_SKELETON],
                )
            )
    return cases


def read_people(folder: Path) -> list[Case]:
    cases = []
    for photo in sorted(folder.glob("*.jpg")):
        parts = read_parts(photo.with_suffix(".parts.png"), LABELS)
        people = read_keypoints(photo.with_suffix(".keypoints.json"))
        chosen = choose_person(people, parts.groups)
        others = tuple(other for other in people if other is not chosen)
        target = select_person(parts.groups, chosen, others)
        cases.append(Case("people", photo.stem, chosen, parts, target, others, photo=photo))
    return cases


def prepare() -> None:
    """Once for each process: one thread, and a fit that does not count, so that kernels are compiled and loaded."""
    wp.config.log_level = wp.LOG_WARNING
    torch.set_num_threads(1)
    set_num_threads(1)
    for case in read_example():
        fit_body(case.keypoints, case.parts)


def fit_case(case: Case, supervision: str, pictures: Path | None) -> Score:
    """Fit one person under one supervision."""
    started = time.perf_counter()
    see, options = SUPERVISIONS[supervision]
    result = fit_body(case.keypoints, see(case.parts), others=case.others, options=options)
    seconds = time.perf_counter() - started
    if pictures is not None and case.photo is not None and supervision == "parts":
        contact_sheet(case, result).save(pictures / f"{case.name}.png", optimize=True)

    shown = PARTS_TO_LSP6[result.draw(case.target.shape).labels[0].numpy()]
    sure = case.keypoints.confident
    landmarks = torch.from_numpy(result.landmarks(case.keypoints.format.landmarks))[None]
    distances = np.linalg.norm(result.camera.project(landmarks)[0, :, :2].numpy() - case.keypoints.points, axis=1)
    pa_mpjpe = mpjpe = math.nan
    if case.joints is not None:
        joints, truth = (points - points[HIPS].mean(0) for points in (result.landmarks(JOINTS), case.joints))
        pa_mpjpe = 1000 * float(metrics.pa_mpjpe(joints, truth))
        mpjpe = 1000 * float(metrics.mpjpe(joints, truth))
    return Score(
        source=case.source,
        case=case.name,
        supervision=supervision,
        counts=metrics.confusion(shown, TO_LSP6[case.target], LSP6.num_groups + 1),
        undisputed=metrics.confusion(
            shown, TO_LSP6[ignore_missing_limbs(case.target, case.keypoints)], LSP6.num_groups + 1
        ),
        keypoints=distances[sure] / person_height(case.keypoints),
        pa_mpjpe=pa_mpjpe,
        mpjpe=mpjpe,
        hypotheses=result.hypotheses,
        seconds=seconds,
    )


def contact_sheet(case: Case, result: FitResult) -> Image.Image:
    """Above: photo, overlay, target and rendered parts; below: the body from four sides."""
    assert case.photo is not None
    photo = read_photo(case.photo)
    shown = LABELS.part_groups[result.draw(case.target.shape).labels[0].numpy()]
    colours = group_colours(LABELS.part_groups)
    overlay = draw_overlay(result, case.keypoints, case.target.shape, photo).resize(photo.shape[1::-1])
    tiles = {
        "photo": Image.fromarray(photo),
        "overlay": overlay,
        "target parts": Image.fromarray(colours[case.target]),
        "result parts": Image.fromarray(colours[shown]),
    }
    x0, y0, x1, y1 = person_crop(case.keypoints, case.target)
    side = max(x1 - x0, y1 - y0)
    left, top = (x0 + x1 - side) // 2, (y0 + y1 - side) // 2  # Beyond the picture, PIL crops black.
    tiles = {
        title: image.crop((left, top, left + side, top + side)).resize((TILE, TILE)) for title, image in tiles.items()
    }
    views = turntable(result.posed, tuple(VIEWS.values()), TILE)
    tiles |= {title: Image.fromarray(view) for title, view in zip(VIEWS, views, strict=True)}

    columns, bar = len(tiles) // 2, 20
    sheet = Image.new("RGB", (columns * TILE, 2 * (TILE + bar)), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    for index, (title, image) in enumerate(tiles.items()):
        x, y = index % columns * TILE, index // columns * (TILE + bar)
        draw.text((x + 4, y + 1), title, fill="black", font=font)
        sheet.paste(image, (x, y + bar))
    return sheet


def run(cases: Sequence[Case], jobs: int, pictures: Path | None) -> list[Score]:
    """All cases under all supervisions, in their order, in ``jobs`` processes."""
    prepare()  # Here too: one process compiles, the others load what it made.
    tasks = [(case, supervision, pictures) for case in cases for supervision in SUPERVISIONS]
    console = Console(stderr=True)
    bar = Progress(
        *Progress.get_default_columns(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
        disable=not console.is_terminal,
        transient=True,
    )
    spawn = multiprocessing.get_context("spawn")  # A fork would inherit Warp's and torch's threads half alive.
    with bar, ProcessPoolExecutor(jobs, mp_context=spawn, initializer=prepare) as pool:
        futures = [pool.submit(fit_case, *task) for task in tasks]
        try:
            for done in bar.track(as_completed(futures), total=len(futures), description="fits"):
                done.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return [future.result() for future in futures]


def bootstrap(values: np.ndarray, statistic: Callable[..., np.ndarray], seed: int = 0) -> tuple[float, float]:
    """Percentile interval of a statistic of independent values, shape (N,); ``statistic`` takes an ``axis``."""
    rng = np.random.default_rng(seed)
    drawn = values[rng.integers(0, len(values), (RESAMPLES, len(values)))]
    low, high = np.quantile(statistic(drawn, axis=1), [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def summarise(scores: Sequence[Score]) -> dict[str, Any]:
    """Figures of one or more fits: pixels and keypoints pooled; joints and seconds averaged over people."""
    counts = metrics.pooled(score.counts for score in scores)
    undisputed = metrics.pooled(score.undisputed for score in scores)
    classes = metrics.f1_scores(counts)
    summary: dict[str, Any] = {
        "people": len(scores),
        "foreground_f1": round(metrics.part_f1(metrics.foreground_counts(counts)), 4),
        "part_f1": round(metrics.part_f1(counts), 4),
        "undisputed_foreground_f1": round(metrics.part_f1(metrics.foreground_counts(undisputed)), 4),
        "undisputed_part_f1": round(metrics.part_f1(undisputed), 4),
        "f1": {
            name: None if np.isnan(value) else round(float(value), 4)
            for name, value in zip(("background", *LSP6.group_names), classes, strict=True)
        },
        "keypoint_distance": round(float(np.concatenate([score.keypoints for score in scores]).mean()), 5),
        "hypotheses": round(float(np.mean([score.hypotheses for score in scores])), 1),
        "seconds": round(float(np.mean([score.seconds for score in scores])), 2),
    }
    aligned = np.array([score.pa_mpjpe for score in scores])
    if np.isfinite(aligned).all():
        summary["mpjpe_mm"] = round(float(np.mean([score.mpjpe for score in scores])), 1)
        for name, statistic in (("mean", np.mean), ("median", np.median)):
            summary[f"pa_mpjpe_{name}_mm"] = round(float(statistic(aligned)), 1)
            if len(scores) > 1:
                interval = bootstrap(aligned, statistic)
                summary[f"pa_mpjpe_{name}_95_mm"] = [round(limit, 1) for limit in interval]
    return summary


def gain(scores: Sequence[Score], better: str, worse: str) -> str:
    """Mean difference in PA-MPJPE of the same people under two supervisions, in words."""
    errors = {
        name: np.array([score.pa_mpjpe for score in scores if score.supervision == name]) for name in (better, worse)
    }
    difference = errors[better] - errors[worse]
    low, high = bootstrap(difference, np.mean)
    return (
        f"PA-MPJPE, {better} minus {worse}, same people: {difference.mean():+.1f} mm ({low:+.1f} to {high:+.1f}); "
        f"lower for {int((difference < 0).sum())} of {len(difference)}"
    )


COLUMNS: dict[str, Callable[[dict[str, Any]], str]] = {
    "PA-MPJPE mean [mm]": lambda row: _millimetres(row, "mean"),
    "median [mm]": lambda row: _millimetres(row, "median"),
    "MPJPE [mm]": lambda row: f"{row['mpjpe_mm']:.0f}",
    "foreground F1": lambda row: f"{row['foreground_f1']:.3f}",
    "part F1": lambda row: f"{row['part_f1']:.3f}",
    "undisputed: foreground": lambda row: f"{row['undisputed_foreground_f1']:.3f}",
    "part": lambda row: f"{row['undisputed_part_f1']:.3f}",
    "keypoints off [% of height]": lambda row: f"{100 * row['keypoint_distance']:.1f}",
    "hypotheses": lambda row: f"{row['hypotheses']:.0f}",
    "time [s]": lambda row: f"{row['seconds']:.1f}",
}
JOINT_COLUMNS = ("PA-MPJPE mean [mm]", "median [mm]", "MPJPE [mm]")


def _millimetres(row: dict[str, Any], name: str) -> str:
    interval = row.get(f"pa_mpjpe_{name}_95_mm")
    return f"{row[f'pa_mpjpe_{name}_mm']:.1f}" + (f" ({interval[0]:.1f} to {interval[1]:.1f})" if interval else "")


def table(title: str, rows: dict[tuple[str, str], dict[str, Any]]) -> Table:
    """A table in Markdown; keys of rows are (person, supervision), of which the person may be empty everywhere."""
    summaries = list(rows.values())
    shown = [name for name in COLUMNS if "mpjpe_mm" in summaries[0] or name not in JOINT_COLUMNS]
    if summaries[0]["people"] == 1:  # Its mean is its median.
        shown = [name for name in shown if name != "median [mm]"]
    people = any(person for person, _ in rows)
    result = Table(title=title, title_justify="left", title_style="bold", box=MARKDOWN)
    for name in [*(["person"] if people else []), "fitted to"]:
        result.add_column(name, no_wrap=True)
    for name in shown:
        header = name.replace(" mean", "") if "median [mm]" not in shown else name
        result.add_column(header, justify="right", no_wrap=True)
    for (person, supervision), summary in rows.items():
        cells = [COLUMNS[name](summary) for name in shown]
        result.add_row(*([person] if people else []), supervision, *cells)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=Path, metavar="FOLDER", help="photos with labels and keypoints")
    parser.add_argument("--anny", type=Path, metavar="FOLDER", help="people of benchmarks/anny_people.py")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="write a contact sheet of each photo")
    parser.add_argument("--jobs", type=int, default=1, help="fits at a time; more than 1 makes each take longer")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="write all figures")
    arguments = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"  # for the processes to come

    cases = {"The packaged example": read_example()}
    if arguments.anny is not None:
        cases["Synthetic people (Anny), {} of them, noisy input"] = read_anny(arguments.anny)
    if arguments.people is not None:
        cases["Photos, against the labels given"] = read_people(arguments.people)
    for title, found in cases.items():
        if not found:
            parser.error(f"{title}: nobody in the folder given")
    if arguments.pictures is not None:
        arguments.pictures.mkdir(parents=True, exist_ok=True)
    measured_with = {**about(), "jobs": arguments.jobs}
    scores = run([case for group in cases.values() for case in group], arguments.jobs, arguments.pictures)

    console = Console(width=200, highlight=False, markup=False)
    console.print(", ".join(f"{key} {value}" for key, value in measured_with.items()))
    summaries: dict[str, dict[str, Any]] = {}
    for title, group in cases.items():
        source = group[0].source
        mine = [score for score in scores if score.source == source]
        pooled = {name: summarise([score for score in mine if score.supervision == name]) for name in SUPERVISIONS}
        rows = {("", name): summary for name, summary in pooled.items()}
        if source == "people":
            single = {(score.case, score.supervision): summarise([score]) for score in mine}
            rows = single | {("all", name): summary for name, summary in pooled.items()}
        console.print()
        console.print(table(title.format(len(group)), rows))
        if source == "anny":
            for other in ("keypoints only", "silhouette, no outline", "parts"):
                console.print(gain(mine, "parts, no outline", other))
        summaries[source] = pooled

    if arguments.out is not None:
        fits = [
            {"source": score.source, "person": score.case, "fitted to": score.supervision, **summarise([score])}
            for score in scores
        ]
        # The options are there to be read, not to be parsed: they change.
        report = {"about": measured_with, "options": repr(FitOptions()), "pooled": summaries, "fits": fits}
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
