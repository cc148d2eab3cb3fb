"""Flips of limbs in depth: what they change, which are proposed, and when one is accepted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from helpers.bodies import observation_of
from helpers.quick import QUICK_SEARCH

from warp_partdr import FitOptions, fit_body
from warp_partdr.body.lens import place_bodies
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.body.template import JOINT_NAMES, PART_NAMES
from warp_partdr.inputs.observation import Observation, resize_nearest
from warp_partdr.inputs.observations import Observations
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.lab.synthetic.pose_recipes import draw_pose
from warp_partdr.networks.regression.uncertainty import Uncertainty
from warp_partdr.results.save import make_report
from warp_partdr.solve.ellipsoids.depth_flips import DepthOrder, flip_depths, repair_depth_orders

LENS = torch.tensor([2.5, 0.9, -0.5])


def arm_before_trunk(device: str, seed: int = 5) -> BodyParameters:
    """A body that faces the camera with its arms before its trunk."""
    drawn = draw_pose("arm before torso", np.random.default_rng(seed))
    rotations = torch.from_numpy(drawn.rotations)[None].float().to(device)
    return replace(BodyParameters.mean(1, device=device), rotations=rotations)


def test_flips_keep_what_is_seen_of_the_joints_and_mirror_depth(device):
    body, prior = arm_before_trunk(device), PosePrior().to(device)
    flips, names = flip_depths(body, prior)
    assert flips.batch_size == 1 + len(names)
    assert torch.equal(flips.rotations[:1], body.rotations)
    assert any(name.startswith("left arm") for name in names)
    assert not any("leg" in name for name in names)  # they stand apart
    joints = flips.posed().joints
    moved = (joints - joints[:1])[1:]
    riding = [JOINT_NAMES.index(f"{side}_fingertip") for side in ("left", "right")]  # a hand turns with its forearm
    held = [joint for joint in range(len(JOINT_NAMES)) if joint not in riding]
    assert moved[:, held, :2].abs().max() < 1e-5
    assert (moved[:, held, 2].abs().amax(1) > 0.05).all()
    elbow, wrist, shoulder = (JOINT_NAMES.index(f"left_{name}") for name in ("elbow", "wrist", "shoulder"))
    for name, flip in zip(names, joints[1:], strict=True):
        if name == "left arm: upper_arm":
            torch.testing.assert_close((flip[elbow] - flip[shoulder])[2], -(joints[0, elbow] - joints[0, shoulder])[2])
            torch.testing.assert_close((flip[wrist] - flip[elbow])[2], (joints[0, wrist] - joints[0, elbow])[2])


def test_flips_before_a_camera_mirror_along_its_ray(device):
    body, prior, lens = arm_before_trunk(device), PosePrior().to(device), LENS.to(device)
    for given, least, most in ((lens, 0.0, 0.04), (None, 0.04, 1.0)):
        flips, names = flip_depths(body, prior, given)
        assert "left arm: forearm" in names
        posed, camera = place_bodies(flips, flips.posed(), lens, 2)
        seen = camera.project(posed.joints)[..., :2]
        wrist = JOINT_NAMES.index("left_wrist")
        off = (seen[1:, wrist] - seen[:1, wrist]).norm(dim=-1).max()
        assert least <= off < most


def test_elbows_of_flips_bend_as_elbows_do():
    """A bone that is only swung to its mirror image keeps its twist: elbows bend backward, and flips are left out."""
    prior = PosePrior()
    elbows = [PART_NAMES.index(f"{side}_forearm") for side in ("left", "right")]
    excess = []
    for seed in range(10):
        drawn = draw_pose("arm before torso", np.random.default_rng(seed))
        rotations = torch.from_numpy(drawn.rotations)[None].float()
        flips, names = flip_depths(replace(BodyParameters.mean(1), rotations=rotations), prior)
        bends = flips.rotations[1:, elbows][[" arm: " in name for name in names]]
        beyond = (prior.lower_limits[elbows] - bends).relu() + (bends - prior.upper_limits[elbows]).relu()
        excess += beyond.square().sum((1, 2)).tolist()
    assert len(excess) >= 15
    assert np.mean(excess) < 0.25


def test_flips_beyond_joint_limits_are_not_proposed():
    body = arm_before_trunk("cpu")
    free, stiff = PosePrior(), PosePrior()
    for prior, limit in ((free, 10.0), (stiff, 0.0)):
        prior.lower_limits.fill_(-limit)
        prior.upper_limits.fill_(limit)
    assert len(flip_depths(body, free)[1]) > len(flip_depths(body, stiff)[1])


def repair_depth_order(
    body: BodyParameters, seen: Observation, prior: PosePrior, said: Uncertainty | None = None
) -> tuple[BodyParameters, DepthOrder]:
    """Repair one person's body."""
    found, (order,) = repair_depth_orders(body, Observations.of([seen]), prior, uncertainty=said)
    return found, order


