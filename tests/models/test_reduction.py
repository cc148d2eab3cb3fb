"""Detailed models of few vertices: the same body where it is drawn, the same landmarks exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.bodies import walker
from trimesh.triangles import closest_point

from warp_partdr.body.labels import label_set
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.template import NUM_PARTS, PART_NAMES
from warp_partdr.cameras import WeakPerspective
from warp_partdr.models.anny import anny
from warp_partdr.models.model import DetailedModel, detailed_mesh
from warp_partdr.models.pose import pose_from_ellipbody
from warp_partdr.models.reduction import Reduced, reduce_model, reduce_within
from warp_partdr.models.surfaces import is_closed, vertex_parts
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.solve.mesh.drawn_model import draw_model
from warp_partdr.solve.mesh.mesh_options import MeshOptions

SIZE = 192


@pytest.fixture(scope="module")
def reduced() -> Reduced:
    return reduce_model(anny(), 1500)


def posed(model: DetailedModel, like: DetailedModel):
    """A walker of an odd shape, posed as the whole model would be."""
    shape = torch.linspace(-1.5, 1.5, like.num_shapes)[None]
    return model.pose(shape, *pose_from_ellipbody(like, walker().posed(), shape))


def drawn(model: DetailedModel) -> torch.Tensor:
    camera = WeakPerspective(torch.tensor([90.0]), torch.full((1, 2), SIZE / 2))
    return draw_mesh(posed(model, anny()).vertices, detailed_mesh(model), camera, (SIZE, SIZE)).labels[0]


def test_a_reduced_model_has_as_many_vertices_as_asked_and_every_part(reduced):
    assert 1400 < reduced.drawn < 1600
    assert int(reduced.model.faces.max()) == reduced.drawn - 1
    assert set(reduced.model.face_parts.tolist()) == set(range(1, NUM_PARTS + 1))
    assert len(torch.unique(reduced.kept)) == reduced.drawn
    assert torch.allclose(reduced.model.skin_weights.sum(1), torch.ones(reduced.model.num_vertices), atol=1e-5)


def test_landmarks_are_the_whole_model_s(reduced):
    whole, few = anny(), reduced.model
    names = whole.landmark_names
    want, have = (model.landmarks(posed(model, whole), names) for model in (whole, few))
    assert (want - have).abs().max() < 1e-5
    assert few.num_vertices < reduced.drawn + 330


def test_its_picture_is_the_whole_model_s_but_for_borders(reduced):
    want, have = drawn(anny()), drawn(reduced.model)
    both = ((want > 0) & (have > 0)).sum() / ((want > 0) | (have > 0)).sum()
    assert both > 0.95
    assert (have > 0).sum() / (want > 0).sum() == pytest.approx(1, abs=0.035)
    assert (want == have)[want > 0].float().mean() > 0.9


def leg_widths(model: DetailedModel) -> torch.Tensor:
    """Widths of the left leg's outline at rest from 8 sides, at heights from the ankle to the crotch [m]."""
    turns, height = torch.arange(8) * (torch.pi / 8), 0.6
    axes = torch.stack([torch.zeros(8), turns, torch.zeros(8)], dim=1)
    leg = [float(name in ("left_upper_leg", "left_lower_leg")) for name in PART_NAMES]
    mesh = detailed_mesh(model).relabel(np.array([0, *leg], dtype=np.uint8))
    middle = model.landmarks(model.rest(torch.zeros(1, model.num_shapes)), ["left_knee"])
    vertices = (model.rest_vertices - middle) @ rotation_from_axis_angle(axes).mT
    zoom = 1000.0
    size = int(zoom * height), 400
    camera = WeakPerspective(torch.tensor([zoom]), torch.tensor([[size[1] / 2, size[0] / 2]]))
    return (draw_mesh(vertices, mesh, camera, size).labels > 0).sum(2) / zoom


def test_faces_seen_from_behind_are_left_out_of_closed_models_alone(reduced):
    """The mesh of few vertices has slits in mouth and eyes, but hardly a pixel changes."""
    model = anny()
    assert is_closed(model)
    assert not is_closed(replace(model, faces=model.faces[1:], face_parts=model.face_parts[1:]))
    assert not is_closed(replace(model, faces=model.faces.flip(1)))
    camera = WeakPerspective(torch.tensor([90.0]), torch.full((1, 2), SIZE / 2))
    vertices = posed(reduced.model, model).vertices
    two_sided = detailed_mesh(reduced.model)
    one_sided = replace(two_sided, cull_backfaces=True)
    want, have = (draw_mesh(vertices, mesh, camera, (SIZE, SIZE)).labels for mesh in (two_sided, one_sided))
    assert (want != have).sum() <= 0.001 * (want > 0).sum()
    seen = draw_model(model, MeshOptions(), label_set("full1")).mesh
    assert seen is not None
    assert seen.cull_backfaces


