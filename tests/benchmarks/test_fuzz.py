"""A few hundred cases of benchmarks/fuzz.py, and that it sees what is wrong."""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import HANG

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import fuzz

CASES = 250


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """As long as any test's, for kernels may compile within a case."""
    monkeypatch.setattr(fuzz, "PATIENCE", HANG)


def test_no_case_fails(device):
    outcomes = [fuzz.run_case(1, case, device) for case in range(CASES)]
    failed = [f"--seed 1 --only {case}: {each}" for case, each in enumerate(outcomes) if not each.passed]
    assert not failed, "\n".join(failed)
    kinds = [outcome.kind for outcome in outcomes]
    assert min(kinds.count(kind) for kind in ("right", "refused")) > CASES // 5


def broken(kind):
    """An entry point with a fault."""

    def call(chance):
        if kind == "bare error":
            return {}["missing"]
        if kind == "torch's error":
            return torch.ones(2) + torch.ones(3)
        if kind == "NumPy's error":
            return np.zeros(2).reshape(3)
        if kind == "hang":
            time.sleep(HANG)
        return {"numbers": [torch.tensor([1.0, math.nan])]}

    return call


@pytest.mark.parametrize("kind", ["bare error", "torch's error", "NumPy's error", "NaN", "hang"])
def test_faults_are_seen(monkeypatch, kind):
    monkeypatch.setattr(fuzz, "TURNS", ["broken"])
    if kind == "hang":
        monkeypatch.setattr(fuzz, "PATIENCE", 1)
    monkeypatch.setitem(fuzz.TARGETS, "broken", broken(kind))
    outcome = fuzz.run_case(0, 0, "cpu")
    assert not outcome.passed
    assert ("still running" in outcome.kind) == (kind == "hang")
    assert "Traceback" in outcome.trace


def test_a_case_is_told_by_its_number():
    """What is drawn, and so what it comes to."""
    for case in range(20):
        drawn = [fuzz.run_case(7, case, "cpu") for _ in range(2)]
        assert drawn[0] == drawn[1]
