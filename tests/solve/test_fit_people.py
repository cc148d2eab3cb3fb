"""Fits side by side: each as ``fit_body`` alone, whatever it is fitted with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.example import example_keypoints, example_parts

from warp_partdr.body.stature import bone_statures
from warp_partdr.cameras import Perspective
from warp_partdr.inputs.cut_people import CutPerson
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import crop_evidence
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.interop.precision import exact_convolutions
from warp_partdr.networks.regression.checkpoint import packaged_network
from warp_partdr.solve.ellipsoids.fitting import fit_body, fit_people
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.stages import OUTLINE, Stage

KEYPOINTS = example_keypoints()
PARTS = example_parts()
FAST = replace(FitOptions.at("fast"), search=())
# Rates so low that rounding, by which batches differ, does not turn small gradients, and with them Adam's steps.
_STAGES = replace(FAST.stages[0], iterations=5, size=64, learning_rate=5e-4), Stage(OUTLINE, 1, 3, 5e-4, 48)
SMALL_STEPS = replace(FAST, stages=_STAGES)


def cut(keypoints: Keypoints2D, parts: PartLabels | None, device: str, camera: Perspective | None = None) -> CutPerson:
    evidence = weigh_evidence(keypoints, parts)[0]
    return CutPerson(evidence, *crop_evidence(evidence, device=device, camera=camera))


def turned(degrees: float) -> Keypoints2D:
    """The person, turned in the picture."""
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]], dtype=np.float32)
    middle = KEYPOINTS.points.mean(0)
    return replace(KEYPOINTS, points=(KEYPOINTS.points - middle) @ turn.T + middle)


@pytest.mark.parametrize("options", [SMALL_STEPS, replace(SMALL_STEPS, stages=())], ids=["refined", "network alone"])
@pytest.mark.parametrize("fov", [None, 50.0])
def test_each_person_is_fitted_as_alone(options: FitOptions, fov: float | None, device: str) -> None:
    """People with labels and without are in one call; one camera is for all, and is not guessed."""
    options = replace(options, guess_camera=False)
    camera = None if fov is None else Perspective.of_picture(PARTS.groups.shape, fov=fov)
    given = [(KEYPOINTS, PARTS), (turned(10), None), (KEYPOINTS, PARTS), (turned(-15), None)]
    people = [cut(keypoints, parts, device, camera) for keypoints, parts in given]
    with exact_convolutions():  # rounded to TF32, those of another batch differ, in the end by millimetres of depth
        fits = fit_people(people, options, packaged_network(device))
        everyone = [fit_body(*each, options=options, device=device, camera=camera) for each in given]
    for alone, fit in zip(everyone, fits, strict=True):
        torch.testing.assert_close(fit.posed.joints, alone.posed.joints, atol=2e-3, rtol=0)
        torch.testing.assert_close(fit.camera.intrinsics, alone.camera.intrinsics, atol=0.3, rtol=1e-3)
        assert fit.energy == pytest.approx(alone.energy, rel=1e-2, abs=0.05)
        assert fit.stages == alone.stages
        assert fit.depth_order == alone.depth_order
        assert [rows.shape for rows in fit.history] == [rows.shape for rows in alone.history]
        assert fit.warnings == alone.warnings


def test_bodies_far_from_what_was_seen_are_told(device: str) -> None:
    """The warning is that of ``fit_body``; others of the batch are fine."""
    rng = np.random.default_rng(0)
    wild = replace(KEYPOINTS, points=rng.uniform(0, 400, KEYPOINTS.points.shape).astype(np.float32))
    people = [cut(KEYPOINTS, None, device), cut(wild, None, device)]
    near, far = fit_people(people, replace(FAST, stages=()), packaged_network(device))
    assert near.warnings == ()
    assert any("the body ends" in warning for warning in far.warnings)
    alone = fit_body(wild, options=replace(FAST, stages=()), device=device)
    assert far.warnings == alone.warnings
    coco = Keypoints2D("coco17", wild.points[:17], np.ones(17, np.float32))
    (asked,) = fit_people([cut(coco, None, device)], replace(FAST, stages=()), packaged_network(device))
    assert any(text.endswith("are these keypoints of coco17, not of h36m17 or posetrack17?") for text in asked.warnings)


def test_bad_calls_name_the_argument(device: str) -> None:
    person, network = cut(KEYPOINTS, None, device), packaged_network(device)
    with pytest.raises(TypeError, match=r"people\[0\]: Observation; expected CutPerson"):
        fit_people([person.observation], FAST, network)  # type: ignore[list-item]
    with pytest.raises(TypeError, match="options: NoneType"):
        fit_people([person], None, network)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="network: str; expected LabelNetwork"):
        fit_people([person], FAST, "packaged")  # type: ignore[arg-type]
    assert fit_people([], FAST, network) == []


def test_without_the_mirror_image_and_in_bfloat16_people_stay_near() -> None:
    """This is the packaged person: bfloat16 moves joints by some millimetres at most, and both ways are asked for."""
    people = [cut(KEYPOINTS, PARTS, "cpu"), cut(turned(10), None, "cpu")]
    usual = replace(FAST, stages=())
    network = packaged_network("cpu")
    ways = (usual, replace(usual, half=True), replace(usual, mirror=False))
    exact, half, alone = (torch.cat([fit.posed.joints for fit in fit_people(people, way, network)]) for way in ways)
    assert 0 < (half - exact).norm(dim=-1).max() < 0.01
    assert 1e-3 < (alone - exact).norm(dim=-1).max() < 0.1


def with_probabilities() -> PartLabels:
    """The person's labels as probabilities of 0.9."""
    groups = np.where(PARTS.groups < 255, PARTS.groups, 0)
    maps = np.eye(PARTS.label_set.num_groups + 1, dtype=np.float32)[groups]
    return replace(PARTS, maps=0.9 * np.moveaxis(maps, -1, 0))


