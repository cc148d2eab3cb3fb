"""PartDR's rule in the formula book (eq. 9 to 12) by hand: what kernels are held to must itself be right."""

import numpy as np
import pytest
import torch

from warp_partdr.cameras import WeakPerspective
from warp_partdr.reference.mesh import MeshScene, face_index_map, gradient, part_maps, rasterize
from warp_partdr.reference.partdr import PixelLine, Rule, depth_slope, line_slope, switch_slope
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import PartMesh

# An edge of part 1 at 3.2 px, whose part ends to the right; part 2 shows at one pixel on either side.
SHOWN = np.array([0, 1, 2, 0, 0, 2, 0, 1])
DEPTH = np.array([np.inf, 2.0, 1.0, np.inf, np.inf, 3.0, np.inf, 2.0])
FACES = np.array([-1, 4, 7, -1, -1, 8, -1, 5])
G = np.array([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0])
PIXELS = PixelLine(SHOWN, DEPTH, G, FACES)
EDGE, EDGE_DEPTH = 3.2, 2.0
# Outward: pixels 3 (0.3 px away, counts as 1), 4 and 6, and pixel 5 where what is farther counts; 7 ends the walk.
OUTWARD, COVERED = 7 / 1 + 11 / 1.3 + 17 / 3.3, 13 / 2.3
# Inward: pixel 1; pixel 2 shows part 2, and pixel 0, of background, ends the walk.
INWARD = 3 / 1.7


def test_part_maps_are_the_books(device, rng):
    vertices = torch.from_numpy(rng.uniform(0, 24, (2, 30, 3))).float().to(device)
    faces, labels = np.arange(30).reshape(10, 3), np.arange(10) % 4 + 1
    mesh, camera = PartMesh.from_faces(faces, labels, device=device), WeakPerspective(torch.ones(1), torch.zeros(1, 2))
    image = draw_mesh(vertices, mesh, camera.to(device), (20, 24), num_maps=3)
    for b in range(2):
        maps = part_maps(image.face_index[b].cpu().numpy(), labels, 3)
        np.testing.assert_array_equal(image.maps[b].cpu().numpy(), maps)
        assert (maps.sum((1, 2)) > 0).all()
        # Labels are these maps as one image, with part 4, which has none here.
        np.testing.assert_array_equal((maps * np.arange(1, 4)[:, None, None]).sum(0), image.labels[b].cpu() % 4)


def test_of_equal_depths_the_lower_face_shows():
    corners = np.array([[0.0, 0, 1], [4, 0, 1], [0, 4, 1]])
    index, depth = face_index_map(MeshScene(corners, np.array([[0, 1, 2], [0, 1, 2]]), np.array([1, 1])), (3, 3))
    # Two centres lie on the side that goes down.
    np.testing.assert_array_equal(index, [[0, 0, 0], [0, 0, 0], [0, 0, -1]])
    np.testing.assert_allclose(depth, np.where(index < 0, np.inf, 1))


def test_slopes_along_a_line_agree_with_numbers_by_hand():
    assert switch_slope(1.0, 3.2, 4.5, 1) == pytest.approx(1 / 1.3)
    assert switch_slope(-1.0, 3.2, 1.5, -1) == pytest.approx(1 / 1.7)
    assert switch_slope(1.0, 3.2, 3.5, 1) == 1  # at least a pixel
    assert line_slope(PIXELS, 1, 1, EDGE, EDGE_DEPTH, Rule()) == pytest.approx(OUTWARD + COVERED + INWARD)
    near = line_slope(PIXELS, 1, 1, EDGE, EDGE_DEPTH, Rule(max_distance=1.5))
    assert near == pytest.approx(7 / 1 + 11 / 1.3)
    # The mirror image is pulled the other way.
    mirrored = PixelLine(*(values[::-1] for values in PIXELS))
    assert line_slope(mirrored, 1, -1, 8 - EDGE, EDGE_DEPTH, Rule()) == pytest.approx(-OUTWARD - COVERED - INWARD)
    # Beside a pixel of its own part, an edge bounds nothing.
    assert line_slope(PIXELS, 1, 1, 6.8, EDGE_DEPTH, Rule()) == 0


def test_other_parts_end_no_walk():
    paper = Rule(occlusion="paper")
    assert line_slope(PIXELS, 1, 1, EDGE, EDGE_DEPTH, paper) == pytest.approx(OUTWARD + INWARD)
    # An edge behind all that shows moves over background alone, whatever the rule.
    assert line_slope(PIXELS, 1, 1, EDGE, 4.0, Rule()) == pytest.approx(OUTWARD + INWARD)


def test_slopes_of_all_edges_agree_with_numbers_by_hand():
    """As in the Neural Mesh Renderer, they cross all background outside, and the one face that shows just inside."""
    rule = Rule(edges="all")
    assert line_slope(PIXELS, 1, 1, 1.8, EDGE_DEPTH, rule, face=4) == pytest.approx(
        3 / 1 + 7 / 1.7 + 11 / 2.7 + 13 / 3.7 + 17 / 4.7  # part 2 at pixel 2 lies in front
    )
    assert line_slope(PIXELS, 1, 1, 1.8, EDGE_DEPTH, rule, face=5) == 0
    # A square of two faces, and a pixel to its right: their common side pulls as well.
    corners = np.array([[2.0, 2, 1], [6, 2, 1], [6, 6, 1], [2, 6, 1]])
    scene, size = MeshScene(corners, np.array([[0, 1, 2], [0, 2, 3]]), np.array([1, 1])), (8, 12)
    picture = rasterize(scene, size)
    assert (picture.labels > 0).sum() == 16
    g = np.zeros((1, *size))
    g[0, 3, 8] = -1.0
    pulls = {edges: gradient(scene, picture, g, edges=edges) for edges in ("silhouette", "all")}
    assert pulls["silhouette"][:, 0].sum() == pytest.approx(-1 / 2.5)
    assert pulls["all"][:, 0].sum() == pytest.approx(-1 / 2.5 - 1 / 5)  # row 3.5 meets the diagonal at 3.5 px
    for pull in pulls.values():
        np.testing.assert_array_equal(pull[:, 1:], 0)


def test_depth_slopes_agree_with_numbers_by_hand():
    assert depth_slope(0.5) == pytest.approx(-np.log(3))
    assert depth_slope(0.5, 0.1) == pytest.approx(-0.1 * np.log(3))
    assert depth_slope(0.0) == depth_slope(1e-5) == pytest.approx(-np.log(10001))
    # A face half a metre behind another: it comes forward and the other goes back, by its vertices' weights at P.
    corners = np.array([[0.0, 0, 1], [8, 0, 1], [0, 8, 1]])
    vertices = np.concatenate([corners, corners + np.array([0, 0, 0.5])])
    scene = MeshScene(vertices, np.arange(6).reshape(2, 3), np.array([1, 2]))
    g = np.zeros((2, 8, 8))
    g[1, 1, 3] = -2.0
    pull = gradient(scene, rasterize(scene, (8, 8)), g, depth_weight=0.7)[:, 2]
    weights = np.array([8 - 3.5 - 1.5, 3.5, 1.5]) / 8
    np.testing.assert_allclose(pull, 0.7 * 2 * np.log(3) * np.concatenate([-weights, weights]))
