"""The accuracy benchmark reads what it says and compares the same people; what it measures is in docs/fitting.md."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from accuracy import SUPERVISIONS, gain, read_example, summarise

from warp_partdr.evaluation.scoring import Score


def _score(pa_mpjpe: float, supervision: str = "parts") -> Score:
    keypoints = np.array([0.01, 0.03])
    return Score("anny", "one", supervision, keypoints, 1.0, 64, mpjpe=2 * pa_mpjpe, pa_mpjpe=pa_mpjpe)


def test_gain_compares_the_same_people() -> None:
    errors = (50.0, 100.0, 150.0)
    scores = [_score(error, "parts") for error in errors]
    scores += [_score(error + 10, "full silhouette") for error in errors]
    assert "-10.0 mm (-10.0 to -10.0); lower for 3 of 3" in gain(scores, "parts", "full silhouette")


def test_the_median_is_among_the_figures() -> None:
    summary = summarise([_score(40.0), _score(50.0), _score(90.0)])
    assert summary["pa_mpjpe_mm"] == 60
    assert summary["pa_mpjpe_median_mm"] == 50
    assert summary["interval_95"]["pa_mpjpe_median_mm"] == [40, 90]
    assert "pa_mpjpe_median_mm" not in summarise([_score(np.nan)])


def test_example_is_read() -> None:
    (sample,) = read_example()
    assert sample.joints is not None
    assert sample.joints.shape == (14, 3)
    assert sample.parts is not None
    assert sample.target is sample.parts.groups


def test_every_supervision_sees_what_its_name_says() -> None:
    (sample,) = read_example()
    assert sample.parts is not None
    for name, method in SUPERVISIONS.items():
        seen = method.see(sample.parts)
        groups = 0 if seen is None else seen.label_set.num_groups
        assert groups == (0 if "keypoints" in name else 1 if "silhouette" in name else 14), name