def test_labels_repair_a_mirrored_arm_and_leave_a_right_one(device):
    """The arm is behind the trunk in the start, before it in the labels."""
    truth, prior = arm_before_trunk(device), PosePrior().to(device)
    flips, names = flip_depths(truth, prior)
    wrong = flips.select(torch.tensor([1 + names.index("left arm: upper_arm")], device=device))
    seen = observation_of(truth)
    found, order = repair_depth_order(wrong, seen, prior)
    assert order.flipped == "left arm: upper_arm"
    assert order.flipped in order.tried
    elbow = JOINT_NAMES.index("left_elbow")
    depth = [float(body.posed().joints[0, elbow, 2]) for body in (truth, wrong, found)]
    assert abs(depth[2] - depth[0]) < 0.3 * abs(depth[1] - depth[0])
    stays, order = repair_depth_order(truth, seen, prior)
    assert order.flipped is None
    assert stays is truth


def test_flips_farther_than_the_network_believes_are_not_tried(device):
    truth, prior = arm_before_trunk(device), PosePrior().to(device)
    flips, names = flip_depths(truth, prior)
    wrong, seen = (
        flips.select(torch.tensor([1 + names.index("left arm: upper_arm")], device=device)),
        observation_of(truth),
    )
    elbow, wrist = (JOINT_NAMES.index(f"left_{name}") for name in ("elbow", "wrist"))
    depths = torch.stack([body.posed().joints[0, :, 2] for body in (wrong, truth)])
    for joint, away in ((elbow, 5.2), (wrist, 5.2), (wrist, 4.8)):
        spreads = torch.full((1, len(JOINT_NAMES) - 1), 1.0, device=device)
        spreads[0, joint - 1] = (depths[1] - depths[0])[joint].abs() / away
        said = Uncertainty(spreads, torch.ones(1, 19, device=device), torch.zeros(1, device=device))
        order = repair_depth_order(wrong, seen, prior, said)[1]
        assert ("left arm: upper_arm" in order.tried) == (order.flipped == "left arm: upper_arm") == (away < 5)
        both = BodyParameters.joined([wrong, wrong])
        several = Uncertainty(*(torch.cat([each, each]) for each in vars(said).values()))
        orders = repair_depth_orders(both, Observations.of([seen, seen]), prior, uncertainty=several)[1]
        assert [each.flipped for each in orders] == [order.flipped] * 2


def test_nobody_has_no_flips():
    bodies = BodyParameters.mean(0)
    nobody = Observations.of([observation_of(BodyParameters.mean(1))]).select(slice(0))
    assert repair_depth_orders(bodies, nobody, PosePrior()) == (bodies, [])


def test_an_arm_of_whose_joints_labels_show_nothing_is_taken_behind_the_trunk(device):
    """Seen from behind, an arm before the chest is hidden; the start has it before the camera, and is sure of it."""
    front, prior = arm_before_trunk(device, seed=3), PosePrior().to(device)
    turned = front.orientation.view(1, 2, 3) * front.orientation.new_tensor([-1.0, 1.0, -1.0])
    truth = replace(front, orientation=turned.reshape(1, 6))
    flips, names = flip_depths(truth, prior)
    wrong = flips.select(torch.tensor([1 + names.index("left arm: upper_arm")], device=device))
    seen = observation_of(truth)
    sure = Uncertainty(*(torch.full((2, count), 0.01, device=device) for count in (20, 19)), torch.zeros(2).to(device))
    said = Uncertainty(*(values[:1] for values in vars(sure).values()))
    found, order = repair_depth_order(wrong, seen, prior, said)
    assert order.hidden == ("left arm",)
    assert order.flipped == "left arm: upper_arm"
    elbow = JOINT_NAMES.index("left_elbow")
    depth = [float(body.posed().joints[0, elbow, 2]) for body in (truth, wrong, found)]
    assert abs(depth[2] - depth[0]) < 0.3 * abs(depth[1] - depth[0])
    orders = repair_depth_orders(
        BodyParameters.joined([wrong, truth]), Observations.of([seen, seen]), prior, uncertainty=sure
    )[1]
    assert [order.flipped for order in orders] == ["left arm: upper_arm", None]
    assert repair_depth_order(front, observation_of(front), prior)[1].hidden == ()


