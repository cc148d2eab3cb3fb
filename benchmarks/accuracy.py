"""Quality of fits, and what part labels add: keypoints only, full silhouette, and parts, by the same fit.

    python benchmarks/accuracy.py [--people FOLDER] [--jobs 2] [--out FILE.json]

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
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from warp_partdr.body.labels import label_set
from warp_partdr.body.skeletons import MPJPE_JOINTS, MPJPE_SKELETON
from warp_partdr.cli.progress import FitProgress
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.keypoints import choose_person
from warp_partdr.inputs.part_labels import read_parts
from warp_partdr.inputs.sample import Sample
from warp_partdr.lab.bench.machine import about, in_words
from warp_partdr.lab.bench.report import make_table, save_figures, wide_console
from warp_partdr.lab.evaluation.datasets import read_folder
from warp_partdr.lab.evaluation.evaluate import Method, evaluate, no_labels, one_thread, silhouette
from warp_partdr.lab.evaluation.partbench.methods import fit_anny
from warp_partdr.lab.evaluation.scoring import summarise
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.mesh.mesh_options import MeshOptions

LABELS = label_set("cdcl14")

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
    "mesh": Method(fit=fit_anny),
    "mesh, labels first": Method(fit=partial(fit_anny, mesh=MeshOptions(seg=1.0, iterations=150))),
}


def read_example() -> list[Sample]:
    folder = Path(str(resources.files("warp_partdr"))) / "assets" / "example"
    parts = read_parts(folder / "parts.png", LABELS)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["joints"][MPJPE_SKELETON]
    places = dict(zip(truth["names"], truth["points_m"], strict=True))
    return [
        Sample(
            source="example",
            name="example",
            keypoints=choose_person(read_keypoints(folder / "keypoints.json"), parts.groups),
            parts=parts,
            target=parts.groups,
            joints=np.array([places[name] for name in MPJPE_JOINTS]),
            picture=folder / "photo.png",
        )
    ]


COLUMNS = {  # of tables: a figure's name and its format
    "PA-MPJPE [mm]": ("pa_mpjpe_mm", "{:.1f}"),
    "MPJPE [mm]": ("mpjpe_mm", "{:.0f}"),
    "foreground F1": ("foreground_f1", "{:.3f}"),
    "part F1": ("part_f1", "{:.3f}"),
    "undisputed: foreground": ("undisputed_foreground_f1", "{:.3f}"),
    "part": ("undisputed_part_f1", "{:.3f}"),
    "keypoints off [% of height]": ("keypoint_distance", "{:.1%}"),
    "time [s]": ("seconds", "{:.1f}"),
}


def cells(person: str, method: str, figures: dict[str, Any]) -> list[str]:
    """A row of a table; what is not known is empty."""
    known = (form.format(figures[name]) if name in figures else "" for name, form in COLUMNS.values())
    return [person, method, *known]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=Path, metavar="FOLDER", help="photos with labels and keypoints")
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
    with FitProgress() as progress:
        everybody = [sample for group in samples.values() for sample in group]
        report = evaluate(everybody, SUPERVISIONS, jobs=arguments.jobs, progress=progress)
    for failure in report.failures:
        print(f"{failure.source}: {failure.sample}: {failure.method}: {failure.reason}")

    console, pooled = wide_console(), report.pooled()
    console.print(in_words(about()), f", jobs {arguments.jobs}", sep="")
    for title, group in samples.items():
        source = group[0].source
        mine = [score for score in report.scores if score.source == source]
        rows = [cells(score.sample, score.method, summarise([score])) for score in mine] if len(group) > 1 else []
        rows += [cells("all" if rows else "", name, figures) for name, figures in pooled[source].items()]
        console.print()
        console.print(make_table(title, ["person", "fitted to", *COLUMNS], rows, left=(0, 1), sections=True))

    if arguments.out is not None:
        # The options are there to be read, not to be parsed: they change.
        where = {"about": {**about(), "jobs": arguments.jobs}, "options": repr(FitOptions())}
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        save_figures({**where, **report.to_json()}, arguments.out)


if __name__ == "__main__":
    main()