def test_outlines_are_as_wide_as_they_were(reduced):
    """Seen from all around; sides that the skin is at distance 0 from on average are outlined 1 mm outside of it."""
    wider = leg_widths(reduced.model) - leg_widths(anny())
    assert float(wider.mean()) / 2 == pytest.approx(0, abs=0.0002)


def hand_areas(model: DetailedModel) -> torch.Tensor:
    """Areas of the left hand alone at rest, seen from 8 sides around it and from 8 more across [px]."""
    own = model.face_parts == PART_NAMES.index("left_hand") + 1
    mesh = detailed_mesh(replace(model, faces=model.faces[own], face_parts=model.face_parts[own]))
    turns = torch.arange(8) * (torch.pi / 8)
    axes = torch.cat([turns[:, None] * torch.eye(3)[axis] for axis in (0, 1)])
    middle = model.landmarks(model.rest(torch.zeros(1, model.num_shapes)), ["left_wrist"])
    vertices = (model.rest_vertices - middle) @ rotation_from_axis_angle(axes).mT
    camera = WeakPerspective(torch.tensor([500.0]), torch.full((1, 2), 150.0))
    return (draw_mesh(vertices, mesh, camera, (300, 300)).labels > 0).sum((1, 2))


def test_fingers_are_not_lost(reduced):
    """They are thinner than vertices are apart, and without theirs hands are a sixth smaller."""
    assert float((hand_areas(reduced.model) / hand_areas(anny())).mean()) == pytest.approx(1, abs=0.05)


def test_more_vertices_are_nearer(reduced):
    errors = [reduce_model(anny(), count).error for count in (500, 4000)]
    assert errors[0] > 1.5 * reduced.error > 1.5**2 * errors[1]
    assert 0.002 < reduced.error < 0.01


def test_pose_directions_are_kept(reduced):
    """A model with SMPL's bends of the skin: those of its vertices, and of landmarks."""
    whole = anny()
    directions = 1e-3 * torch.randn(
        9 * (whole.num_joints - 1), 3 * whole.num_vertices, generator=torch.Generator().manual_seed(0)
    )
    whole = replace(whole, pose_directions=directions)
    few = reduce_model(whole, 600)
    wide, narrow = posed(whole, whole), posed(few.model, whole)
    names = whole.landmark_names
    assert (whole.landmarks(wide, names) - few.model.landmarks(narrow, names)).abs().max() < 1e-4
    moved = wide.vertices[:, few.kept] - posed(anny(), whole).vertices[:, few.kept]
    without = posed(replace(few.model, pose_directions=None), whole).vertices[:, : few.drawn]
    assert torch.allclose(narrow.vertices[:, : few.drawn] - without, moved, atol=1e-4)


@pytest.mark.parametrize("count", [239, 13_719])
def test_numbers_of_vertices_that_no_mesh_can_have_are_refused(count):
    with pytest.raises(ValueError, match="vertices"):
        reduce_model(anny(), count)


@pytest.mark.parametrize(("error", "size"), [(0.004, 1.0), (0.01, 2.5)])
def test_as_many_vertices_are_kept_as_an_error_needs(error, size):
    """The first number that is tried is too small for a giant."""
    model = replace(anny(), rest_vertices=size * anny().rest_vertices)
    few = reduce_within(model, error)
    assert few.error <= error
    assert reduce_model(model, few.drawn // 2).error > error


def test_a_model_that_has_no_more_than_it_needs_stays_whole():
    assert reduce_within(anny(), 1e-4) is None


def test_small_parts_are_denser(reduced):
    """A part has as many vertices as the root of its skin's area asks for: hands keep their fingers."""
    model = anny()
    part, areas = vertex_parts(model)
    counts = {name: int((part[reduced.kept] == index).sum()) for index, name in enumerate(PART_NAMES)}
    skin = {name: float(areas[part == index].sum()) for index, name in enumerate(PART_NAMES)}
    for small, large in (("left_hand", "left_upper_leg"), ("right_foot", "chest"), ("left_forearm", "head")):
        wanted = np.sqrt(skin[small] / skin[large])
        assert counts[small] / counts[large] == pytest.approx(wanted, rel=0.05)


def test_the_error_holds_for_nearly_all_of_the_surface(reduced):
    """A sample of the whole model's vertices counts, weighed by the skin around them."""
    model = anny()
    _, areas = vertex_parts(model)
    some = (areas > 0).nonzero()[::23, 0]
    triangles = reduced.model.rest_vertices[reduced.model.faces.long()].double().numpy()
    distances = []
    for point in model.rest_vertices[some].double().numpy():
        nearest = closest_point(triangles, np.broadcast_to(point, (len(triangles), 3)))
        distances.append(np.linalg.norm(nearest - point, axis=1).min())
    beyond = areas[some].numpy()[np.array(distances) > reduced.error].sum() / areas[some].sum().item()
    assert beyond < 0.1