def test_only_labels_of_another_part_say_that_a_limb_is_hidden(device):
    front, prior = arm_before_trunk(device, seed=3), PosePrior().to(device)
    turned = front.orientation.view(1, 2, 3) * front.orientation.new_tensor([-1.0, 1.0, -1.0])
    truth = replace(front, orientation=turned.reshape(1, 6))
    seen = observation_of(truth)
    arm = torch.tensor(["left_elbow" in name or "left_wrist" in name for name in seen.landmarks], device=device)
    trunk = torch.zeros(256, dtype=torch.uint8, device=device)
    trunk[[1 + PART_NAMES.index(name) for name in ("abdomen", "chest", "left_shoulder", "right_shoulder")]] = 1
    on_trunk = trunk[seen.labels.long()].bool()
    stripes = torch.arange(seen.labels.shape[-1], device=device) % 8 < 4
    mirrored = 1 + PART_NAMES.index("right_forearm")
    cases = {
        "seen so": (seen, ("left arm",)),
        "without keypoints": (replace(seen, confidence=torch.where(arm, 0.0, seen.confidence)), ()),
        "no label": (replace(seen, labels=seen.labels.masked_fill(on_trunk, 0)), ()),
        "partly unknown": (replace(seen, labels=seen.labels.masked_fill(on_trunk & stripes, 255)), ()),
        "sides exchanged": (replace(seen, labels=seen.labels.masked_fill(on_trunk, mirrored)), ()),
    }
    for name, (given, hidden) in cases.items():
        assert repair_depth_order(truth, given, prior)[1].hidden == hidden, name


def test_of_finer_labels_flips_see_what_fits_keep(device):
    """People whose labels are kept at 128 px end where they would with all labels."""
    truth, prior = arm_before_trunk(device), PosePrior().to(device)
    flips, names = flip_depths(truth, prior)
    wrong = flips.select(torch.tensor([1 + names.index("left arm: upper_arm")], device=device))
    fine = observation_of(truth, size=640)
    kept = replace(fine, labels=resize_nearest(fine.labels, 128))
    (one, order), (other, same) = (repair_depth_order(wrong, seen, prior) for seen in (fine, kept))
    assert order.flipped == same.flipped == "left arm: upper_arm"
    assert torch.equal(one.rotations, other.rotations)
    bodies = BodyParameters.joined([wrong, wrong])
    found = [repair_depth_orders(bodies, Observations.of([seen, seen]), prior)[0] for seen in (fine, kept)]
    assert torch.equal(found[0].rotations, found[1].rotations)


def test_people_side_by_side_are_repaired_as_each_alone(device):
    truth, prior = arm_before_trunk(device), PosePrior().to(device)
    flips, names = flip_depths(truth, prior)
    wrong = flips.select(torch.tensor([1 + names.index("left arm: upper_arm")], device=device))
    apart = BodyParameters.mean(1, device=device)
    pairs = [(wrong, truth), (apart, apart), (truth, truth), (wrong, wrong), (wrong, truth)]
    seen = [observation_of(shown) for _, shown in pairs]
    together, orders = repair_depth_orders(
        BodyParameters.joined([body for body, _ in pairs]), Observations.of(seen), prior
    )
    for row, (body, _) in enumerate(pairs):
        alone, order = repair_depth_order(body, seen[row], prior)
        assert orders[row] == order
        torch.testing.assert_close(together.rotations[row], alone.rotations[0], atol=2e-3, rtol=0)
    assert [order.flipped is not None for order in orders] == [True, False, False, False, True]
    assert orders[1].tried == ()


def test_a_fit_says_what_was_tried(device):
    sample = make_sample(392, "realistic")  # a forearm goes along the view, toward or away: the network is not sure
    keypoints, parts = sample.keypoints, sample.parts
    result = fit_body(keypoints, parts, quality="fast", device=device)
    assert result.depth_order is not None
    assert result.depth_order.tried
    report = make_report(result)["depth"]
    assert report["flips_tried"] == list(result.depth_order.tried)
    assert report["flipped"] == result.depth_order.flipped
    assert report["limbs_hidden"] == list(result.depth_order.hidden)
    assert report["spread_m"].keys() == set(JOINT_NAMES[1:])
    assert 0 < report["spread_m"]["left_hip"] < report["spread_m"]["left_fingertip"] < 0.5
    assert 1 < report["network_distance_m"] <= 1000
    alone = fit_body(keypoints, parts, options=FitOptions(stages=(), search=()), device=device)
    without = fit_body(keypoints, None, quality="fast", device=device)
    assert alone.depth_order is None  # without stages the network's body stays as it is
    assert without.depth_order is None  # no labels to decide
    searched = fit_body(keypoints, parts, options=QUICK_SEARCH, device=device)
    assert make_report(searched)["depth"] == {}
