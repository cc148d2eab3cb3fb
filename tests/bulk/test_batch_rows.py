"""Rows of a batch of fits: as of each fit alone, though no fit's own object is made for them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from scenes.files import EXAMPLE

from warp_partdr.bulk.rows import describe_bodies
from warp_partdr.fit import together
from warp_partdr.fit.options import FitOptions
from warp_partdr.fit.together import BatchFits, CutPerson, fit_together
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.observation import crop_evidence
from warp_partdr.network.checkpoint import packaged_network


@pytest.fixture
def batch(device: str) -> BatchFits:
    """Of the example and of someone whose keypoints are noise, by the network alone."""
    keypoints = read_keypoints(EXAMPLE / "keypoints.json")[0]
    places = np.random.default_rng(0).uniform(0, 400, keypoints.points.shape).astype(np.float32)
    people = []
    for each in (keypoints, replace(keypoints, points=places)):
        evidence = weigh_evidence(each)[0]
        people.append(CutPerson(evidence, *crop_evidence(evidence, device=device)))
    fits = fit_together(people, replace(FitOptions.at("fast"), stages=()), packaged_network(device))
    assert isinstance(fits, BatchFits)
    return replace(fits, energy={"proj": np.float32([1.5, 2.0]), "seg": np.float32([0.1, 0.2])})


def test_rows_of_a_batch_are_those_of_its_fits(batch: BatchFits, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = describe_bodies(list(batch))

    def made(**given: Any) -> None:
        raise AssertionError("a fit's own object was made")

    monkeypatch.setattr(together, "FitResult", made)
    for row, other in zip(describe_bodies(batch), expected, strict=True):
        assert row.keys() == other.keys()
        for name, value in row.items():
            np.testing.assert_array_equal(value, other[name], err_msg=name)
    assert [bool(row["warnings"]) for row in expected] == [False, True]
    assert expected[0]["energy"] == sum(batch.energy[name][0].item() for name in ("proj", "seg"))


def test_a_body_that_is_not_finite_is_an_error(batch: BatchFits) -> None:
    shift = batch.parameters.shift.clone()
    shift[1, 0] = torch.nan
    rows = describe_bodies(replace(batch, parameters=replace(batch.parameters, shift=shift)))
    assert "joints" in rows[0]
    assert "error" not in rows[0]
    assert rows[1] == {"error": "the body holds NaN or infinity; expected finite numbers"}
