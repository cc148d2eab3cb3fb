"""Arguments of both renderers: types and strides that change nothing, and what is refused by name."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from scenes.pictures import (
    GRADIENTS,
    Intrinsics,
    Leaves,
    ball,
    body_parameters,
    checked_target,
    draw_on_screen,
    loss_on_screen,
    one_scene,
    triangle,
)

from warp_partdr.body.posing import pose
from warp_partdr.cameras import Crop, Perspective, WeakPerspective
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import ellipbody_mesh

SIZE = (24, 32)
HALVES = [torch.float16, torch.bfloat16, torch.float64]


@pytest.mark.parametrize("dtype", HALVES)
@pytest.mark.parametrize("gradient", GRADIENTS)
def test_other_types_give_what_float32_gives(device, gradient, dtype):
    scene = one_scene((0.1, 0, 3), (0.5, 0.4, 0.3), True)
    target = checked_target(SIZE, 2, device)
    found = []
    for kind in (dtype, torch.float32):
        tensors = [tensor.detach().to(dtype).to(kind) for tensor in Leaves.of(scene, device=device).tensors().values()]
        tensors = [tensor.requires_grad_() for tensor in tensors]
        loss, image = ellipsoid_label_loss(
            Ellipsoids(*tensors[:3]), Intrinsics(tensors[3], True), target, gradient=gradient
        )
        gradients = torch.autograd.grad(loss.sum(), tensors)
        assert all(tensor.dtype == kind and torch.isfinite(tensor).all() for tensor in gradients)
        found.append((image.labels, *gradients))
    for have, want in zip(*found, strict=True):
        assert torch.equal(have, want.to(have.dtype))


@pytest.mark.parametrize("dtype", HALVES)
def test_other_types_of_vertices_give_what_float32_gives(device, dtype):
    vertices, mesh = triangle(device)
    target = checked_target((8, 8), 1, device)
    found = []
    for kind in (dtype, torch.float32):
        leaf = vertices.to(dtype).to(kind).requires_grad_()
        loss, image = loss_on_screen(leaf, mesh, target)
        (gradient,) = torch.autograd.grad(loss.sum(), leaf)
        assert gradient.dtype == kind
        assert torch.isfinite(gradient).all()
        found.append((image.labels, gradient))
    for have, want in zip(*found, strict=True):
        torch.testing.assert_close(have, want.to(have.dtype))


BAD_NUMBERS = [math.nan, math.inf, -math.inf, 1e300]


def spoiled(tensor, value):
    tensor = tensor.double().clone()
    tensor.view(-1)[-1] = value
    return tensor


@pytest.mark.parametrize("value", BAD_NUMBERS)
@pytest.mark.parametrize("name", ["centres", "axes", "semi_axes", "camera"])
def test_ellipsoids_that_are_no_numbers_are_named(device, name, value):
    ellipsoids, camera = ball(device=device)
    tensors = {name: getattr(ellipsoids, name).double() for name in ("centres", "axes", "semi_axes")}
    tensors["camera"] = camera.intrinsics.double()
    tensors[name] = spoiled(tensors[name], value)
    seen = Intrinsics(tensors.pop("camera"), False)
    target = torch.zeros(1, 8, 8, dtype=torch.uint8, device=device)
    for call in (draw_ellipsoids, ellipsoid_label_loss):
        with pytest.raises(ValueError, match=f"{name}: "):
            call(Ellipsoids(**tensors), seen, (8, 8) if call is draw_ellipsoids else target)


@pytest.mark.parametrize("value", BAD_NUMBERS)
def test_vertices_that_are_no_numbers_are_named(device, value):
    vertices, mesh = triangle(device)
    target = torch.zeros(1, 8, 8, dtype=torch.uint8, device=device)
    with pytest.raises(ValueError, match="vertices: "):
        draw_on_screen(spoiled(vertices, value), mesh, (8, 8))
    with pytest.raises(ValueError, match="vertices: "):
        loss_on_screen(spoiled(vertices, value), mesh, target)


@pytest.mark.parametrize("value", BAD_NUMBERS)
@pytest.mark.parametrize("name", ["global_orient", "translation", "rotations", "lengths", "thicknesses"])
def test_poses_that_are_no_numbers_are_named(device, name, value):
    parameters = {name: tensor.double() for name, tensor in body_parameters(0, device).items()}
    with pytest.raises(ValueError, match=f"{name}: "):
        pose(**{**parameters, name: spoiled(parameters[name], value)})


def test_a_near_plane_that_is_no_number_is_named():
    with pytest.raises(ValueError, match="near: nan"):
        WeakPerspective(torch.ones(1), torch.ones(1, 2), math.nan)
    with pytest.raises(ValueError, match="near: nan"):
        Perspective(torch.ones(1, 2), torch.ones(1, 2), math.nan)


def test_nothing_behind_a_perspective_camera_is_drawn(device):
    """Whatever the near plane."""
    bodies, _ = ball(device=device)
    behind = replace(bodies, centres=-bodies.centres)
    camera = Perspective(torch.full((1, 2), 8.0, device=device), torch.full((1, 2), 4.0, device=device), near=-10.0)
    assert (draw_ellipsoids(behind, camera, (8, 8)).labels == 0).all()
    vertices, mesh = triangle(device)
    for depth in (-1.0, 0.0, 1e-40):
        moved = torch.cat([vertices[..., :2], torch.full_like(vertices[..., 2:], depth)], -1)
        assert (draw_mesh(moved, mesh, camera, (8, 8)).labels == 0).all()


BAD_CAMERAS = {
    "scale: shape": lambda: WeakPerspective(torch.ones(1, 1), torch.ones(1, 2)),
    "scale: float": lambda: WeakPerspective(1.0, torch.ones(1, 2)),
    "translation: shape": lambda: WeakPerspective(torch.ones(2), torch.ones(1, 2)),
    "translation: torch.float64": lambda: WeakPerspective(torch.ones(1), torch.ones(1, 2).double()),
    "translation: on meta": lambda: WeakPerspective(torch.ones(1), torch.ones(1, 2, device="meta")),
    "focal: torch.int64": lambda: Perspective(torch.ones(1, 2).long(), torch.ones(1, 2)),
    "centre: shape": lambda: Perspective(torch.ones(1, 2), torch.ones(1, 3)),
    "left: nan": lambda: Crop(math.nan, 0.0, 1.0, (8, 8)),
    "zoom: 0.0": lambda: Crop(0.0, 0.0, 0.0, (8, 8)),
    "zoom: inf": lambda: Crop(0.0, 0.0, math.inf, (8, 8)),
    "image_size: int": lambda: draw_on_screen(*triangle(), 8),
    "image_size: NoneType": lambda: draw_ellipsoids(*ball(), None),
    "vertices: torch.sparse_coo": lambda: draw_on_screen(triangle()[0].to_sparse(), triangle()[1], (8, 8)),
    "vertices: list": lambda: loss_on_screen([[1.0]], triangle()[1], torch.zeros(1, 8, 8, dtype=torch.uint8)),
    "vertices: shape": lambda: loss_on_screen(torch.ones(()), triangle()[1], torch.zeros(1, 8, 8, dtype=torch.uint8)),
    "global_orient: list": lambda: pose([1.0], *list(body_parameters(0).values())[1:]),
    "num_maps: 1.5": lambda: draw_on_screen(*triangle(), (8, 8), num_maps=1.5),
    "num_maps: 'a'": lambda: draw_ellipsoids(*ball(), (8, 8), num_maps="a"),
}


@pytest.mark.parametrize("message", BAD_CAMERAS)
def test_other_bad_calls_name_the_argument(message):
    with pytest.raises((ValueError, TypeError), match=message):
        BAD_CAMERAS[message]()


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_expanded_and_strided_tensors_give_what_contiguous_ones_give(device, gradient):
    """With gradients, which must not be written twice to memory that is shared."""
    scene = one_scene((0.1, 0, 3), (0.5, 0.4, 0.3), True)
    target = checked_target(SIZE, 2, device)
    found = []
    for strided in (False, True):
        leaves = Leaves.of(scene, device=device)
        tensors = [tensor.expand(3, *tensor.shape[1:]) for tensor in leaves.tensors().values()]
        if strided:
            tensors = [tensor.transpose(0, -1).contiguous().transpose(0, -1) for tensor in tensors]
            wanted = target.expand(3, -1, -1)
        else:
            tensors, wanted = [tensor.contiguous() for tensor in tensors], target.repeat(3, 1, 1)
        loss, image = ellipsoid_label_loss(
            Ellipsoids(*tensors[:3]), Intrinsics(tensors[3], True), wanted, gradient=gradient
        )
        loss.sum().backward()
        found.append([image.labels, image.depth, loss.detach(), *(tensor.grad for tensor in leaves.tensors().values())])
    for have, want in zip(*found, strict=True):
        assert torch.equal(have, want)


@pytest.mark.parametrize(
    "option", [{"max_distance": -1.0}, {"max_distance": math.nan}, {"depth_weight": -0.5}, {"depth_weight": math.nan}]
)
def test_the_mesh_renderer_refuses_the_same_options(option):
    mesh = ellipbody_mesh(0)
    vertices = torch.zeros(1, mesh.num_vertices, 3)
    with pytest.raises(ValueError, match=f"{next(iter(option))}: "):
        draw_on_screen(vertices, mesh, (8, 8), **option)
    with pytest.raises(ValueError, match=f"{next(iter(option))}: "):
        loss_on_screen(vertices, mesh, torch.zeros(1, 8, 8, dtype=torch.uint8), **option)
