"""Soft light on bodies: smooth, with even edges, and decent."""

import numpy as np
import pytest
import torch
from helpers.bodies import upright

from warp_partdr.cameras import Perspective, WeakPerspective
from warp_partdr.models.anny import anny
from warp_partdr.models.model import detailed_mesh
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import PartMesh
from warp_partdr.results.overlays import CLOTHES_COLOUR, clothes_over
from warp_partdr.results.palette import PART_COLOURS
from warp_partdr.results.shading import BodySurface, shade_mesh, shade_skin

SIZE = (240, 120)
WHITE = np.full((21, 3), 200, dtype=np.uint8)


def standing():
    """Anny at rest, seen from the front in the middle of the picture."""
    return anny().rest_vertices[None] * torch.tensor([1.0, -1.0, -1.0])


def from_ahead(zoom=1.0):
    return WeakPerspective(torch.tensor([125.0 * zoom]), torch.tensor([[60.0, 125.0]]) * zoom)


def globe(rows=12):
    """Coarse ball of radius 1, as a mesh of one part."""
    points = [[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]]
    for height in np.linspace(0, np.pi, rows)[1:-1]:
        for turn in np.linspace(0, 2 * np.pi, 2 * rows, endpoint=False):
            points.append([np.sin(height) * np.cos(turn), -np.cos(height), np.sin(height) * np.sin(turn)])
    around, faces = 2 * rows, []
    for ring in range(rows - 3):
        for step in range(around):
            a, b = 2 + ring * around + step, 2 + ring * around + (step + 1) % around
            faces += [[a, b, a + around], [b, b + around, a + around]]
    last = 2 + (rows - 3) * around
    for step in range(around):
        faces += [[0, 2 + (step + 1) % around, 2 + step], [1, last + step, last + (step + 1) % around]]
    mesh = PartMesh.from_faces(np.array(faces)[:, ::-1], np.ones(len(faces), dtype=np.uint8))
    return torch.tensor(points, dtype=torch.float32)[None], mesh


def test_light_changes_evenly_over_the_faces_of_a_coarse_ball():
    """No stripes: from pixel to pixel the brightness changes little, and it is greater at the upper left."""
    points, mesh = globe()
    rgba = shade_mesh(points, mesh, WeakPerspective(torch.tensor([90.0]), torch.full((1, 2), 100.0)), (200, 200), WHITE)
    inside = rgba[40:160, 40:160, 0].astype(int)
    assert np.abs(np.diff(inside, axis=0)).max() <= 8
    assert np.abs(np.diff(inside, axis=1)).max() <= 8
    assert np.ptp(inside) > 60
    upper_left, lower_right = (rgba[at, at, 0].astype(int) for at in (65, 135))
    assert upper_left > lower_right + 50


@pytest.mark.parametrize("side", [100, 900])  # many samples a pixel, and few
def test_outlines_are_smooth_and_no_darker(side):
    points, mesh = globe(24)
    camera = WeakPerspective(torch.tensor([side * 0.45]), torch.full((1, 2), side / 2))
    rgba = shade_mesh(points, mesh, camera, (side, side), WHITE).astype(int)
    edge = (rgba[..., 3] > 0) & (rgba[..., 3] < 255)
    assert len(np.unique(rgba[edge][:, 3])) == (8 if side == 100 else 3)
    whole = rgba[rgba[..., 3] == 255][:, 0]
    assert rgba[edge][:, 0].min() > whole.min() - 12
    covered = rgba[..., 3].sum() / 255
    assert covered == pytest.approx(np.pi * (0.45 * side) ** 2, rel=0.01)