def test_people_with_probabilities_are_fitted_as_each_alone(device: str) -> None:
    """Torch refines them, all at once; whoever has labels beside them is refined by a graph."""
    soft, options = with_probabilities(), replace(SMALL_STEPS, guess_camera=False)
    given = [(KEYPOINTS, soft), (KEYPOINTS, PARTS), (turned(5), soft)]
    with exact_convolutions():
        fits = fit_people([cut(*each, device) for each in given], options, packaged_network(device))
        everyone = [fit_body(*each, options=options, device=device) for each in given]
    for alone, fit in zip(everyone, fits, strict=True):
        torch.testing.assert_close(fit.posed.joints, alone.posed.joints, atol=2e-3, rtol=0)
        assert fit.energy == pytest.approx(alone.energy, rel=1e-2, abs=0.05)
        assert (fit.observation.maps is None) == (alone.observation.maps is None)


def test_each_has_the_stature_that_is_known_of_them(device: str) -> None:
    people = [cut(KEYPOINTS, PARTS, device) for _ in range(3)]
    known = [1.95, None, 1.5]
    people = [
        replace(person, observation=replace(person.observation, stature=stature))
        for person, stature in zip(people, known, strict=True)
    ]
    fits = fit_people(people, SMALL_STEPS, packaged_network(device))
    for stature, fit in zip(known, fits, strict=True):
        assert fit.stature == pytest.approx(stature)
        found = float(bone_statures(fit.parameters.lengths))
        assert found == pytest.approx(stature or found, abs=1e-4)
        assert stature or 1.55 < found < 1.9
        alone = fit_body(
            KEYPOINTS, PARTS, options=replace(SMALL_STEPS, stature=stature, guess_camera=False), device=device
        )
        torch.testing.assert_close(fit.posed.joints, alone.posed.joints, atol=5e-3, rtol=0)


def test_a_search_is_tried_for_those_alone_who_end_far_from_their_keypoints(device: str) -> None:
    """The other one keeps the network's body."""
    rng = np.random.default_rng(0)
    wild = replace(KEYPOINTS, points=rng.uniform(0, 400, KEYPOINTS.points.shape).astype(np.float32))
    search = (Stage("lift", 8, 6, 0.1), Stage("keypoints", 4, 4, 0.02))
    options = replace(FAST, stages=(), search=search)
    people = [cut(KEYPOINTS, None, device), cut(wild, None, device), cut(wild, None, device)]
    near, far, twin = fit_people(people, options, packaged_network(device))
    assert (near.start, near.hypotheses, near.warnings) == ("network", 1, ())
    assert far.start == "search"
    assert far.hypotheses > 1
    assert len(far.finalists) > 1
    assert far.finalists == sorted(far.finalists)
    assert [name for name in far.stage_seconds if name.endswith("search")] == ["lift, search", "keypoints, search"]
    assert [row.shape for row in far.history] == [(6,), (4,)]
    torch.testing.assert_close(far.parameters.rotations, twin.parameters.rotations, atol=1e-3, rtol=0)
    alone = fit_body(wild, options=replace(options, guess_camera=False), device=device)
    assert alone.finalists == pytest.approx(far.finalists, rel=0.05)
    assert any("the body ends" in warning for warning in far.warnings)


def test_labels_that_lie_elsewhere_are_told_of_each(device: str) -> None:
    """Ids of another label set make parts of the body lie where they can't be."""
    mixed = PARTS.groups.copy()
    ids = np.arange(1, PARTS.label_set.num_groups + 1)
    for old, new in zip(ids, np.roll(ids, 5), strict=True):
        mixed[PARTS.groups == old] = new
    observations = [cut(KEYPOINTS, parts, device) for parts in (PARTS, replace(PARTS, groups=mixed))]
    right, wrong = fit_people(observations, replace(FAST, stages=()), packaged_network(device))
    assert not any("part F1" in warning for warning in right.warnings)
    assert any("part F1" in warning and "are these ids of cdcl14?" in warning for warning in wrong.warnings)
