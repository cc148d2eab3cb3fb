"""Calibrations of other programs: each one's convention, told by where a point of the world is seen."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.errors import InputError
from warp_partdr.inputs.calibrated_camera import CalibratedCamera
from warp_partdr.inputs.camera_files import cameras_of_films, read_cameras
from warp_partdr.inputs.scene import View

TURN = (0.3, -0.8, 0.1)  # Rodrigues
MOVE = (0.4, 1.1, 3.2)  # [m]


def turned(vector: tuple[float, ...] = TURN) -> np.ndarray:
    return rotation_from_axis_angle(torch.tensor(vector, dtype=torch.float64)).numpy()


def seen(camera: CalibratedCamera, point: tuple[float, float, float]) -> list[float]:
    """A point of the world [m] in the picture, by the view of a scene."""
    view = View.of(camera)
    there = view.to_camera(torch.tensor([[point]]))
    return view.camera.project(there)[0, 0, :2].tolist()


def matrix(values: np.ndarray) -> str:
    """A matrix in OpenCV's YAML."""
    rows, cols = values.shape
    data = ", ".join(f"{value:.9f}" for value in values.ravel())
    return f"!!opencv-matrix\n  rows: {rows}\n  cols: {cols}\n  dt: d\n  data: [{data}]\n"


def easymocap(folder: Path, *, turn: str = "R", size: bool = True) -> Path:
    """A folder of two cameras, "7" and "left", whose turns are Rodrigues' vectors (R) or matrices (Rot)."""
    folder.mkdir()
    names = 'names:\n  - 7\n  - "left"\n'
    intri, extri = f"%YAML:1.0\n---\n{names}", f"%YAML:1.0\n---\n{names}"
    for name in ("7", "left"):
        intri += f"K_{name}: " + matrix(np.array([[900.0, 0, 320], [0, 910, 240], [0, 0, 1]]))
        intri += f"dist_{name}: " + matrix(np.array([[-0.04, 0.3, -0.004, 0.01, 0.02]]))
        intri += f"H_{name}: 480\nW_{name}: 640\n" if size else ""
        value = np.array(TURN)[:, None] if turn == "R" else turned()
        extri += f"{turn}_{name}: " + matrix(value) + f"T_{name}: " + matrix(np.array(MOVE)[:, None])
    (folder / "intri.yml").write_text(intri)
    (folder / "extri.yml").write_text(extri)
    return folder


@pytest.mark.parametrize("turn", ["R", "Rot"])
def test_cameras_of_easymocap_are_read(tmp_path: Path, turn: str) -> None:
    folder = easymocap(tmp_path / "rig", turn=turn)
    (folder / "notes.json").write_text('{"frames": 3}')  # another file beside them
    for path in (folder, folder / "intri.yml", folder / "extri.yml"):
        cameras = read_cameras(path)
        assert list(cameras) == ["7", "left"]
        camera = cameras["left"]
        np.testing.assert_allclose(camera.rotation, turned(), atol=1e-8)
        assert camera.translation.tolist() == pytest.approx(MOVE)
        assert (camera.focal, camera.principal, camera.size) == ((900.0, 910.0), (320.5, 240.5), (480, 640))
        assert camera.distortion == (-0.04, 0.3, -0.004, 0.01, 0.02)
    assert read_cameras(easymocap(tmp_path / "other", size=False))["7"].size is None


def test_camera_names_of_easymocap_need_no_quotes(tmp_path: Path) -> None:
    folder = easymocap(tmp_path / "rig")
    for path in folder.iterdir():
        path.write_text(path.read_text().replace("- 7", "- 07").replace("_7:", "_07:"))
    assert list(read_cameras(folder)) == ["07", "left"]


def test_one_of_two_files_of_easymocap_is_refused(tmp_path: Path) -> None:
    folder = easymocap(tmp_path / "rig")
    (folder / "extri.yml").unlink()
    with pytest.raises(InputError, match=r"T_7: missing; expected a folder of EasyMocap's intri\.yml and extri\.yml"):
        read_cameras(folder / "intri.yml")
    (easymocap(tmp_path / "other") / "intri.yml").unlink()
    with pytest.raises(InputError, match="places of cameras alone; expected a folder of EasyMocap"):
        read_cameras(tmp_path / "other" / "extri.yml")


