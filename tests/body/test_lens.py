"""Bodies before a known camera, and the rays through their pelvises."""

from __future__ import annotations

import pytest
import torch
from helpers.bodies import random_bodies

from warp_partdr.body.lens import find_camera, move_pelvises, place_bodies, ray_rotations, turn_to_rays

LENS = torch.tensor([2.5, 0.8, -1.2])


def test_the_pelvis_is_seen_at_the_same_place_and_size(device):
    bodies = random_bodies(4, device)
    weak = bodies.camera(100)
    posed, camera = place_bodies(bodies, bodies.posed(), LENS.to(device), 100)
    torch.testing.assert_close(camera.project(posed.joints[:, :1])[:, 0, :2], weak.translation, rtol=1e-4, atol=1e-3)
    across = torch.tensor([0.1, 0.0, 0.0], device=device)
    seen = camera.project(torch.stack([posed.joints[:, 0], posed.joints[:, 0] + across], dim=1))
    torch.testing.assert_close(seen[:, 1, 0] - seen[:, 0, 0], 0.1 * weak.scale, rtol=1e-3, atol=1e-3)
    assert place_bodies(bodies, posed, None, 100)[0] is posed


def test_rays_turn_the_axis_to_the_pelvis_the_shortest_way(device):
    bodies = random_bodies(5, device)
    turns = ray_rotations(bodies, LENS.to(device))
    identity = torch.eye(3, device=device).expand(5, 3, 3)
    torch.testing.assert_close(turns @ turns.transpose(1, 2), identity, rtol=0, atol=1e-5)
    pelvis = place_bodies(bodies, bodies.posed(), LENS.to(device), 2)[0].joints[:, 0]
    ray = pelvis / pelvis.norm(dim=1, keepdim=True)
    torch.testing.assert_close(turns[..., 2], ray, rtol=0, atol=1e-5)
    # A shortest way has the angle between its ends.
    torch.testing.assert_close((turns.diagonal(dim1=1, dim2=2).sum(1) - 1) / 2, ray[:, 2], rtol=0, atol=1e-5)
    turned = turn_to_rays(bodies, LENS.to(device)).global_orient()
    torch.testing.assert_close(turned, turns @ bodies.global_orient(), rtol=0, atol=1e-5)


@pytest.mark.parametrize("lens", [None, LENS])
def test_a_moved_pelvis_is_seen_where_it_is(lens: torch.Tensor | None, device: str) -> None:
    bodies = random_bodies(4, device)
    given = None if lens is None else lens.to(device)
    moves = torch.tensor([0.05, -0.1, 0.2], device=device).expand(4, 3)
    moved = move_pelvises(bodies, given, moves)
    (before, places), (after, new_places) = (find_camera(each, given, 100) for each in (bodies, moved))
    assert (places is None) == (lens is None)
    places, new_places = (torch.zeros_like(moves) if each is None else each for each in (places, new_places))
    if lens is None:  # the origin is the pelvis, before and after
        seen, again = before.project(moves[:, None]), after.project(new_places[:, None])
        torch.testing.assert_close(moved.log_scale, bodies.log_scale)
    else:
        torch.testing.assert_close(new_places, places + moves, rtol=1e-4, atol=1e-5)
        seen, again = before.project((places + moves)[:, None]), after.project(new_places[:, None])
    torch.testing.assert_close(again[..., :2], seen[..., :2], rtol=1e-4, atol=1e-3)
