"""PeopleRows of a batch of fits: as of each fit alone, though no fit's own object is made for them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from helpers.example import example_keypoints

from warp_partdr.bulk.rows import PeopleRows, RowPart, columns, describe_bodies, people_table
from warp_partdr.inputs.cut_people import CutPeople, CutPerson
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.observation import crop_evidence
from warp_partdr.networks.regression.checkpoint import packaged_network
from warp_partdr.solve.ellipsoids import batch_fits
from warp_partdr.solve.ellipsoids.batch_fits import BatchFits
from warp_partdr.solve.ellipsoids.fitting import fit_people
from warp_partdr.solve.ellipsoids.options import FitOptions


@pytest.fixture
def batch(device: str) -> BatchFits:
    """The network alone predicts the example and a person whose keypoints are noise."""
    keypoints = example_keypoints()
    places = np.random.default_rng(0).uniform(0, 400, keypoints.points.shape).astype(np.float32)
    people = []
    for each in (keypoints, replace(keypoints, points=places)):
        evidence = weigh_evidence(each)[0]
        people.append(CutPerson(evidence, *crop_evidence(evidence, device=device)))
    fits = fit_people(people, replace(FitOptions.at("fast"), stages=(), search=()), packaged_network(device))
    assert isinstance(fits, BatchFits)
    return replace(fits, energy={"proj": np.float32([1.5, 2.0]), "seg": np.float32([0.1, 0.2])})


def rows_of(fits: Any) -> list[dict[str, Any]]:
    """PeopleRows as a data set's readers find them."""
    rows = PeopleRows(len(fits), describe_bodies(fits))
    return people_table(rows, columns("coco17"), {}).to_pylist()


def test_rows_of_a_batch_are_those_of_its_fits(batch: BatchFits, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = rows_of(list(batch))

    def made(**given: Any) -> None:
        raise AssertionError("a fit's own object was made")

    monkeypatch.setattr(batch_fits, "FitResult", made)
    assert rows_of(batch) == expected
    assert all(row["joints"] for row in expected)
    assert [bool(row["warnings"]) for row in expected] == [False, True]
    assert expected[0]["energy"] == np.float32(sum(batch.energy[name][0].item() for name in ("proj", "seg")))


def test_rows_have_the_picture_s_pixels_and_shares_of_the_height(batch: BatchFits) -> None:
    for fit, row in zip(list(batch), rows_of(batch), strict=True):
        seen = fit.camera.project(fit.posed.joints)[0, :, :2].cpu().numpy()
        np.testing.assert_allclose(np.reshape(row["joints_2d"], (-1, 2)), seen, atol=0.02)
    first, _ = rows_of(batch)
    assert 0.001 < first["keypoint_error"] < 0.1  # of the person's height


def test_people_stacked_before_are_fitted_alike(batch: BatchFits, device: str) -> None:
    """Joined of parts, on another device before; and one by one they are who was given."""
    people = batch.people
    there = CutPeople.joined([people[:1], people[1:]]).to(device)
    again = fit_people(there, replace(FitOptions.at("fast"), stages=(), search=()), packaged_network(device))
    assert isinstance(again, BatchFits)
    assert rows_of(replace(again, energy=batch.energy)) == rows_of(batch)
    alone = fit_people(list(people), replace(FitOptions.at("fast"), stages=(), search=()), packaged_network(device))
    assert rows_of(replace(alone, energy=batch.energy)) == rows_of(batch)


def test_a_body_that_is_not_finite_is_an_error(batch: BatchFits) -> None:
    shift = batch.parameters.shift.clone()
    shift[0, 0] = torch.nan
    first, other = rows_of(replace(batch, parameters=replace(batch.parameters, shift=shift)))
    assert {name for name, value in first.items() if value is not None} == {"error"}
    assert first["error"] == "the body holds NaN or infinity; expected finite numbers"
    assert other == rows_of(batch)[1]


def test_columns_are_those_of_rows_made_one_by_one() -> None:
    """A missing value is null, also where parts come later; the last one holds."""
    rows = PeopleRows()
    assert rows.extend(PeopleRows.of([{"picture": "a", "error": "torn"}])).tolist() == [0]
    numbers = rows.extend(PeopleRows.of([{"picture": name, "annotation": None, "warnings": []} for name in "bcd"]))
    lengths = np.arange(24, dtype=np.float32).reshape(2, 12)
    bodies = RowPart(np.array([0, 1]), {"lengths": lengths, "energy": [None, 2.0], "warnings": [["far"], []]})
    rows.parts.append(bodies.at(numbers[[2, 0]]))
    found = people_table(rows, columns("coco17"), {}).to_pylist()
    assert [row["picture"] for row in found] == ["a", "b", "c", "d"]
    assert [row["error"] for row in found] == ["torn", None, None, None]
    assert [row["warnings"] for row in found] == [None, [], [], ["far"]]
    assert [row["energy"] for row in found] == [None, 2.0, None, None]
    assert [row["lengths"] for row in found] == [None, lengths[1].tolist(), None, lengths[0].tolist()]
    assert {row["annotation"] for row in found} == {None}


def test_rows_of_bodies_that_are_likely_wrong_warn_of_it(batch: BatchFits) -> None:
    rows = rows_of(batch)
    told = [[text for text in row["warnings"] if text.startswith("body: confidence")] for row in rows]
    assert [len(each) for each in told] == [0, 1]
    assert rows[0]["confidence"] >= 0.4 > rows[1]["confidence"]
    end = "; expected 0.40 or more; compare the body with the picture"
    assert told[1] == [f"body: confidence {rows[1]['confidence']:.2f}{end}"]
