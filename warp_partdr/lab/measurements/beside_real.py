"""PartBench's levels beside views of real people, fitted by the network and the mesh stage.

VIEWS is a folder or file as `partdr evaluate real` takes it; its rows "baseline" count. Their keypoints get the errors
of a level, too, as if none were hidden. No camera is given. Statures are shares of the true ones, also of children.
Intervals of 95 % are over people.

With `--formats`, which takes no views, only people count whose keypoints lie where another data set than COCO marks
them. Fits are told so, or take the keypoints for the body's own joints.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...inputs.keypoints import person_height
from ...inputs.sample import Sample
from ..evaluation.datasets import ViewSelection, read_real, view_samples
from ..evaluation.evaluate import Fitting, Method, all_parts, evaluate, one_thread
from ..evaluation.pairs import compare_pairs
from ..evaluation.partbench.samples import make_sample
from ..evaluation.real import MESH, NETWORK, real_methods
from ..options import Levels, Names, NetworkFile, People
from ..synthetic.noise import LEVELS, noisy_keypoints
from ..synthetic.partbench_people import OTHER_FORMATS
from ..tables import FigureTable, pooled_estimate

_UNKNOWN_SIZE = (10**6, 10**6)  # (H, W) [px]: nothing lies beyond the border
_FIGURES = (("PA-MPJPE [mm]", "pa_mpjpe_mm", 1), ("MPJPE [mm]", "mpjpe_mm", 1), ("stature [%]", "stature_share", 100))
_ALL_LEVELS = ("clean", "mild", "realistic", "hard", "clothed")


def measure_beside_real(
    views: Path | None = None,
    /,
    *,
    formats: bool = False,
    leave_out: Names = (),
    levels: Levels = _ALL_LEVELS,
    people: People = range(200, 236),
    network: NetworkFile = None,
) -> Iterator[FigureTable | str]:
    """Fit both kinds of people.

    Args:
        views: Folder or file of real views.
        formats: Compare fits that know the format of keypoints with fits that do not.
        leave_out: Data sets among the real views that don't count.
        levels: Levels to fit PartBench's people at.
        people: PartBench's people.
        network: Label network of the fits.

    Raises:
        InputError: If there are neither views nor ``formats``, or both.
    """
    if (views is None) != formats:
        raise InputError("views: expected VIEWS or --formats, one of them")
    one_thread()
    alone = {name: real_methods(network=network)[name] for name in (NETWORK, MESH)}
    labelled = {f"{name}, labels": _with_labels(method) for name, method in alone.items()}
    real: list[Sample] = []
    if views is not None:
        found = read_real(views)
        real = view_samples(found, ViewSelection("baseline", leave_out=leave_out).of(found))
    comparison = _Comparison()
    for name in levels:
        samples = [make_sample(index, name) for index in people]
        if formats:
            with_format = [sample for sample in samples if sample.keypoints.format in OTHER_FORMATS]
            comparison.measure(f"{name}, told", with_format, alone)
            comparison.measure(f"{name}, not told", [_untold(sample) for sample in with_format], alone)
            continue
        comparison.measure(name, samples, alone | labelled)
        if name in LEVELS:
            comparison.measure(f"real, {name}", [_spoil(sample, name) for sample in real], alone)
    yield comparison.table
    yield from comparison.differences


def _empty_table() -> FigureTable:
    headings = [f"{method}: {heading}" for method in ("network", "mesh") for heading, _, _ in _FIGURES]
    return FigureTable("PartBench beside real people", {"people": "", "given": ""} | dict.fromkeys(headings, ".0f"))


@dataclass
class _Comparison:
    """Rows of people at a level with each input, and how the mesh compares with the network there."""

    table: FigureTable = field(default_factory=_empty_table)
    differences: list[str] = field(default_factory=list)

    def measure(self, title: str, samples: Sequence[Sample], methods: Mapping[str, Fitting]) -> None:
        """Fit people by all methods."""
        pairs = [(MESH, NETWORK), (f"{MESH}, labels", f"{NETWORK}, labels")]
        report = evaluate([replace(sample, source=title) for sample in samples], methods)
        figures = report.pooled()[title]
        for mesh, network in pairs:
            if network in figures:
                given = "keypoints, labels" if network.endswith("labels") else "keypoints"
                cells = [
                    pooled_estimate(figures[method], name).scaled(factor)
                    for method in (network, mesh)
                    for _, name, factor in _FIGURES
                ]
                self.table.add(title, given, *cells)
        self.differences += [f"{title}: {sentence}" for _, sentence in compare_pairs(report, pairs)]


def _with_labels(method: Fitting) -> Method:
    """Method that sees part labels, too."""
    assert isinstance(method, Method)
    return replace(method, see=all_parts)


def _untold(sample: Sample) -> Sample:
    """Sample whose keypoints are taken for the body's own joints."""
    form = sample.keypoints.format
    return replace(sample, keypoints=replace(sample.keypoints, skeleton=replace(form, marks=form.landmarks)))


def _spoil(sample: Sample, name: str) -> Sample:
    """View whose keypoints have a level's errors, as if none were hidden."""
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
