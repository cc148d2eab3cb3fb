"""Vertices of a scene's people in its pictures: kernels in float32 against torch in float64, body by body."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest
import torch
from helpers.bodies import random_turns

from warp_partdr.body.lens import lens_camera, placed_at
from warp_partdr.solve.mesh.placed_people import PictureViews, pelvises_in_world, place_people
from warp_partdr.solve.scene.clusters import Clusters, slots_of

FRAMES, VERTICES, SIZE = 3, 7, 96


def case(num_views: int, clusters: Clusters = ((0, 1),)) -> tuple[torch.Tensor, torch.Tensor, PictureViews]:
    """Vertices, pelvises and views, in which one of the people is not seen."""
    slots, places = slots_of(clusters, 1 + max(map(max, clusters)), torch.device("cpu"))
    random = torch.Generator().manual_seed(num_views)
    bodies, pictures = len(places) * FRAMES, len(clusters) * FRAMES * num_views
    shown = torch.ones(bodies, num_views, dtype=torch.bool)
    shown[1, 0] = False
    moves = torch.randn(num_views, 3, generator=random), torch.randn(pictures, 3, generator=random)
    views = PictureViews(
        rotations=random_turns(1, num_views, 0.2)[0].float(),
        translations=torch.tensor([0.0, 0.0, 4.0]) + 0.3 * moves[0],
        lenses=torch.tensor([2.0, 0.0, 0.0])
        + 0.3 * torch.randn(len(clusters) * FRAMES * num_views, 3, generator=random),
        observed=shown,
        slots=slots,
        person_slots=places,
    )
    vertices, pelvises = (torch.randn(bodies, *shape, 3, generator=random) for shape in ((VERTICES,), ()))
    return vertices, pelvises, views


def slow_pictures(vertices: torch.Tensor, pelvises: torch.Tensor, views: PictureViews) -> torch.Tensor:
    rows = []
    for people, frame in product(views.slots.tolist(), range(FRAMES)):
        for view, (turn, move) in enumerate(zip(views.rotations.double(), views.translations.double(), strict=True)):
            camera = lens_camera(views.lenses[len(rows)][None].double(), SIZE)
            drawn = []
            for person in people:
                body = max(person, 0) * FRAMES + frame
                seen = camera.project(((vertices[body] + pelvises[body]) @ turn.T + move)[None])[0]
                hidden = seen.new_tensor([0.0, 0.0, -1.0]).expand_as(seen)
                drawn.append(seen if person >= 0 and views.observed[body, view] else hidden)
            rows.append(torch.cat(drawn))
    return torch.stack(rows)


@pytest.mark.parametrize("clusters", [((0, 1),), ((0,), (1,)), ((0, 3), (1,), (2, 4)), ((1, 3),)])
@pytest.mark.parametrize("num_views", [1, 3])
def test_people_are_where_their_cameras_see_them(num_views, clusters, device):
    vertices, pelvises, views = case(num_views, clusters)
    slow = [each.double().requires_grad_() for each in (vertices, pelvises)]
    wanted = slow_pictures(*slow, views)
    fast = [each.to(device).requires_grad_() for each in (vertices, pelvises)]
    found = place_people(*fast, PictureViews(*(each.to(device) for each in vars(views).values())), SIZE)
    torch.testing.assert_close(found.cpu().double(), wanted, atol=1e-3, rtol=1e-4)
    pull = torch.randn(wanted.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    slopes = torch.autograd.grad((found * pull.to(found)).sum(), fast)
    for one, other in zip(slopes, torch.autograd.grad((wanted * pull).sum(), slow), strict=True):
        torch.testing.assert_close(one.cpu().double(), other, atol=1e-2, rtol=1e-3)


def test_points_in_the_camera_have_finite_places(device):
    vertices, pelvises, views = (case(1)[0] * 0, case(1)[1] * 0, case(1)[2])
    views = replace(views, translations=0 * views.translations)
    moving = vertices.to(device).requires_grad_()
    found = place_people(moving, pelvises.to(device), PictureViews(*(v.to(device) for v in vars(views).values())), SIZE)
    (slope,) = torch.autograd.grad(found.sum(), moving)
    assert bool(torch.isfinite(found).all())
    assert bool(torch.isfinite(slope).all())


def test_the_gradient_has_no_derivative():
    vertices, pelvises, views = case(1)
    moving = vertices.requires_grad_()
    (slope,) = torch.autograd.grad(place_people(moving, pelvises, views, SIZE).sum(), moving, create_graph=True)
    with pytest.raises(NotImplementedError, match="place_people"):
        slope.sum().backward()


def test_pelvises_are_where_crops_see_them(device):
    random = torch.Generator().manual_seed(4)
    numbers = torch.randn(4, 6, generator=random)  # columns are not contiguous
    moving, lens = [numbers[:, 0], numbers[:, 1:3]], numbers[:, 3:] + torch.tensor([3.0, 0.0, 0.0])
    turns, moves = random_turns(1, 4, 0.5)[0], torch.randn(4, 3, generator=random)
    slow = [each.double().requires_grad_() for each in moving]
    seen = placed_at(*slow, lens.double())
    wanted = ((seen - moves)[:, None] @ turns.double())[:, 0]
    fast = [each.to(device).requires_grad_() for each in moving]
    found = pelvises_in_world(*fast, lens.to(device), turns.float().to(device), moves.to(device))
    torch.testing.assert_close(found.cpu().double(), wanted, atol=1e-4, rtol=1e-5)
    pull = torch.randn(4, 3, dtype=torch.float64, generator=random)
    slopes = torch.autograd.grad((found * pull.to(found)).sum(), fast, create_graph=True)
    for one, other in zip(slopes, torch.autograd.grad((wanted * pull).sum(), slow), strict=True):
        torch.testing.assert_close(one.detach().cpu().double(), other, atol=1e-4, rtol=1e-4)
    with pytest.raises(NotImplementedError, match="pelvises_in_world"):
        slopes[0].sum().backward()
