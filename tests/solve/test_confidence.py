"""Confidence in bodies: measures, model, limbs that are guessed, and words."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from importlib import resources

import numpy as np
import pytest
import torch
from helpers.example import example_keypoints

from warp_partdr.body.template import PART_NAMES
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observations import Observations
from warp_partdr.networks.detection.person import FoundPerson
from warp_partdr.solve.confidence.judge import BodyConfidence, LimbConfidence, Sight, confidence_record, judge_fits
from warp_partdr.solve.confidence.limbs import LIMBS, guessed_parts
from warp_partdr.solve.confidence.measures import BodyMeasures, detection_measures, measure_bodies
from warp_partdr.solve.confidence.model import FORMAT, packaged_model, read_confidence_model
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.result import FitResult

NAMES = [limb.name for limb in LIMBS]


@cache
def example_fit() -> FitResult:
    """Quick fit of the example's keypoints."""
    return fit_body(example_keypoints(), options=FitOptions.at("fast"))


def measured(fit: FitResult) -> BodyMeasures:
    return measure_bodies(fit.parameters, Observations.of([fit.observation]), fit.uncertainty)


def moved(fit: FitResult, shift: float) -> FitResult:
    """The body aside of its keypoints by a share of the crop's half side."""
    parameters = replace(fit.parameters, shift=fit.parameters.shift + torch.tensor([[shift, 0.0]]))
    return replace(fit, parameters=parameters)


def with_confidence(fit: FitResult, names: Sequence[str], confidence: float) -> FitResult:
    """The fit as if the detector had seen these landmarks with such a confidence."""
    keypoints = fit.evidence.keypoints
    changed = keypoints.confidence.copy()
    changed[[keypoints.format.landmarks.index(name) for name in names]] = confidence
    evidence = replace(fit.evidence, keypoints=replace(keypoints, confidence=changed))
    rows = [fit.observation.landmarks.index(name) for name in names]
    weights = fit.observation.confidence.clone()
    weights[rows] = confidence
    return replace(fit, evidence=evidence, observation=replace(fit.observation, confidence=weights))


def test_distance_from_keypoints_is_a_share_of_the_crop() -> None:
    fit = example_fit()
    near, far = measured(fit).keypoints[0], measured(moved(fit, 0.5)).keypoints[0]
    assert near < 0.03
    assert far == pytest.approx(0.25, abs=0.03)


def test_joints_that_nobody_saw_count_little() -> None:
    fit = example_fit()
    wrists = ("left_wrist", "right_wrist")
    points = fit.observation.points.clone()
    points[[fit.observation.landmarks.index(name) for name in wrists]] += 1.0
    astray = replace(fit, observation=replace(fit.observation, points=points))
    unseen = with_confidence(astray, wrists, 1e-3)
    assert measured(astray).keypoints[0] > 5 * measured(fit).keypoints[0]
    assert measured(unseen).keypoints[0] == pytest.approx(measured(fit).keypoints[0], rel=0.3)
    assert measured(unseen).seen[0] == pytest.approx(measured(fit).seen[0] - 2 / 12, abs=0.02)
    assert fit.uncertainty is not None
    sure = fit.uncertainty.depths.clone()
    assert measured(fit).depths is not None
    loose = replace(fit, uncertainty=replace(fit.uncertainty, depths=sure * 3))
    assert measured(loose).depths == pytest.approx(3 * measured(fit).depths)


def test_bodies_side_by_side_are_judged_as_alone() -> None:
    fits = [example_fit(), moved(example_fit(), 0.4), replace(example_fit(), uncertainty=None)]
    together = judge_fits(fits)
    alone = [judge_fits([each])[0] for each in fits]
    for one, other in zip(together, alone, strict=True):
        assert one.probability == pytest.approx(other.probability, rel=1e-5)
        assert one.limbs.keys() == other.limbs.keys()
    assert judge_fits([]) == []


def test_people_with_fewer_measures_take_none_from_others() -> None:
    fit, measures = example_fit(), [{"score": 0.9}, {"score": 0.9, "mirror": -4.0}, {}]
    together = judge_fits([fit, fit, fit], measures)
    alone = [judge_fits([fit], [each])[0] for each in measures]
    assert [each.probability for each in together] == pytest.approx([each.probability for each in alone], rel=1e-5)
    assert len({each.probability for each in together}) == 3


def test_a_body_that_fits_is_right_and_one_that_does_not_is_warned_of() -> None:
    right, wrong = judge_fits(
        [example_fit(), with_confidence(example_fit(), example_fit().observation.landmarks, 0.01)]
    )
    assert right.probability > 0.6 > wrong.probability
    assert right.warnings == ()
    unsure = judge_fits([example_fit()], [{"score": 0.3, "mirror": np.log(0.2)}])[0]
    assert unsure.probability < packaged_model().least
    (warning,) = unsure.warnings
    assert warning.startswith(
        f"body: confidence {unsure.probability:.2f}; expected {packaged_model().least:.2f} or more"
    )
    assert "overlay.png" in warning


