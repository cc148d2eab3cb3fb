"""Costs of landmarks before cameras: kernels in float32 against torch in float64."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from warp_partdr.cameras import Camera, Perspective, WeakPerspective
from warp_partdr.inputs.observation import REFERENCE_SIZE
from warp_partdr.solve.mesh.landmark_costs import LandmarkAims, landmark_costs

VIEWS, LANDMARKS, KEYPOINTS, JOINTS = 5, 13, 8, 6


def slow_costs(landmarks: torch.Tensor, camera: Camera, aims: LandmarkAims) -> tuple[torch.Tensor, torch.Tensor]:
    marks = landmarks.gather(1, aims.landmark_indices[..., None].expand(-1, -1, 3))
    apart = camera.project(marks)[..., :2] - (aims.points.double() + 1) * REFERENCE_SIZE / 2
    depths = landmarks[:, aims.ends, 2]
    moved = depths[:, 1:] - depths[:, :1] - aims.depths
    return (apart.abs().sum(-1) * aims.weights).sum(1), (moved.square() * aims.depth_weights).sum(1)


def case(*, perspective: bool) -> tuple[torch.Tensor, torch.Tensor, LandmarkAims]:
    """Landmarks, intrinsics and aims; several keypoints mark one landmark, some have no vote."""
    random = torch.Generator().manual_seed(3)
    landmarks = torch.randn(VIEWS, LANDMARKS, 3, generator=random) + torch.tensor([0.0, 0.0, 4.0])
    focal = 300 + 100 * torch.rand(VIEWS, 2 if perspective else 1, generator=random).expand(-1, 2)
    cameras = torch.cat([focal, 128 + 20 * torch.randn(VIEWS, 2, generator=random)], dim=1)
    aims = LandmarkAims(
        landmark_indices=torch.randint(LANDMARKS, (VIEWS, KEYPOINTS), generator=random),
        points=torch.randn(VIEWS, KEYPOINTS, 2, generator=random),
        weights=torch.rand(VIEWS, KEYPOINTS, generator=random) * (torch.arange(KEYPOINTS) % 3 > 0),
        ends=torch.randperm(LANDMARKS, generator=random)[: JOINTS + 1],
        depths=torch.randn(VIEWS, JOINTS, generator=random),
        depth_weights=10 * torch.rand(VIEWS, JOINTS, generator=random),
    )
    return landmarks, cameras, aims


def camera_of(intrinsics: torch.Tensor, *, perspective: bool) -> Camera:
    if perspective:
        return Perspective(intrinsics[:, :2], intrinsics[:, 2:])
    return WeakPerspective(intrinsics[:, 0], intrinsics[:, 2:])


@pytest.mark.parametrize("perspective", [False, True])
def test_costs_and_gradients_are_torchs(perspective, device):
    landmarks, cameras, aims = case(perspective=perspective)
    found, slopes = [], []
    for dtype, where, costs in ((torch.float32, device, landmark_costs), (torch.float64, "cpu", slow_costs)):
        moving = [each.detach().to(where, dtype).requires_grad_() for each in (landmarks, cameras)]
        own = LandmarkAims(*(each.to(where) for each in vars(aims).values()))
        seen, deep = costs(moving[0], camera_of(moving[1], perspective=perspective), own)
        slopes.append(torch.autograd.grad((seen + 7 * deep * torch.arange(VIEWS, device=where)).sum(), moving))
        found.append((seen, deep))
    for one, other in zip((*found[0], *slopes[0]), (*found[1], *slopes[1]), strict=True):
        torch.testing.assert_close(one.detach().cpu().double(), other.detach(), rtol=1e-5, atol=1e-3)
    assert slopes[1][0].abs().amax(0).min(1).values.gt(0).any()


def test_what_lies_in_the_camera_has_finite_costs(device):
    landmarks, cameras, aims = case(perspective=True)
    landmarks[:, :, 2] = torch.tensor([0.0, 1e-9, -1e-9, -3.0, 2.0])[:, None]
    moving = landmarks.to(device).requires_grad_()
    own = LandmarkAims(*(each.to(device) for each in vars(aims).values()))
    seen, deep = landmark_costs(moving, camera_of(cameras.to(device), perspective=True), own)
    (slope,) = torch.autograd.grad(seen.sum() + deep.sum(), moving)
    assert all(bool(torch.isfinite(each).all()) for each in (seen, deep, slope))
    wanted, _ = slow_costs(landmarks.double(), camera_of(cameras.double(), perspective=True), aims)
    torch.testing.assert_close(seen.detach().cpu().double(), wanted, rtol=1e-5, atol=1e-3)


def test_a_keypoint_on_its_landmark_costs_nothing():
    landmarks, cameras, aims = case(perspective=True)
    pictures = camera_of(cameras, perspective=True).project(landmarks)[..., :2] / (REFERENCE_SIZE / 2) - 1
    exact = replace(aims, points=pictures.gather(1, aims.landmark_indices[..., None].expand(-1, -1, 2)))
    seen, _ = landmark_costs(landmarks, camera_of(cameras, perspective=True), exact)
    assert seen.max() < 1e-3


def test_the_gradient_has_no_derivative():
    landmarks, cameras, aims = case(perspective=False)
    moving = landmarks.requires_grad_()
    seen, _ = landmark_costs(moving, camera_of(cameras, perspective=False), aims)
    (slope,) = torch.autograd.grad(seen.sum(), moving, create_graph=True)
    with pytest.raises(NotImplementedError, match="landmark_costs"):
        slope.sum().backward()


def test_nobody_costs_nothing():
    landmarks, cameras, aims = case(perspective=False)
    none = LandmarkAims(*(each if each is aims.ends else each[:0] for each in vars(aims).values()))
    seen, deep = landmark_costs(landmarks[:0], camera_of(cameras[:0], perspective=False), none)
    assert seen.shape == deep.shape == (0,)


@pytest.mark.parametrize("perspective", [False, True])
def test_what_is_not_finite_stays_nan(perspective, device):
    """Landmarks and cameras: cost and gradient of their view, and of no other."""
    for broken in range(2):
        given = case(perspective=perspective)
        voted = given[2].landmark_indices[1, 1]  # by a keypoint with a weight
        moving = [each.clone().to(device) for each in given[:2]]
        moving[broken][(1, voted, 0) if broken == 0 else (1, 2)] = torch.nan
        moving = [each.requires_grad_() for each in moving]
        aims = LandmarkAims(*(each.to(device) for each in vars(given[2]).values()))
        seen, _ = landmark_costs(moving[0], camera_of(moving[1], perspective=perspective), aims)
        assert seen.isnan().tolist() == [False, True, False, False, False]
        slopes = torch.autograd.grad(seen.sum(), moving)
        for slope in slopes:
            assert slope.flatten(1).isnan().any(1).tolist() == [False, True, False, False, False]
