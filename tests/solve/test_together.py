"""Fits side by side: each as ``fit_body`` alone, whatever it is fitted with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.example import example_keypoints, example_parts

from warp_partdr.cameras import Perspective
from warp_partdr.inputs.cut_people import CutPerson
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import crop_evidence
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.interop.precision import exact_convolutions
from warp_partdr.networks.regression.checkpoint import packaged_network
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.stages import OUTLINE, Stage
from warp_partdr.solve.ellipsoids.together import fit_together

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
def test_each_is_as_alone(options: FitOptions, fov: float | None, device: str) -> None:
    """With labels and without, in one call; a camera is of all, and is not guessed."""
    options = replace(options, guess_camera=False)
    camera = None if fov is None else Perspective.of_picture(PARTS.groups.shape, fov=fov)
    given = [(KEYPOINTS, PARTS), (turned(10), None), (KEYPOINTS, PARTS), (turned(-15), None)]
    people = [cut(keypoints, parts, device, camera) for keypoints, parts in given]
    with exact_convolutions():  # rounded to TF32, those of another batch differ, in the end by millimetres of depth
        fits = fit_together(people, options, packaged_network(device))
        everyone = [fit_body(*each, options=options, device=device, camera=camera) for each in given]
    for alone, fit in zip(everyone, fits, strict=True):
        torch.testing.assert_close(fit.posed.joints, alone.posed.joints, atol=2e-3, rtol=0)
        torch.testing.assert_close(fit.camera.intrinsics, alone.camera.intrinsics, atol=0.3, rtol=1e-3)
        assert fit.energy == pytest.approx(alone.energy, rel=1e-2, abs=0.05)
        assert fit.stages == alone.stages
        assert fit.depth_order == alone.depth_order
        assert (fit.before_outline is None) == (alone.before_outline is None)
        assert [rows.shape for rows in fit.history] == [rows.shape for rows in alone.history]
        assert fit.warnings == alone.warnings


def test_bodies_far_from_what_was_seen_are_told(device: str) -> None:
    """As ``fit_body`` tells them; others of the batch are fine."""
    rng = np.random.default_rng(0)
    wild = replace(KEYPOINTS, points=rng.uniform(0, 400, KEYPOINTS.points.shape).astype(np.float32))
    people = [cut(KEYPOINTS, None, device), cut(wild, None, device)]
    near, far = fit_together(people, replace(FAST, stages=()), packaged_network(device))
    assert near.warnings == ()
    assert any("the body ends" in warning for warning in far.warnings)
    alone = fit_body(wild, options=replace(FAST, stages=()), device=device)
    assert far.warnings == alone.warnings
    coco = Keypoints2D("coco17", wild.points[:17], np.ones(17, np.float32))
    (asked,) = fit_together([cut(coco, None, device)], replace(FAST, stages=()), packaged_network(device))
    assert any(text.endswith("are these keypoints of coco17, not of h36m17 or posetrack17?") for text in asked.warnings)


def test_what_can_not_be_fitted_so_is_refused(device: str) -> None:
    person = cut(KEYPOINTS, None, device)
    network = packaged_network(device)
    with pytest.raises(ValueError, match=r"options.start: 'search'; expected 'network'"):
        fit_together([person], FitOptions.at("fast", "search"), network)
    with pytest.raises(ValueError, match=r"options.stature: 1\.8, of many people; expected none"):
        fit_together([person], replace(FAST, stature=1.8), network)
    soft = replace(person, observation=replace(person.observation, maps=torch.zeros(1, 4, 4)))
    with pytest.raises(ValueError, match=r"people\[1\]: probabilities"):
        fit_together([person, soft], FAST, network)
    with pytest.raises(TypeError, match="people"):
        fit_together([person.observation], FAST, network)  # type: ignore[list-item]
    assert fit_together([], FAST, network) == []


def test_without_the_mirror_image_and_in_bfloat16_people_stay_near() -> None:
    """Of the packaged person: bfloat16 moves joints by some millimetres at most, and both ways are asked for."""
    people = [cut(KEYPOINTS, PARTS, "cpu"), cut(turned(10), None, "cpu")]
    usual = replace(FAST, stages=())
    network = packaged_network("cpu")
    ways = (usual, replace(usual, half=True), replace(usual, mirror=False))
    exact, half, alone = (torch.cat([fit.posed.joints for fit in fit_together(people, way, network)]) for way in ways)
    assert 0 < (half - exact).norm(dim=-1).max() < 0.01
    assert 1e-3 < (alone - exact).norm(dim=-1).max() < 0.1