def test_the_back_is_dimmer_where_something_is_close_before_it():
    """Contact takes light away: a wall is darker around a plate that is close before it than elsewhere."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=np.float32)
    wall = np.column_stack([corners, np.full(4, 3.0)])
    plate = np.column_stack([0.25 * corners, np.full(4, 2.85)])
    square = np.array([[0, 2, 1], [0, 3, 2]])
    mesh = PartMesh.from_faces(np.concatenate([square, square + 4]), np.ones(4, dtype=np.uint8))
    points = torch.from_numpy(np.concatenate([wall, plate]).astype(np.float32))[None]
    camera = Perspective(torch.tensor([[300.0, 300.0]]), torch.full((1, 2), 100.0))
    grey = shade_mesh(points, mesh, camera, (200, 200), WHITE)[..., 0].astype(int)
    assert grey[100, 128] < grey[100, 170] - 5  # 3 px beside the plate, and far from it
    assert grey[100, 100] >= grey[100, 170] - 3


def test_a_body_wears_a_suit_unless_skin_is_asked_for():
    """Trunk and thighs are darker in a T-shirt and shorts, which differ; head, hands and feet look the same."""
    model, camera = anny(), from_ahead()
    worn, bare = (shade_skin(standing(), model, camera, SIZE, bare=each).astype(float) for each in (False, True))
    labels = draw_mesh(standing(), detailed_mesh(model), camera, SIZE).labels[0].numpy()
    share = worn[..., 0] / np.maximum(bare[..., 0], 1)
    head = labels == 8
    head[head.any(1).nonzero()[0].max() - 8 :] = False
    np.testing.assert_array_equal(worn[head], bare[head])
    chest, hips = (np.median(share[np.isin(labels, some)]) for some in ([4], [1, 2]))
    assert chest == pytest.approx(0.86, abs=0.03)
    assert hips == pytest.approx(0.74, abs=0.04)


def test_seams_are_sharp_lines():
    """The hem of the shorts is a step within a pixel or two, not a gradient over the mesh's faces."""
    worn, bare = (
        shade_skin(standing(), anny(), from_ahead(4), (960, 480), bare=each)[:, 285, 0].astype(float)
        for each in (False, True)
    )
    share = worn[600:760] / np.maximum(bare[600:760], 1)
    between = (share > 0.8) & (share < 0.95)
    assert between.sum() <= 2
    assert (share > 0.95).sum() > 20
    assert (share < 0.8).sum() > 20


def test_pale_parts_fade_and_the_rest_stays():
    pale = np.zeros(21, dtype=bool)
    pale[[10, 12, 14]] = True  # the right leg
    some, whole = (shade_skin(standing(), anny(), from_ahead(), SIZE, pale=each) for each in (pale, None))
    legs = slice(160, 235)
    for side, opacity in ((slice(61, 120), 255), (slice(0, 59), 102)):
        middle = whole[legs, side, 3] == 255
        assert np.median(some[legs, side, 3][middle]) == pytest.approx(opacity, abs=1)
    np.testing.assert_array_equal(some[:90], whole[:90])


def test_ellipsoids_of_each_part_keep_their_colours():
    """In the same light: the parts' colours are scaled, not mixed."""
    points, mesh = globe()
    rgba = shade_mesh(
        points, mesh, WeakPerspective(torch.tensor([90.0]), torch.full((1, 2), 100.0)), (200, 200), PART_COLOURS
    )
    inside = rgba[60:140, 60:140, :3].astype(float)
    hue = inside / inside.sum(-1, keepdims=True)
    np.testing.assert_allclose(hue, np.broadcast_to(PART_COLOURS[1] / PART_COLOURS[1].sum(), hue.shape), atol=0.02)


def test_clothes_are_a_thin_line_around_the_body():
    """The line lies where the mesh in its clothes ends, and nothing else of the picture changes."""
    body = upright()
    thick = torch.tensor([[0.0, 0.0, 0.05, 0.05, 0.0, 0.0, 0.05, 0.05]])
    white, camera = np.full((*SIZE, 3), 255, dtype=np.uint8), from_ahead()
    drawn = clothes_over(white, body, thick, camera)
    line = (drawn != 255).any(-1)
    covered = draw_mesh(body.clothed(thick).vertices, detailed_mesh(body.model), camera, SIZE).labels[0].numpy() > 0
    edge = covered[:, 1:] != covered[:, :-1]
    assert line[:, 1:][edge].all()
    assert line[:, :-1][edge].all()
    assert not line[~near(covered)].any()
    strong = (np.abs(drawn.astype(int) - CLOTHES_COLOUR) < 60).all(-1)
    assert strong.sum() > 300
    assert line.mean() < 0.12


def near(covered):
    """Pixels that have both kinds of pixels among their neighbours and themselves."""
    padded = np.pad(covered, 1, mode="edge")
    around = [padded[y : y + covered.shape[0], x : x + covered.shape[1]] for y, x in np.ndindex(3, 3)]
    return np.any(around, axis=0) & ~np.all(around, axis=0)


@pytest.mark.parametrize("bare", [False, True])
def test_a_surface_that_is_moved_looks_like_one_that_is_made_there(bare):
    """The light stays where it is, so that normals turn with the body."""
    turn, offset, scale = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), np.array([0.1, 0.0, 0.2]), 0.9
    surface = BodySurface.of_body(standing(), anny(), bare=bare)
    there = torch.from_numpy((standing()[0].double().numpy() + offset) * scale @ turn.T).float()[None]
    moved = surface.moved(turn, offset, scale).draw(from_ahead(), SIZE).astype(int)
    made = shade_skin(there, anny(), from_ahead(), SIZE, bare=bare).astype(int)
    assert (moved[..., 3] > 0).sum() > 2000
    assert (np.abs(moved - made).max(-1) > 2).mean() < 0.001
    still = surface.draw(from_ahead(), SIZE)
    np.testing.assert_array_equal(still, shade_skin(standing(), anny(), from_ahead(), SIZE, bare=bare))