CALISCOPE = """
[cameras.0]
cam_id = 0
rotation_count = 0
error = 0.5
exposure = "null"
size = [1280, 720]
matrix = [[900.0, 0.0, 640.0], [0.0, 905.0, 360.0], [0.0, 0.0, 1.0]]
distortions = [0.1, -0.1, 0.001, 0.002, -0.05]
translation = [0.4, 1.1, 3.2]
rotation = [0.3, -0.8, 0.1]
fisheye = false

[cameras.4]
cam_id = 4
size = [1280, 720]
matrix = [[900.0, 0.0, 640.0], [0.0, 905.0, 360.0], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0, 0.0]
translation = "null"
rotation = "null"

[cameras.5]
cam_id = 5
ignore = true
size = [1280, 720]
matrix = [[900.0, 0.0, 640.0], [0.0, 905.0, 360.0], [0.0, 0.0, 1.0]]
translation = [0.0, 0.0, 1.0]
rotation = [0.0, 0.0, 0.0]

[cameras.11]
cam_id = 11
size = [1280, 720]
matrix = [[900.0, 0.0, 640.0], [0.0, 905.0, 360.0], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0, 0.0]
translation = [0.0, 0.0, 2.0]
rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
"""


def test_cameras_of_caliscope_are_read_and_those_left_out_are_named(tmp_path: Path) -> None:
    (tmp_path / "camera_array.toml").write_text(CALISCOPE)
    (tmp_path / "charuco.toml").write_text("columns = 4\n")  # Caliscope's folders hold more
    said: list[str] = []
    cameras = read_cameras(tmp_path, warn=said.append)
    assert list(cameras) == ["0", "11"]
    np.testing.assert_allclose(cameras["0"].rotation, turned(), atol=1e-12)
    assert (cameras["0"].size, cameras["0"].translation.tolist()) == ((720, 1280), list(MOVE))
    assert cameras["11"].translation.tolist() == [0, 0, 2]
    assert [sentence.partition(": ")[2] for sentence in said] == [
        "camera 4 is left out, for it has no place",
        "camera 5 is left out, for it is marked with ignore",
    ]
    first, second = cameras_of_films(tmp_path, ["port_11.mp4", "port_0.mp4"])
    assert first.translation.tolist() == [0, 0, 0]
    np.testing.assert_allclose(second.rotation, turned(), atol=1e-12)


def test_a_file_whose_cameras_have_no_place_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera_array.toml"
    path.write_text("\n[cameras.4]" + CALISCOPE.partition("[cameras.4]")[2].partition("[cameras.5]")[0])
    with pytest.raises(InputError, match="no camera in it"):
        read_cameras(path)


OLD_CALISCOPE = """
camera_count = 4
[charuco]
columns = 5
square_size_overide_cm = 4.0

[capture_volume]
origin_sync_index = 12

[cam_3]
port = 3
size = [1280, 720]
error = "null"

[cam_5]
port = 5
size = [1280, 720]
matrix = [[900.0, 0.0, 640.0], [0.0, 905.0, 360.0], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0, 0.0]

[cam_7]
port = 7
size = [1280, 720]
matrix = [[900.0, 0.0, 640.0], [0.0, 905.0, 360.0], [0.0, 0.0, 1.0]]
distortions = [0.1, -0.1, 0.001, 0.002, -0.05]
translation = [0.4, 1.1, 3.2]
rotation = [0.3, -0.8, 0.1]

[cam_8]
port = 8
size = [1280, 720]
matrix = [[900.0, 0.0, 640.0], [0.0, 905.0, 360.0], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0, 0.0]
translation = [0.0, 0.0, 2.0]
rotation = [0.0, 0.0, 0.0]
"""


