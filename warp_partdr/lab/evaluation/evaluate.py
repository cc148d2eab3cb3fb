"""Methods side by side on people of known truth.

A ``Method`` is what a fit sees and how it goes; a ``Sample`` (``datasets``) is a person and the truth. ``evaluate``
fits every sample by every method, and its ``Report`` pools the scores (``scoring``) of each source.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import starmap
from typing import Any, Protocol

import numpy as np
import torch
import warp as wp
from rich.table import Table
from rich.text import Text

from ...body.labels import BACKGROUND, IGNORE, label_set
from ...errors import InputError
from ...inputs.part_labels import PartLabels
from ...inputs.sample import Sample
from ...interop.devices import without_driver_warning
from ...kernels.launch import set_num_threads
from ...solve.ellipsoids.fitting import fit_body
from ...solve.ellipsoids.options import FitOptions
from ...solve.ellipsoids.stages import Progress
from .scoring import Score, score_fit, summarise


def all_parts(parts: PartLabels) -> PartLabels:
    """The labels as they are."""
    return parts


def silhouette(parts: PartLabels) -> PartLabels:
    """All parts as one; what is to be ignored stays so."""
    person = (parts.groups != BACKGROUND) & (parts.groups != IGNORE)
    return PartLabels(label_set("full1"), np.where(person, 1, parts.groups).astype(np.uint8))


def no_labels(parts: PartLabels) -> None:
    """Keypoints alone."""


class Evaluated(Protocol):
    """Person or scene of known truth, such as a ``Sample``."""

    @property
    def source(self) -> str:
        """Group whose figures are pooled."""

    @property
    def name(self) -> str:
        """Name within the source."""


class Fitting(Protocol):
    """One way to fit, such as a ``Method``."""

    def serves(self, sample: Any) -> bool:
        """True for what it fits."""

    def fit_sample(self, sample: Any, device: str) -> Any:
        """Fit a sample."""

    def score(self, sample: Any, name: str, result: Any, seconds: float) -> Score:
        """Compare the result with the truth."""


@dataclass(frozen=True)
class Method:
    """One way to fit. Its functions are called in other processes, so they must be those of a module.

    ``fit`` is called as ``fit_body`` is, with keypoints, labels, others, options, device and, if ``camera`` says so, a
    sample's camera; it returns a ``FitResult``, or what has its ``camera``, ``landmarks`` and ``draw``.

    Examples:
        >>> from warp_partdr import FitOptions
        >>> from warp_partdr.benchmark import Method, evaluate, make_sample
        >>> sample = make_sample(0, "clean")
        >>> report = evaluate([sample], {"fast": Method(options=FitOptions.at("fast"))})
        >>> bool(report.pooled()[sample.source]["fast"]["pa_mpjpe_mm"] < 100)
        True
    """

    see: Callable[[PartLabels], PartLabels | None] = all_parts  # what of a sample's labels the fit gets to see
    options: FitOptions = field(default_factory=FitOptions)
    fit: Callable[..., Any] = fit_body
    camera: bool = False  # a sample's is given to the fit, where it is known
    stature: bool = False  # likewise
    vertices: Callable[[Any], np.ndarray] | None = None  # of a result's mesh, as ``Sample.vertices``, camera frame [m]

    def fit_sample(self, sample: Sample, device: str) -> Any:
        """Fit one person; returns what ``fit`` does."""
        parts = None if sample.parts is None else self.see(sample.parts)
        given = {"camera": sample.camera} if self.camera else {}
        options = replace(self.options, stature=sample.stature) if self.stature else self.options
        return self.fit(sample.keypoints, parts, others=sample.others, options=options, device=device, **given)

    def serves(self, sample: object) -> bool:
        """True for single people."""
        return isinstance(sample, Sample)

    def score(self, sample: Sample, name: str, result: Any, seconds: float) -> Score:
        """Compare the result with what is known of the sample."""
        vertices = None if self.vertices is None or sample.vertices is None else self.vertices(result)
        return score_fit(sample, name, result, seconds, vertices)


# Ellipsoids are compared by how well they follow labels, too, which the outline stage is for.
_OUTLINE = FitOptions().with_outline()
METHODS: dict[str, Method] = {
    "keypoints only": Method(no_labels),
    "full silhouette": Method(silhouette, _OUTLINE),
    "parts": Method(options=_OUTLINE),
}
"""Methods by name: keypoints alone, with the person's silhouette, or with part labels, whose outlines are followed.

