"""Extreme faces are drawn right and have finite, right gradients: points, needles, a million pixels wide."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scenes.pictures import (
    CAMERAS,
    PLACE,
    checked_target,
    draw_on_screen,
    faces,
    mesh_picture,
    mesh_scene,
    push_on_screen,
)

from warp_partdr.reference import mesh as reference
from warp_partdr.render.part_mesh import PartMesh

few = settings(max_examples=25, derandomize=True, deadline=None)


@st.composite
def grids_of_faces(draw):
    """Faces on a quarter-pixel grid, each at one depth: all float32 products are exact, so pictures must be equal.

    Corners fall on pixel centres and on one another, so there are points, needles, twins and shared edges.
    """
    count = draw(st.integers(1, 5))
    place = st.tuples(st.integers(-8, 56), st.integers(-8, 48))
    corners = draw(st.lists(place, min_size=3 * count, max_size=3 * count))
    depths = draw(st.lists(st.sampled_from([-1.0, 0.0, 1.0, 1.0, 2.0]), min_size=count, max_size=count))
    index = draw(st.lists(st.integers(0, 3 * count - 1), min_size=3 * count, max_size=3 * count))
    vertices = np.concatenate([np.array(corners) / 4, np.repeat(depths, 3)[:, None]], 1)
    # Some faces share corners, and so lie askew; the others have three of their own.
    shared = draw(st.integers(0, count))
    index[3 * shared :] = range(3 * shared, 3 * count)
    labels = draw(st.lists(st.integers(1, 3), min_size=count, max_size=count))
    return vertices.astype(np.float32), np.reshape(index, (-1, 3)), np.array(labels)


MESH_SIZE = (11, 13)


def rounding_decides(vertices, index):
    """Whether an edge meets a scan line so near a pixel's centre that float32 may put it on the other side."""
    for face in index:
        for a, b in ((vertices[face[k]], vertices[face[(k + 1) % 3]]) for k in range(3)):
            for along, across in ((0, 1), (1, 0)):
                low, high = sorted((a[across], b[across]))
                lines = np.arange(np.ceil(low - 0.5), np.ceil(high - 0.5)) + 0.5
                share = (lines - a[across]) / (b[across] - a[across]) if low < high else lines[:0]
                place = (1 - share) * a[along] + share * b[along] - 0.5
                near = np.abs(place - np.round(place)) < 1e-4
                if (near & (share != share.astype(np.float32))).any():
                    return True
    return False


@few
@given(scene=grids_of_faces(), perspective=st.booleans())
def test_any_faces_are_drawn_right_and_pushed_right(device, scene, perspective):
    vertices, index, labels = scene
    mesh = PartMesh.from_faces(index, labels, device=device)
    g = np.random.default_rng(0).normal(size=(3, *MESH_SIZE)).astype(np.float32).astype(float)
    leaf = torch.from_numpy(vertices).to(device)[None].requires_grad_()
    image = draw_on_screen(leaf, mesh, MESH_SIZE, perspective=perspective, num_maps=3)
    (image.maps[0] * torch.tensor(g, dtype=torch.float32, device=device)).sum().backward()
    body, picture = mesh_scene(leaf[0], mesh, perspective), mesh_picture(image)
    want = reference.rasterize(body, MESH_SIZE)
    np.testing.assert_allclose(picture.depth, want.depth, rtol=1e-5, atol=1e-5)
    ties = picture.face_index != want.face_index  # of faces askew that meet: rounding decides
    np.testing.assert_array_equal(picture.labels[~ties], want.labels[~ties])
    assume(not rounding_decides(body.vertices, index))
    forces = reference.gradient(body, picture, g)
    have = leaf.grad[0].cpu().numpy()
    scale = max(np.abs(forces).max(), 1.0)
    np.testing.assert_allclose(have / scale, forces / scale, atol=2e-4)


