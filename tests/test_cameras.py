"""Cameras: what they project, and that every conversion is exact."""

from dataclasses import replace

import pytest
import torch

from warp_partdr.cameras import Crop, Perspective, WeakPerspective

DOUBLE = torch.float64
POINTS = torch.tensor([[[0.1, -0.4, 0.2], [-0.3, 0.5, -0.1], [0.0, 0.0, 0.0]]], dtype=DOUBLE)
CROP = Crop(left=-12.5, top=40.25, zoom=1.75, size=(256, 192))


def weak() -> WeakPerspective:
    return WeakPerspective(torch.tensor([120.0], dtype=DOUBLE), torch.tensor([[210.0, 95.0]], dtype=DOUBLE))


def full() -> Perspective:
    return Perspective(torch.tensor([[900.0, 950.0]], dtype=DOUBLE), torch.tensor([[320.0, 240.0]], dtype=DOUBLE))


def test_projections_agree_with_numbers_by_hand():
    for camera, point, seen in (
        (weak(), [0.1, -0.4, 0.2], [222.0, 47.0, 0.2]),
        (full(), [0.5, -0.25, 2.0], [545.0, 121.25, 2.0]),
    ):
        image = camera.project(torch.tensor([[point]], dtype=DOUBLE))
        torch.testing.assert_close(image[0, 0], torch.tensor(seen, dtype=DOUBLE))


@pytest.mark.parametrize("depth", [0.0, -1.0, 1e-12])
def test_points_at_and_behind_the_camera_stay_finite(depth):
    points = torch.tensor([[[0.5, -0.25, depth]]], dtype=torch.float32, requires_grad=True)
    camera = Perspective(torch.tensor([[900.0, 900.0]]), torch.tensor([[320.0, 240.0]]))
    image = camera.project(points)
    image.sum().backward()
    assert torch.isfinite(image).all()
    assert torch.isfinite(points.grad).all()
    assert image[0, 0, 2] == depth


@pytest.mark.parametrize("camera", [weak(), full()])
def test_crop_camera_sees_the_cropped_picture(camera):
    points = POINTS + torch.tensor([0.0, 0.0, 3.0], dtype=DOUBLE)
    in_full = camera.project(points)[..., :2]
    in_crop = camera.in_crop(CROP).project(points)[..., :2]
    torch.testing.assert_close(in_crop, CROP.to_crop(in_full))
    torch.testing.assert_close(CROP.to_full(in_crop), in_full)
    back = camera.in_crop(CROP).in_full(CROP).project(points)[..., :2]
    torch.testing.assert_close(back, in_full)


@pytest.mark.parametrize("camera", [weak(), full()])
def test_crops_keep_the_near_plane(camera):
    near = replace(camera, near=1.5)
    assert near.in_crop(CROP).near == near.in_full(CROP).near == near.in_crop(CROP).near_plane == 1.5


def test_hmr_parameters_round_trip_and_mean_what_they_say():
    parameters = torch.tensor([[0.9, 0.1, -0.2]], dtype=DOUBLE)
    camera = WeakPerspective.from_hmr(parameters, 224)
    torch.testing.assert_close(camera.to_hmr(224), parameters)
    # x = s (X + t_x) in [-1, 1] of the crop
    normalised = camera.project(POINTS)[..., :2] / 112 - 1
    torch.testing.assert_close(normalised, 0.9 * (POINTS[..., :2] + parameters[0, 1:]))


def test_weak_and_perspective_agree_in_the_origins_plane():
    focal, centre = torch.tensor([1000.0], dtype=DOUBLE), torch.tensor([[320.0, 240.0]], dtype=DOUBLE)
    camera, translation = weak().to_perspective(focal, centre)
    flat = POINTS * torch.tensor([1.0, 1.0, 0.0], dtype=DOUBLE)
    seen = camera.project(flat + translation[:, None])[..., :2]
    torch.testing.assert_close(seen, weak().project(flat)[..., :2])
    back = camera.to_weak(translation)
    torch.testing.assert_close(back.scale, weak().scale)
    torch.testing.assert_close(back.translation, weak().translation)
    # farther away and longer, the perspective camera comes as near to the weak one as one likes
    far, away = weak().to_perspective(focal * 1e5, centre)
    torch.testing.assert_close(
        far.project(POINTS + away[:, None])[..., :2], weak().project(POINTS)[..., :2], atol=1e-2, rtol=0
    )


def test_a_weak_camera_takes_the_mean_focal_length():
    """Pixels are not square: at the body's depth, it is too wide by as much as it is too low."""
    point = torch.tensor([[0.5, -0.25, 2.0]], dtype=DOUBLE)
    camera = full().to_weak(point)
    torch.testing.assert_close(camera.scale, torch.tensor([925.0 / 2], dtype=DOUBLE))
    torch.testing.assert_close(camera.translation, torch.tensor([[545.0, 121.25]], dtype=DOUBLE))
    aside = torch.tensor([[[0.1, 0.1, 0.0]]], dtype=DOUBLE)
    off = (camera.project(aside) - full().project(point + aside))[0, 0]
    assert off[0] > 1
    assert off[1] == pytest.approx(-off[0])


@pytest.mark.parametrize("wrong", [0.0, -900.0])
def test_cameras_look_forward(wrong):
    centre = torch.tensor([[320.0, 240.0]] * 2)
    for focal in ([[900.0, 900.0], [wrong, 900.0]], [[900.0, wrong], [900.0, 900.0]]):
        with pytest.raises(ValueError, match=f"focal: {wrong:g}; expected positive numbers"):
            Perspective(torch.tensor(focal), centre)
    with pytest.raises(ValueError, match=f"scale: {wrong:g}; expected positive numbers"):
        WeakPerspective(torch.tensor([120.0, wrong]), centre)
    # A number that a training lost stays NaN.
    assert Perspective(torch.full((2, 2), torch.nan), centre).focal.isnan().all()


def test_cameras_are_made_within_transforms():
    centre = torch.tensor([[320.0, 240.0]])

    def seen(focal: torch.Tensor) -> torch.Tensor:
        return Perspective(focal[None], centre).project(torch.tensor([[[0.1, 0.2, 2.0]]])).sum()

    focals = torch.tensor([[900.0, 950.0], [400.0, 450.0]])
    slopes = torch.func.vmap(torch.func.grad(seen))(focals)
    torch.testing.assert_close(slopes, torch.tensor([[0.05, 0.1]] * 2))
