"""The mesh stage: a detailed body that shows what the labels do, where the fit that it goes on from was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.quick import QUICK_MESH

from warp_partdr import Perspective, metrics
from warp_partdr.body.template import JOINT_NAMES, PART_NAMES
from warp_partdr.errors import InputError
from warp_partdr.inputs.sample import Sample
from warp_partdr.lab.evaluation.partbench.samples import LABELS, make_sample
from warp_partdr.models.anny import anny
from warp_partdr.models.growth import Growth
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.result import FitResult
from warp_partdr.solve.mesh.energy import mesh_energy
from warp_partdr.solve.mesh.gather import gather_starts
from warp_partdr.solve.mesh.mesh_options import MeshOptions
from warp_partdr.solve.mesh.mesh_stage import MeshFit, refine_mesh, refine_meshes
from warp_partdr.solve.mesh.observed_body import ObservedBody
from warp_partdr.solve.mesh.steps import Steps

HIPS = ("left_hip", "right_hip")


def fitted(sample: Sample, device: str = "cpu", **given: object) -> FitResult:
    options = replace(FitOptions.at("fast"), guess_camera=False)
    return fit_body(sample.keypoints, sample.parts, others=sample.others, options=options, device=device, **given)


@pytest.fixture(scope="module")
def sample() -> Sample:
    return make_sample(4, "clean")


@pytest.fixture(scope="module")
def first(sample) -> FitResult:
    return fitted(sample)


def part_f1(sample: Sample, shown: np.ndarray) -> float:
    return float(metrics.part_f1(metrics.confusion(LABELS.from_parts(shown), sample.target, LABELS.num_groups + 1)))


def test_it_shows_the_labels_better_than_ellipsoids(sample, device):
    first = fitted(sample, device)
    mesh = refine_mesh(first)
    size = sample.target.shape
    before, after = (part_f1(sample, found.draw(size).labels[0].cpu().numpy()) for found in (first, mesh))
    assert after > before + 0.04
    assert mesh.vertices.shape == sample.vertices.shape
    names = ("left_knee", "right_wrist", "neck")
    assert np.abs(mesh.landmarks(names) - first.landmarks(names)).max() < 0.15
    assert set(mesh.body.losses) == {"proj", "depth", "turns", "shape", "clothes", "seg"}


def test_no_steps_leave_ellipbodys_pose(first):
    mesh = refine_mesh(first, options=replace(QUICK_MESH, iterations=0))
    names = ("left_knee", "right_ankle", "left_elbow", "right_wrist", "neck", "head")
    apart = np.linalg.norm(mesh.landmarks(names) - first.landmarks(names), axis=1)
    assert apart.max() < 0.045
    assert mesh.body.losses == {}


@pytest.mark.parametrize("kind", ["depths", "turns"])
def test_the_network_holds_depth_and_turns(first, kind):
    """The surer it says it is, the less the body moves."""
    said, alone = (
        first.uncertainty,
        replace(QUICK_MESH, depth=0.0) if kind == "turns" else replace(QUICK_MESH, turns=0.0),
    )

    def moved(spread: float) -> float:
        stated = replace(first, uncertainty=replace(said, **{kind: spread * getattr(said, kind)}))
        start, found = (
            refine_mesh(stated, options=replace(alone, iterations=steps)).body for steps in (0, QUICK_MESH.iterations)
        )
        if kind == "depths":
            return float((start.detailed.joints - found.detailed.joints)[..., 2].abs().mean())
        return float((3 - (start.rotations.mT @ found.rotations).diagonal(dim1=2, dim2=3).sum(-1)).mean())

    assert moved(0.2) < 0.5 * moved(5.0)


def test_labels_count_alike_at_whatever_size_they_are_drawn(first):
    small, large = (refine_mesh(first, options=MeshOptions(iterations=1, size=size)) for size in (96, 256))
    assert float(small.body.losses["seg"]) == pytest.approx(float(large.body.losses["seg"]), rel=0.1)


def test_of_usual_noise_losses_are_plain_sums(first):
    options = MeshOptions(iterations=1)
    unknown, usual = (refine_mesh(first, options=replace(options, noise=noise)).body for noise in ("unknown", "usual"))
    assert {name for name, loss in usual.losses.items() if loss != unknown.losses[name]} == {"proj", "seg"}
    votes = first.observation.confidence.sum()
    assert 0.1 < float(usual.losses["proj"]) / (options.proj * float(votes)) < 30  # px


def test_without_labels_keypoints_pull_alone(sample):
    alone = fit_body(sample.keypoints, None, options=FitOptions.at("fast"))
    off = []
    for iterations in (0, 20):
        mesh = refine_mesh(alone, options=replace(QUICK_MESH, iterations=iterations))
        assert "seg" not in mesh.body.losses
        places = torch.from_numpy(mesh.landmarks(sample.keypoints.format.marks))[None]
        apart = mesh.camera.project(places)[0, :, :2].numpy() - sample.keypoints.points
        off.append(np.linalg.norm(apart, axis=1)[sample.keypoints.confident].mean())
    assert off[1] < 0.8 * off[0]


def test_a_known_camera_sees_it_in_metres():
    near = make_sample(0, "near")
    found, weak = fitted(near, camera=near.camera), fitted(near)
    first_terms = [refine_mesh(each, options=replace(QUICK_MESH, iterations=1)).body.losses for each in (found, weak)]
    for name in ("proj", "seg"):  # it is seen where it is, as without the camera
        assert first_terms[0][name].item() == pytest.approx(first_terms[1][name].item(), rel=0.25)
    mesh = refine_mesh(found, options=QUICK_MESH)
    assert isinstance(mesh.camera, Perspective)
    assert mesh.camera.focal[0, 0] == pytest.approx(float(near.camera.focal[0, 0]), rel=1e-3)
    pelvis = mesh.landmarks(("pelvis",))[0]
    assert pelvis == pytest.approx(found.landmarks(("pelvis",))[0], abs=0.15)
    assert mesh.ellipbody.landmarks(("pelvis",))[0] == pytest.approx(pelvis, abs=0.015)
    assert 1 < pelvis[2] < 4
    body = mesh.body
    again = body.model.pose(body.shape, body.rotations, body.translation)
    torch.testing.assert_close(again.vertices, body.detailed.vertices)


def test_a_search_s_body_is_held_by_common_spreads(first):
    mesh = refine_mesh(replace(first, uncertainty=None), options=QUICK_MESH)
    assert all(np.isfinite(term) for term in mesh.body.losses.values())


def test_ellipbody_is_measured_from_it(first):
    """Both are one body: joints, what the camera sees, and nothing that an edit would find unexplained."""
    mesh = refine_mesh(first, options=QUICK_MESH)
    body, fit = mesh.body, mesh.ellipbody
    apart = np.linalg.norm(fit.landmarks(JOINT_NAMES) - mesh.landmarks(JOINT_NAMES), axis=1)
    assert apart.max() < 0.02
    assert apart.mean() < 0.008
    assert fit.posed.joints[0, 0].abs().max() < 1e-6  # weak perspective
    assert fit.energy.keys() == body.losses.keys()
    assert fit.stage_seconds["mesh"] > 0
    eye = torch.eye(3).expand(1, 20, 3, 3)
    torch.testing.assert_close(body.stretches, eye, atol=1e-5, rtol=0)
    assert (body.growth == 1).all()
    growth = Growth(body.model, body.shape)
    torch.testing.assert_close(growth.demanded(fit.posed.semi_axes), growth.measured(body.shape), atol=1e-5, rtol=0)


def test_clothes_are_thickness_not_the_body(device):
    """A coat's outline does not fatten the person who wears it."""
    coated = make_sample(9, "clothed")
    first = fitted(coated, device)
    nude, clothed = (refine_mesh(first, options=MeshOptions(clothes=each)) for each in (None, 1.0))
    assert not nude.clothes.any()
    assert "clothes" not in nude.body.losses
    assert clothed.clothes.max() > 0.005
    assert clothed.clothes.min() >= 0
    errors = [
        1000 * metrics.pve(each.vertices, coated.vertices, pelvis=each.landmarks(HIPS).mean(0), target_pelvis=middle)
        for each, middle in (
            (each, coated.joints[[coated.joint_names.index(name) for name in HIPS]].mean(0)) for each in (nude, clothed)
        )
    ]
    assert errors[1] < errors[0] + 2


