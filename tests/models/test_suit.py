"""The suit in which bodies are drawn: its seams, and its surface."""

import numpy as np
import pytest
import torch

from warp_partdr.body.template import PART_NAMES
from warp_partdr.models.anny import anny
from warp_partdr.models.normals import vertex_normals
from warp_partdr.models.suit import suit_of


@pytest.fixture(scope="module")
def worn():
    """Anny at rest with a body of its own, and the same in the suit, shape (V, 3) each."""
    model = anny()
    shape = torch.zeros(1, model.num_shapes)
    shape[0, 4] = -2.0  # large breasts
    skin = model.rest(shape).vertices[0]
    return skin.numpy(), suit_of(model).put_on(skin).numpy()


def part_of_vertices(*endings):
    """Flags of Anny's vertices all of whose faces show one of some parts, shape (V,)."""
    model = anny()
    parts = np.isin(model.face_parts.numpy(), [1 + PART_NAMES.index(n) for n in PART_NAMES if n.endswith(endings)])
    inside = np.ones(model.num_vertices, dtype=bool)
    inside[model.faces.numpy()[~parts]] = False
    return inside


def test_a_suit_covers_the_trunk_and_leaves_head_hands_and_feet_bare():
    shirt, shorts = suit_of(anny()).cloth.T
    assert (shirt[part_of_vertices("chest")] > 0).mean() > 0.97
    assert (np.maximum(shirt, shorts)[part_of_vertices("chest", "abdomen", "hip")] > 0).mean() > 0.97
    bare = part_of_vertices("head", "forearm", "hand", "lower_leg", "foot")
    assert bare.sum() > 5000
    assert (np.maximum(shirt, shorts)[bare] < 0).all()
    assert not ((shirt > 0) & (shorts > 0)).any()
    for cloth, limb in ((shirt, "upper_arm"), (shorts, "upper_leg")):  # a sleeve ends within its limb
        assert 0.2 < (cloth[part_of_vertices(limb)] > 0).mean() < 0.95


def test_a_suit_is_alike_left_and_right():
    model = anny()
    points, cloth = model.rest_vertices.numpy(), suit_of(model).cloth
    left = np.flatnonzero(points[:, 0] > 0.02)[::7]
    others = np.linalg.norm(points[left, None] * [-1, 1, 1] - points[None], axis=-1).argmin(1)
    np.testing.assert_allclose(cloth[others], cloth[left], atol=0.01)


def test_a_suit_has_no_nipples_and_stays_on_the_body(worn):
    """The chest's normals turn less from vertex to vertex; nothing else moves, and nothing moves far."""
    skin, suit = worn
    model, faces = anny(), anny().faces.numpy()
    bare = suit_of(model).cloth.max(1) < 0
    np.testing.assert_array_equal(suit[bare], skin[bare])
    moved = np.linalg.norm(suit - skin, axis=1)
    assert 0.002 < moved.max() < 0.05
    assert moved[part_of_vertices("chest", "abdomen", "hip")].mean() < 0.008
    chest = part_of_vertices("chest") & (vertex_normals(model.rest_vertices.numpy(), faces)[:, 2] > 0.3)
    pairs = faces[chest[faces].all(1)][:, :2]
    turns = [np.linalg.norm(np.diff(vertex_normals(each, faces)[pairs], axis=1), axis=-1) for each in worn]
    assert np.median(turns[1]) < 0.6 * np.median(turns[0])


def test_a_suit_moves_with_the_body(worn):
    """In any frame the same: a body that is turned and moved first wears it there."""
    skin, suit = worn
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], dtype=np.float32)
    moved = torch.from_numpy(skin @ turn.T + np.float32(3.0))
    np.testing.assert_allclose(suit_of(anny()).put_on(moved).numpy(), suit @ turn.T + 3.0, atol=1e-5)


def test_the_mean_of_a_round_trunk_does_not_shrink(worn):
    belly = part_of_vertices("abdomen")
    sizes = [np.ptp(each[belly], axis=0) for each in worn]
    np.testing.assert_allclose(sizes[1], sizes[0], atol=0.012)
