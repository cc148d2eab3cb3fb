"""Files of calibrated cameras: the layouts that Pose2Sim and OpenCV write are read, and what can't be is said."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.errors import InputError
from warp_partdr.files.opencv_files import read_opencv, to_matrix
from warp_partdr.inputs.camera_files import read_cameras
from warp_partdr.inputs.scene import View

POSE2SIM = """
[int_cam01_img]
name = "int_cam01_img"
size = [ 1088.0, 1920.0]
matrix = [ [ 1671.5, 0.0, 564.6], [ 0.0, 1668.2, 933.0], [ 0.0, 0.0, 1.0]]
distortions = [ -0.053, 0.151, -0.00012, 0.00065]
rotation = [ 1.678784562972848, 1.031972654261743, -0.3910235872501538]
translation = [ 0.2609476905995074, 0.9641586618892432, 2.932963441842366]
fisheye = false

[cam02]
name = "second"
size = [ 1088.0, 1920.0]
matrix = [ [ 1675.7, 0.0, 555.8], [ 0.0, 1675.4, 937.7], [ 0.0, 0.0, 1.0]]
distortions = [ 0.0, 0.0, 0.0, 0.0]
rotation = [ 0.0, 0.0, 0.0]
translation = [ 0.0, 0.0, 3.0]
fisheye = false

[metadata]
adjusted = false
error = 0.0
"""
# As OpenCV's samples/data/intrinsics.yml, and as stereo_calib writes extrinsics.
INTRINSICS = """%YAML:1.0
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.3480326845051309e+02, 0., 3.3568643204394891e+02, 0.,
       5.3480326845051309e+02, 2.4066183054066337e+02, 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ 2.9589439552724328e-01, -1.0354662043042675e+00, 0., 0., 0. ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.3480326845051309e+02, 0., 3.3455744527912015e+02, 0.,
       5.3480326845051309e+02, 2.4205324573376600e+02, 0., 0., 1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 14
   dt: d
   data: [ -1.6916358306948096e-01, -1.1214173641213163e-01, 0., 0., 0., 0.,
       0., 0., 0., 0., 0., 0., 0., 0. ]
"""
EXTRINSICS = """%YAML:1.0
---
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 0., -1., 0., 1., 0., 0., 0., 0., 1. ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -3.3, 0.5, 0. ]
Q: !!opencv-matrix
   rows: 1
   cols: 1
   dt: d
   data: [ 0. ]
"""
# As the calibration samples write one camera.
ONE = """%YAML:1.0
---
calibration_time: "Mon Nov 23 17:47:32 2026"
nframes: 13
image_width: 640
image_height: 480
flags: 0 # no one
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 600., 0., 319.5, 0., 600., 239.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-nd-matrix
   sizes: [ 5 ]
   dt: d
   data: [ -2.0e-01, 1.0e-01, 0., 0., 3.0e-02 ]
avg_reprojection_error: 4.0e-01
per_view_reprojection_errors: !!opencv-matrix
   rows: 2
   cols: 1
   dt: f
   data: [ 3.9e-01, .Nan ]
"""


def matrix(values: np.ndarray) -> dict[str, object]:
    """A matrix as OpenCV's JSON has it."""
    rows, cols = values.shape
    return {"type_id": "opencv-matrix", "rows": rows, "cols": cols, "dt": "d", "data": values.ravel().tolist()}


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_cameras_of_pose2sim_are_read(tmp_path: Path) -> None:
    cameras = read_cameras(write(tmp_path / "Calib.toml", POSE2SIM))
    assert list(cameras) == ["int_cam01_img", "second"]
    first = cameras["int_cam01_img"]
    assert first.size == (1920, 1088)
    assert first.focal == (1671.5, 1668.2)
    assert first.principal == (565.1, 933.5)  # the middle of OpenCV's first pixel is at 0
    assert first.distortion == (-0.053, 0.151, -0.00012, 0.00065)
    # Rodrigues' formula by itself: the axis stays, and the trace says the angle.
    vector = np.array([1.678784562972848, 1.031972654261743, -0.3910235872501538])
    np.testing.assert_allclose(first.rotation @ vector, vector, atol=1e-12)
    np.testing.assert_allclose(np.trace(first.rotation), 1 + 2 * np.cos(np.linalg.norm(vector)), atol=1e-12)
    view = View.of(cameras["second"])
    torch.testing.assert_close(view.to_camera(torch.tensor([0.1, 0.2, 0.3])), torch.tensor([0.1, 0.2, 3.3]))
    across, down = View.of(first).camera.focal[0].tolist()
    assert across == down == pytest.approx((1671.5 * 1668.2) ** 0.5)