def test_legs_that_stand_in_each_other_are_parted(first):
    """Nothing else pulls here."""
    turns = first.parameters.rotations.clone()
    for part, angle in (("left_upper_leg", -0.25), ("right_upper_leg", 0.25)):
        turns[0, PART_NAMES.index(part)] = torch.tensor([0.0, 0.0, angle])
    crossed = replace(first, parameters=replace(first.parameters, rotations=turns))
    alone = replace(QUICK_MESH, proj=0.0, seg=0.0, depth=0.0, turns=0.1, apart=1.0)
    found: list[float] = []
    for iterations in (1, 40):
        mesh = refine_mesh(crossed, options=replace(alone, iterations=iterations))
        found.append(float(mesh.body.losses["apart"]))
        assert mesh.ellipbody.energy["apart"] == pytest.approx(found[-1])
    assert found[0] > 10
    assert found[1] < 0.1 * found[0]
    assert "apart" not in refine_mesh(first, options=replace(alone, iterations=1, apart=0.0)).body.losses


@pytest.fixture(scope="module")
def crowd() -> dict[str, list[FitResult]]:
    """Fits that don't go in one batch, by device: of two label sets' kinds, with and without labels and cameras."""
    return {}


def several(crowd: dict[str, list[FitResult]], device: str) -> list[FitResult]:
    if device not in crowd:
        other, third = make_sample(5, "realistic"), make_sample(6, "hard")
        near, close = make_sample(1, "near"), make_sample(2, "near")
        seen = [fitted(other, device), fitted(third, device)]
        seen += [fitted(each, device, camera=each.camera) for each in (near, close)]
        alone = fit_body(other.keypoints, None, options=FitOptions.at("fast"), device=device)
        crowd[device] = [*seen, alone, fitted(near, device)]
    return crowd[device]