def test_cameras_of_old_caliscope_files_are_read(tmp_path: Path) -> None:
    """Other tables stand beside the cameras, of which one is not calibrated, and one has no place."""
    path = tmp_path / "config.toml"
    path.write_text(OLD_CALISCOPE)
    said: list[str] = []
    cameras = read_cameras(path, warn=said.append)
    assert list(cameras) == ["cam_7", "cam_8"]
    assert cameras["cam_7"].translation.tolist() == list(MOVE)
    assert said == [
        f"{path}: camera cam_3 is left out, for it is not calibrated",
        f"{path}: camera cam_5 is left out, for it has no place",
    ]


def test_files_without_cameras_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(FREEMOCAP)
    (tmp_path / "Config.toml").write_text("[project]\nframe_rate = 60\n[pose.intrinsics]\nk = 3\n")
    (tmp_path / "info.json").write_text('{"cameras_used": 2, "m": 1.5}')
    (tmp_path / "parameters.yaml").write_text("model:\n  complexity: 2\n")
    said: list[str] = []
    assert list(read_cameras(tmp_path, warn=said.append)) == ["sesh_synced_Cam1", "sesh_synced_Cam2"]
    left_out = [f"{tmp_path / name}: left out, for it holds no camera" for name in ("Config.toml", "info.json")]
    assert said[:3] == [*left_out, f"{tmp_path / 'parameters.yaml'}: left out, for it holds no camera"]
    # One that is a camera's is read, and what it lacks is said.
    (tmp_path / "left.json").write_text(json.dumps({"K": [[900, 0, 320], [0, 900, 240]], "R": [0, 0, 0]}))
    with pytest.raises(InputError, match=r"left.json: K: shape \(2, 3\); expected a camera matrix"):
        read_cameras(tmp_path)
    for name in ("rig.toml", "left.json"):
        (tmp_path / name).unlink()
    with pytest.raises(InputError, match="no camera in it"):
        read_cameras(tmp_path)


@pytest.mark.parametrize(
    ("matrices", "lenses", "names"),
    [
        (("M1", "M2"), ("D1", "D2"), ["1", "2"]),
        (("cameraMatrix1", "cameraMatrix2"), ("distCoeffs1", "distCoeffs2"), ["1", "2"]),
        (("camera_matrix_1", "camera_matrix_2"), ("dist_coeffs_1", "dist_coeffs_2"), ["1", "2"]),
        (("K1", "K2"), ("D1", "D2"), ["1", "2"]),
        (("K_1", "K_2"), ("D_1", "D_2"), ["1", "2"]),
        (("cameraMatrixL", "cameraMatrixR"), ("distCoeffsL", "distCoeffsR"), ["left", "right"]),
        (("K_left", "K_right"), ("dist_left", "dist_right"), ["left", "right"]),
        (("mtxL", "mtxR"), ("distL", "distR"), ["left", "right"]),
    ],
)
def test_stereo_calibrations_are_known_by_any_usual_names(
    tmp_path: Path, matrices: tuple[str, str], lenses: tuple[str, str], names: list[str]
) -> None:
    text = "%YAML:1.0\n---\nimageSize: [640, 480]\n"
    for number, (inner, bent) in enumerate(zip(matrices, lenses, strict=True), 1):
        text += f"{inner}: " + matrix(np.array([[900.0 + number, 0, 320], [0, 900, 240], [0, 0, 1]]))
        text += f"{bent}: " + matrix(np.array([[-0.1 * number, 0.0, 0.0, 0.0, 0.0]]))
    path = tmp_path / "stereo.yml"
    path.write_text(text + "R: " + matrix(turned()) + "T: " + matrix(np.array(MOVE)[:, None]))
    cameras = read_cameras(path)
    assert list(cameras) == names
    first, second = cameras.values()
    assert (first.focal[0], second.focal[0]) == (901.0, 902.0)
    assert (first.distortion[0], second.distortion[0]) == (-0.1, -0.2)
    assert first.translation.tolist() == [0, 0, 0]
    assert second.translation.tolist() == list(MOVE)
    assert second.size == (480, 640)


