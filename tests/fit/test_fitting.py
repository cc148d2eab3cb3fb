"""Fitting: parameters, energy, hypotheses and the whole path on bodies whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from warp_partdr import metrics
from warp_partdr.body.labels import label_set
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.body.rotations import rotation_from_axis_angle, rotation_to_6d
from warp_partdr.body.skeletons import skeleton
from warp_partdr.errors import InputError
from warp_partdr.fit.fitting import fit_body
from warp_partdr.fit.options import FitOptions
from warp_partdr.fit.stages import Stage
from warp_partdr.fit.start_search import distinct, hypothesize
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import Observation
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.refinement.energy import Energy, Weights
from warp_partdr.refinement.refine import refine
from warp_partdr.refinement.steps import SIZES
from warp_partdr.render.ellipsoids import draw_ellipsoids
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import ellipbody_mesh

SIZE = (200, 160)
QUICK = FitOptions(
    start="search",
    stages=(Stage("lift", 64, 20, 0.1), Stage("keypoints", 64, 10, 0.04), Stage("labels", 6, 40, 0.02, 96)),
)


def walker(device="cpu") -> BodyParameters:
    """A body in one of the prior's own poses, turned by 40 degrees."""
    prior = PosePrior().to(device)
    mean = BodyParameters.mean(1, device=device)
    turn = rotation_from_axis_angle(torch.tensor([[0.0, 0.7, 0.0]], device=device))
    facing = torch.diag(torch.tensor([1.0, -1.0, -1.0], device=device))
    return replace(
        mean,
        orientation=rotation_to_6d(turn @ facing),
        rotations=prior.exemplars[:1].clone(),
        log_scale=torch.full_like(mean.log_scale, -0.1),
    )


def seen_by(body: BodyParameters, fmt: str = "coco17") -> tuple[Keypoints2D, PartLabels]:
    """Perfect keypoints and 20-part labels of a body in a picture of ``SIZE``."""
    posed, device = body.posed(), body.shift.device
    down = torch.tensor([0.0, 20.0], device=device)
    camera = replace(body.camera(160), translation=body.camera(160).translation + down)
    names = skeleton(fmt).landmarks
    points = camera.project(LandmarkGather(names, device)(posed))[0, :, :2].cpu().numpy()
    mesh = ellipbody_mesh(2, device=device)
    labels = draw_mesh(posed.vertices(2), mesh, camera, SIZE).labels[0].cpu().numpy()
    keypoints = Keypoints2D(fmt, points.astype(np.float32), np.ones(len(points), dtype=np.float32))
    return keypoints, PartLabels(label_set("ellipbody20"), labels)


def observation_of(body: BodyParameters, device: str) -> Observation:
    """What the crop of ``body`` itself shows."""
    names = skeleton("coco17").landmarks
    points = body.camera(2).project(LandmarkGather(names, device)(body.posed()))[0, :, :2] - 1
    labels = draw_ellipsoids(body.posed(), body.camera(256), (256, 256)).labels[0]
    return Observation(names, points.detach(), torch.ones(17, device=device), labels, label_set("ellipbody20"))


def test_energy_of_the_truth_is_its_prior_alone(device):
    body = walker(device)
    energy = Energy(observation_of(body, device), prior=PosePrior().to(device))
    terms = energy(body)
    assert terms["seg"].item() == 0
    assert terms["proj"].item() == pytest.approx(0, abs=1e-2)
    assert terms["length"].item() == pytest.approx(0, abs=1e-6)
    assert terms["limits"].item() < 1e-3


def test_losses_have_the_stated_units(device):
    body = walker(device)
    seen = observation_of(body, device)
    weights = Weights(proj=1.0, seg=1.0, length=1.0, thickness=1.0)
    energy = Energy(seen, weights=weights)
    shifted = replace(body, shift=body.shift + torch.tensor([4 / 128, 0.0], device=device))
    assert energy(shifted)["proj"].item() == pytest.approx(4 * energy.votes.sum().item(), rel=1e-3)
    longer = replace(body, lengths=body.lengths + 0.002)
    assert energy(longer)["length"].item() == pytest.approx(12 * 4, rel=1e-3)
    # the same shift costs about the same, whatever size is drawn
    fine = energy(shifted)["seg"].item()
    coarse = Energy(seen, size=128, weights=weights)(shifted)["seg"].item()
    assert coarse == pytest.approx(fine, rel=0.15)