def test_people_side_by_side_are_as_alone(crowd, device):
    """Also the second time, when a graph takes other people than those it was captured for.

    Steps are few: rounding, which differs between batches, may move a pixel from one label to another, and many steps
    after that make millimetres of it.
    """
    options = replace(QUICK_MESH, iterations=8)
    firsts, names = several(crowd, device), (*HIPS, "left_wrist", "right_ankle", "head")
    alone = [refine_mesh(each, options=options) for each in firsts]
    for order in ([0, 1, 2, 3, 4, 5], [5, 4, 3, 2, 1, 0]):
        together = refine_meshes([firsts[place] for place in order], options=options)
        for place, mesh in zip(order, together, strict=True):
            assert mesh.first is firsts[place]
            np.testing.assert_allclose(mesh.landmarks(names), alone[place].landmarks(names), atol=1e-4)
            assert mesh.body.losses.keys() == alone[place].body.losses.keys()
            for name, loss in mesh.body.losses.items():
                assert loss.shape == (1,)
                assert float(loss) == pytest.approx(float(alone[place].body.losses[name]), rel=0.05, abs=0.1)
            assert mesh.ellipbody.energy["proj"] == pytest.approx(float(mesh.body.losses["proj"]))
            assert mesh.ellipbody.posed.joints.shape == (1, 21, 3)
    assert refine_meshes([]) == []


def test_steps_start_again_with_other_people(crowd):
    """Captured steps do so, whose tensors stay in their memory."""
    everyone = several(crowd, "cpu")
    seen = [each for each in everyone if each.observation.lens is None and each.observation.label_set is not None][:2]
    energy = mesh_energy(anny(), QUICK_MESH, seen[0].observation.label_set)
    first, second = (gather_starts(energy, anny(), [ObservedBody.of_fit(each)]) for each in seen)
    used, fresh = Steps(energy, first.copied()), Steps(energy, second)
    used.step(1.0)
    used.restart(second)
    for steps in (used, fresh):
        for _ in range(2):
            steps.step(1.0)
    for one, other in zip(vars(used.unknowns).values(), vars(fresh.unknowns).values(), strict=True):
        torch.testing.assert_close(one, other)
    assert used.terms["proj"] == fresh.terms["proj"]


def test_progress_of_batches_is_one(crowd):
    told: list[tuple[str, int, int]] = []
    short = replace(QUICK_MESH, iterations=2)
    refine_meshes(several(crowd, "cpu"), options=short, progress=lambda *news: told.append(news))
    assert told == [("mesh", step, 6) for step in range(1, 7)]  # with labels, with a camera, without labels


def test_progress_is_told(first):
    told: list[tuple[str, int, int]] = []
    refine_mesh(first, options=QUICK_MESH, progress=lambda *news: told.append(news))
    assert told == [("mesh", step, 20) for step in range(1, 21)]


def test_wrong_arguments_are_named(first):
    with pytest.raises(TypeError, match="result"):
        refine_mesh(first.posed)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="results"):
        refine_meshes([first, None])  # type: ignore[list-item]
    with pytest.raises(TypeError, match="model"):
        refine_mesh(first, "anny")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"model: torch\.float64 on cpu; expected torch\.float32 on cpu"):
        refine_mesh(first, anny(dtype=torch.float64))
    with pytest.raises(ValueError, match="iterations"):
        refine_mesh(first, options=replace(QUICK_MESH, iterations=-1))
    with pytest.raises(InputError, match=r"learning_rate: 0\.01; the mesh stage went astray .*; expected a smaller"):
        refine_mesh(first, options=replace(QUICK_MESH, proj=1e38))
    with pytest.raises(ValueError, match="size: 0; expected"):
        MeshOptions(size=0)
    with pytest.raises(ValueError, match="seg: -1"):
        MeshOptions(seg=-1.0)
    with pytest.raises(ValueError, match="seg: None"):
        MeshOptions(seg=None)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="clothes: -1"):
        MeshOptions(clothes=-1.0)
    with pytest.raises(ValueError, match="apart: nan"):
        MeshOptions(apart=float("nan"))
    with pytest.raises(ValueError, match="noise: 'loud'; expected 'unknown' or 'usual'"):
        MeshOptions(noise="loud")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="vertices"):
        replace(QUICK_MESH, vertices=10)


def test_a_caller_s_inference_mode_changes_nothing(first):
    usual = refine_mesh(first, options=QUICK_MESH)
    with torch.inference_mode():
        found = refine_mesh(first, options=QUICK_MESH)
        fit = fit_body(first.evidence.keypoints, first.evidence.picture, quality="fast")
    torch.testing.assert_close(found.body.detailed.vertices, usual.body.detailed.vertices, rtol=0, atol=0)
    assert not fit.posed.joints.is_inference()
    refine_mesh(fit, options=replace(QUICK_MESH, iterations=1))


def test_it_moves_to_another_device_as_a_whole(first, device):
    mesh = refine_mesh(first, options=replace(QUICK_MESH, iterations=1)).to(device)
    assert isinstance(mesh, MeshFit)
    assert mesh.body.detailed.vertices.device.type == mesh.first.parameters.shift.device.type == device
