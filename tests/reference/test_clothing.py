"""Registration against the formula book (eq. 16 to 18)."""

import numpy as np
import pytest
import torch
from helpers.bodies import ellipbodies

from warp_partdr.body.posing import Posed
from warp_partdr.models.anny import anny
from warp_partdr.models.pose import pose_from_ellipbody
from warp_partdr.models.registration import REACH, SCALE, RegistrationWeights, _Loss
from warp_partdr.models.surfaces import surface_samples
from warp_partdr.reference.ellipbody import PosedEllipsoid
from warp_partdr.reference.registration import (
    DetailedSurface,
    closest_points,
    icp_to_ellipsoids,
    icp_to_mesh,
    penetration_loss,
    radial_distance,
    registration_loss,
)


def numpy(tensor: torch.Tensor) -> np.ndarray:
    return tensor.cpu().double().numpy()


def ellipsoids_of(posed: Posed, body: int) -> list[PosedEllipsoid]:
    axes, centres, sizes = (numpy(tensor[body]) for tensor in (posed.axes, posed.centres, 2 * posed.semi_axes))
    return [PosedEllipsoid(a, c, *size) for a, c, size in zip(axes, centres, sizes, strict=True)]


def test_registration_terms_are_the_books(device):
    """The body lies 4 cm beside its EllipBody."""
    weights = RegistrationWeights(icp=1.0, penetration=10.0)
    model, posed, body = anny(torch.device(device)), ellipbodies(device), 1
    shape = torch.zeros(2, model.num_shapes, device=device)
    rotations, translation = pose_from_ellipbody(model, posed, shape)
    detailed = model.pose(shape, rotations, translation + 0.04)
    loss = _Loss(model, posed, weights)
    loss.sample_weights[:, torch.arange(loss.samples.shape[1]) % 9 > 0] = 0  # the book is slow
    for moved in (0.01, 0.0):  # the second time refits the mesh
        loss.search(detailed.vertices + moved)
    loss.sample_weights[loss.places.amin(-1) < 1e-4] = 0  # what is closest is a side, whose faces' normals differ
    loss.search(detailed.vertices)
    terms = loss(detailed, shape, shape[:, None, :3])

    face_parts = model.face_parts.cpu().numpy().astype(int) - 1
    skin = numpy(loss.areas), loss.parts.cpu().numpy()
    surface = DetailedSurface(numpy(detailed.vertices[body]), *skin, model.faces.cpu().numpy(), face_parts)
    samples, areas = numpy(loss.samples[body]), numpy(loss.sample_weights[body])
    ellipsoids, scale, reach = ellipsoids_of(posed, body), SCALE, REACH
    want = {
        "icp_to_mesh": 1e4 * icp_to_mesh(surface, samples, areas, scale, reach),
        "icp_to_ellipsoids": 1e4 * icp_to_ellipsoids(surface, ellipsoids, scale),
        "penetration": 10 * penetration_loss(surface.vertices, ellipsoids, surface.areas),
    }
    for name, value in want.items():
        assert terms[name][body].item() == pytest.approx(value, rel=1e-4), name
        assert value > 1e-2
    both = registration_loss(
        surface, ellipsoids, samples, areas, scale=scale, reach=reach, icp_weight=1e4, penetration_weight=10
    )
    assert both == pytest.approx(sum(want.values()))


def test_samples_within_another_ellipsoid_do_not_count(device):
    posed = ellipbodies(device, 1)
    samples, weights = (numpy(tensor[0]) for tensor in surface_samples(posed))
    own = np.arange(len(samples)) // (len(samples) // 20)
    e = np.stack([radial_distance(samples, each) for each in ellipsoids_of(posed, 0)])
    np.testing.assert_allclose(e[own, np.arange(len(samples))], 1, atol=1e-4)
    e[own, np.arange(len(samples))] = np.inf
    sure = np.abs(e - 1).min(0) > 1e-4
    np.testing.assert_array_equal(weights[sure] == 0, (e < 1).any(0)[sure])
    assert 0.05 < (weights == 0).mean() < 0.5


def test_penetration_agrees_with_numbers_by_hand():
    """An ellipsoid of 2 × 4 × 6: half way out along each axis, at its surface, and outside."""
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # length along y, first thickness along z, second along x
    ellipsoid = PosedEllipsoid(turn, np.array([1.0, 1, 1]), 2.0, 4.0, 6.0)
    offsets = np.array([[0, 0.5, 0], [0, 0, -1], [1.5, 0, 0], [0, 1, 0], [0, 5, 0]])
    np.testing.assert_allclose(radial_distance(1 + offsets, ellipsoid), [0.5, 0.5, 0.5, 1, 5])
    assert penetration_loss(1 + offsets, [ellipsoid]) == pytest.approx(3 * 0.25)
    assert penetration_loss(1 + offsets, [ellipsoid] * 2, np.array([1.0, 0, 0, 9, 9])) == pytest.approx(2 * 0.25)


def test_closest_points_of_a_triangle_are_found():
    """The points lie above the inside, beyond a side, and beyond a corner."""
    triangle = np.array([[[0.0, 0, 0], [4, 0, 0], [0, 4, 0]]])
    for point, wanted in (
        ((1, 1, 2), (1, 1, 0)),
        ((2, -3, 1), (2, 0, 0)),
        ((3, 3, 1), (2, 2, 0)),
        ((9, -1, 0), (4, 0, 0)),
    ):
        np.testing.assert_allclose(closest_points(np.array(point, dtype=float), triangle)[0], wanted, atol=1e-12)
