"""People of a photo: those who overlap are refined as a scene, all others as before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.quick import QUICK_MESH

from warp_partdr import FitOptions, metrics
from warp_partdr.body.skeletons import MPJPE_JOINTS
from warp_partdr.cameras import Perspective
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.lab.synthetic.scene_people import SceneSample, make_pair
from warp_partdr.solve.ellipsoids.fitting import fit_evidence
from warp_partdr.solve.ellipsoids.result import FitResult
from warp_partdr.solve.mesh.mesh_stage import refine_meshes
from warp_partdr.solve.scene.overlapping import overlapping, refine_people


def fits_of(sample: SceneSample, camera: Perspective | None, device: str) -> list[FitResult]:
    options = replace(FitOptions.at("fast"), guess_camera=False)
    readings = [weigh_evidence(observation.keypoints, observation.parts) for observation in sample.scene.observations]
    return [fit_evidence(each, options, camera=camera, device=device) for each in readings]


def elsewhere(result: FitResult, aside: float) -> FitResult:
    """A person whose labels and keypoints lie elsewhere in the picture [px]."""
    window = replace(result.evidence.window, left=result.evidence.window.left + aside)
    points = result.evidence.keypoints.points + np.float32([aside, 0])
    moved = replace(result.evidence, window=window, keypoints=replace(result.evidence.keypoints, points=points))
    return replace(result, evidence=moved)


def test_who_overlaps_is_one_scene(device) -> None:
    sample = make_pair(103, "clean")
    camera = sample.scene.views[0].camera
    results = fits_of(sample, camera, device)
    assert overlapping(results) == ((0, 1),)
    told: list[str] = []
    fits = refine_people(results, options=QUICK_MESH, progress=lambda name, done, total: told.append(name))
    assert set(told) == {"scene"}
    for person, (fit, first) in enumerate(zip(fits, results, strict=True)):
        assert fit.first is first
        assert fit.ellipbody.energy
        assert fit.ellipbody.stage_seconds.keys() == first.stage_seconds.keys() | {"mesh"}
        error = metrics.pa_mpjpe(fit.landmarks(MPJPE_JOINTS), sample.joints[person, 0])
        assert 1000 * float(error) < 80
        # The measured EllipBody is where the mesh is.
        ours, its = fit.ellipbody.posed.joints[0, 0].cpu().numpy(), fit.landmarks(("pelvis",))[0]
        assert np.linalg.norm(ours - its) < 0.03


def test_a_scene_s_bodies_stay_where_it_has_them(monkeypatch) -> None:
    from warp_partdr.solve.scene import overlapping as module

    seen = []
    real = module.fit_scene

    def spied(*given, **named):
        seen.append(real(*given, **named))
        return seen[-1]

    monkeypatch.setattr(module, "fit_scene", spied)
    sample = make_pair(103, "clean")
    fits = refine_people(fits_of(sample, sample.scene.views[0].camera, "cpu"), options=QUICK_MESH)
    (scene,) = seen
    for person, fit in enumerate(fits):
        there = scene.vertices[person, 0].numpy()
        assert np.abs(fit.vertices - there).max() < 2e-3  # [m]


def test_all_others_are_refined_side_by_side() -> None:
    sample = make_pair(103, "clean")
    near = fits_of(sample, sample.scene.views[0].camera, "cpu")
    apart = [near[0], elsewhere(near[1], 5000.0)]
    weak = fits_of(sample, None, "cpu")
    for results in (apart, weak, near[:1]):
        assert overlapping(results) == ()
    for results in (apart, weak):
        found, expected = (
            refine(results, options=replace(QUICK_MESH, iterations=2)) for refine in (refine_people, refine_meshes)
        )
        for one, other in zip(found, expected, strict=True):
            assert np.array_equal(one.vertices, other.vertices)


@pytest.mark.parametrize("labels", ["none", "others"])
def test_labels_of_one_set_tell_who_is_in_front(labels: str) -> None:
    sample = make_pair(103, "clean")
    results = fits_of(sample, sample.scene.views[0].camera, "cpu")
    if labels == "none":
        changed = [replace(each, observation=replace(each.observation, label_set=None)) for each in results]
    else:
        other = replace(results[0].observation.label_set, at_joints=not results[0].observation.label_set.at_joints)
        changed = [replace(results[0], observation=replace(results[0].observation, label_set=other)), results[1]]
    assert overlapping(changed) == ()