Examples:
    >>> from warp_partdr.benchmark import METHODS
    >>> list(METHODS)
    ['keypoints only', 'full silhouette', 'parts']
    >>> METHODS["parts"].options.stages[-1].name
    'outline'
"""


ALL = "all"  # name of all sources together


@dataclass(frozen=True)
class Failure:
    """A sample that could not be fitted, and why."""

    source: str
    sample: str
    method: str
    reason: str


@dataclass(frozen=True)
class Report:
    """All scores, in the order of samples and, for each, of methods; and what could not be fitted.

    Attributes:
        scores: Scores of each sample and method.
        failures: Samples that a method could not fit.
        clusters: Name of the scores' clusters, for tables.
        together: True also pools all sources as the source ``ALL``, if there are several.
    """

    scores: tuple[Score, ...]
    failures: tuple[Failure, ...] = ()
    clusters: str = "people"
    together: bool = False

    def by_source(self) -> dict[str, list[Score]]:
        """Scores of each source."""
        groups: dict[str, list[Score]] = {}
        for each in self.scores:
            groups.setdefault(each.source, []).append(each)
        if self.together and len(groups) > 1:
            groups[ALL] = list(self.scores)
        return groups

    def pooled(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Figures (``summarise``) by source and method."""
        return {
            source: {
                method: summarise([each for each in scores if each.method == method])
                for method in dict.fromkeys(each.method for each in scores)
            }
            for source, scores in self.by_source().items()
        }

    def to_json(self) -> dict[str, Any]:
        """Pooled figures, every fit's own, and the failures."""
        fits = [
            {"source": each.source, "sample": each.sample, "method": each.method, **summarise([each])}
            for each in self.scores
        ]
        return {"pooled": self.pooled(), "fits": fits, "failures": [vars(failure) for failure in self.failures]}


def evaluate(
    samples: Sequence[Evaluated],
    methods: Mapping[str, Fitting] = METHODS,
    *,
    jobs: int = 1,
    device: str = "cpu",
    progress: Progress | None = None,
) -> Report:
    """Fit every sample by every method that serves it and score the results.

    A method's first fit in a process is done twice, so that no time counted has the compiling of kernels in it.

    Args:
        samples: Samples to fit.
        methods: Methods by name.
        jobs: Number of fits at a time, in processes of their own with one thread each. They make one another slower.
            With 1, fits stay in this process.
        device: Device, "cpu" or a CUDA device.
        progress: Function that is called with ("fits", done, total).

    Raises:
        InputError: If nothing could be fitted: why the first could not, or that no method serves.
        ValueError: If ``jobs`` is less than 1.

    Examples:
        >>> from warp_partdr.benchmark import METHODS, evaluate, make_sample
        >>> sample = make_sample(0, "clean")
        >>> report = evaluate([sample], {"keypoints": METHODS["keypoints only"]})
        >>> bool(report.pooled()[sample.source]["keypoints"]["pa_mpjpe_mm"] < 100)
        True
    """
    if jobs < 1:
        raise ValueError(f"jobs: {jobs}; expected 1 or more")
    tasks = [
        (sample, name, method, device)
        for sample in samples
        for name, method in methods.items()
        if method.serves(sample)
    ]
    if samples and not tasks:
        raise InputError(f"methods: {', '.join(methods)}; expected one that fits {samples[0].source}")

    def counted(finished: Iterable[Any]) -> Iterator[Any]:
        for done, each in enumerate(finished, start=1):
            yield each
            if progress is not None:
                progress("fits", done, len(tasks))

    if jobs == 1:
        outcomes = list(counted(starmap(_run, tasks)))
    else:
        spawn = multiprocessing.get_context("spawn")  # a fork would inherit Warp's and torch's threads half alive
        with ProcessPoolExecutor(jobs, mp_context=spawn, initializer=one_thread) as pool:
            outcomes = list(counted(pool.map(_run, *zip(*tasks, strict=True))))
    scores = tuple(outcome for outcome in outcomes if isinstance(outcome, Score))
    failures = tuple(outcome for outcome in outcomes if isinstance(outcome, Failure))
    if failures and not scores:
        first = failures[0]
        raise InputError(f"{first.source}: {first.sample}: {first.reason}")
    return Report(scores, failures)