def test_stereo_calibrations_of_opencv_are_read_from_one_file_or_two(tmp_path: Path) -> None:
    folder = tmp_path / "stereo"
    folder.mkdir()
    write(folder / "intrinsics.yml", INTRINSICS)
    write(folder / "extrinsics.yml", EXTRINSICS)
    both = read_cameras(write(tmp_path / "both.yml", INTRINSICS + EXTRINSICS.partition("---")[2]))
    for cameras in (read_cameras(folder), both):
        first, second = cameras["1"], cameras["2"]
        np.testing.assert_array_equal(first.rotation, np.eye(3))
        assert first.principal == (336.18643204394891, 241.16183054066337)
        assert second.rotation[0, 1] == -1
        assert second.translation.tolist() == [-3.3, 0.5, 0.0]
        assert second.distortion[:2] == (-0.16916358306948096, -0.11214173641213163)
    with pytest.raises(InputError, match=r"r: missing, but M, D; expected a rotation, world to camera"):
        read_cameras(write(tmp_path / "half.yml", INTRINSICS))


def test_a_folder_with_a_file_for_each_camera_is_read(tmp_path: Path) -> None:
    alone = read_cameras(write(tmp_path / "left.yml", ONE))["left"]
    assert (alone.size, alone.focal, alone.principal) == ((480, 640), (600.0, 600.0), (320.0, 240.0))
    assert alone.distortion == (-0.2, 0.1, 0.0, 0.0, 0.03)

    folder = tmp_path / "rig"
    folder.mkdir()
    place = "R: [[1., 0., 0.], [0., 1., 0.],\n  [0., 0., 1.]]\nT: [0., 0., 2.]\n"
    write(folder / "left.yaml", ONE + place)
    inner = np.array([[600.0, 0.0, 319.5], [0.0, 600.0, 239.5], [0.0, 0.0, 1.0]])
    right = {"K": matrix(inner), "dist": matrix(np.zeros((1, 4))), "rvec": matrix(np.array([[0.0], [1.5], [0.0]]))}
    text = json.dumps(right | {"tvec": matrix(np.array([[0.0], [0.0], [2.0]]))})
    text = text.replace(".0,", ".,").replace('{"K"', '{"error": .Nan, "K"')  # as OpenCV writes numbers
    write(folder / "right.json", text)
    write(folder / "notes.txt", "not a camera")
    cameras = read_cameras(folder)
    assert list(cameras) == ["left", "right"]
    expected = rotation_from_axis_angle(torch.tensor([0.0, 1.5, 0.0], dtype=torch.float64)).numpy()
    np.testing.assert_allclose(cameras["right"].rotation, expected)
    assert cameras["right"].size is None


def test_cameras_are_read_by_name_from_one_file(tmp_path: Path) -> None:
    inner = np.array([[600.0, 0.0, 319.5], [0.0, 600.0, 239.5], [0.0, 0.0, 1.0]])
    node = {"camera_matrix": matrix(inner), "distortion_coefficients": matrix(np.zeros((1, 5))), "R": matrix(np.eye(3))}
    node |= {"T": matrix(np.array([[0.0], [0.0], [2.0]])), "image_width": 640, "image_height": 480}
    text = json.dumps({"date": "today", "b": node, "a": node})
    cameras = read_cameras(write(tmp_path / "rig.json", text))
    assert list(cameras) == ["b", "a"]
    assert cameras["a"].translation.tolist() == [0, 0, 2]


