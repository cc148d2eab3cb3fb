"""A few hundred cases of benchmarks/fuzz.py, and that it sees what is wrong."""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import HANG

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import fuzz

CASES = 12  # of each entry point


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """It is as long as any test's, because kernels may compile within a case."""
    monkeypatch.setattr(fuzz, "PATIENCE", HANG)


def test_no_case_fails(device):
    outcomes = {name: fuzz.fuzz(name, CASES, 1, device) for name in fuzz.TARGETS}
    failed = [f"{name}: {outcome.trace}" for name, outcome in outcomes.items() if outcome.trace]
    assert not failed, "\n".join(failed)
    counts = sum((outcome.counts for outcome in outcomes.values()), Counter())
    assert min(counts["right"], counts["refused"]) > counts.total() // 5 > 40


FAULTS = {
    "bare error": lambda case: {}["missing"],
    "torch's error": lambda case: torch.ones(2) + torch.ones(3),
    "NumPy's error": lambda case: np.zeros(2).reshape(3),
    "NaN": lambda case: {"numbers": [torch.tensor([1.0, math.nan])]},
    "hang": lambda case: time.sleep(HANG),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_and_hangs_are_found(monkeypatch, fault):
    monkeypatch.setitem(fuzz.TARGETS, "broken", FAULTS[fault])
    if fault == "hang":
        monkeypatch.setattr(fuzz, "PATIENCE", 0.05)
    outcome = fuzz.fuzz("broken", 3, 0, "cpu")
    assert not outcome.counts
    assert "Traceback" in outcome.trace
    assert ("still running" in outcome.trace) == (fault == "hang")


def test_a_case_is_drawn_again_from_its_seed(monkeypatch):
    drawn = []

    def note(case):
        drawn.append((case.maybe(torch.ones(2, 3)), case.number(1.0), case.json({"a": [1, 2]}), case.tensor(4)))

    monkeypatch.setitem(fuzz.TARGETS, "noted", note)
    for _ in range(2):
        fuzz.fuzz("noted", 20, 7, "cpu")
    half = len(drawn) // 2
    assert repr(drawn[:half]) == repr(drawn[half:])
    assert len({repr(each) for each in drawn}) > 10
