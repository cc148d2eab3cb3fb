"""Calibrated cameras: their files, and pictures without distortion."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from warp_partdr.body.labels import label_set
from warp_partdr.errors import InputError
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.scenes.calibration import CalibratedCamera, distort, read_cameras

CALIB = """
[cam01]
name = "left"
size = [640.0, 480.0]
matrix = [[700.0, 0.0, 310.0], [0.0, 710.0, 250.0], [0.0, 0.0, 1.0]]
distortions = [-0.21, 0.09, 0.002, -0.003]
rotation = [0.0, 1.5707963267948966, 0.0]
translation = [0.1, 0.2, 4.0]
fisheye = false

[cam02]
name = "right"
size = [640.0, 480.0]
matrix = [[700.0, 0.0, 319.5], [0.0, 700.0, 239.5], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0]
rotation = [0.0, 0.0, 0.0]
translation = [0.0, 0.0, 4.0]
fisheye = false

[metadata]
adjusted = false
error = 0.0
"""


def opencv(**changed: Any) -> dict[str, Any]:
    """As cv2.FileStorage writes a camera."""

    def matrix(rows: int, cols: int, data: list[float]) -> dict[str, Any]:
        return {"type_id": "opencv-matrix", "rows": rows, "cols": cols, "dt": "d", "data": data}

    return {
        "image_width": 640,
        "image_height": 480,
        "camera_matrix": matrix(3, 3, [700, 0, 310, 0, 710, 250, 0, 0, 1]),
        "distortion_coefficients": matrix(1, 5, [-0.21, 0.09, 0.002, -0.003, 0.01]),
        "R": matrix(3, 3, [0, 0, 1, 0, 1, 0, -1, 0, 0]),
        "T": matrix(3, 1, [0.1, 0.2, 4.0]),
        **changed,
    }


@pytest.fixture
def camera(tmp_path: Path) -> CalibratedCamera:
    (tmp_path / "Calib.toml").write_text(CALIB)
    return read_cameras(tmp_path / "Calib.toml")[0]


def through_lens(points: np.ndarray) -> np.ndarray:
    """World points in the first camera's own picture, by OpenCV's documented formula, in its pixels."""
    turned = points @ np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]).T + [0.1, 0.2, 4.0]
    x, y = turned[:, 0] / turned[:, 2], turned[:, 1] / turned[:, 2]
    r2 = x**2 + y**2
    k1, k2, p1, p2 = -0.21, 0.09, 0.002, -0.003
    radial = 1 + k1 * r2 + k2 * r2**2
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([700 * u + 310, 710 * v + 250], axis=1)


def test_a_camera_sees_what_its_pictures_show(camera: CalibratedCamera) -> None:
    world = np.random.default_rng(0).uniform(-0.8, 0.8, (50, 3))
    straight = camera.straight(through_lens(world) + 0.5)
    there = camera.view.to_camera(torch.from_numpy(world).float())
    expected = camera.view.camera.project(there[None])[0, :, :2].numpy()
    np.testing.assert_allclose(straight, expected, atol=2e-3)
    assert np.abs(straight - through_lens(world)).max() > 5  # the lens does bend
    assert (camera.name, camera.size) == ("left", (480, 640))


def test_points_go_there_and_back(camera: CalibratedCamera) -> None:
    rays = np.random.default_rng(1).uniform(-0.4, 0.4, (200, 2))
    coefficients = np.array([-0.21, 0.09, 0.002, -0.003, 0.01, 0.02, -0.01, 0.003])
    lens = CalibratedCamera("one", camera.size, camera.view, camera.matrix, coefficients)
    bent = distort(rays, coefficients) * camera.matrix[[0, 1], [0, 1]] + camera.matrix[:2, 2]
    back = (lens.straight(bent) - camera.matrix[:2, 2]) / camera.matrix[0, 0]
    np.testing.assert_allclose(back, rays, atol=1e-9)
    cv2 = pytest.importorskip("cv2", reason="needs OpenCV, to compare with")
    theirs = cv2.projectPoints(
        np.column_stack([rays, np.ones(len(rays))]), np.zeros(3), np.zeros(3), np.eye(3), coefficients
    )[0][:, 0]
    np.testing.assert_allclose(distort(rays, coefficients), theirs, atol=1e-12)


def test_keypoints_and_labels_move_together(camera: CalibratedCamera) -> None:
    groups = np.zeros(camera.size, np.uint8)
    groups[60:70, 40:50] = 3
    labels = camera.straight_labels(PartLabels(label_set("body14"), groups))
    rows, columns = np.nonzero(labels.groups == 3)
    middle = camera.straight(np.array([[45.0, 65.0]]))[0]
    np.testing.assert_allclose([columns.mean() + 0.5, rows.mean() + 0.5], middle, atol=0.7)
    assert np.abs(middle - [45, 65]).max() > 5
    points = np.zeros((17, 2), np.float32)
    points[3] = 45, 65
    confidence = np.zeros(17, np.float32)
    confidence[3] = 1
    moved = camera.straight_keypoints(Keypoints2D("coco17", points, confidence))
    np.testing.assert_allclose(moved.points[3], middle, atol=1e-3)
    assert not moved.points[[0, 1, 2, *range(4, 17)]].any()
    with pytest.raises(InputError, match=r"labels: \(48, 64\); expected \(640, 480\)"):
        camera.straight_labels(PartLabels(label_set("body14"), np.zeros((64, 48), np.uint8)))


def test_what_a_camera_never_saw_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "Calib.toml").write_text(CALIB.replace("-0.21", "0.3"))
    lens = read_cameras(tmp_path / "Calib.toml")[0]
    labels = lens.straight_labels(PartLabels(label_set("body14"), np.zeros(lens.size, np.uint8)))
    assert labels.groups[0, 0] == 255
    assert labels.groups[240, 320] == 0


def test_opencv_s_files(tmp_path: Path, camera: CalibratedCamera) -> None:
    (tmp_path / "left.json").write_text(json.dumps(opencv()))
    (one,) = read_cameras(tmp_path / "left.json")
    assert one.name == "left"
    np.testing.assert_allclose(one.matrix, camera.matrix)
    np.testing.assert_allclose(one.distortion[:5], [-0.21, 0.09, 0.002, -0.003, 0.01])
    torch.testing.assert_close(one.view.rotation, camera.view.rotation, atol=1e-6, rtol=0)
    (tmp_path / "both.json").write_text(json.dumps({"a": opencv(), "b": opencv(R=[0, 0, 0])}))
    assert [each.name for each in read_cameras(tmp_path / "both.json")] == ["a", "b"]
    folder = tmp_path / "cameras"
    folder.mkdir()
    for name in ("b", "a"):
        (folder / f"{name}.json").write_text(json.dumps(opencv()))
    assert [each.name for each in read_cameras(folder)] == ["a", "b"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("fisheye = false", "fisheye = true", "cam01: fisheye; expected"),
        ("size = [640.0, 480.0]", "size = [640.0]", "cam01: size"),
        ("700.0, 0.0, 310.0", "0.0, 0.0, 310.0", "cam01: matrix"),
        ("translation = [0.1, 0.2, 4.0]", "", "cam01: translation: missing; expected one of T, tvec"),
        ("translation = [0.1, 0.2, 4.0]", "translation = [0.1, nan, 4.0]", "expected 3 finite numbers"),
        ("distortions = [-0.21, 0.09, 0.002, -0.003]", "distortions = [1, 2]", "expected 0 or 4 or 5 or 8"),
        ('name = "right"', 'name = "left"', "camera 'left' twice"),
        ("matrix", "matrices", "no camera in it"),
    ],
)
def test_faults_of_files_are_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    (tmp_path / "Calib.toml").write_text(CALIB.replace(old, new))
    with pytest.raises(InputError, match=r"Calib\.toml: ") as caught:
        read_cameras(tmp_path / "Calib.toml")
    assert said in str(caught.value)


def test_other_faults(tmp_path: Path) -> None:
    (tmp_path / "one.json").write_text(json.dumps(opencv(R=[[1, 0, 0], [0, 1, 0], [0, 0, -1]])))
    with pytest.raises(InputError, match="one: rotation: not orthonormal, or a mirror image"):
        read_cameras(tmp_path / "one.json")
    with pytest.raises(InputError, match=r"neither \.toml nor \.json"):
        read_cameras(tmp_path / "calib.yml")
    with pytest.raises(InputError, match="No such file"):
        read_cameras(tmp_path / "none.toml")
