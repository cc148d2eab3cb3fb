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
from helpers.example import example_keypoints, example_photo
from helpers.quick import QUICK_SCENE

from warp_partdr.body.skeletons import BODY_LANDMARKS
from warp_partdr.body.template import JOINT_NAMES, PART_NAMES
from warp_partdr.cameras import Perspective
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observations import Observations
from warp_partdr.inputs.scene import Scene, SceneObservation, View
from warp_partdr.networks.detection.person import FoundPerson
from warp_partdr.results.motion_confidence import motion_confidence_record
from warp_partdr.solve.confidence.judge import BodyConfidence, LimbConfidence, confidence_record, judge_fits
from warp_partdr.solve.confidence.limbs import LIMBS, guessed_parts
from warp_partdr.solve.confidence.measures import BodyMeasures, detection_measures, measure_bodies
from warp_partdr.solve.confidence.model import FORMAT, packaged_model, read_confidence_model
from warp_partdr.solve.confidence.motions import MotionConfidence, motion_warning, unsure_stretches
from warp_partdr.solve.confidence.scenes import SceneConfidence, judge_scene
from warp_partdr.solve.confidence.sights import NO_SIGHT, SIGHTS, Sight
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.result import FitResult
from warp_partdr.solve.mesh.observed_body import ObservedBody
from warp_partdr.solve.scene.fitting import SceneFit, fit_scene
from warp_partdr.solve.scene.observations import observe_scene

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


@cache
def example_scene(device: str = "cpu") -> tuple[SceneFit, list[ObservedBody]]:
    """Quick fit of the example in frames 0 and 2 of one view, and in frame 2 of another, which shows no left arm."""
    height, width = example_photo().shape[:2]
    view = View(Perspective.of_picture((height, width), focal=600.0))
    keypoints = example_keypoints()
    confidence = keypoints.confidence.copy()
    confidence[[keypoints.format.landmarks.index(name) for name in ("left_elbow", "left_wrist")]] = 0.05
    armless = replace(keypoints, confidence=confidence)
    seen = [SceneObservation(keypoints, frame=frame) for frame in (0, 2)]
    scene = Scene([view, view], [*seen, SceneObservation(armless, frame=2, view=1)])
    observed_bodies = observe_scene(scene, device)
    return fit_scene(scene, options=QUICK_SCENE, device=device, observed_bodies=observed_bodies), observed_bodies


def judged_scene(
    views: tuple[int, ...] = (0, 1), size: tuple[int, int] | None = None, device: str = "cpu"
) -> SceneConfidence:
    fit, observed_bodies = example_scene(device)
    height, width = example_photo().shape[:2]
    return judge_scene(fit, [each for each in observed_bodies if each.view in views], [size or (height, width)] * 2)


def test_a_scene_s_bodies_are_judged_by_their_meshes_in_the_picture(device: str) -> None:
    """The measures by hand: distances in pixels of the picture, as a share of the side of the crop there."""
    fit, (observed, *_) = example_scene(device)
    keypoints = observed.evidence.keypoints
    names = [name for name in BODY_LANDMARKS if name in keypoints.format.landmarks]
    rows = [keypoints.format.landmarks.index(name) for name in names]
    world = fit.landmarks(tuple(keypoints.format.marks[row] for row in rows))[0, 0].cpu()
    pixels = fit.scene.views[0].camera.project(world[None])[0, :, :2].numpy()
    side = observed.crop.size[0] / observed.crop.zoom
    distances = np.linalg.norm(pixels - keypoints.points[rows], axis=1) / side
    weights = keypoints.confidence[rows]
    assert observed.uncertainty is not None
    stated = observed.uncertainty.depths[0, [JOINT_NAMES.index(name) - 1 for name in names]].cpu().numpy()
    columns = {
        "keypoints": np.log([np.average(distances, weights=weights)]),
        "seen": weights.mean()[None],
        "depths": np.log([np.average(stated, weights=weights)]),
    }
    regression = next(each for each in packaged_model().bodies if set(each.measures) == set(columns))
    assert judged_scene(device=device).bodies[0, 0] == pytest.approx(regression.logits(columns)[0], abs=1e-3)


def test_views_of_a_body_are_no_independent_witnesses() -> None:
    both, first, second = (judged_scene(views) for views in ((0, 1), (0,), (1,)))
    assert abs(first.bodies[0, 2] - second.bodies[0, 2]) > 0.1
    assert both.bodies[0, 2] == pytest.approx((first.bodies[0, 2] + second.bodies[0, 2]) / 2)
    assert both.bodies[0, 0] == first.bodies[0, 0]  # the other view does not show frame 0
    arm = NAMES.index("left arm")
    assert first.limbs[0, 2, arm] > second.limbs[0, 2, arm]
    np.testing.assert_array_equal(both.limbs[0, 2], np.maximum(first.limbs[0, 2], second.limbs[0, 2]))
    assert SIGHTS[second.sights[0, 2, arm]] == "hidden"
    assert SIGHTS[both.sights[0, 2, arm]] == "seen"


