"""Losses of training and refinement, against the formula book (eq. 3 to 6 and 19)."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from helpers.bodies import moved_bodies, unsure_observation, walker

from warp_partdr.body.labels import label_set
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.body.skeletons import MPJPE_HIPS, MPJPE_JOINTS
from warp_partdr.lab.training.picture_losses import body_terms
from warp_partdr.lab.training.task import weighted_losses
from warp_partdr.networks.regression.landmarks import LANDMARKS
from warp_partdr.networks.regression.predicted import posed_landmarks
from warp_partdr.reference.losses import (
    IGNORE,
    joint_loss,
    label_gradient,
    learning_objective,
    projection_loss,
    refinement_energy,
    segmentation_loss,
    size_loss,
)
from warp_partdr.reference.mesh import part_maps
from warp_partdr.render.ellipsoids import draw_ellipsoids
from warp_partdr.render.renderers import RendererEllipsoids, RendererMesh
from warp_partdr.solve.ellipsoids.captured import CapturedRefinement
from warp_partdr.solve.ellipsoids.energy import Energy, Weights

SIZE, LABELS = 64, label_set("surreal14")
REFERENCE_SIZE = 256  # [px] of the crop in whose pixels losses count


def numpy(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().cpu().double().numpy()


def maps_of(labels: np.ndarray, count: int) -> np.ndarray:
    return part_maps(labels.astype(int) - 1, np.arange(1, 256), count)


@pytest.mark.parametrize("path", ["torch", "kernels"])
def test_energy_is_the_books(device, path):
    body = walker(device)
    sizes = {"lengths": 0.9 * body.lengths[0], "thicknesses": 1.1 * body.thicknesses[0]}  # expected of the person
    seen = replace(unsure_observation(body, labels=LABELS), **sizes)
    seen.labels[:9, :30] = IGNORE
    weights = {"seg": 1e-2, "proj": 1.0, "l": 1e-3, "t": 2e-3}
    energy = Energy(seen, size=SIZE, weights=Weights(1.0, 1e-2, 1e-3, 2e-3))
    bodies = moved_bodies(body, 3)
    terms = energy(bodies) if path == "torch" else CapturedRefinement(energy, 3, iterations=0).refine(bodies).terms
    found = torch.stack([terms[name] for name in ("proj", "seg", "length", "thickness")])

    groups = LABELS.part_groups[1:].astype(int)
    parts = draw_ellipsoids(bodies.posed(), bodies.camera(SIZE), (SIZE, SIZE), part_labels=groups.tolist()).parts
    points = bodies.camera(REFERENCE_SIZE).project(LandmarkGather(seen.body_points, device)(bodies.posed()))[..., :2]
    target = numpy(seen.labels)
    for b in range(3):
        maps = part_maps(parts[b].cpu().numpy().astype(int) - 1, groups, 14)
        l_seg = segmentation_loss(maps, maps_of(target, 14), target != IGNORE) * (REFERENCE_SIZE / SIZE) ** 2
        wanted = (numpy(seen.points) + 1) * REFERENCE_SIZE / 2
        l_proj = projection_loss(numpy(points[b]), wanted, numpy(energy.landmark_weights[0]))
        l_l = size_loss(numpy(bodies.lengths[b]), numpy(seen.lengths))
        l_t = size_loss(numpy(bodies.thicknesses[b]), numpy(seen.thicknesses))
        of_each = [weights[name] * term for name, term in zip(weights, (l_seg, l_proj, l_l, l_t), strict=True)]
        np.testing.assert_allclose(numpy(found[:, b]), np.array(of_each)[[1, 0, 2, 3]], rtol=1e-4)
        assert min(of_each) > 0.1
        assert sum(numpy(found[:, b])) == pytest.approx(refinement_energy(l_seg, l_proj, l_l, l_t, weights), rel=1e-4)


def test_training_terms_are_the_books(rng):
    bodies = moved_bodies(walker(), 2)
    joints, has_joints = posed_landmarks(bodies.posed(), MPJPE_JOINTS).flip(0) + 0.1, torch.ones(2, len(MPJPE_JOINTS))
    has_joints[1, MPJPE_JOINTS.index("neck")] = 0
    keypoints = torch.from_numpy(rng.random((2, len(LANDMARKS), 3))).float()
    plain = torch.zeros(2, dtype=torch.bool)
    examples = SimpleNamespace(joints=joints, has_joints=has_joints, keypoints=keypoints, annotated=plain)
    terms = body_terms(SimpleNamespace(bodies=bodies), examples)
    l_3d = l_proj = 0.0
    points = bodies.camera(REFERENCE_SIZE).project(posed_landmarks(bodies.posed(), LANDMARKS))[..., :2]
    for b in range(2):
        have, wanted = (100 * numpy(each[b]) for each in (posed_landmarks(bodies.posed(), MPJPE_JOINTS), joints))
        known = numpy(has_joints[b])
        have, wanted = (each - each[MPJPE_HIPS].mean(0) for each in (have, wanted))
        l_3d += joint_loss(have, wanted, known / known.sum()) / 2
        pixels = (numpy(keypoints[b, :, :2]) + 1) * REFERENCE_SIZE / 2
        l_proj += projection_loss(numpy(points[b]), pixels, numpy(keypoints[b, :, 2])) / 2
    assert terms["joints"].item() == pytest.approx(l_3d, rel=1e-5)
    assert terms["proj"].item() == pytest.approx(l_proj, rel=1e-5)
    # In the paper's own words: nothing weighs, and nothing is left out.
    assert joint_loss(np.eye(3), np.zeros((3, 3))) == 3
    assert projection_loss(np.array([[3.0, -4.0], [0.0, 1.0]]), np.zeros((2, 2))) == 8


@pytest.mark.parametrize("left_out", [set(), {"seg"}])
def test_training_loss_is_the_books(left_out):
    terms, weights = {"joints": 3.0, "proj": 5.0, "seg": 7.0}, {"joints": 1.0, "proj": 0.5, "seg": 1e-2}
    loss = weighted_losses({name: torch.tensor(term) for name, term in terms.items()}, weights, left_out)["total"]
    weights = {name: 0.0 if name in left_out else weight for name, weight in weights.items()}
    assert loss.item() == pytest.approx(learning_objective(terms, weights))


@pytest.mark.parametrize("renderer", [RendererMesh(), RendererEllipsoids()], ids=["mesh", "ellipsoids"])
def test_label_losses_are_the_books(device, rng, renderer):
    bodies = moved_bodies(walker(device), 2)
    target = torch.from_numpy(rng.integers(0, 22, (2, SIZE, SIZE))).to(device, torch.uint8)
    target[target == 21] = IGNORE
    loss, image = renderer.label_loss(bodies.posed(), bodies.camera(SIZE), target)
    for b in range(2):
        shown, wanted = numpy(image.labels[b]), numpy(target[b])
        maps, wanted_maps = maps_of(shown, 20), maps_of(wanted, 20)
        assert loss[b].item() == segmentation_loss(maps, wanted_maps, wanted != IGNORE)
        # Its slope, of a quadratic by differences.
        change = rng.normal(size=maps.shape)
        there, back = (segmentation_loss(maps + s * change, wanted_maps, wanted != IGNORE) for s in (0.5, -0.5))
        assert there - back == pytest.approx((label_gradient(shown, wanted, 20) * change).sum())
