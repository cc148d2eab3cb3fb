"""Photos of hard situations, and how confidence is measured on them and learned."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from warp_partdr.lab.measurements.confidence import (
    ConfidenceRow,
    area_under_curve,
    confidence_rows,
    describe_confidence,
    save_rows,
)
from warp_partdr.lab.tables import FigureTable


def row(photo: int, *, right: bool, rng: np.random.Generator) -> ConfidenceRow:
    """Body whose measures tell whether it is right, with some noise."""
    sign = 1.0 if right else -1.0
    names = ("keypoints", "seen", "depths", "score", "mirror")
    ways = dict(zip(names, (-1, 1, -1, 1, -1), strict=True))
    measures = {name: sign * way + rng.normal() for name, way in ways.items()}
    limbs = {name: sign * way + rng.normal(size=5) for name, way in (("depths", -1), ("keypoints", 1))}
    error = 0.05 if right else 0.3
    return ConfidenceRow(photo, "plain", 0.9 if right else 0.1, measures, limbs, (error, 0.02), np.full(5, error))


def test_a_body_s_errors_are_those_of_the_joints_that_are_seen() -> None:
    rows = list(confidence_rows(41_000, "cpu"))
    assert len(rows) == 1
    (found,) = rows
    assert found.photo == 41_000
    assert 0 < max(found.errors) < 0.2
    assert found.stated > 0.5
    assert found.limb_errors.shape == (5,)
    assert {"keypoints", "seen", "depths", "score", "mirror"} == found.measures.keys()


def test_area_is_the_chance_that_a_right_body_has_the_higher_score() -> None:
    right = np.array([True, True, False, False])
    assert area_under_curve(np.array([0.9, 0.5, 0.5, 0.1]), right) == pytest.approx(3.5 / 4)
    assert np.isnan(area_under_curve(np.array([0.5, 0.6]), np.array([True, True])))


def test_tables_count_warnings_of_right_and_of_wrong_bodies() -> None:
    rng = np.random.default_rng(0)
    rows = [row(index, right=index % 4 > 0, rng=rng) for index in range(40)]
    table, curve, sentence = describe_confidence(rows)
    assert isinstance(table, FigureTable)
    assert isinstance(curve, FigureTable)
    assert sentence == "30 right, 10 wrong, of them 0 show nobody"


def test_a_model_is_learned_that_tells_right_from_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from scripts import learn_confidence
    from warp_partdr.solve.confidence.model import packaged_model, read_confidence_model

    rng = np.random.default_rng(1)
    save_rows(tmp_path / "rows.npz", [row(index, right=index % 3 > 0, rng=rng) for index in range(300)])
    monkeypatch.setattr(learn_confidence, "ASSET", tmp_path / "model.json")
    learn_confidence.learn(tmp_path / "rows.npz")
    model = read_confidence_model((tmp_path / "model.json").read_text())
    assert [each.measures[2:] for each in model.bodies] == list(learn_confidence.SETS)
    assert model.least == packaged_model().least
    signs = {
        name: np.sign(weight) for name, weight in zip(model.bodies[0].measures, model.bodies[0].weights, strict=True)
    }
    assert signs == {"keypoints": -1, "seen": 1, "depths": -1, "score": 1, "mirror": -1}
    assert "held out, AUC 0.9" in capsys.readouterr().out
    assert json.loads((tmp_path / "model.json").read_text())["limbs"].keys() == {"head", "arm", "leg"}
