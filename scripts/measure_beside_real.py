"""Measure PartBench's levels beside views of real people, and print the rows of docs/evaluation.md.

    python scripts/measure_beside_real.py VIEWS [--leave-out SET] [--levels clean realistic ...] [--people FIRST LAST]
    python scripts/measure_beside_real.py --formats [--levels realistic] [--people FIRST LAST]

VIEWS is a folder or file as `partdr evaluate real` takes it; its rows "baseline" count. Their keypoints get the errors
of a level, too, as if none were hidden. No camera is given. Statures are shares of the true ones, also of children.
Intervals are of 95 %, over people.

With --formats only people count whose keypoints lie where another data set than COCO marks them. Fits are told so, or
take the keypoints for the body's own joints.
"""

from __future__ import annotations

import argparse
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from warp_partdr.inputs.keypoints import person_height
from warp_partdr.inputs.sample import Sample
from warp_partdr.lab.evaluation.datasets import ViewSelection, read_real, view_samples
from warp_partdr.lab.evaluation.evaluate import Fitting, Method, all_parts, evaluate, one_thread
from warp_partdr.lab.evaluation.pairs import compare_pairs
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.lab.evaluation.real import MESH, NETWORK, real_methods
from warp_partdr.lab.synthetic.noise import LEVELS, noisy_keypoints
from warp_partdr.lab.synthetic.partbench_people import OTHER_FORMATS

_UNKNOWN_SIZE = (10**6, 10**6)  # (H, W) [px]: nothing lies beyond the border
_FIGURES = (("pa_mpjpe_mm", 1), ("mpjpe_mm", 1), ("stature_share", 100))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("views", nargs="?")
    parser.add_argument("--formats", action="store_true")
    parser.add_argument("--leave-out", action="append", default=[])
    parser.add_argument("--levels", nargs="+", default=["clean", "mild", "realistic", "hard", "clothed"])
    parser.add_argument("--people", nargs=2, type=int, default=(200, 235))
    parser.add_argument("--network", help="file of `partdr train`; default: the packaged one")
    given = parser.parse_args()
    if (given.views is None) != given.formats:
        parser.error("expected VIEWS or --formats")
    one_thread()
    alone = {name: real_methods(network=given.network)[name] for name in (NETWORK, MESH)}
    labelled = {f"{name}, labels": _with_labels(method) for name, method in alone.items()}
    pairs = [(MESH, NETWORK), (f"{MESH}, labels", f"{NETWORK}, labels")]

    print("| people | given | network: PA-MPJPE [mm] | MPJPE [mm] | stature [%] | mesh: PA-MPJPE | MPJPE | stature |")
    print("|---|---|---:|---:|---:|---:|---:|---:|")
    real: list[Sample] = []
    if given.views is not None:
        views = read_real(given.views)
        real = view_samples(views, ViewSelection("baseline", leave_out=tuple(given.leave_out)).of(views))
    compared: list[str] = []
    for name in given.levels:
        people = [make_sample(index, name) for index in range(given.people[0], given.people[1] + 1)]
        if given.formats:
            told = [sample for sample in people if sample.keypoints.format in OTHER_FORMATS]
            compared += _measure(f"{name}, told", told, alone, pairs)
            compared += _measure(f"{name}, not told", [_untold(sample) for sample in told], alone, pairs)
            continue
        compared += _measure(name, people, alone | labelled, pairs)
        if name in LEVELS:
            compared += _measure(f"real, {name}", [_spoil(sample, name) for sample in real], alone, pairs)
    print()
    print("\n".join(compared))


def _with_labels(method: Fitting) -> Method:
    """Method that sees part labels, too."""
    assert isinstance(method, Method)
    return replace(method, see=all_parts)


def _untold(sample: Sample) -> Sample:
    """Sample whose keypoints are taken for the body's own joints."""
    form = sample.keypoints.format
    return replace(sample, keypoints=replace(sample.keypoints, skeleton=replace(form, marks=form.landmarks)))


def _spoil(sample: Sample, name: str) -> Sample:
    """A view whose keypoints have a level's errors, as if none were hidden."""
    keypoints = sample.keypoints
    rng = np.random.default_rng(zlib.crc32(f"{name} {sample.name}".encode()))
    noisy = noisy_keypoints(
        keypoints.points,
        np.zeros(len(keypoints.points), dtype=bool),
        keypoints.format.landmarks,
        person_height(keypoints),
        keypoints.image_size or _UNKNOWN_SIZE,
        level=LEVELS[name],
        rng=rng,
    ).astype(np.float32)
    noisy[~keypoints.visible] = 0.0
    spoilt = replace(keypoints, points=noisy[:, :2], confidence=noisy[:, 2])
    return replace(sample, keypoints=spoilt)


def _measure(
    title: str, samples: Sequence[Sample], methods: Mapping[str, Fitting], pairs: Sequence[tuple[str, str]]
) -> list[str]:
    """Print a row for each input of some people, and return how the mesh compares with the network."""
    together = [replace(sample, source=title) for sample in samples]
    report = evaluate(together, methods)
    figures = report.pooled()[title]
    for mesh, network in pairs:
        if network in figures:
            given = "keypoints, labels" if network.endswith("labels") else "keypoints"
            cells = [_cell(figures[each], *figure) for each in (network, mesh) for figure in _FIGURES]
            print(f"| {title} | {given} | {' | '.join(cells)} |", flush=True)
    return [f"{title}: {sentence}" for _, sentence in compare_pairs(report, pairs)]


def _cell(row: dict[str, Any], name: str, factor: int) -> str:
    low, high = (factor * limit for limit in row["interval_95"][name])
    return f"{factor * row[name]:.0f} ({low:.0f}–{high:.0f})"


if __name__ == "__main__":
    main()