@few
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(-2, 6),
    thin=st.floats(-6, 0),
    depth=st.floats(-2, 4),
    perspective=st.booleans(),
)
def test_wild_faces_stay_finite_and_cover_what_they_should(device, seed, size, thin, depth, perspective):
    """Needles a millionth as wide as long, a hundredth of a pixel or a million of them."""
    rng = np.random.default_rng(seed)
    count, (height, width) = 4, MESH_SIZE
    way = rng.normal(size=(count, 2))
    across = np.stack([-way[:, 1], way[:, 0]], 1) * 10**thin
    middle = rng.uniform(0, 1, (count, 2)) * (width, height)
    places = middle[:, None] + 10**size * np.stack([way, -way + across, -way - across], 1)
    z = 10**depth * rng.uniform(1, 1.5, (count, 3, 1))
    leaf, mesh = faces(np.concatenate([places, z], 2), np.arange(1, count + 1), device)
    loss, image = push_on_screen(leaf, mesh, checked_target(MESH_SIZE, count, device), perspective=perspective)
    assert torch.isfinite(leaf.grad).all()
    assert torch.isfinite(loss).all()
    assert (torch.isfinite(image.depth) == (image.labels > 0)).all()
    # Moved by what float32 can't tell apart, the reference's picture must hold the kernel's.
    body = replace(mesh_scene(leaf[0], mesh, perspective), near=-np.inf)
    off = PLACE + 1e-6 * np.abs(body.vertices[..., :2]).max()
    moved = [replace(body, vertices=body.vertices + np.array(way)) for way in product(*[(-off, 0, off)] * 2, [0])]
    seen = [reference.rasterize(each, MESH_SIZE).labels for each in moved]
    sure = (np.array(seen) == seen[4]).all(0)
    sure &= np.diff(depths_of_faces(body), axis=0)[0] > 1e-4 * 10**depth
    np.testing.assert_array_equal(image.labels[0].cpu().numpy()[sure], seen[4][sure])


def depths_of_faces(body):
    """Of each pixel's two nearest faces, inf where there are fewer, (2, H, W)."""
    depths = [reference.face_index_map(replace(body, faces=face[None]), MESH_SIZE)[1] for face in body.faces]
    nearest = np.sort(depths, 0)[:2]
    return np.where(np.isfinite(nearest), nearest, (np.full((2, 1, 1), 1e30) * [[[1]], [[2]]]))


EXTREME_FACES = {  # corners (x, y, z), and how many pixels of 12 x 12 show something
    "a point": ([[5.5, 5.5, 1]] * 3, 0),
    "a line": ([[1.5, 1.5, 1], [5.5, 5.5, 1], [9.5, 9.5, 2]], 0),
    "a needle": ([[0.5, 0.5, 1], [11.5, 11.5, 1], [11.5, 11.499, 1]], None),
    "a million pixels wide": ([[-1e6, -1e6, 1], [1e6, -1e6, 1], [0, 1e6, 1.5]], 144),
    "a million pixels off": ([[1e6, 1e6, 1], [1e6 + 9, 1e6, 1], [1e6, 1e6 + 9, 1]], 0),
    "at depth 0": ([[1, 1, 0], [11, 1, 0], [1, 11, 0]], None),
    "10 km away": ([[1, 1, 1e4], [11, 1, 1e4], [1, 11, 1.0001e4]], None),
}


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("name", EXTREME_FACES)
def test_extreme_faces(device, name, perspective):
    corners, shows = EXTREME_FACES[name]
    leaf, mesh = faces(corners, [1], device)
    target = checked_target((12, 12), 1, device)
    loss, image = push_on_screen(leaf, mesh, target, perspective=perspective)
    want = reference.rasterize(mesh_scene(leaf[0], mesh, perspective), (12, 12))
    np.testing.assert_array_equal(image.labels[0].cpu().numpy(), want.labels)
    np.testing.assert_allclose(image.depth[0].cpu().numpy(), want.depth, rtol=1e-5)
    assert shows is None or (image.labels > 0).sum() == shows
    assert torch.isfinite(leaf.grad).all()
    assert loss.item() == (image.labels != target).sum()
