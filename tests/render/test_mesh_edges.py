"""The mesh renderer's gradient "edges" against its float64 definition, and against differences of covered area."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.pictures import (
    CAMERAS,
    draw_on_screen,
    faces,
    mesh_picture,
    mesh_scene,
    noisy_picture,
    projected_bodies,
    push_on_screen,
    relative_error,
    smooth_maps,
)

from warp_partdr.reference.coverage import dense_costs, target_costs
from warp_partdr.reference.mesh_edges import mesh_edges_gradient
from warp_partdr.render.mesh_passes import MeshPasses, mesh_passes
from warp_partdr.render.part_mesh import mesh_constants

SIZES = [(21, 34), (40, 32)]  # pixel by pixel, and four a word
EDGES = {"gradient": "edges"}


def check_definition(leaf, mesh, image, costs, perspective):
    for b, of_body in enumerate(costs):
        want = mesh_edges_gradient(mesh_scene(leaf[b], mesh, perspective), mesh_picture(image, b), of_body)
        assert np.abs(want[:, :2]).max() > 0
        assert relative_error(leaf.grad[b].cpu().numpy(), want) < 1e-4


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("size", SIZES)
def test_gradient_of_maps_is_its_definition(device, size, perspective):
    leaf, mesh = projected_bodies(1, size, device, perspective, batch=2)
    image = draw_on_screen(leaf, mesh, size, perspective=perspective, num_maps=20, **EDGES)
    g = np.stack([smooth_maps(seed, 20, size) for seed in range(2)])
    (image.maps * torch.tensor(g, dtype=torch.float32, device=device)).sum().backward()
    check_definition(leaf, mesh, image, [dense_costs(each) for each in g], perspective)


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("size", SIZES)
def test_gradient_of_the_label_loss_is_its_definition(device, size, perspective):
    leaf, mesh = projected_bodies(3, size, device, perspective, batch=2)
    target = noisy_picture(draw_on_screen(leaf, mesh, size, perspective=perspective).labels, 20, 0)
    _, image = push_on_screen(leaf, mesh, target, perspective=perspective, **EDGES)
    check_definition(leaf, mesh, image, [target_costs(each.cpu().numpy(), 20) for each in target], perspective)


@pytest.mark.parametrize("seed", [0, 1])
def test_gradient_is_that_of_area(device, seed):
    """Along smooth motions of the picture, of smooth costs, against differences of areas in sixteenths of pixels."""
    size, fine = (112, 96), 16
    leaf, mesh = projected_bodies(seed, size, device, subdivisions=2)
    costs = torch.tensor(smooth_maps(seed, 20, size), dtype=torch.float32, device=device)[None]
    (draw_on_screen(leaf, mesh, size, num_maps=20, **EDGES).maps * costs).sum().backward()

    def area_cost(points):
        scale = points.new_tensor([fine, fine, 1.0])
        labels = draw_on_screen(points * scale, mesh, (fine * size[0], fine * size[1])).labels.long()
        layers = torch.cat([torch.zeros_like(costs[:, :1]), costs], dim=1)
        layers = layers.repeat_interleave(fine, 2).repeat_interleave(fine, 3)
        return float(layers.gather(1, labels[:, None]).double().sum()) / fine**2

    points, errors, sizes = leaf.detach(), [], []
    away = (points[..., :2] - points[..., :2].mean(1, keepdim=True)) / 30
    turned = torch.stack([-away[..., 1], away[..., 0]], -1)
    ones = torch.ones_like(away)
    for way in (ones * ones.new_tensor([1.0, 0.0]), ones * ones.new_tensor([0.0, 1.0]), away, turned):
        step = torch.cat([0.25 * way, torch.zeros_like(points[..., :1])], -1)
        want = (area_cost(points + step) - area_cost(points - step)) / 0.5
        errors.append(float((leaf.grad[..., :2] * way).sum()) - want)
        sizes.append(want)
    assert np.linalg.norm(errors) < 0.05 * np.linalg.norm(sizes)


def rectangle(device, label=1, depth=1.0, left=4, right=10):
    """Two faces that cover rows 5 to 12."""
    a, b, c, d = ([x, y, depth] for x, y in ((left, 5), (right, 5), (right, 13), (left, 13)))
    return faces([[a, b, c], [a, c, d]], [label, label], device)


def test_the_gradient_of_a_rectangle_agrees_with_numbers_by_hand(device):
    """Eight rows on either side should be two pixels further to the right: 16 pixels' cost a pixel of way."""
    leaf, mesh = rectangle(device)
    target = torch.zeros(1, 16, 16, dtype=torch.uint8, device=device)
    target[:, 5:13, 6:12] = 1
    push_on_screen(leaf, mesh, target, **EDGES)
    torch.testing.assert_close(leaf.grad.sum((0, 1)).cpu(), torch.tensor([-16.0, 0.0, 0.0]))


def test_a_picture_that_is_the_target_has_no_gradient(device):
    """Exactly none: on either side of a border the two pixels' costs are opposite."""
    leaf, mesh = projected_bodies(2, (40, 32), device)
    push_on_screen(leaf, mesh, draw_on_screen(leaf, mesh, (40, 32)).labels, **EDGES)
    assert (leaf.grad == 0).all()


@pytest.mark.parametrize("front", [0, 1])
def test_the_nearer_face_carries_a_border(device, front):
    depths = [2.0, 2.0]
    depths[front] = 1.0
    (one, _), (other, _) = (rectangle(device, depth=depths[0]), rectangle(device, depth=depths[1], left=8, right=14))
    points = torch.cat([one, other], dim=1).detach()
    leaf, mesh = faces(points.reshape(-1, 3, 3).tolist(), [1, 1, 2, 2], device)
    target = torch.full((1, 16, 16), 255, dtype=torch.uint8, device=device)
    target[:, 5:13, 6:12] = 1  # where 2 shows, too: the border between them moves to the right
    push_on_screen(leaf, mesh, target, **EDGES)
    pulls = leaf.grad[0, :, 0].reshape(2, 6).sum(1)
    assert float(pulls[front]) == pytest.approx(-16.0)
    assert float(pulls[1 - front]) == 0.0


def test_parts_in_no_group_cost_nothing(device):
    leaf, mesh = rectangle(device)
    target = torch.zeros(1, 16, 16, dtype=torch.uint8, device=device)
    push_on_screen(leaf, mesh.relabel({1: 255}), target, **EDGES)
    assert (leaf.grad == 0).all()


def test_other_gradients_are_refused(device):
    leaf, mesh = rectangle(device)
    with pytest.raises(ValueError, match="gradient: 'coverage'; expected one of edges, partdr, of a mesh"):
        draw_on_screen(leaf, mesh, (16, 16), gradient="coverage")


@pytest.mark.parametrize("gradient", ["edges", "partdr"])
def test_the_custom_operations_take_the_gradient_along(device, gradient):
    _, mesh = rectangle(device)
    for cull, perspective in ((False, True), (True, False)):
        passes = mesh_passes(*mesh_constants(replace(mesh, cull_backfaces=cull)), perspective, 0.0, 3.0, 1.0, gradient)
        assert (passes.cull_backfaces, passes.perspective) == (cull, perspective)
        assert MeshPasses.of((mesh.faces, mesh.face_labels, mesh.edges), *passes.settings()) is passes
