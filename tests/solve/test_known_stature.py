"""A stature that is known: bodies have it, and cameras see the same as without."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from helpers.people import crowd
from helpers.quick import QUICK_MESH

from warp_partdr import FitOptions, fit_body
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.stature import bone_statures
from warp_partdr.errors import InputError
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.observations import Observations
from warp_partdr.inputs.sample import Sample
from warp_partdr.lab.evaluation.partbench.samples import NEAR, make_sample
from warp_partdr.lab.synthetic.scene_people import make_pair, make_views
from warp_partdr.models.anny import anny
from warp_partdr.models.measuring import statures
from warp_partdr.networks.regression.checkpoint import packaged_network
from warp_partdr.networks.regression.predict import ask_network
from warp_partdr.pipelines.photo import fit_photo
from warp_partdr.results.save import describe_body, describe_mesh
from warp_partdr.solve.ellipsoids.fitting import fit_evidence
from warp_partdr.solve.ellipsoids.result import FitResult
from warp_partdr.solve.mesh.mesh_stage import MeshFit, refine_meshes
from warp_partdr.solve.scene.fitting import fit_scene
from warp_partdr.solve.scene.options import SceneOptions

FAST = FitOptions.at("fast")
TALL = 1.93  # [m]


def fitted(sample: Sample, stature: float | None, device: str = "cpu", **given) -> FitResult:
    options = replace(given.pop("options", FAST), stature=stature)
    return fit_body(sample.keypoints, sample.parts, options=options, others=sample.others, device=device, **given)


def standing(found: FitResult) -> float:
    return bone_statures(found.parameters.lengths).item()


def alike(sample: Sample, *found: FitResult | MeshFit) -> float:
    """Share of the pixels of either that both show as the same."""
    one, other = (each.draw(sample.target.shape).labels[0].cpu().numpy() for each in found)
    shown = (one > 0) | (other > 0)
    return (one == other)[shown].mean()


@pytest.mark.parametrize("start", ["network", "search"])
def test_the_body_has_it_and_is_seen_as_without(device, start):
    sample = make_sample(14, "clean")
    options = FAST if start == "network" else replace(FAST, start="search", stages=FAST.search)
    options = replace(options, guess_camera=False)
    plain, tall = (fitted(sample, stature, device, options=options) for stature in (None, TALL))
    assert standing(tall) == pytest.approx(TALL, rel=1e-5)
    assert abs(standing(plain) - TALL) > 0.05
    assert alike(sample, plain, tall) > 0.9
    assert not tall.camera.perspective
    larger = (tall.landmarks(("neck",)) / plain.landmarks(("neck",)))[0, 1]
    assert larger == pytest.approx(TALL / standing(plain), rel=0.05)


def test_before_a_known_camera_who_is_taller_is_farther_away(device):
    sample = make_sample(5, NEAR)
    plain, tall = (fitted(sample, stature, device, camera=sample.camera) for stature in (None, TALL))
    share = TALL / standing(plain)
    assert abs(share - 1) > 0.05
    torch.testing.assert_close(tall.posed.joints, share * plain.posed.joints, rtol=0.02, atol=0.02)
    assert alike(sample, plain, tall) > 0.9


def test_what_the_network_says_of_a_larger_body_is_of_one_farther_away():
    sample = make_sample(5, NEAR)
    seen = fitted(sample, None, options=replace(FAST, stages=())).observation
    said = ask_network(Observations.of([seen]), packaged_network("cpu"))
    larger = said.resized(torch.tensor([1.2]))
    points = [each.camera(256).project(each.posed().joints)[..., :2] for each in (said, larger)]
    torch.testing.assert_close(*points, rtol=1e-5, atol=1e-3)
    torch.testing.assert_close(larger.posed().joints, 1.2 * said.posed().joints)
    torch.testing.assert_close(larger.uncertainty.depths, 1.2 * said.uncertainty.depths)
    torch.testing.assert_close(1 / larger.uncertainty.nearness, 1.2 / said.uncertainty.nearness)
    body = said.parameters()
    torch.testing.assert_close(body.resized(torch.tensor([1.2])).tensors(), larger.parameters().tensors())


def test_the_mesh_has_it_and_others_beside_stay_as_they_are(device):
    samples = [make_sample(index, "clean") for index in (3, 4)]
    plain = [fitted(sample, None, device) for sample in samples]
    tall = fitted(samples[0], TALL, device)
    model = anny(torch.device(device))
    one, other = refine_meshes([tall, plain[1]], model, options=QUICK_MESH)
    both = refine_meshes(plain, model, options=QUICK_MESH)
    assert statures(model, one.body.shape).item() == pytest.approx(TALL, abs=1e-4)
    assert torch.equal(other.body.shape, both[1].body.shape)
    assert alike(samples[0], one, both[0]) > 0.9
    (grown,) = refine_meshes([replace(plain[0], stature=TALL)], model, options=QUICK_MESH)  # from the guessed size on
    assert alike(samples[0], grown, both[0]) > 0.9
    assert statures(model, grown.body.shape).item() == pytest.approx(TALL, abs=1e-4)
    assert standing(one.ellipbody) == pytest.approx(TALL, rel=0.02)
    assert describe_body(one.ellipbody)["stature_given_cm"] == 193.0
    assert describe_mesh(one.body)["stature"] == pytest.approx(193.0, abs=0.1)
    assert "stature_given_cm" not in describe_body(other.ellipbody)


def test_a_body_that_is_given_is_resized():
    sample = make_sample(4, "clean")
    first = fitted(sample, None)
    readings = weigh_evidence(sample.keypoints, sample.parts)
    options = replace(FAST, stages=(), stature=TALL)
    again = fit_evidence(readings, options, body=first.parameters)
    assert standing(again) == pytest.approx(TALL, rel=1e-5)


@pytest.mark.parametrize("stature", [178, 0.0, -1.7, float("nan"), True, "1.78"])
def test_nobodys_is_told(stature):
    with pytest.raises(InputError, match=r"stature: .*; expected metres, 0\.4 to 2\.8"):
        FitOptions(stature=stature)


def test_of_several_people_it_is_whose():
    picture, _ = crowd(2)
    with pytest.raises(InputError, match=r"stature: 1\.8 m, for 2 people; expected one of them, person 0 to 1"):
        fit_photo(picture, options=FitOptions(stature=1.8))
    fit = fit_photo(picture, person=0, options=replace(FAST, mesh=QUICK_MESH, stature=1.8))
    assert statures(fit.fits[0].body.model, fit.fits[0].body.shape).item() == pytest.approx(1.8, abs=1e-4)


def test_a_person_of_a_film_has_it_in_all_frames_and_is_seen_as_without(device):
    """Before a camera that stands somewhere in the world."""
    one = make_views(1, 1).scene  # the first of whom all limbs are seen: a hidden one may end anywhere
    turn = rotation_from_axis_angle(torch.tensor([0.3, -0.2, 0.1]))
    view = replace(one.views[0], rotation=turn, translation=torch.tensor([0.5, -0.3, 1.0]))
    scene = replace(one, views=[view], observations=[replace(one.observations[0], frame=frame) for frame in range(3)])
    options = SceneOptions(mesh=QUICK_MESH)
    plain, tall = (fit_scene(scene, options=replace(options, stature=each), device=device) for each in (None, TALL))
    assert tall.statures.tolist() == pytest.approx([TALL], abs=1e-4)
    assert abs(plain.statures.item() - TALL) > 0.1
    before, after = (view.to_camera(each.joints[0, 1]).cpu() for each in (plain, tall))
    pixels = [view.camera.project(each[None])[..., :2] for each in (before, after)]
    assert (pixels[0] - pixels[1]).abs().max() < 6  # of 400
    share = TALL / plain.statures.item()
    torch.testing.assert_close(after.norm(dim=1), share * before.norm(dim=1), rtol=0.02, atol=0)


def test_a_film_of_several_people_or_before_several_cameras_is_told():
    options = SceneOptions(stature=TALL)
    for scene, told in (
        (make_pair(101, "clean").scene, "2 people and 1 cameras"),
        (make_views(3, 2).scene, "1 people and 2 cameras"),
    ):
        with pytest.raises(
            InputError, match=f"stature: 1.93 m, for {told}; expected one person in front of one camera"
        ):
            fit_scene(scene, options=options)
    with pytest.raises(InputError, match=r"stature: 178; expected metres"):
        SceneOptions(stature=178)