def test_soft_maps_of_certain_labels_are_the_labels_loss(device):
    body = walker(device)
    seen = observation_of(body, device)
    maps = (seen.labels[None] == torch.arange(1, 21, device=device)[:, None, None]).float()
    soft = replace(seen, maps=maps, known=torch.ones(256, 256, device=device))
    moved = replace(body, shift=body.shift + 0.05).leaves()
    values, gradients = [], []
    for observation in (seen, soft):
        term = Energy(observation)(moved)["seg"]
        values.append(term.item())
        gradients.append(torch.autograd.grad(term.sum(), moved.shift)[0])
    assert values[0] == pytest.approx(values[1], rel=1e-4)
    torch.testing.assert_close(gradients[0], gradients[1], rtol=1e-3, atol=1e-2)


def test_refinement_brings_a_moved_body_back(device):
    body = walker(device)
    energy = Energy(observation_of(body, device), prior=PosePrior().to(device))
    generator = torch.Generator().manual_seed(0)
    noise = (0.12 * torch.randn(1, 20, 3, generator=generator)).to(device)
    start = replace(body, rotations=body.rotations + noise, shift=body.shift + 0.06, log_scale=body.log_scale + 0.05)
    refined = refine(start, energy, iterations=60, learning_rate=0.02)
    before = sum(term.item() for term in energy(start).values())
    assert refined.energy.item() < 0.35 * before
    assert refined.terms["seg"].item() < 0.4 * energy(start)["seg"].item()
    assert refined.history.shape == (60, 1)
    # what comes back is what was measured
    again = sum(term.item() for term in energy(refined.parameters).values())
    assert again == pytest.approx(refined.energy.item(), rel=1e-4)


def test_bodies_of_a_batch_do_not_influence_one_another(device):
    body = walker(device)
    energy = Energy(observation_of(body, device), size=64, prior=PosePrior().to(device))
    first = replace(body, shift=body.shift + 0.05)
    second = replace(body, log_scale=body.log_scale + 0.1)
    both = BodyParameters(**{n: torch.cat([t, second.tensors()[n]]) for n, t in first.tensors().items()})
    together = refine(both, energy, iterations=5)
    alone = refine(first, energy, iterations=5)
    torch.testing.assert_close(together.energy[:1], alone.energy, rtol=1e-3, atol=1e-3)


def test_hypotheses_hold_the_truth():
    """One of the hypotheses has every joint on the right side of the body in depth."""
    body = walker()
    seen = observation_of(body, "cpu")
    starts, targets, known = hypothesize(seen, 4096)
    assert known.all()
    assert starts.batch_size > 1
    from warp_partdr.fit.start_search import _JOINTS

    truth = LandmarkGather(_JOINTS, "cpu")(body.posed())[0]
    truth = (truth - truth[:1])[:, 2] * body.log_scale.exp()
    errors = (targets[:, :, 2] - truth).abs().mean(1)
    assert errors.min() < 0.06
    assert errors.max() > 3 * errors.min()
    few, _, _ = hypothesize(seen, 1)
    assert few.batch_size == 1


def test_hypotheses_without_a_trunk():
    names = ("left_knee", "left_ankle")
    seen = Observation(names, torch.tensor([[0.0, 0.0], [0.1, 0.5]]), torch.ones(2), None, None)
    starts, targets, known = hypothesize(seen, 16)
    assert torch.isfinite(targets).all()
    assert torch.isfinite(starts.orientation).all()
    assert known.sum() == 2


def test_distinct_keeps_the_best_of_equals():
    body = walker()
    other = replace(body, rotations=body.rotations + 0.5)
    three = BodyParameters(**{n: torch.cat([t, t + 1e-5, other.tensors()[n]]) for n, t in body.tensors().items()})
    assert distinct(three, torch.tensor([2.0, 1.0, 3.0]), 3).tolist() == [1, 2]


def test_fit_finds_a_body_from_perfect_labels():
    body = walker()
    keypoints, parts = seen_by(body)
    result = fit_body(keypoints, parts, options=QUICK)
    shown = result.draw(SIZE).labels[0].numpy()
    counts = metrics.confusion(shown, parts.groups, 21)
    assert metrics.part_f1(metrics.foreground_counts(counts)) > 0.94
    names = skeleton("lsp14").landmarks
    truth = LandmarkGather(names, "cpu")(body.posed())[0].numpy()
    assert metrics.pa_mpjpe(result.landmarks(names), truth) < 0.08
    assert list(result.stage_seconds) == [stage.name for stage in QUICK.stages]