def test_frames_without_the_person_have_no_confidence() -> None:
    found = judged_scene()
    assert np.isfinite(found.bodies[0]).tolist() == [True, False, True]
    assert np.isnan(found.limbs[0, 1]).all()
    assert (found.sights[0, 1] == NO_SIGHT).all()
    assert (found.sights[0, [0, 2]] == SIGHTS.index("seen")).all()


def test_a_face_alone_can_not_judge_a_body() -> None:
    keypoints = example_keypoints()
    confidence = keypoints.confidence.copy()
    confidence[5:] = 0
    view = View(Perspective.of_picture(example_photo().shape[:2], focal=600.0))
    scene = Scene([view], [SceneObservation(replace(keypoints, confidence=confidence))])
    observed_bodies = observe_scene(scene, "cpu")
    fit = fit_scene(scene, options=QUICK_SCENE, observed_bodies=observed_bodies)
    found = judge_scene(fit, observed_bodies, [example_photo().shape[:2]])
    assert np.isnan(found.bodies).all()
    assert (found.sights == NO_SIGHT).all()
    record = motion_confidence_record(np.array([4]), MotionConfidence(found.bodies[0], found.limbs[0], found.sights[0]))
    assert record == {"mean_confidence": None, "confidence": [None], "guessed": {}}


def test_limbs_of_meshes_beyond_the_border_are_outside() -> None:
    arm = NAMES.index("left arm")
    assert SIGHTS[judged_scene((1,), (2, 2)).sights[0, 2, arm]] == "outside"


def confidence_of(bodies: Sequence[float], arm: Sight = "seen") -> MotionConfidence:
    """Confidence in frames, in which one arm is seen or not."""
    values = np.array(bodies)
    sights = np.full((len(values), len(LIMBS)), SIGHTS.index("seen"), dtype=np.uint8)
    sights[:, NAMES.index("left arm")] = SIGHTS.index(arm)
    sights[np.isnan(values)] = NO_SIGHT
    return MotionConfidence(values, np.repeat(values[:, None], len(LIMBS), 1), sights)


def test_stretches_that_are_near_to_one_another_are_one() -> None:
    low, high, none = 0.1, 0.9, np.nan
    confidence = confidence_of([low, low, high, high, low, none, low, high, low, high])
    times = np.array([0.0, 0.2, 0.4, 0.6, 0.7, 0.8, 0.9, 1.2, 1.5, 1.6])
    assert unsure_stretches(confidence, times) == [slice(0, 7), slice(8, 9)]
    # Frames that follow one another are one stretch, however far they are apart.
    assert unsure_stretches(confidence, 10 * times) == [slice(0, 2), slice(4, 5), slice(6, 7), slice(8, 9)]
    assert unsure_stretches(confidence_of([high, packaged_model().least, none]), times[:3]) == []


def test_a_warning_says_when_and_why_and_counts_the_shorter_stretches() -> None:
    low, high = 0.2, 0.9
    end = "; expected 0.40 or more; compare overlay.mp4 with the film"
    once = confidence_of([high, low, low, low, high], "hidden")
    times = np.arange(5) / 2.5
    assert motion_warning("person0", once, times) == (
        f"person0: confidence below 0.40 from 0.4 to 1.2 s (left arm hidden, guessed){end}"
    )
    assert motion_warning("person0", confidence_of([high, high]), times[:2]) is None
    one_frame = confidence_of([high, low, high], "outside")
    assert motion_warning("person3", one_frame, times[:3]) == (
        f"person3: confidence below 0.40 at 0.4 s (left arm outside the picture, guessed){end}"
    )
    lengths = (1, 3, 1, 4, 2)  # frames of each stretch, of which the last one is the third in length
    often = confidence_of([each for length in lengths for each in (*[low] * length, high)])
    assert motion_warning("person1", often, np.arange(len(often.bodies), dtype=float)) == (
        f"person1: confidence below 0.40 from 2.0 to 4.0 s, from 8.0 to 11.0 s, from 13.0 to 14.0 s and in 2 shorter "
        f"stretches{end}"
    )


def test_limbs_are_guessed_in_a_warning_if_they_are_in_most_of_its_frames() -> None:
    confidence = confidence_of([0.1] * 5, "hidden")
    arm = confidence.sights[:, NAMES.index("left arm")]
    told = []
    for sight, index in (("hidden", 1), ("seen", 0), ("outside", 2)):
        arm[:3] = index
        told.append((sight, motion_warning("person0", confidence, np.arange(5) / 10)))
    for sight, warning in told:
        assert warning is not None
        words = {"hidden": "(left arm hidden, guessed)", "outside": "(left arm outside the picture, guessed)"}
        assert words.get(sight, "0.4 s;") in warning
    assert confidence.guessed(0) == ("left arm",)
    assert confidence_of([np.nan]).guessed(0) == tuple(NAMES)
