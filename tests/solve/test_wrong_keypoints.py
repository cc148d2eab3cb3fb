"""Keypoints far from the body that the label network sees count less."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from warp_partdr import FitOptions, fit_body
from warp_partdr.inputs.cut_people import CutPeople, CutPerson
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.keypoints import Keypoints2D, person_height
from warp_partdr.inputs.observation import REFERENCE_SIZE, crop_evidence, observe, usual_lens
from warp_partdr.inputs.observations import Observations
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.networks.regression.checkpoint import packaged_network
from warp_partdr.networks.regression.predict import ask_network
from warp_partdr.networks.regression.predicted import landmarks_in_crop
from warp_partdr.solve.ellipsoids.fitting import fit_people
from warp_partdr.solve.ellipsoids.wrong_keypoints import GROSS_ERROR, doubt_keypoints

FAST = replace(FitOptions.at("fast"), search=())


def with_wrong_wrist(keypoints: Keypoints2D) -> Keypoints2D:
    """The left wrist lies a third of the person's height beside its place, and is believed."""
    points = keypoints.points.copy()
    points[keypoints.format.landmarks.index("left_wrist")] += np.float32([person_height(keypoints) / 3, 0])
    return replace(keypoints, points=points, confidence=np.ones(len(points), np.float32))


def test_the_factor_is_one_at_the_body_and_a_quarter_at_a_gross_error(device):
    sample = make_sample(3, "mild")
    seen = Observations.of([observe(sample.keypoints, None, device=device)[0]])
    predicted = ask_network(seen, packaged_network(device))
    there = landmarks_in_crop(predicted, seen.marks, seen.lens)
    off = torch.linspace(0, 2 * GROSS_ERROR, there.shape[1], device=device) / (REFERENCE_SIZE / 2)
    placed = replace(seen, points=there + torch.stack([off, torch.zeros_like(off)], dim=1))
    (factors,) = doubt_keypoints(placed, predicted).confidence / placed.confidence
    assert float(factors[0]) == pytest.approx(1.0)
    assert (factors.diff() < 0).all()
    one = replace(seen, points=there + torch.tensor([0.0, GROSS_ERROR / (REFERENCE_SIZE / 2)], device=device))
    quarter = doubt_keypoints(one, predicted).confidence / one.confidence
    torch.testing.assert_close(quarter, torch.full_like(quarter, 0.25))


def test_people_side_by_side_are_doubted_as_each_alone(device):
    samples = [make_sample(3, "hard"), make_sample(4, "hard")]
    form = samples[0].keypoints.skeleton
    evidence = [weigh_evidence(replace(each.keypoints, skeleton=form), None)[0] for each in samples]
    cut = [CutPerson(each, *crop_evidence(each, device=device, camera=usual_lens(each))) for each in evidence]
    stacked = CutPeople.of(cut).observations
    predicted = ask_network(stacked, packaged_network(device))
    together = doubt_keypoints(stacked, predicted)
    for row, person in enumerate(cut):
        alone = doubt_keypoints(Observations.of([person.observation]), predicted.select(slice(row, row + 1)))
        torch.testing.assert_close(together[row].confidence, alone[0].confidence)


@pytest.mark.parametrize("alone", [True, False])
def test_a_wrong_wrist_does_not_pull_the_arm_to_it(alone):
    """The fit's wrist stays nearer to the true place than to the wrong keypoint, with all others as they are."""
    sample = make_sample(3, "clean")
    wrong = with_wrong_wrist(sample.keypoints)
    if alone:
        found = fit_body(wrong, options=FAST)
    else:
        evidence = weigh_evidence(wrong, None)[0]
        person = CutPerson(evidence, *crop_evidence(evidence, camera=usual_lens(evidence)))
        found = fit_people([person], FAST, packaged_network("cpu"))[0]
    row = wrong.format.landmarks.index("left_wrist")
    wrist = found.camera.project(torch.from_numpy(found.landmarks(["left_wrist"]))[None])[0, 0, :2].numpy()
    to_truth, to_wrong = (np.linalg.norm(wrist - given.points[row]) for given in (sample.keypoints, wrong))
    assert to_truth < 0.7 * to_wrong


def test_a_body_that_follows_few_keypoints_is_still_judged_by_all():
    """Doubt of wrong keypoints does not silence the warning about the body."""
    sample = make_sample(3, "clean")
    points = np.random.default_rng(0).uniform(0, 400, sample.keypoints.points.shape).astype(np.float32)
    wild = replace(sample.keypoints, points=points)
    assert any("the body ends" in warning for warning in fit_body(wild, options=FAST).warnings)


def test_a_body_that_is_far_from_doubted_keypoints_alone_starts_no_search():
    """The arms' sides are swapped. A search would follow them; the body's distance from them is told all the same."""
    sample = make_sample(222, "realistic")
    found = fit_body(sample.keypoints, options=FitOptions.at("fast"))
    assert found.start == "network"
    assert found.hypotheses == 1
    assert any("the body ends" in warning for warning in found.warnings)
