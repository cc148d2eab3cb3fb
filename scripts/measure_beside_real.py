"""Measure PartBench's levels beside views of real people, and print the rows of docs/evaluation.md.

    python scripts/measure_beside_real.py VIEWS [--leave-out SET] [--levels clean realistic ...] [--people FIRST LAST]

VIEWS are a folder or file of `partdr evaluate real`; their rows "baseline" count. Levels that spoil keypoints spoil those
of the views likewise, as if none were hidden. Statures are shares of the true ones, children's, too. Intervals are of
95 %, over people.
"""

from __future__ import annotations

import argparse
import zlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from warp_partdr.evaluation.datasets import ViewSelection, read_real, view_samples
from warp_partdr.evaluation.evaluate import Method, all_parts, evaluate, one_thread
from warp_partdr.evaluation.pairs import compare_pairs
from warp_partdr.evaluation.partbench.samples import make_sample, source_name
from warp_partdr.evaluation.real import MESH, NETWORK, real_methods
from warp_partdr.inputs.keypoints import person_height
from warp_partdr.inputs.sample import Sample
from warp_partdr.synthetic.noise import LEVELS, Level, noisy_keypoints

_FIGURES = (("pa_mpjpe_mm", 1), ("mpjpe_mm", 1), ("stature_share", 100))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("views")
    parser.add_argument("--leave-out", action="append", default=[])
    parser.add_argument("--levels", nargs="+", default=["clean", "mild", "realistic", "hard", "clothed"])
    parser.add_argument("--people", nargs=2, type=int, default=(200, 235))
    parser.add_argument("--network", help="file of `partdr train`; default: the packaged one")
    given = parser.parse_args()
    one_thread()
    alone = {name: real_methods(network=given.network)[name] for name in (NETWORK, MESH)}
    labelled = {f"{name}, labels": _with_labels(method) for name, method in alone.items()}
    pair = (MESH, NETWORK)
    pairs = [pair, tuple(f"{name}, labels" for name in pair)]

    print("| people | given | network: PA-MPJPE [mm] | MPJPE [mm] | stature [%] | mesh: PA-MPJPE | MPJPE | stature |")
    print("|---|---|---:|---:|---:|---:|---:|---:|")
    views = read_real(given.views)
    rows = ViewSelection("baseline", leave_out=tuple(given.leave_out)).of(views)
    real = view_samples(views, rows)
    told: list[str] = []
    for name in given.levels:
        people = [make_sample(index, name) for index in range(given.people[0], given.people[1] + 1)]
        told += _measure(name, people, alone | labelled, pairs)
        if name in LEVELS:
            told += _measure(f"real, {name}", [_spoil(sample, name) for sample in real], alone, pairs)
    print()
    print("\n".join(told))


def _with_labels(method: Any) -> Method:
    """The same with part labels."""
    assert isinstance(method, Method)
    return replace(method, see=all_parts)


def _spoil(sample: Sample, name: str) -> Sample:
    """A view with keypoints as a detector of this level gives them, none of whom is hidden."""
    level: Level = LEVELS[name]
    keypoints = sample.keypoints
    rng = np.random.default_rng(zlib.crc32(f"{name} {sample.name}".encode()))
    noisy = noisy_keypoints(
        keypoints.points,
        np.zeros(len(keypoints.points), dtype=bool),
        keypoints.format.landmarks,
        person_height(keypoints),
        keypoints.image_size or (10**6, 10**6),
        level=level,
        rng=rng,
    ).astype(np.float32)
    noisy[~keypoints.visible] = 0.0
    spoilt = replace(keypoints, points=noisy[:, :2], confidence=noisy[:, 2])
    return replace(sample, keypoints=spoilt)


def _measure(
    title: str, samples: Sequence[Sample], methods: dict[str, Any], pairs: Sequence[tuple[str, str]]
) -> list[str]:
    """Print a row for each input of some people, and return how the mesh compares with the network."""
    together = [replace(sample, source=title) for sample in samples]
    report = evaluate(together, methods)
    figures = report.pooled()[title]
    for _, (mesh, network) in enumerate(pairs):
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