def mc_calib(path: Path, **second: object) -> Path:
    """Two cameras of MC-Calib, of which the second stands half a metre to the right, turned to the left."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turned((0.0, -0.5, 0.0)), (0.5, 0.0, 0.0)
    text = "%YAML:1.0\n---\nnb_camera: 2\n"
    for number, place in enumerate((np.eye(4), pose)):
        text += f"camera_{number}:\n   camera_matrix: "
        text += matrix(np.array([[600.0, 0, 630], [0, 600, 360], [0, 0, 1]])).replace("\n  ", "\n      ")
        text += "   distortion_vector: " + matrix(np.zeros((1, 5))).replace("\n  ", "\n      ")
        facts: dict[str, object] = {"distortion_type": 0, "camera_group": 0, "img_width": 1280, "img_height": 720}
        text += "".join(f"   {key}: {value}\n" for key, value in (facts | (second if number else {})).items())
        text += "   camera_pose_matrix: " + matrix(place).replace("\n  ", "\n      ")
    path.write_text(text)
    return path


def test_cameras_of_mc_calib_are_read(tmp_path: Path) -> None:
    """Poses are where cameras stand: camera to reference."""
    path = mc_calib(tmp_path / "calibrated_cameras_data.yml")
    (tmp_path / "reprojection_error_data.yml").write_text("%YAML:1.0\n---\nnb_camera_group: 1\n")
    for there in (path, tmp_path):
        cameras = read_cameras(there)
        assert list(cameras) == ["camera_0", "camera_1"]
        second = cameras["camera_1"]
        np.testing.assert_allclose(View.of(second).eye, [0.5, 0.0, 0.0], atol=1e-6)
        # Turned to the left, it sees what is before and left of it in its middle.
        u, v = seen(second, (0.5 - np.sin(0.5), 0.0, np.cos(0.5)))
        assert (u, v) == pytest.approx((630.5, 360.5), abs=1e-3)
        assert second.size == (720, 1280)
    for fault, message in (
        ({"distortion_type": 1}, "distortion_type: 1, a fisheye lens, is not supported"),
        ({"camera_group": 1}, r"cameras of groups \[0, 1\]; expected one group"),
    ):
        with pytest.raises(InputError, match=message):
            read_cameras(mc_calib(path, **fault))


FREEMOCAP = """
[cam_0]
name = "sesh_synced_Cam1"
size = [ 720, 1280,]
matrix = [ [ 900.0, 0.0, 359.5,], [ 0.0, 900.0, 639.5,], [ 0.0, 0.0, 1.0,],]
distortions = [ -0.3, 0.0, 0.0, 0.0, 0.0,]
rotation = [ 0.0, 0.0, 0.0,]
translation = [ 0.0, 0.0, 0.0,]

[cam_1]
name = "sesh_synced_Cam2"
size = [ 720, 1280,]
matrix = [ [ 900.0, 0.0, 359.5,], [ 0.0, 900.0, 639.5,], [ 0.0, 0.0, 1.0,],]
distortions = [ -0.3, 0.0, 0.0, 0.0, 0.0,]
rotation = [ 0.1, 1.2, 0.6,]
translation = [ -2500.0, -650.0, 750.0,]

