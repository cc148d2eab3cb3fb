"""Methods compared with one another on the same people: differences of their errors, with intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ... import metrics
from ..tables import Estimate
from .evaluate import Report
from .scoring import Score, sum_clusters

_GAINS = (  # figure, field of ``Score``, factor, unit
    ("PA-MPJPE", "pa_mpjpe", 1, "mm"),
    ("MPJPE", "mpjpe", 1, "mm"),
    ("world MPJPE", "world_mpjpe", 1, "mm"),
    ("acceleration", "acceleration", 1, "mm/frame²"),
    ("feet slide", "sliding", 1, "mm/s"),
    ("depth order right", "order", 100, "%"),
    ("depth between people", "depth_between", 1, "mm"),
    ("stature", "stature", 1, "mm"),
)


def compare_pairs(report: Report, pairs: Sequence[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Differences between two methods on the same samples, with 95 % intervals over people.

    Args:
        report: Report that ``evaluate`` returned.
        pairs: Names of two methods each. The difference is the first minus the second.

    Yields:
        Source, and a sentence about a pair, for each pair that a source's samples were fitted by.
    """
    for source, scores in report.by_source().items():
        found = {(each.method, each.source, each.sample): each for each in scores}
        samples = sorted({(each.source, each.sample) for each in scores})
        for pair in pairs:
            keys = ([(method, *sample) for method in pair] for sample in samples)
            matched = [[found[key] for key in both] for both in keys if found.keys() >= set(both)]
            if matched:
                yield source, f"{pair[0]} minus {pair[1]}: {_compare(matched)}"


def _compare(pairs: list[list[Score]]) -> str:
    """Errors and part F1 of the first score of each pair minus those of the second."""
    clusters = [pair[0].cluster or str(row) for row, pair in enumerate(pairs)]
    parts = []
    for name, field, factor, unit in _GAINS:
        gains = factor * np.array([getattr(better, field) - getattr(worse, field) for better, worse in pairs])
        if np.isfinite(gains).all():
            sums = sum_clusters(np.stack([gains, np.ones(len(gains))], axis=1), clusters)
            text = f"{name} {gains.mean():+.1f}"
            if len(sums) > 1 or len(gains) == 1:
                interval = metrics.bootstrap_sum(sums, lambda sums: sums[..., 0] / sums[..., 1])
                text = f"{name} {Estimate(gains.mean(), *interval):+.1f}"
            parts.append(f"{text} {unit}")
    counts = np.array([[score.pixels.parts for score in pair if score.pixels is not None] for pair in pairs])
    if counts.ndim == 4:
        gain = lambda sums: metrics.part_f1(sums[..., 0, :, :]) - metrics.part_f1(sums[..., 1, :, :])  # noqa: E731
        interval = metrics.bootstrap_sum(sum_clusters(counts, clusters), gain)
        parts.append(f"part F1 {Estimate(float(gain(counts.sum(0))), *interval):+.4f}")
    return ", ".join(parts)
