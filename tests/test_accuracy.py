"""The accuracy benchmark counts what it says; what it measures is in docs/fitting.md."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

from accuracy import LABELS, LSP6, PARTS_TO_LSP6, TO_LSP6, Score, bootstrap, gain, read_example, silhouette, summarise

from warp_partdr.body.template import PART_NAMES
from warp_partdr.inputs import PartLabels


def _score(counts: np.ndarray, pa_mpjpe: float, supervision: str = "parts") -> Score:
    return Score("anny", "one", supervision, counts, counts, np.array([0.01, 0.03]), pa_mpjpe, 2 * pa_mpjpe, 64, 1.0)


def test_silhouette_keeps_what_is_ignored() -> None:
    parts = PartLabels(LABELS, np.array([[0, 1, 14], [255, 7, 0]], dtype=np.uint8))
    full = silhouette(parts)
    assert full.groups.tolist() == [[0, 1, 1], [255, 1, 0]]
    assert full.groups.dtype == np.uint8
    assert full.label_set.num_groups == 1


def test_rendered_parts_and_labels_are_grouped_alike() -> None:
    for part, name in enumerate(PART_NAMES, start=1):
        assert PARTS_TO_LSP6[part] == TO_LSP6[LABELS.part_groups[part]]
        if name != "neck":  # It goes where the labels have it, with the head.
            assert PARTS_TO_LSP6[part] == LSP6.part_groups[part]
    assert PARTS_TO_LSP6[0] == 0
    assert TO_LSP6[255] == 255


def test_pixels_are_pooled_and_joints_averaged() -> None:
    right, wrong = np.zeros((2, 7, 7), dtype=np.int64)
    np.fill_diagonal(right, 90)
    wrong[1, 0] = 10  # One part's pixels that the body does not cover, in a picture of nothing else.
    summary = summarise([_score(right, 40.0), _score(wrong, 60.0)])
    part, background = 2 * 90 / (2 * 90 + 10), 2 * 90 / (2 * 90 + 10)
    assert summary["part_f1"] == pytest.approx((5 + part + background) / 7, abs=1e-4)
    assert summary["foreground_f1"] == pytest.approx((background + 2 * 540 / (2 * 540 + 10)) / 2, abs=1e-4)
    assert summary["pa_mpjpe_mean_mm"] == 50
    assert summary["keypoint_distance"] == pytest.approx(0.02)
    assert "mpjpe_mm" not in summarise([replace(_score(right, 40.0), pa_mpjpe=np.nan)])


def test_bootstrap_covers_the_mean_as_often_as_it_says() -> None:
    values = np.random.default_rng(1).normal(50.0, 10.0, (100, 24))
    intervals = [bootstrap(row, np.mean, seed) for seed, row in enumerate(values)]
    assert 85 <= sum(low <= 50 <= high for low, high in intervals) <= 99
    assert 6 < np.mean([high - low for low, high in intervals]) < 9  # 2 x 1.96 x 10 / sqrt(24) = 8.0


def test_gain_compares_the_same_people() -> None:
    counts = np.eye(7, dtype=np.int64)
    errors = (50.0, 100.0, 150.0)
    scores = [_score(counts, error, "parts") for error in errors]
    scores += [_score(counts, error + 10, "full silhouette") for error in errors]
    assert "-10.0 mm (-10.0 to -10.0); lower for 3 of 3" in gain(scores, "parts", "full silhouette")


def test_example_is_read() -> None:
    (case,) = read_example()
    assert case.joints is not None
    assert case.joints.shape == (14, 3)
    assert case.target.shape == case.parts.groups.shape