@pytest.mark.parametrize("case", ["cut off", "missing limbs", "keypoints alone", "ignored half"])
def test_fit_takes_what_is_there(case):
    keypoints, parts = seen_by(walker())
    if case == "cut off":  # the legs are beyond the picture's border
        visible = keypoints.points[:, 1] < 110
        keypoints = replace(keypoints, confidence=visible.astype(np.float32))
        parts = PartLabels(parts.label_set, parts.groups[:110])
    elif case == "missing limbs":
        confidence = keypoints.confidence.copy()
        confidence[7:11] = 0
        keypoints = replace(keypoints, confidence=confidence)
        parts = PartLabels(parts.label_set, np.where(parts.groups > 14, 0, parts.groups))
    elif case == "keypoints alone":
        parts = None
    else:
        groups = parts.groups.copy()
        groups[:, 80:] = 255
        parts = PartLabels(parts.label_set, groups)
    result = fit_body(keypoints, parts, options=QUICK)
    for tensor in result.parameters.tensors().values():
        assert torch.isfinite(tensor).all()
    seen = result.camera.project(torch.from_numpy(result.landmarks(keypoints.format.landmarks))[None])[0, :, :2]
    sure = keypoints.visible
    assert np.linalg.norm(seen.numpy() - keypoints.points, axis=1)[sure].mean() < 8


def test_fit_refuses_keypoints_that_say_nothing():
    keypoints, parts = seen_by(walker())
    with pytest.raises(InputError, match="none is visible"):
        fit_body(replace(keypoints, confidence=keypoints.confidence * 0), parts)
    with pytest.raises(InputError, match="one point"):
        fit_body(replace(keypoints, points=keypoints.points * 0 + 50), parts)


def test_fit_is_reproducible():
    keypoints, parts = seen_by(walker())
    first, second = (fit_body(keypoints, parts, options=QUICK) for _ in range(2))
    for name, tensor in first.parameters.tensors().items():
        assert torch.equal(tensor, second.parameters.tensors()[name]), name


def test_sizes_stay_within_human_bounds():
    """A target that no human fills (everything is the head) must not blow the body up."""
    seen = observation_of(walker(), "cpu")
    flooded = replace(seen, labels=torch.full_like(seen.labels, 8))
    refined = refine(walker(), Energy(flooded, size=64, weights=Weights(seg=1.0)), iterations=40, learning_rate=0.1)
    mean = BodyParameters.mean(1)
    assert (refined.parameters.thicknesses <= mean.thicknesses * SIZES["thicknesses"][1] + 1e-6).all()
    assert (refined.parameters.lengths >= mean.lengths * SIZES["lengths"][0] - 1e-6).all()
    assert refined.parameters.thicknesses[0, 6] > 1.2 * mean.thicknesses[0, 6]


def test_a_stage_holds_depth_where_it_starts():
    """Labels of one body pull another one that leans from it, in the picture alone if told so."""
    keypoints, parts = seen_by(walker())
    options = replace(FitOptions.at("balanced"), search=())
    *before, outline = options.stages

    def depths(*stages):
        return fit_body(keypoints, parts, options=replace(options, stages=stages)).posed.centres[0, :, 2]

    short = replace(outline, iterations=60, size=96)
    free = replace(short, weights=replace(outline.weights, depth=0.0))
    start = depths(*before)
    held, loose = ((depths(*before, stage) - start).abs().max() for stage in (short, free))
    assert held < 0.01
    assert loose > 2 * held
    many = FitOptions.at("fast", "search").stages[0], replace(short, bodies=4)
    with pytest.raises(ValueError, match=r"holds depth, of \d+ bodies; expected one"):
        fit_body(keypoints, parts, options=replace(options, start="search", stages=many))


def test_without_outline_leaves_out_that_stage_alone():
    options = FitOptions()
    assert [stage.name for stage in options.without_outline().stages] == [s.name for s in options.stages][:-1]
    assert options.without_outline().weights == options.weights


def test_labels_first_ends_with_the_true_gradient_of_the_outlines():
    usual, first = FitOptions(trust_background=True), FitOptions(trust_background=True).labels_first()
    assert first.stages[:-1] == usual.without_outline().stages
    assert first.stages[-1].name == usual.stages[-1].name
    assert (first.stages[-1].renderer.gradient, first.trust_background) == ("coverage", True)


def test_labels_first_fills_the_labels_better():
    keypoints, parts = seen_by(walker())
    options = FitOptions()
    options = replace(options, stages=tuple(replace(s, bodies=min(s.bodies, 4), iterations=20) for s in options.stages))

    def wrong(chosen):
        shown = fit_body(keypoints, parts, options=chosen).draw(parts.groups.shape).labels[0].numpy()
        return (shown != parts.groups).mean()

    *before, last = options.labels_first().stages
    quick = replace(options, stages=(*before, replace(last, iterations=60)))
    assert wrong(quick) < wrong(options.without_outline())