def one_thread() -> None:
    """Let this process compute on one core and keep Warp's notes to itself."""
    wp.config.log_level = wp.LOG_WARNING
    with without_driver_warning():
        wp.init()
    torch.set_num_threads(1)
    set_num_threads(1)


_warm: set[tuple[str, str]] = set()  # (method, device) that this process has fitted by


def _run(sample: Evaluated, name: str, method: Fitting, device: str) -> Score | Failure:
    try:
        if (name, device) not in _warm:
            method.fit_sample(sample, device)
            _warm.add((name, device))
        started = time.perf_counter()
        result = method.fit_sample(sample, device)
        seconds = time.perf_counter() - started
    except InputError as error:
        return Failure(sample.source, sample.name, name, str(error))
    return method.score(sample, name, result, seconds)


_COLUMNS = {  # figure: its heading, a factor, and digits
    "foreground_accuracy": ("FB\naccuracy", 1, 3),
    "foreground_f1": ("FB\nF1", 1, 3),
    "part_accuracy": ("part\naccuracy", 1, 3),
    "part_f1": ("part\nF1", 1, 3),
    "keypoint_distance": ("keypoints off\n[% of height]", 100, 2),
    "mpjpe_mm": ("MPJPE\n[mm]", 1, 1),
    "pa_mpjpe_mm": ("PA-MPJPE\n[mm]", 1, 1),
    "pve_mm": ("PVE\n[mm]", 1, 1),
    "size_share": ("bones\n[% of true]", 100, 1),
    "stature_share": ("stature\n[% of true]", 100, 1),
    "world_mpjpe_mm": ("world\nMPJPE [mm]", 1, 1),
    "depth_between_mm": ("depth between\noff [mm]", 1, 0),
    "stature_off_mm": ("stature\noff [mm]", 1, 0),
    "acceleration_mm": ("acceleration\noff [mm/frame²]", 1, 1),
    "sliding_mm_s": ("feet slide\n[mm/s]", 1, 0),
    "order_right": ("depth\norder [%]", 100, 0),
    "depth_within_spread": ("depth in\n68 % [%]", 100, 0),
    "depth_within_two_spreads": ("in twice\nthat [%]", 100, 0),
    "shared_volume_cm3": ("shared\n[cm³]", 1, 0),
    "seconds": ("time\n[s]", 1, 2),
}


def tables(report: Report) -> Iterator[Table]:
    """One table a source: a row a method, with 95 % intervals below the figures."""
    for source, rows in report.pooled().items():
        people, views = (max(row[name] for row in rows.values()) for name in ("people", "views"))
        what = ("scene", "scenes") if any("world_mpjpe_mm" in row for row in rows.values()) else ("person", "people")
        count = f"{people} {what[people != 1]}"
        if views != people:
            count = f"{views} views, intervals over {people} {report.clusters}" if people > 1 else f"{views} views"
        title = Text(f"{source}: {count}", style="bold")
        table = Table(title=title, title_justify="left")
        table.add_column("fitted to", no_wrap=True)
        shown = [name for name in _COLUMNS if any(name in row for row in rows.values())]
        for name in shown:
            table.add_column(Text(_COLUMNS[name][0]), justify="right", no_wrap=True)
        for method, row in rows.items():
            table.add_row(Text(method), *(_cell(row, name) for name in shown))
        yield table


def _cell(row: dict[str, Any], name: str) -> str:
    if name not in row:
        return "–"
    _, factor, digits = _COLUMNS[name]
    text = f"{factor * row[name]:.{digits}f}"
    if name in row.get("interval_95", {}):
        low, high = row["interval_95"][name]
        text += f"\n{factor * low:.{digits}f}–{factor * high:.{digits}f}"
    return text
