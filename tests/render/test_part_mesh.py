"""The topology of part-labelled meshes, and which pixels a face's border gives it."""

import numpy as np
import pytest
import torch
from scenes.pictures import draw_on_screen

from warp_partdr.render.part_mesh import PartMesh


def test_edges_of_three_faces_stand_alone():
    """Where three faces of a part meet, no two of them are a pair: each may be the silhouette."""
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    edges = PartMesh.from_faces(faces, np.array([1, 1, 1])).edges.tolist()
    shared = sorted(edge[2:] for edge in edges if edge[:2] == [0, 1])
    assert shared == [[0, -1, 2, 2], [1, -1, 3, 3], [2, -1, 4, 4]]
    assert len(edges) == 3 + 6
    assert all(edge[3] == -1 for edge in edges)


def test_edges_of_two_faces_are_one_where_they_show_one_part():
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    one, two = (PartMesh.from_faces(faces, np.array(labels)).edges.tolist() for labels in ([1, 1], [1, 2]))
    assert [edge for edge in one if edge[:2] == [0, 1]] == [[0, 1, 0, 1, 2, 3]]
    assert sorted(edge for edge in two if edge[:2] == [0, 1]) == [[0, 1, 0, -1, 2, 2], [0, 1, 1, -1, 3, 3]]
    assert (len(one), len(two)) == (5, 6)


@pytest.mark.parametrize("order", [[0, 1, 2], [0, 2, 1], [2, 0, 1]])
def test_fill_rule_of_borders_on_pixel_centres(device, order):
    """What goes down the picture, or level to the left, belongs to the face; whatever way the face is turned."""
    vertices = torch.tensor([[[2.5, 2.5, 1.0], [8.5, 2.5, 1.0], [2.5, 8.5, 1.0]]], device=device)
    mesh = PartMesh.from_faces(np.array([order]), np.array([1]), device=device)
    rows, columns = np.mgrid[:12, :12]
    inside = (columns > 2) & (rows > 2) & (columns + rows <= 10)
    np.testing.assert_array_equal(draw_on_screen(vertices, mesh, (12, 12)).labels[0].cpu().numpy(), inside)
    turned = torch.tensor([[[8.5, 8.5, 1.0], [2.5, 8.5, 1.0], [8.5, 2.5, 1.0]]], device=device)
    inside = (columns <= 8) & (rows <= 8) & (columns + rows > 10)
    np.testing.assert_array_equal(draw_on_screen(turned, mesh, (12, 12)).labels[0].cpu().numpy(), inside)
