"""The sheet of views: people over the photo, from the front, from the side and from above."""

import math

import numpy as np
import pytest
import torch
from helpers.bodies import upright

from warp_partdr.cameras import Perspective, WeakPerspective
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.results.palette import PEOPLE_COLOURS
from warp_partdr.results.placements import Placement
from warp_partdr.results.shading import BodySurface
from warp_partdr.results.views import _ABOVE, _FRONT, _SIDE, PlacedBody, _Scene, _View, draw_views, place_alone

SIZE = (300, 400)
CAMERA = Perspective.of_picture(SIZE, focal=320.0)


def placed(x, z, name="person0", *, feet=True, scale=1.0):
    placement = Placement(np.zeros(3), scale, z * scale)
    body = upright(x, z)
    surface = BodySurface.of_body(body.detailed.vertices, body.model, bare=True)
    return PlacedBody(name, body, CAMERA, placement, feet, lens_assumed=False, surface=surface)


def hues(picture, colour):
    """Rows and columns of the pixels that have the hue of a pastel colour."""
    pixels, wanted = np.asarray(picture).astype(float), np.asarray(colour).astype(float)
    lit = pixels / pixels.sum(-1, keepdims=True).clip(1)
    return np.nonzero((np.abs(lit - wanted / wanted.sum()) < 0.012).all(-1))


def test_people_have_one_colour_in_all_views_and_stand_where_they_are():
    """The person at the right is there from above, too, and the nearer one is lower and, from the side, at the left."""
    bodies = [placed(-0.8, 4.0), placed(0.9, 3.0, "person1")]
    scene = _Scene.of(bodies, SIZE)
    expected = (0.5 * PEOPLE_COLOURS[:2] + 127.5).astype(np.uint8)
    np.testing.assert_array_equal(scene.colours, expected)
    front, side, above = (scene.draw(rotation, 0.0) for rotation in (_FRONT, _SIDE, _ABOVE))
    for view, axis, first_is_less in ((front, 1, True), (above, 1, True), (above, 0, True), (side, 1, False)):
        one, other = (hues(view, colour)[axis] for colour in scene.colours)
        assert min(len(one), len(other)) > 500
        assert (np.median(one) < np.median(other)) == first_is_less


def test_the_nearer_person_hides_the_other():
    for places in ((2.0, 4.0), (4.0, 2.0)):
        scene = _Scene.of([placed(0.0, places[0]), placed(0.0, places[1], "person1")], SIZE)
        shown = [len(hues(scene.draw(_FRONT, 0.0), colour)[0]) for colour in scene.colours]
        assert (shown[0] > 3 * shown[1]) == (places[0] < places[1])


def test_lengths_are_those_of_the_scene():
    body = placed(0.0, 3.0)
    scene = _Scene.of([body], SIZE)
    for rotation, axis in ((_FRONT, 1), (_SIDE, 1), (_ABOVE, 2)):
        view = _View.around(scene, rotation, with_camera=rotation is not _FRONT)
        assert view.has_camera == (rotation is not _FRONT)
        first, second = np.zeros(3), np.zeros(3)
        second[axis] = 1.0
        assert math.dist(view.point(*first), view.point(*second)) == pytest.approx(view.scale)
        corners = [view.point(*scene.points[0][index]) for index in scene.points[0].argmin(0)]
        assert all(0 < left < view.width and 0 < top < 560 for left, top in corners)
        left, top = view.point(0.0, 0.0, 0.0)
        if view.has_camera:
            assert 0 < left < view.width
            assert 0 < top < 560
    assert scene.ground == pytest.approx(body.vertices()[:, 1].max())
    assert scene.points[0][:, 2].mean() == pytest.approx(3.0, abs=0.15)


def test_a_body_that_grows_about_the_camera_stands_farther_away():
    far = placed(0.5, 3.0, scale=1.5)
    np.testing.assert_allclose(far.vertices(), 1.5 * placed(0.5, 3.0).vertices(), rtol=1e-6)


def test_the_ground_is_left_out_where_no_feet_are_seen_and_the_camera_where_it_is_far():
    scene = _Scene.of([placed(0.0, 3.0, feet=False)], SIZE)
    assert math.isnan(scene.ground)
    assert "no feet" in scene.note()
    assert "1 m" in _Scene.of([placed(0.0, 3.0)], SIZE).note()
    picture = np.asarray(scene.draw(_ABOVE, 0.0))
    grounded = np.asarray(_Scene.of([placed(0.0, 3.0)], SIZE).draw(_ABOVE, 0.0))
    floor = (236, 238, 241)
    assert (grounded == floor).all(-1).sum() > 10_000
    assert (picture == floor).all(-1).sum() < 100
    far = _Scene.of([placed(0.0, 30.0)], SIZE)
    assert not _View.around(far, _SIDE, with_camera=True).has_camera


@pytest.mark.parametrize("size", [(300, 400), (900, 300), (200, 1500)])
def test_the_sheet_has_four_views_of_any_picture(size):
    photo = np.full((*size, 3), (20, 160, 90), dtype=np.uint8)
    sheet = np.asarray(draw_views([placed(0.0, 3.0)], size, photo))
    shown = (sheet == (20, 160, 90)).all(-1)
    assert shown.any()
    rows, columns = np.nonzero(shown)
    assert rows.max() < sheet.shape[0] / 2
    across, down = np.ptp(columns) + 1, np.ptp(rows) + 1
    assert across / down == pytest.approx(size[1] / size[0], rel=0.02)
    for rows in (slice(40, 560), slice(640, 1150)):  # something is drawn in both rows
        assert (sheet[rows] < 120).all(-1).any()


@pytest.mark.parametrize("seen", [0.9, 0.1])
def test_a_person_alone_is_placed_before_a_camera_without_distance(seen):
    weak = placed(0.0, 3.0).body.select(slice(1)).moved(torch.tensor([[0.0, 0.0, -3.0]]))
    points = np.zeros((17, 2), dtype=np.float32)
    keypoints = Keypoints2D("coco17", points, np.full(17, seen, dtype=np.float32))
    camera = WeakPerspective(torch.tensor([100.0]), torch.tensor([[200.0, 150.0]]))
    alone = place_alone(weak, camera, SIZE, keypoints, lens_assumed=True)
    assert alone.feet == (seen > 0.5)
    assert alone.placement.distance > 3
    assert alone.vertices()[:, 2].mean() == pytest.approx(alone.placement.distance, abs=0.2)
    sheet = draw_views([alone], SIZE)
    assert sheet.height > 1000
