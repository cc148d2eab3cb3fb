"""Distortion is removed: the formula is OpenCV's, points go there and back, and pictures are cut where nothing is."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from warp_partdr.body.labels import IGNORE, label_set
from warp_partdr.errors import InputError
from warp_partdr.inputs.calibrated_camera import CalibratedCamera
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.part_labels import PartLabels

LENSES = {
    "none": (),
    "barrel": (-0.25, 0.06, 0.001, -0.002),
    "pincushion": (0.2, 0.05, -0.003, 0.001, 0.02),
    "rational": (0.5, 0.1, 0.0005, -0.0005, 0.01, 0.8, 0.2, 0.02),
}


def camera(distortion: tuple[float, ...]) -> CalibratedCamera:
    return CalibratedCamera((900.0, 880.0), (620.0, 370.0), distortion, size=(720, 1280))


@pytest.mark.parametrize("lens", LENSES)
def test_undistorted_points_are_distorted_back(lens: str) -> None:
    taken = np.stack(np.meshgrid(np.linspace(0, 1280, 33), np.linspace(0, 720, 19)), axis=-1)
    one = camera(LENSES[lens])
    straight = one.undistort_points(taken)
    np.testing.assert_allclose(one.distort_points(straight), taken, rtol=0, atol=1e-6)
    np.testing.assert_allclose(one.undistort_points(one.distort_points(straight)), straight, rtol=0, atol=1e-6)
    if lens == "none":
        across, down = np.sqrt(880 / 900), np.sqrt(900 / 880)  # square pixels
        np.testing.assert_allclose(straight - one.principal, (taken - one.principal) * [across, down])
    else:
        assert np.abs(straight - taken).max() > 10


def test_each_coefficient_distorts_as_its_formula_says() -> None:
    # x, y = 0.3, -0.4: r^2 = 0.25; each coefficient alone.
    one = CalibratedCamera((100.0, 100.0), (0.0, 0.0))
    place = np.array([30.0, -40.0])
    for index, seen in enumerate(
        (
            (30 * 1.025, -40 * 1.025),  # k1 0.1: 1 + 0.1 r^2
            (30 * 1.00625, -40 * 1.00625),  # k2: 1 + 0.1 r^4
            (30 - 2.4, -40 + 5.7),  # p1: 2 p1 x y, p1 (r^2 + 2 y^2)
            (30 + 4.3, -40 - 2.4),  # p2: p2 (r^2 + 2 x^2), 2 p2 x y
            (30 * 1.0015625, -40 * 1.0015625),  # k3: 1 + 0.1 r^6
            (30 / 1.025, -40 / 1.025),  # k4: divided by 1 + 0.1 r^2
        )
    ):
        lens = tuple(0.1 if place == index else 0.0 for place in range(6))
        np.testing.assert_allclose(replace(one, distortion=lens).distort_points(place), seen)


@pytest.mark.skipif(find_spec("cv2") is None, reason="cv2 is not installed")
@pytest.mark.parametrize("lens", LENSES)
def test_distorted_points_are_where_opencv_projects_them(lens: str) -> None:
    import cv2

    one = camera(LENSES[lens])
    inner = np.array([[900.0, 0, 620.0], [0, 880.0, 370.0], [0, 0, 1]])
    places = np.random.default_rng(0).uniform(-0.4, 0.4, (40, 3)) + np.array([0, 0, 1.0])
    seen, _ = cv2.projectPoints(places, np.zeros(3), np.zeros(3), inner, np.array(LENSES[lens] or (0.0,) * 4))
    focal = one.without_distortion.focal[0, 0].double().item()
    straight = places[:, :2] / places[:, 2:] * focal + one.principal
    np.testing.assert_allclose(one.distort_points(straight), seen[:, 0], rtol=0, atol=1e-4)


def test_points_beyond_the_lens_are_nan_and_their_keypoints_missing() -> None:
    # r (1 - 0.3 r^2) is largest at r = 1.054, where it is 0.703: 703 px from the middle.
    one = CalibratedCamera((1000.0, 1000.0), (0.0, 0.0), (-0.3,))
    found = one.undistort_points(np.array([[0.0, 700.0], [0.0, 710.0]]))
    assert 0.97 < found[0, 1] / 1000 < 1.054
    assert np.isnan(found[1]).all()
    assert np.isnan(one.distort_points(np.array([0.0, 1100.0]))).all()
    points = np.array([[0.0, 700.0], [0.0, 710.0], *[[10.0, 10.0]] * 15], dtype=np.float32)
    seen = one.undistort_keypoints(Keypoints2D("coco17", points, np.full(17, 0.7, dtype=np.float32)))
    assert (seen.confidence > 0).tolist() == [True, False] + [True] * 15
    assert seen.points[1].tolist() == [0, 0]
    assert seen.points.dtype == np.float32


def test_pictures_lose_their_distortion() -> None:
    """An edge that the lens bent is straight again, and border pixels that nobody saw are ignored."""
    one = CalibratedCamera((300.0, 300.0), (160.0, 120.0), (0.3, 0.1, 0.0, 0.0), size=(240, 320))
    rows, columns = np.mgrid[:240, :320] + 0.5
    straight = one.undistort_points(np.stack([columns, rows], axis=-1))
    groups = np.where(straight[..., 0] > 270, 2, 1).astype(np.uint8)
    assert len({int((row == 1).sum()) for row in groups}) > 4  # bent
    labels = label_set("cdcl14")
    maps = np.stack([groups == group for group in range(labels.num_groups + 1)]).astype(np.float32)
    seen = one.undistort_parts(PartLabels(labels, groups, maps, groups[None]))
    known = seen.groups != IGNORE
    assert not known[0, 0]
    assert known[60:180, 80:240].all()
    wrong = (seen.groups != np.where(columns > 270, 2, 1)) & known
    assert set(columns[wrong]) <= {269.5, 270.5}
    np.testing.assert_array_equal(seen.maps.argmax(0)[known], seen.groups[known])
    assert not seen.maps[:, ~known].any()
    np.testing.assert_array_equal(seen.instances[0], seen.groups)
    photo = np.repeat(groups[..., None], 3, axis=-1)
    np.testing.assert_array_equal(one.undistort_picture(photo)[known][:, 0], seen.groups[known])
    with pytest.raises(InputError, match="picture: 240 x 320 px; expected 320 x 240"):
        one.undistort_picture(photo.swapaxes(0, 1))


def test_without_distortion_nothing_moves() -> None:
    one = CalibratedCamera((300.0, 300.0), (160.0, 120.0))
    picture = np.random.default_rng(0).integers(0, 255, (240, 320), dtype=np.uint8)
    np.testing.assert_array_equal(one.undistort_picture(picture), picture)
    lens = one.without_distortion
    assert lens.intrinsics[0].tolist() == [300, 300, 160, 120]


def test_impossible_cameras_are_refused() -> None:
    with pytest.raises(InputError, match=r"distortion: .*expected up to 8 numbers"):
        CalibratedCamera((1.0, 1.0), (0.0, 0.0), (0.0,) * 9)
    with pytest.raises(InputError, match="rotation: not orthonormal"):
        CalibratedCamera((1.0, 1.0), (0.0, 0.0), rotation=np.zeros((3, 3)))
    with pytest.raises(InputError, match=r"translation: .*expected 3 numbers"):
        CalibratedCamera((1.0, 1.0), (0.0, 0.0), translation=np.zeros(2))
    with pytest.raises(InputError, match="focal above 0"):
        CalibratedCamera((900.0, -900.0), (0.0, 0.0))


@pytest.mark.parametrize(
    ("focal", "principal", "message"),
    [
        ((0.7, 0.7), (0.5, 0.5), "focal: .*expected pixels, 80 to 80000 for a picture of 800 x 600 px"),
        ((70.0, 70.0), (400.0, 300.0), "focal: .*expected pixels, 80 to 80000 for a picture of 800 x 600 px"),
        ((8.1e4, 8.1e4), (400.0, 300.0), "focal: .*expected pixels, 80 to 80000"),
        ((700.0, 200.0), (400.0, 300.0), "focal: .*expected two lengths within a factor of 2.5"),
        ((200.0, 700.0), (400.0, 300.0), "focal: .*expected two lengths within a factor of 2.5"),
        (
            (700.0, 700.0),
            (2401.0, 300.0),
            "principal: .*expected pixels, -1600 to 2400 and -1200 to 1800 for a picture of 800 x 600 px",
        ),
        ((700.0, 700.0), (400.0, -1201.0), "principal: .*expected pixels, -1600 to 2400 and -1200 to 1800"),
    ],
)
def test_lenses_that_no_camera_has_are_refused(
    focal: tuple[float, float], principal: tuple[float, float], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        CalibratedCamera(focal, principal, size=(600, 800))


def test_lenses_that_no_camera_of_any_size_has_are_refused() -> None:
    for focal, principal, message in (
        ((0.7, 0.7), (0.5, 0.5), "focal: .*expected pixels, 1 to 1e"),
        ((2e6, 2e6), (400.0, 300.0), "focal: .*expected pixels, 1 to 1e"),
        ((700.0, 700.0), (400.0, -2e6), r"principal: .*expected pixels, -1e\+06 to 1e\+06"),
    ):
        with pytest.raises(InputError, match=message):
            CalibratedCamera(focal, principal)
    # A picture's size, once it is known, tells more.
    one = CalibratedCamera((70.0, 70.0), (400.0, 300.0))
    with pytest.raises(InputError, match="expected pixels, 80 to 80000 for a picture of 800 x 600 px"):
        one.fitted((600, 800))


@pytest.mark.parametrize(
    ("focal", "principal"),
    [
        ((90.0, 90.0), (400.0, 300.0)),  # 155 degrees
        ((5e4, 5e4), (400.0, 300.0)),  # a telescope
        ((800.0, 400.0), (400.0, 150.0)),  # every other row
        ((6000.0, 6000.0), (-1500.0, 1700.0)),  # a part of a sensor's picture
    ],
)
def test_lenses_that_are_rare_are_taken(focal: tuple[float, float], principal: tuple[float, float]) -> None:
    assert CalibratedCamera(focal, principal, size=(600, 800)).focal == focal


def sized(width: int, height: int) -> CalibratedCamera:
    return CalibratedCamera((1000.0, 900.0), (500.0, 300.0), size=(height, width))


@pytest.mark.parametrize(
    ("calibrated", "film", "zoom"),
    [
        ((1920, 1080), (1920, 1080), 1.0),
        ((1920, 1088), (1920, 1080), 1.0),  # a codec's padding at the bottom
        ((1088, 1920), (1080, 1920), 1.0),  # and at the right
        ((1920, 1080), (1920, 1088), 1.0),
        ((640, 368), (640, 360), 1.0),
        ((1000, 608), (1000, 600), 1.0),
        ((864, 480), (854, 480), 1.0),
        ((640, 360), (640, 384), 1.0),  # to a multiple of 64
        ((2160, 3840), (1088, 1920), 0.5),  # resized, then padded
        ((1920, 1080), (960, 540), 0.5),
        ((1280, 720), (1920, 1080), 1.5),
        ((1366, 768), (1280, 720), 0.9375),  # a side is rounded
        ((1088, 1920), (540, 960), 0.5),  # both
        ((1920, 1088), (1280, 720), 2 / 3),
        ((540, 960), (1088, 1920), 2.0),
        ((1920, 1080), (1440, 816), 0.75),
    ],
)
def test_pictures_are_resized_and_padded(calibrated: tuple[int, int], film: tuple[int, int], zoom: float) -> None:
    """The principal point is as far from the left and from the top, in pixels of the calibration."""
    found = sized(*calibrated).fitted(film[::-1])
    assert found.size == film[::-1]
    assert found.focal == pytest.approx((1000 * zoom, 900 * zoom))
    assert found.principal == pytest.approx((500 * zoom, 300 * zoom))


@pytest.mark.parametrize(
    ("calibrated", "film"),
    [
        ((1920, 1080), (1080, 1920)),
        ((1920, 1080), (640, 480)),
        ((1920, 1080), (1920, 1440)),
        ((640, 480), (640, 440)),  # more than a block
        ((480, 640), (465, 625)),  # both sides
        ((1088, 608), (1080, 600)),
        ((1920, 1080), (960, 560)),  # nobody pads 540 to 560
        ((640, 484), (640, 480)),  # nobody pads to 484
        ((640, 500), (640, 490)),
    ],
)
def test_pictures_of_another_shape_are_refused(calibrated: tuple[int, int], film: tuple[int, int]) -> None:
    said = f"picture: {film[0]} x {film[1]} px; expected {calibrated[0]} x {calibrated[1]}, as calibrated"
    with pytest.raises(InputError, match=said):
        sized(*calibrated).fitted(film[::-1])


def test_a_camera_of_unknown_size_takes_any() -> None:
    found = replace(sized(640, 480), size=None).fitted((300, 200))
    assert (found.size, found.focal, found.principal) == ((300, 200), (1000.0, 900.0), (500.0, 300.0))


def test_a_resized_camera_sees_what_the_first_one_saw() -> None:
    one = camera(LENSES["barrel"])
    small = one.resized((360, 640))
    place = np.array([[700.0, 250.0], [100.0, 600.0]])
    np.testing.assert_allclose(small.undistort_points(place / 2), one.undistort_points(place) / 2, atol=1e-9)


def test_a_lens_reaches_to_where_it_turns_back() -> None:
    """k1 -0.3 is farthest out at r = 1.054; a pole of k4 -0.25 is at r = 2."""
    for lens, reach in (((-0.3,), 1 / np.sqrt(0.9)), ((0.0, 0.0, 0.0, 0.0, 0.0, -0.25), 2.0)):
        one = CalibratedCamera((1000.0, 1000.0), (0.0, 0.0), lens)
        near, far = one.distort_points(np.array([[1000 * reach - 5, 0.0], [1000 * reach + 5, 0.0]]))
        assert np.isfinite(near).all()
        assert np.isnan(far).all()
    straight = CalibratedCamera((1000.0, 1000.0), (0.0, 0.0), (0.1,))
    assert np.isfinite(straight.distort_points(np.array([50_000.0, 0.0]))).all()