[metadata]
charuco_square_size = 58.0
"""


def test_freemocap_is_in_millimetres(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    path.write_text(FREEMOCAP)
    said: list[str] = []
    cameras = read_cameras(path, warn=said.append)
    assert list(cameras) == ["sesh_synced_Cam1", "sesh_synced_Cam2"]
    assert cameras["sesh_synced_Cam2"].translation.tolist() == pytest.approx([-2.5, -0.65, 0.75])
    assert said == [f"{path}: translations are taken as millimetres, as charuco_square_size is"]
    # Squares of no known size are another unit, which people tell.
    for side in ("1.0", "0.058", "true"):
        path.write_text(FREEMOCAP.replace("58.0", side))
        assert read_cameras(path)["sesh_synced_Cam2"].translation.tolist() == [-2500.0, -650.0, 750.0]


# A camera 4 m before the origin, 1.5 m above it, that looks along y; z is up.
QUALISYS = """<?xml version='1.0' encoding='ASCII'?>
<calibration source="x.qca.txt" type="regular">
  <results min-max-diff="0." std-dev="0."/>
  <cameras>
    <camera active="1" model="Miqus Video" serial="cam10" viewrotation="0">
      <fov_marker bottom="479" left="0" right="639" top="0"/>
      <fov_video bottom="489" left="20" right="659" top="10"/>
      <transform x="0" y="-4000" z="1500" r11="1" r12="0" r13="0" r21="0" r22="0" r23="1" r31="0" r32="-1" r33="0"/>
      <intrinsic focallength="9.3" centerPointU="21760" centerPointV="16000" focalLengthU="64000" focalLengthV="63360"
        radialDistortion1="-0.05" radialDistortion2="0.14" radialDistortion3="0.02" skew="0.0"
        tangentalDistortion1="0.001" tangentalDistortion2="-0.002"
        sensorMaxU="40960" sensorMaxV="30720" sensorMinU="0.0" sensorMinV="0.0"/>
    </camera>
    <camera active="1" model="Video" serial="cam9">
      <transform x="0" y="-2000" z="1500" r11="1" r12="0" r13="0" r21="0" r22="0" r23="1" r31="0" r32="-1" r33="0"/>
      <intrinsic centerPointU="20480" centerPointV="15360" focalLengthU="64000" focalLengthV="64000"
        radialDistortion1="0" radialDistortion2="0" radialDistortion3="0"
        tangentalDistortion1="0" tangentalDistortion2="0" sensorMaxU="40959" sensorMaxV="30656"/>
    </camera>
    <camera active="1" model="Oqus 300+" serial="12059"/>
  </cameras>
</calibration>
"""


def test_cameras_of_qualisys_are_read(tmp_path: Path) -> None:
    path = tmp_path / "Calib.qca.txt"
    path.write_text(QUALISYS)
    (tmp_path / "notes.txt").write_text("not a camera")
    for there in (path, tmp_path):
        cameras = read_cameras(there)
        assert list(cameras) == ["cam9", "cam10"]  # markers' cameras have no films
    camera = cameras["cam10"]
    assert (camera.size, camera.focal) == ((480, 640), (1000.0, 990.0))
    assert camera.principal == (320.5, 240.5)  # 340 - 20 and 250 - 10, pixel centres at + 0.5
    assert camera.distortion == (-0.05, 0.14, 0.001, -0.002, 0.02)
    np.testing.assert_allclose(View.of(camera).eye, [0.0, -4.0, 1.5], atol=1e-6)
    middle, right, above = (seen(camera, point) for point in ((0, 0, 1.5), (1, 0, 1.5), (0, 0, 2.5)))
    assert middle == pytest.approx([320.5, 240.5], abs=1e-3)
    assert right[0] > 500
    assert above[1] < 50
    assert cameras["cam9"].size == (480, 640)  # 40959 subpixels of 640 px, and 30656 = 479 · 64


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<calibration", "<!DOCTYPE x [<!ENTITY a 'b'>]>\n<calibration", "a document type in it"),
        ("</calibration>", "", "no element found"),
        ('x="0" y="-4000"', 'y="-4000"', "camera cam10: transform: x: None; expected a number"),
        ('r11="1"', 'r11="one"', "camera cam10: transform: r11: 'one'; expected a number"),
        ('r11="1"', 'r11="-1"', "cam10: rotation: not orthonormal, or a mirror image"),
        ('focalLengthU="64000"', 'focalLengthU="-64000"', "cam10: focal, principal: .*expected pixels, focal above 0"),
        ('skew="0.0"', 'skew="3"', "camera cam10: skew: 3; expected 0"),
        ('serial="cam9"', 'serial="cam10"', "camera cam10 a second time"),
        ("<intrinsic", "<inner", "camera cam10: intrinsic: missing; expected a calibrated camera"),
        ("camera", "box", "no camera in it"),
    ],
)
def test_faulty_qualisys_files_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "Calib.qca.txt"
    path.write_text(QUALISYS.replace(old, new) if old == "camera" else QUALISYS.replace(old, new, 1))
    with pytest.raises(InputError, match=message) as error:
        read_cameras(path)
    assert str(path) in str(error.value)


def test_a_document_type_in_another_encoding_is_seen(tmp_path: Path) -> None:
    path = tmp_path / "Calib.qca.txt"
    text = QUALISYS.replace("'ASCII'", "'UTF-16'").replace("<calibration", "<!DOCTYPE a>\n<calibration", 1)
    path.write_bytes(text.encode("utf-16"))
    with pytest.raises(InputError, match="a document type in it"):
        read_cameras(path)


KALIBR = """
cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.2, 0.1, 0.001, 0.002]
  distortion_model: radtan
  intrinsics: [600.0, 605.0, 320.0, 240.0]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1: [[0.0, -1.0, 0.0, 0.1], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
  camera_model: pinhole
  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]
  distortion_model: radtan
  intrinsics: [600.0, 605.0, 320.0, 240.0]
  resolution: [640, 480]