def test_limbs_that_no_keypoint_shows_are_guessed() -> None:
    fit = with_confidence(example_fit(), ("left_elbow", "left_wrist"), 0.05)
    confidence = judge_fits([fit])[0]
    assert confidence.guessed == ("left arm",)
    assert confidence.limbs["left arm"].sight == "hidden"
    assert confidence.limbs["left arm"].probability < judge_fits([example_fit()])[0].limbs["left arm"].probability
    assert confidence.describe_guessed() == "left arm hidden, guessed"
    assert judge_fits([with_confidence(example_fit(), ("left_elbow",), 0.05)])[0].guessed == ()


def test_limbs_beyond_the_border_are_outside() -> None:
    """The picture ends above the knees."""
    fit = with_confidence(example_fit(), ("left_knee", "left_ankle", "right_knee", "right_ankle"), 0.0)
    knees = fit.camera.project(torch.from_numpy(fit.landmarks(("left_knee", "right_knee")))[None].float())[0, :, 1]
    keypoints = fit.evidence.keypoints
    width = int(keypoints.points[:, 0].max()) + 50
    cut = replace(keypoints, image_size=(int(knees.min()) - 5, width))
    fit = replace(fit, evidence=replace(fit.evidence, keypoints=cut, picture=None))
    confidence = judge_fits([fit])[0]
    assert {name: limb.sight for name, limb in confidence.limbs.items() if limb.sight != "seen"} == {
        "left leg": "outside",
        "right leg": "outside",
    }
    assert confidence.describe_guessed() == "left leg and right leg outside the picture, guessed"


def test_parts_of_guessed_limbs_are_flagged() -> None:
    flags = guessed_parts(("left arm",))
    assert flags.shape == (21,)
    assert {PART_NAMES[row - 1] for row in np.flatnonzero(flags)} == {"left_upper_arm", "left_forearm", "left_hand"}
    assert not guessed_parts(()).any()


def test_records_are_json() -> None:
    sights: tuple[Sight, ...] = ("seen", "hidden", "seen", "outside", "seen")
    limbs = {name: LimbConfidence(0.5, sight) for name, sight in zip(NAMES, sights, strict=True)}
    record = json.loads(json.dumps(confidence_record(BodyConfidence(0.87654, limbs))))
    assert record["confidence"] == 0.877
    assert record["guessed"] == ["left arm", "right arm"]
    assert record["limbs"]["right_arm"] == {"confidence": 0.5, "sight": "outside"}


def test_the_model_takes_the_measures_that_are_there() -> None:
    model = packaged_model()
    measures = BodyMeasures(
        np.array([0.9]), np.array([0.05]), np.array([0.01]), np.full((1, 5), 0.06), np.full((1, 5), 0.9)
    )
    some: list[dict[str, np.ndarray]] = [
        {},
        {"score": np.array([0.9])},
        {"score": np.array([0.9]), "mirror": np.array([-4.0])},
    ]
    for own in (measures, replace(measures, depths=None, limb_depths=None)):
        found = [float(model.judge(own, further)[0][0]) for further in some]
        assert len(set(found)) == len(found)
        assert min(found) > 0.5
    worse = replace(measures, depths=np.array([0.3]))
    assert model.judge(worse, {})[0] < model.judge(measures, {})[0]
    low, high = (model.judge(measures, {"score": np.array([score])})[0] for score in (0.3, 0.9))
    assert low < high


def test_only_its_own_format_is_read() -> None:
    text = resources.files("warp_partdr").joinpath("assets", "body_confidence.json").read_text("utf-8")
    assert read_confidence_model(text).least == packaged_model().least
    with pytest.raises(ValueError, match="format: 'other'; expected"):
        read_confidence_model(text.replace(FORMAT, "other"))


def test_a_detector_s_measures_are_those_of_the_person(person_found: FoundPerson) -> None:
    assert detection_measures(person_found) == {"score": person_found.score}
    both = detection_measures(replace(person_found, mirror_distance=0.02))
    assert both == {"score": person_found.score, "mirror": pytest.approx(np.log(0.02))}


@pytest.fixture
def person_found() -> FoundPerson:
    from warp_partdr.networks.detection.crops import TurnedCrops

    keypoints = Keypoints2D("blazepose33", np.zeros((33, 2), np.float32), np.ones(33, np.float32))
    crop = TurnedCrops(np.zeros((1, 2)), np.ones(1), np.zeros(1), np.zeros(1, int))
    return FoundPerson(keypoints, 0.8, (0.0, 0.0, 1.0, 1.0), crop, torch.zeros(4, 4), crop)


def test_a_search_s_body_is_judged_without_a_network() -> None:
    fit = replace(example_fit(), uncertainty=None, start="search")
    confidence = judge_fits([fit])[0]
    assert 0 < confidence.probability < 1