def test_the_project_s_own_camera_file_is_read_and_its_faults_are_named(tmp_path: Path) -> None:
    left = {"size": [1920, 1080], "focal": [1500, 1500], "principal": [960, 540], "translation": [0, 0, 3]}
    left |= {"distortion": [0.1, 0, 0, 0], "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}
    path = tmp_path / "rig.json"
    camera = read_cameras(write(path, json.dumps({"cameras": {"left": left}})))["left"]
    assert (camera.principal, camera.size) == ((960.0, 540.0), (1080, 1920))
    for change, message in (
        ({"focal": [0, 1]}, r"cameras.left: focal, principal: .*expected pixels, focal above 0"),
        ({"focal": 1500}, r"cameras.left: focal: 1500; expected two numbers \[px\]"),
        (
            {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]},
            "cameras.left: rotation: not orthonormal, or a mirror image",
        ),
        ({"rotation": [0, 90, 0]}, r"cameras.left: rotation \[0.0, 90.0, 0.0\], by 90 radians; .*, not degrees"),
        ({"translation": [0, 0, 3e6]}, r"translation: .*expected 3 numbers in metres, 1e\+06 at most"),
        ({"size": [1920, 0]}, r"size .*expected width and height"),
        ({"distance": 3}, "distance: unknown; expected one of size, focal"),
    ):
        with pytest.raises(InputError, match=message) as error:
            read_cameras(write(path, json.dumps({"cameras": {"left": left | change}})))
        assert str(path) in str(error.value)
    del left["translation"]
    with pytest.raises(InputError, match=r"cameras\.left: translation: missing"):
        read_cameras(write(path, json.dumps({"cameras": {"left": left}})))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fisheye = false", "fisheye = true", "fisheye: a fisheye lens is not supported"),
        ("matrix = [ [ 1671.5, 0.0", "matrix = [ [ 1671.5, 40.0", "camera matrix .*expected"),
        ("rotation = [ 1.67", "rotation = [ 0.0, 1.67", r"rotation: shape \(4,\); expected a rotation"),
        ("translation = [ 0.26", "shift = [ 0.26", "int_cam01_img: t: missing, but name, size"),
        ("distortions = [ -0.053", "distortions = [ nan", "distortions: .*expected finite numbers"),
        ("size = [ 1088.0", "size = [ 1088.5", r"size .*expected width and height \[px\]"),
        ("[metadata]", "[cam03]", "cam03: cameramatrix: missing, but adjusted, error"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        read_cameras(write(tmp_path / "Calib.toml", POSE2SIM.replace(old, new, 1)))
    assert "Calib.toml" in str(error.value)


def test_files_without_a_usable_camera_are_refused(tmp_path: Path) -> None:
    for name, text, message in (
        ("a.txt", "", r"a.txt: .txt; expected calibrated cameras"),
        ("a.yml", "%YAML:1.0\n---\nframes: 3\n", "no camera in it, but frames"),
        ("a.toml", "[", "expected TOML"),
        ("fish.yml", ONE + "fisheye_model: 1\n", "a fisheye lens is not supported"),
        ("ros.yml", ONE + "distortion_model: equidistant\n", "distortion_model: 'equidistant' is not supported"),
    ):
        with pytest.raises(InputError, match=message):
            read_cameras(write(tmp_path / name, text))
    with pytest.raises(InputError, match=r"none.yml: No such file"):
        read_cameras(tmp_path / "none.yml")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="no camera in it"):
        read_cameras(empty)


def test_yaml_of_opencv_is_read(tmp_path: Path) -> None:
    text = """%YAML:1.0
---
name: 'it''s'
items:
   - { x: 41, y: -0.5, "far": [ 0, 1.e+01, .Inf ] } # a comment
   - u: 2
     v: !!opencv-matrix
        rows: 1
        cols: 2
        dt: d
        data: [ 1.e-03,
           2. ]
last:
"""
    found = read_opencv(write(tmp_path / "a.yml", text))
    assert found["items"][0] == {"x": 41, "y": -0.5, "far": [0, 10.0, float("inf")]}
    np.testing.assert_array_equal(to_matrix(found["items"][1]["v"], "v"), [[0.001, 2.0]])
    assert (found["name"], found["last"]) == ("it's", None)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: !!python/object/apply:os.system [ls]", "line 1: could not determine a constructor for the tag"),
        ("a: !local 1", "could not determine a constructor"),
        ("a: [1, 2", "line 1: expected ',' or ']'"),
        ("a: 1\nb: 1\na: 2", "key 'a' twice"),
        ("a: 1\n   b: 2", "line 2: mapping values are not allowed here"),
        ("a: 2026-13-45", "month must be in 1..12"),
        ("a: 1\n---\nb: 1\n---\nc: 1", "but found another document"),
        ("- 1", r"\[1\]; expected a file of OpenCV"),
        ("word", "'word'; expected a file of OpenCV"),
        ('{"a": 1, "a": 2}', "key 'a' twice"),
        ("a: " + "[" * 4000 + "]" * 4000, "nested more than 32 levels deep"),
    ],
)
def test_other_yaml_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_opencv(write(tmp_path / "a.yml", text))