cam2:
  T_cn_cnm1: [[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.5], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
  camera_model: pinhole
  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]
  distortion_model: none
  intrinsics: [600.0, 605.0, 320.0, 240.0]
  resolution: [640, 480]
"""


def test_cameras_of_kalibr_are_read(tmp_path: Path) -> None:
    """Kalibr states the place of each camera relative to the one before."""
    path = tmp_path / "camchain.yaml"
    path.write_text(KALIBR)
    cameras = read_cameras(path)
    assert (cameras["cam0"].focal, cameras["cam0"].principal) == ((600.0, 605.0), (320.5, 240.5))
    assert cameras["cam0"].distortion == (-0.2, 0.1, 0.001, 0.002)
    assert cameras["cam0"].translation.tolist() == [0, 0, 0]
    assert cameras["cam1"].translation.tolist() == [0.1, 0, 0]
    assert cameras["cam1"].rotation[0].tolist() == [0, -1, 0]
    assert cameras["cam2"].rotation.tolist() == [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]  # a quarter twice
    assert cameras["cam2"].translation.tolist() == [0, 0.6, 0]
    for old, new, message in (
        ("radtan", "equidistant", "distortion_model: 'equidistant' is not supported"),
        ("pinhole", "omni", "camera_model: 'omni' is not supported"),
    ):
        path.write_text(KALIBR.replace(old, new, 1))
        with pytest.raises(InputError, match=message):
            read_cameras(path)


def test_a_list_of_cameras_as_cmu_panoptics_is_read(tmp_path: Path) -> None:
    """CMU Panoptic writes such lists."""
    camera = {"type": "hd", "resolution": [1920, 1080], "K": [[1400, 0, 960], [0, 1400, 540], [0, 0, 1]]}
    camera |= {"distCoef": [-0.28, 0.18, 0, 0, 0.04], "R": turned().tolist(), "t": [[-50.0], [100.0], [280.0]]}
    listed = [{"name": "00_00", **camera}, {"name": "00_01", **camera}]
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps({"calibDataSource": "x", "cameras": listed}))
    cameras = read_cameras(path)
    assert list(cameras) == ["00_00", "00_01"]
    assert cameras["00_01"].translation.tolist() == [-50, 100, 280]  # centimetres, which people tell
    assert (cameras["00_01"].size, cameras["00_01"].distortion[0]) == ((1080, 1920), -0.28)
    path.write_text(json.dumps({"cameras": [camera, camera]}))
    assert list(read_cameras(path)) == ["0", "1"]
    path.write_text(json.dumps({"cameras": [listed[0], listed[0]]}))
    with pytest.raises(InputError, match="cameras: 00_00, 00_00; expected each name once"):
        read_cameras(path)


OWN = {"size": [1920, 1080], "focal": [1500, 1500], "principal": [960, 540], "translation": [0, 0, 3]}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rotation": [True, False, False]}, r"rotation: \[True, False, False\]; expected numbers, not true and false"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, True]]}, "expected numbers, not true and false"),
        ({"focal": [1500.0, True]}, "focal: .*expected numbers, not true and false"),
        ({"size": [True, True]}, r"size \[True, True\]|not true and false"),
        ({"focal": [-1500, 1500]}, "expected pixels, focal above 0"),
        ({"rotation": [0, 5, 0]}, r"rotation \[0.0, 5.0, 0.0\], by 5 radians; expected .* radians, not degrees"),
        ({"rotation": [3.5, 0, 0]}, "radians, not degrees"),
        ({"rotation": [180, 0, 0]}, "radians, not degrees"),
        ({"fisheye": True}, "fisheye: a fisheye lens is not supported"),
        ({"xi": 1.2}, "xi: a fisheye lens is not supported"),
        ({"camera_model": "omnidirectional"}, "camera_model: 'omnidirectional' is not supported"),
        ({"lens_type": "Fisheye"}, "lens_type: 'Fisheye' is not supported"),
    ],
)
def test_numbers_that_are_none_are_refused(tmp_path: Path, change: dict[str, object], message: str) -> None:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps({"cameras": {"left": {**OWN, "rotation": [0, 0, 0], **change}}}))
    with pytest.raises(InputError, match=message) as error:
        read_cameras(path)
    assert str(error.value).startswith(f"{path}: cameras.left")


@pytest.mark.parametrize("side", [True, 0, -640, 640.5, "640"])
def test_sides_are_whole_numbers(tmp_path: Path, side: object) -> None:
    path = tmp_path / "left.json"
    lens = {"K": [[900, 0, 320], [0, 900, 240], [0, 0, 1]], "image_width": 640.0, "image_height": side}
    path.write_text(json.dumps(lens))
    with pytest.raises(InputError, match=r"size .*expected width and height \[px\]"):
        read_cameras(path)
    path.write_text(json.dumps(lens | {"image_height": 480}))
    assert read_cameras(path)["left"].size == (480, 640)


def test_turns_of_more_than_half_a_turn_are_taken(tmp_path: Path) -> None:
    """Optimisers leave such vectors; those in degrees are short numbers."""
    path = tmp_path / "rig.json"
    for vector in ([0.0, 3.1415926, 0.0], [0.123, 3.511, 0.0], [1.0, 2.0, 0.5], [0.0, 3.0, 0.0]):
        path.write_text(json.dumps({"cameras": {"left": {**OWN, "rotation": vector}}}))
        np.testing.assert_allclose(read_cameras(path)["left"].rotation, turned(tuple(vector)), atol=1e-12)


def test_films_in_the_order_of_cameras_are_told(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    rig = {name: {**OWN, "rotation": [0, 0, 0], "translation": [x, 0, 0]} for name, x in (("1", 0), ("2", -1))}
    path.write_text(json.dumps({"cameras": rig}))
    said: list[str] = []
    cameras = cameras_of_films(path, ["left.mp4", "right.mp4"], warn=said.append)
    assert [camera.translation[0] for camera in cameras] == [0, -1]
    assert said == [
        f"{path}: films are taken in the order of cameras, for no name says otherwise: left of 1, right of 2"
    ]
    said.clear()
    cameras = cameras_of_films(path, ["x_cam2.mp4", "x_cam1.mp4"], warn=said.append)
    assert ([camera.translation[0] for camera in cameras], said) == ([0, 1], [])
    cameras = cameras_of_films(path, ["hop_02.mp4", "hop_01.mp4"], warn=said.append)
    assert [camera.translation[0] for camera in cameras] == [0, 1]
    assert said == [
        f"{path}: films are taken by numbers or letters in their names, which no word for a camera precedes: "
        "hop_02 of 2, hop_01 of 1"
    ]
    with pytest.raises(InputError, match=r"rig.json: cameras 1, 2; expected one a film: a, b, c, by name"):
        cameras_of_films(path, ["a.mp4", "b.mp4", "c.mp4"])


def test_another_kind_of_file_names_those_that_are_read(tmp_path: Path) -> None:
    for name, text in (("a.calib", "1920"), ("a.pickle", "x"), ("a.xcp", "<Cameras/>"), ("a.json", '{"frames": 3}')):
        path = tmp_path / name
        path.write_text(text)
        with pytest.raises(
            InputError, match=r"Pose2Sim, Anipose, FreeMoCap or Caliscope.*Qualisys.*EasyMocap"
        ) as error:
            read_cameras(path)
        assert "\n" not in str(error.value)
