"""Views of real people: the layout, its checks, readers of data sets' own files, and the command on made-up people."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import commands
from scipy.io import savemat

from warp_partdr.body.skeletons import MPJPE_JOINTS, skeleton
from warp_partdr.errors import InputError
from warp_partdr.inputs.films import FilmPicture
from warp_partdr.inputs.keypoints import Keypoints2D, person_height
from warp_partdr.lab.evaluation import real
from warp_partdr.lab.evaluation.datasets import Views, ViewSelection, read_real, read_views, view_samples, write_views
from warp_partdr.lab.evaluation.datasets.lenses import find_lens
from warp_partdr.lab.evaluation.datasets.mpi_inf_3dhp import _TRAIN_JOINTS
from warp_partdr.lab.evaluation.datasets.views import concatenate_views
from warp_partdr.lab.evaluation.evaluate import Method
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.lab.evaluation.real import real_methods
from warp_partdr.lab.evaluation.sizes import trunk_and_legs
from warp_partdr.solve.mesh.mesh_options import MeshOptions

run = commands.run  # a fixture
LSP = skeleton("lsp14").landmarks
FOCAL, CENTRE, SIZE = 1000.0, 500.0, (1000, 1000)
AWAY = np.array([0.0, 0.0, 4.0])


def project(joints: np.ndarray) -> np.ndarray:
    return FOCAL * joints[..., :2] / joints[..., 2:] + CENTRE


def made_views(**changes: Any) -> Views:
    """Two people of PartBench 4 m before a camera, the second one of whom has two views."""
    bodies = [make_sample(index, "clean").joints for index in (0, 1, 1)]
    joints = np.stack([body - body.mean(0) + AWAY for body in bodies])
    joints[2, :, 2] = 8 - joints[2, :, 2]  # from behind, mirrored
    arrays = {
        "joint_names": np.array(LSP),
        "joints_camera": joints,
        "keypoints": project(joints),
        "person": np.array([0, 1, 1]),
        "set": np.array(["a", "b", "b"]),
        "frame": np.array([5, 6, 7]),
        "camera": np.array(["left", "left", "right"]),
        "focal": np.full((3, 2), FOCAL),
        "centre": np.full((3, 2), CENTRE),
        "picture_size": np.full((3, 2), SIZE[0]),
    }
    return Views(**(arrays | changes))


def test_views_are_read_as_they_were_written(tmp_path):
    views = made_views(baseline=np.array([True, False, True]))
    write_views(tmp_path / "views.npz", views)
    for path in (tmp_path, tmp_path / "views.npz"):
        again = read_views(path)
        assert again.arrays().keys() == views.arrays().keys()
        for name, values in views.arrays().items():
            np.testing.assert_array_equal(again.arrays()[name], values)
    first, second, third = view_samples(again, np.arange(3))
    assert [first.source, second.name, third.cluster] == ["a", "b/1/6/left", "b/1"]
    np.testing.assert_array_equal(second.joints, views.joints_camera[1])
    np.testing.assert_allclose(second.keypoints.points, views.keypoints[1], rtol=1e-6)
    assert second.keypoints.visible.all()
    assert second.camera.intrinsics.tolist() == [[FOCAL, FOCAL, CENTRE, CENTRE]]
    assert view_samples(again, np.arange(3), clusters="moments")[2].cluster == "b/1/7"


def test_the_sets_name_is_the_folders_where_none_is_told(tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    write_views(folder / "sights.npz", replace(made_views(), set=None))
    assert view_samples(read_views(folder), np.arange(1))[0].source == "mine"


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("joints_camera", np.zeros((3, 13, 3)), r"joints_camera: shape .*; expected \(3, 14, 3\)"),
        ("keypoints", np.full((3, 14, 2), np.inf), "keypoints: inf"),
        ("person", np.array([0.5, 1, 2]), "person: float64; expected text or whole numbers"),
        ("joint_names", np.array(["left_paw", *LSP[1:]]), "joint_names: 'left_paw'; expected landmarks"),
        ("joint_names", np.array([LSP[1], *LSP[1:]]), "joint_names: 'right_knee' 2 times; expected each name once"),
        (
            "joint_names",
            np.array(["nose", *LSP[1:]]),
            "joint_names: left_ankle, without right_ankle; expected both sides",
        ),
        ("confidence", np.full((3, 14), np.nan), "confidence: nan in it; expected finite numbers"),
        ("confidence", np.full((3, 14), 1.5), "confidence: 1.5 in it; expected 0 to 1"),
        ("joints_camera", 1000 * np.ones((3, 14, 3)), "joints_camera: people of 0 m; expected joints in metres"),
        ("joints_camera", 1e9 * np.ones((3, 14, 3)), "joints_camera: 1000000000.0 in it; expected -100000 to 100000"),
        ("keypoint_names", np.array([LSP[1], *LSP[1:]]), "keypoint_names: 'right_knee' 2 times"),
        ("keypoints", np.full((3, 14, 2), 1e7), "keypoints: 10000000.0 in it"),
        ("focal", np.full((3, 2), -1000.0), r"focal: -1000.0 in it; expected 1 to 1e\+06"),
        ("focal", np.zeros((3, 2)), "focal: 0.0 in it"),
        ("stature", np.full(3, 178.0), "stature: 178.0 in it; expected 0.4 to 2.8"),
        ("picture_size", np.zeros((3, 2), dtype=int), "picture_size: 0 in it"),
        ("film_frame", np.full(3, -1), "film_frame: -1 in it; expected 0 or more"),
        ("person", np.array([b"a", b"b", b"b"]), "person: .S1; expected text or whole numbers"),
        ("focal", None, "focal, centre: one without the other"),
        ("picture_size", np.full((3, 2), 100.5), "picture_size: float64; expected whole numbers"),
        ("baseline", np.array([0, 1, 1]), "baseline: int64; expected true or false"),
    ],
)
def test_wrong_arrays_are_refused(name, value, error):
    with pytest.raises(InputError, match=error):
        made_views(**{name: value})


def test_joints_in_millimetres_and_behind_the_camera_are_refused():
    joints = made_views().joints_camera
    with pytest.raises(InputError, match=r"joints_camera: people of 1.*e\+03 m; expected joints in metres"):
        made_views(joints_camera=1000 * joints)
    with pytest.raises(InputError, match="joints_camera: row 1 is behind its camera; expected z away"):
        made_views(joints_camera=joints * np.array([1, -1, 1])[:, None, None])
    rooted = joints - joints.mean(axis=1, keepdims=True)  # as SPIN has them, whose cameras are not known
    assert len(made_views(joints_camera=rooted, focal=None, centre=None)) == 3


def test_rows_that_nothing_can_be_told_of_are_left_out():
    views = made_views()
    joints, confidence = views.joints_camera.copy(), np.ones((3, len(LSP)))
    joints[0, 2:], confidence[1] = np.nan, 0
    assert ViewSelection("every").of(replace(views, joints_camera=joints, confidence=confidence)).tolist() == [2]


def test_samples_of_one_person_moment_and_camera_have_names_of_their_own():
    views = made_views(frame=np.array([6, 6, 6]), camera=np.array(["left"] * 3))
    assert [each.name for each in view_samples(views, np.arange(3))] == ["a/0/6/left", "b/1/6/left", "b/1/6/left (2)"]


def test_conventions_are_known_or_refused():
    views = made_views()
    assert view_samples(views, np.arange(1), convention="panoptic")[0].body_points[0] == "coco_right_ankle"
    for wrong in ({"convention": "kinect"}, {}):
        with pytest.raises(InputError, match="convention: 'kinect'; expected coco, h36m, shelf"):
            view_samples(replace(views, convention=np.array(["kinect"] * 3)), np.arange(1), **wrong)


def test_pickles_and_files_without_what_is_needed_are_refused(tmp_path):
    arrays = made_views().arrays()
    np.savez(tmp_path / "views.npz", **(arrays | {"person": np.array([{}, {}, {}], dtype=object)}))
    with pytest.raises(InputError, match="pickled"):
        read_views(tmp_path)
    del arrays["person"]
    np.savez(tmp_path / "views.npz", **arrays)
    with pytest.raises(InputError, match=r"views\.npz: no array person"):
        read_views(tmp_path)
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match=r"none of these; expected a folder with views\.npz"):
        read_real(empty)


def test_views_of_other_joints_are_not_joined():
    views = made_views()
    fewer = {name: getattr(views, name)[:, :-1] for name in ("joints_camera", "keypoints")}
    fewer = replace(views, joint_names=views.joint_names[:-1], **fewer)
    with pytest.raises(InputError, match=r"files with \d+ and \d+ joints; expected one kind of file a folder"):
        concatenate_views([views, fewer])


def test_rows_are_chosen_by_border_name_moment_and_mark():
    views = made_views()
    keypoints = views.keypoints.copy()
    keypoints[0, 0], keypoints[0, 2] = [-5, 100], [1100, 100]
    keypoints[1, 1] = np.nan
    marked = np.array([True, False, True])
    views = replace(views, keypoints=keypoints, baseline=marked, picture_size=np.array([[1200, 1000]] * 3))
    assert ViewSelection().of(views).tolist() == [1, 2]  # a joint that nobody knows is not outside
    assert ViewSelection("every").of(views).tolist() == [0, 1, 2]
    assert ViewSelection("baseline").of(views).tolist() == [0, 2]
    assert ViewSelection("every", people=("b",)).of(views).tolist() == [1, 2]
    assert ViewSelection("every", leave_out=("b/1",)).of(views).tolist() == [0]
    assert ViewSelection("every", frames=("5", "7")).of(views).tolist() == [0, 2]
    assert ViewSelection("every", step=2).of(views).tolist() == [0, 2]
    assert ViewSelection("every", frames=("0",)).of(replace(views, frame=None)).tolist() == [0, 1, 2]
    with pytest.raises(ValueError, match="step: 0; expected an integer of 1 or more"):
        ViewSelection("every", step=0).of(views)
    with pytest.raises(InputError, match="people: 'c'; expected of a/0, b/1"):
        ViewSelection(people=("c",)).of(views)
    with pytest.raises(InputError, match="rows: none of 3 left"):
        ViewSelection(people=("a",)).of(views)
    outside, unknown, _ = view_samples(views, np.arange(3))
    assert np.flatnonzero(~outside.keypoints.visible).tolist() == [0, 2]
    assert np.flatnonzero(~unknown.keypoints.visible).tolist() == [1]


def test_joints_mark_the_points_of_their_sets_convention():
    """They are the keypoints' targets and the truth's counterpart."""
    views = made_views(set=np.array(["coco_x", "panoptic_band", "mine"]))
    coco, panoptic, mine = view_samples(views, np.arange(3))
    hip = MPJPE_JOINTS.index("left_hip")
    assert coco.body_points[hip] == coco.keypoints.format.marks[hip] == "coco_left_hip"
    assert panoptic.body_points == coco.body_points
    assert mine.body_points == mine.joint_names == mine.keypoints.format.marks
    assert view_samples(views, np.arange(1), convention="")[0].body_points == MPJPE_JOINTS
    told = replace(views, convention=np.array(["", "", "coco"]))
    assert view_samples(told, np.arange(3))[2].body_points == coco.body_points


def test_keypoints_of_a_format_are_given_alone_where_all_are_known():
    names = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
    views = made_views()
    seen = np.concatenate([views.keypoints, np.full((3, 5, 2), 300.0)], axis=1)
    joints = np.concatenate([views.joints_camera, np.full((3, 5, 3), 3.0)], axis=1)
    seen[2, 14] = np.nan
    views = replace(views, joint_names=np.array([*LSP, *names]), keypoints=seen, joints_camera=joints)
    whole, _, part = view_samples(views, np.arange(3), keypoints="coco17")
    assert whole.keypoints.skeleton.name == "coco17"
    knee = skeleton("coco17").landmarks.index("left_knee")
    np.testing.assert_allclose(whole.keypoints.points[knee], seen[0, LSP.index("left_knee")], rtol=1e-6)
    assert len(part.keypoints.format) == 19


def test_a_detectors_keypoints_have_names_of_their_own():
    names = ["LHip", "RHip", "LKnee", "RKnee", "cheek"]
    points = np.arange(30.0).reshape(3, 5, 2) + 1
    views = made_views(keypoint_names=np.array(names), keypoints=points, confidence=np.full((3, 5), 0.5))
    keypoints = view_samples(views, np.arange(1))[0].keypoints
    assert set(keypoints.format.landmarks) == {"left_hip", "right_hip", "left_knee", "right_knee"}
    place = keypoints.format.landmarks.index("left_knee")
    assert keypoints.points[place].tolist() == points[0, 2].tolist()
    assert keypoints.confidence[place] == 0.5


def test_statures_are_given_or_told_by_the_persons_bones():
    views = made_views()
    lengths = [trunk_and_legs(joints, LSP) for joints in views.joints_camera]
    told = [sample.stature for sample in view_samples(views, np.arange(3))]
    assert told[0] == pytest.approx(lengths[0] / 0.779)
    assert told[1] == told[2] == pytest.approx((lengths[1] + lengths[2]) / 2 / 0.779)
    given = replace(views, stature=np.array([1.7, np.nan, np.nan]))
    assert [sample.stature for sample in view_samples(given, np.arange(2))] == pytest.approx([1.7, told[1]])


def test_trunk_and_legs_are_measured_along_their_bones():
    """The trunk is 0.5 m long, and the legs 0.4 + 0.3 m and 0.5 + 0.4 m."""
    places = {
        "shoulder": [[0.2, -0.5, 0.0], [-0.2, -0.5, 0.0]],
        "hip": [[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0]],
        "knee": [[0.1, 0.4, 0.0], [-0.1, 0.0, 0.5]],
        "ankle": [[0.1, 0.4, -0.3], [-0.1, 0.4, 0.5]],
    }
    names = [f"{side}_{joint}" for joint in places for side in ("left", "right")]
    joints = np.concatenate(list(places.values()))
    assert trunk_and_legs(joints, names) == pytest.approx(0.5 + (0.7 + 0.9) / 2)
    assert np.isnan(trunk_and_legs(joints, ["nose", *names[1:]]))


def test_a_lens_is_found_by_points_and_where_they_are_seen(rng):
    joints = rng.uniform(-1, 1, (20, 3)) + AWAY
    seen = joints[:, :2] / joints[:, 2:] * [900, 1100] + [300, 400]
    seen[0] = np.nan
    focal, centre = find_lens(joints, seen)
    np.testing.assert_allclose(focal, [900, 1100])
    np.testing.assert_allclose(centre, [300, 400])


def trc(path: Path, names: list[str], points: np.ndarray, unit: str = "mm") -> Path:
    """A file as Pose2Sim writes it; points (T, J, 3) in this unit."""
    lines = [
        "PathFileType\t4\t(X/Y/Z)\ttrial.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"60\t60\t{len(points)}\t{len(names)}\t{unit}\t60\t0\t{len(points)}",
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{k + 1}" for k in range(len(names)) for axis in "XYZ"),
        "",
    ]
    for frame, row in enumerate(points, start=3):
        cells = ["" if np.isnan(value) else f"{value:.6f}" for value in row.ravel()]
        lines.append("\t".join([str(frame), f"{frame / 60:.4f}", *cells]))
    path.write_text("\n".join(lines) + "\n")
    return path


def cameras(path: Path) -> Path:
    """Two cameras of 1000 x 1000 px: one in the world's frame, one from the side, both 4 m before the same place."""
    one = {"size": [1000, 1000], "focal": [FOCAL, FOCAL], "principal": [CENTRE, CENTRE], "translation": [0, 0, 0]}
    other = one | {"rotation": [0, np.pi / 2, 0], "translation": [-4, 0, 4]}
    path.write_text(json.dumps({"cameras": {"cam1": one | {"rotation": [0, 0, 0]}, "cam2": other}}))
    return path


TRC_NAMES = ["RHip", "LHip", "RKnee", "LKnee", "RAnkle", "LAnkle", "RShoulder", "LShoulder", "Cluster1"]


def test_trc_files_are_seen_by_calibrated_cameras(tmp_path, rng):
    points = rng.uniform(-0.8, 0.8, (2, len(TRC_NAMES), 3)) + AWAY
    points[1, 2] = np.nan
    views = read_real(trc(tmp_path / "walk.trc", TRC_NAMES, 1000 * points), cameras=cameras(tmp_path / "c.json"))
    assert len(views) == 4
    assert views.frame.tolist() == [3, 3, 4, 4]
    assert views.camera.tolist() == ["cam1", "cam2"] * 2
    names = views.joint_names.tolist()
    assert "left_knee" in names
    assert len(names) == 8
    hip = names.index("right_hip")
    np.testing.assert_allclose(views.joints_camera[0, hip], points[0, 0], atol=1e-6)
    np.testing.assert_allclose(
        views.joints_camera[1, hip], [points[0, 0, 2] - 4, points[0, 0, 1], 4 - points[0, 0, 0]], atol=1e-6
    )
    np.testing.assert_allclose(views.keypoints[1, hip], project(views.joints_camera[1, hip]), atol=1e-6)
    assert np.isnan(views.keypoints[2:, names.index("right_knee")]).all()
    (sample,) = view_samples(views, np.arange(1))
    assert sample.source == "walk"
    assert "coco_left_hip" in sample.body_points


def test_trc_files_that_were_turned_are_turned_back(tmp_path, rng):
    """Pose2Sim's y is up: it writes (y, z, x)."""
    points = rng.uniform(-0.8, 0.8, (1, len(TRC_NAMES), 3)) + AWAY
    turned, known = points[..., [1, 2, 0]], cameras(tmp_path / "c.json")
    file = trc(tmp_path / "walk.trc", TRC_NAMES, turned, "m")
    found = read_real(file, cameras=known)
    hip = found.joint_names.tolist().index("right_hip")
    np.testing.assert_allclose(found.joints_camera[0, hip], points[0, 0], atol=1e-6)
    np.testing.assert_array_equal(read_real(file, cameras=known, axes="z x y").keypoints, found.keypoints)
    with pytest.raises(InputError, match="axes: 'x y -z'; expected x, y and z"):
        read_real(file, cameras=known, axes="x y -z")


@pytest.mark.parametrize(
    ("change", "error"),
    [
        (lambda text: text.replace("\tmm\t", "\tinch\t"), "Units: 'inch'; expected m, mm, cm"),
        (lambda text: "no " + text, "in its first line; expected a .trc file"),
        (lambda text: text.replace("\t60\t0\t", "\t60\t0\t").replace("3\t0.0500", "three\t0.0500"), "frame 0"),
        (lambda text: "".join(text.splitlines(keepends=True)[:5]), "expected a .trc file"),
        (lambda text: text.replace("LHip", "RHip"), "names: 'RHip' 2 times; expected joints of one person"),
        (lambda text: text.replace("\t0.0500\t", "\t0.0500\tinf\t"), "points: infinite"),
        (lambda text: text + text.splitlines()[-1], "frames: 3 after 3; expected rising numbers"),
        (lambda text: text.rpartition("\t")[0], "frame 3: 26 numbers; expected 27"),
    ],
)
def test_trc_files_with_faults_are_refused(tmp_path, rng, change, error):
    file = trc(tmp_path / "walk.trc", TRC_NAMES, rng.uniform(size=(1, len(TRC_NAMES), 3)))
    file.write_text(change(file.read_text()))
    with pytest.raises(InputError, match=error):
        read_real(file, cameras=cameras(tmp_path / "c.json"))


def test_units_in_capitals_and_a_byte_order_mark_are_read(tmp_path, rng):
    file = trc(tmp_path / "walk.trc", TRC_NAMES, 1000 * (rng.uniform(-0.8, 0.8, (1, len(TRC_NAMES), 3)) + AWAY), "MM")
    file.write_text("\ufeff" + file.read_text(), encoding="utf-8")
    assert len(read_real(file, cameras=cameras(tmp_path / "c.json"))) == 2


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"joints_world": np.full((2, 14, 3), "1")}, "<U1; expected joints over time"),
        ({"joint_names": np.array("left_hip")}, "expected joints over time"),
        ({"frames": np.array([9, 9])}, "frames: 9 after 9; expected rising numbers"),
    ],
)
def test_joints_over_time_with_faults_are_refused(tmp_path, changes, error):
    arrays = {"joint_names": np.array(LSP), "joints_world": np.ones((2, 14, 3)), "frames": np.arange(2)}
    np.savez(tmp_path / "trial.npz", **(arrays | changes))
    with pytest.raises(InputError, match=rf"trial\.npz: .*{error}"):
        read_real(tmp_path / "trial.npz", cameras=cameras(tmp_path / "c.json"))


def test_joints_over_time_come_with_cameras_and_films(tmp_path, rng):
    points = rng.uniform(-0.8, 0.8, (2, 14, 3)) + AWAY
    file = tmp_path / "trial.npz"
    np.savez(file, joint_names=np.array(LSP), joints_world=points, frames=np.array([7, 9]))
    with pytest.raises(InputError, match="without cameras"):
        read_real(file)
    films = tmp_path / "films"
    films.mkdir()
    for name in ("cam2", "cam1"):
        (films / f"{name}.mp4").touch()
    views = read_real(file, cameras=cameras(tmp_path / "c.json"), films=films)
    np.testing.assert_allclose(views.joints_camera[3, 0], [points[1, 0, 2] - 4, points[1, 0, 1], 4 - points[1, 0, 0]])
    samples = view_samples(views, np.arange(4))
    assert [sample.picture for sample in samples] == [
        FilmPicture(films / f"cam{camera}.mp4", frame) for frame in (0, 2) for camera in (1, 2)
    ]
    assert [sample.name for sample in samples][:2] == ["trial/0/7/cam1", "trial/0/7/cam2"]
    (films / "cam3.mp4").touch()
    with pytest.raises(InputError, match="3 films; expected 2, one a camera"):
        read_real(file, cameras=tmp_path / "c.json", films=films)


def test_annotations_of_mpi_inf_3dhp_are_read(tmp_path, rng):
    """They are as in ``annot.mat``: cells of 14 cameras, 28 joints in a row of numbers, millimetres."""
    joints = rng.uniform(-800, 800, (14, 3, 28, 3)) + 1000 * AWAY
    seen = joints[..., :2] / joints[..., 2:] * 1500 + 1024
    cells = {name: np.empty((14, 1), dtype=object) for name in ("annot2", "annot3")}
    for camera in range(14):
        cells["annot3"][camera, 0] = joints[camera].reshape(3, -1)
        cells["annot2"][camera, 0] = seen[camera].reshape(3, -1)
    folder = tmp_path / "S1" / "Seq2"
    folder.mkdir(parents=True)
    savemat(folder / "annot.mat", cells)
    views = read_real(tmp_path)
    assert len(views) == 14 * 3
    place, row = views.joint_names.tolist().index("left_ankle"), 3 * 5 + 1
    np.testing.assert_allclose(views.joints_camera[row, place], joints[5, 1, 20] / 1000)
    np.testing.assert_allclose(views.keypoints[row, place], seen[5, 1, 20])
    np.testing.assert_allclose([*views.focal[row], *views.centre[row]], [1500, 1500, 1024, 1024])
    assert view_samples(views, np.array([row]))[0].name == "mpi_inf_3dhp/S1/Seq2_1/5"
    assert len(_TRAIN_JOINTS) == 28


def write_hdf5(path: Path, arrays: dict[str, np.ndarray]) -> None:
    h5py = pytest.importorskip("h5py", reason="needs h5py")
    path.parent.mkdir(parents=True)
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file.create_dataset(name, data=values)


def test_test_people_of_mpi_inf_3dhp_are_read(tmp_path, rng):
    """They are as in ``annot_data.mat``, and only valid frames count."""
    joints = rng.uniform(-800, 800, (4, 1, 17, 3)) + 1000 * AWAY
    seen = joints[..., :2] / joints[..., 2:] * 1500 + 500
    arrays = {"annot2": seen, "annot3": joints, "valid_frame": np.array([[1.0], [0], [0], [1]])}
    write_hdf5(tmp_path / "TS5" / "annot_data.mat", arrays)
    views = read_real(tmp_path)
    assert views.frame.tolist() == ["0", "3"]
    assert views.picture_size[0].tolist() == [1080, 1920]
    np.testing.assert_allclose(views.joints_camera[1, 0], joints[3, 0, 0] / 1000)
    assert views.joint_names[0] == "head_top"


def test_human36m_is_read_from_hdf5(tmp_path, rng):
    """The file is as h36m-fetch writes it: rows of all cameras, 32 joints, millimetres."""
    joints = rng.uniform(-800, 800, (4, 32, 3)) + 1000 * AWAY
    seen = joints[..., :2] / joints[..., 2:] * 1145 + 512
    arrays = {"frame": np.array([1, 6, 1, 6]), "camera": np.array([5, 5, 8, 8]), "subject": np.full(4, 9)}
    write_hdf5(tmp_path / "S9" / "Eating" / "annot.h5", {"pose/2d": seen, "pose/3d-univ": joints} | arrays)
    views = read_real(tmp_path)
    assert [sample.name for sample in view_samples(views, np.arange(4))] == [
        f"h36m/S9/Eating_{frame}/{camera}" for camera in (5, 8) for frame in (1, 6)
    ]
    np.testing.assert_allclose(views.joints_camera[2, 10], joints[2, 15] / 1000)  # the crown
    np.testing.assert_allclose(views.focal[0], 1145)


def test_spins_arrays_are_views_of_subjects(tmp_path, rng):
    truth, part = rng.normal(size=(2, 24, 4)), rng.uniform(1, 100, (2, 24, 3))
    truth[..., 3], part[..., 2] = 1, 1
    truth[0, 5, 3] = part[1, 4, 2] = 0
    np.savez(
        tmp_path / "h36m_valid.npz",
        imgname=np.array(["images/S9_Eating.1_000001.jpg", "S11_Eating.1_000006.jpg"]),
        center=np.zeros((2, 2)),
        scale=np.ones(2),
        part=part,
        S=truth,
    )
    views = read_real(tmp_path / "h36m_valid.npz")
    first, second = view_samples(views, np.arange(2))
    assert (first.cluster, second.cluster) == ("h36m_valid/S9", "h36m_valid/S11")
    assert np.flatnonzero(np.isnan(first.joints).any(axis=1)).tolist() == [LSP.index("left_ankle")]
    assert not second.keypoints.visible[views.joint_names.tolist().index("left_knee")]
    np.testing.assert_allclose(second.joints[0], truth[1, 0, :3])


def test_spins_arrays_of_nobody_are_refused_and_bytes_are_text(tmp_path, rng):
    arrays = {
        "imgname": np.array([b"images/S9_Eating.1_000001.jpg"]),
        "center": np.zeros((1, 2)),
        "scale": np.ones(1),
        "part": np.ones((1, 24, 3)),
        "S": np.concatenate([rng.normal(size=(1, 24, 3)), np.ones((1, 24, 1))], axis=2),
    }
    np.savez(tmp_path / "h36m.npz", **arrays)
    assert read_real(tmp_path / "h36m.npz").people().tolist() == ["h36m/S9"]
    np.savez(tmp_path / "h36m.npz", **{name: values[:0] for name, values in arrays.items()})
    with pytest.raises(InputError, match=r"h36m\.npz: imgname: nobody; expected at least one person"):
        read_real(tmp_path / "h36m.npz")


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"annot3": np.ones((4, 17, 3))}, r"annot3: shape \(4, 17, 3\); expected \(4, 1, 17, 3\)"),
        ({"valid_frame": np.ones((9, 1))}, "annot3: shape"),
        ({"valid_frame": np.zeros((4, 1))}, "valid_frame: none of them is"),
        ({"annot3": np.ones((4, 1, 17, 3)) * [1, 1, -1]}, "0 before the camera; expected 6 or more, all before it"),
        ({"annot3": np.full((4, 1, 17, 3), np.nan)}, "0 known in both"),
    ],
)
def test_mpi_inf_3dhps_test_people_with_faults_are_refused(tmp_path, rng, changes, error):
    joints = rng.uniform(-800, 800, (4, 1, 17, 3)) + 1000 * AWAY
    arrays = {"annot2": project(joints), "annot3": joints, "valid_frame": np.ones((4, 1))}
    write_hdf5(tmp_path / "TS5" / "annot_data.mat", arrays | changes)
    with pytest.raises(InputError, match=rf"^{tmp_path}/TS5/annot_data\.mat: .*{error}"):
        read_real(tmp_path)


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"subject": np.array([9])}, r"subject: int64 \(1,\); expected whole numbers, one a frame"),
        ({"camera": np.array([5.0, np.nan])}, "camera: float64"),
        ({"pose/3d": np.ones((2, 32, 3)), "pose/2d": np.zeros((2, 32, 2))}, "expected joints where the keypoints are"),
        ({"pose/2d": np.ones((3, 32, 2))}, "not 32 joints of each of 2 frames"),
    ],
)
def test_human36ms_hdf5_with_faults_is_refused(tmp_path, rng, changes, error):
    joints = rng.uniform(-800, 800, (2, 32, 3)) + 1000 * AWAY
    arrays = {"frame": np.arange(2), "camera": np.full(2, 5), "subject": np.full(2, 9)}
    arrays |= {"pose/2d": project(joints), "pose/3d": joints}
    write_hdf5(tmp_path / "S9" / "Eating" / "annot.h5", arrays | changes)
    with pytest.raises(InputError, match=rf"annot\.h5: .*{error}"):
        read_real(tmp_path)


def test_mpi_inf_3dhps_cells_of_other_shapes_are_refused(tmp_path):
    cells = {name: np.empty((14, 1), dtype=object) for name in ("annot2", "annot3")}
    for camera in range(14):
        cells["annot2"][camera, 0], cells["annot3"][camera, 0] = np.ones((2, 56)), np.ones((2, 83))
    savemat(tmp_path / "annot.mat", cells)
    with pytest.raises(InputError, match=r"annot\.mat: annot3: camera 0: shape \(2, 83\); expected \(frames, 84\)"):
        read_real(tmp_path)


def test_the_command_compares_methods_on_people(tmp_path, run):
    """Clusters are people, the better told fits are nearer, and views that were fitted can be kept."""
    write_views(tmp_path / "views.npz", made_views())
    out, kept = tmp_path / "f.json", tmp_path / "kept.npz"
    code, told, errors = run(f"evaluate real {tmp_path} --camera true --stature true --out {out} --save {kept}")
    assert code == 0, errors
    data = json.loads(out.read_text())
    assert data["pooled"].keys() == {"a", "b", "all"}
    both = data["pooled"]["all"]["network"]
    assert (both["people"], both["views"]) == (2, 3)
    assert both["stature_share"] == pytest.approx(1, abs=1e-3)
    assert 0 <= both["depth_within_spread"] <= both["depth_within_two_spreads"] <= 1
    assert "all: 3 views, intervals over 2 people" in told
    assert "all: mesh minus network: PA-MPJPE" in told
    assert "interval_95" not in data["pooled"]["b"]["mesh"]  # two views of one person
    assert len(read_views(kept)) == 3


def test_of_everybody_in_a_photo_the_person_counts_who_is_where_the_truth_is(monkeypatch):
    (sample,) = view_samples(made_views(), np.arange(1))
    sample = replace(sample, picture=np.zeros((4, 4, 3), dtype=np.uint8))
    form = skeleton("coco17")
    confidence = np.ones(17, dtype=np.float32)
    here = np.stack(
        [sample.keypoints.points[LSP.index(name)] if name in LSP else np.zeros(2) for name in form.landmarks]
    ).astype(np.float32)
    height = person_height(sample.keypoints)
    people = [SimpleNamespace(keypoints=Keypoints2D(form, here + off * height, confidence)) for off in (0.3, 0.01)]
    given = {}

    def found(photo: np.ndarray, **options: Any) -> Any:
        given.update(options)
        return SimpleNamespace(people=people, fits={0: "other", 1: "person"})

    monkeypatch.setattr(real, "fit_photo", found)
    methods = real_methods(camera=True, stature=1.8)
    assert methods["photo alone"].serves(sample)
    assert not methods["photo alone"].serves(replace(sample, picture=None))
    assert methods["photo alone"].fit_sample(sample, "cpu") == "person"
    assert given["camera"] is sample.camera
    assert given["options"].stature == 1.8
    for name, source in (
        ("photo alone", "packaged"),
        ("photo alone, mask", "mask"),
        ("photo alone, keypoints", "none"),
    ):
        methods[name].fit_sample(sample, "cpu")
        assert given["parts_from"] == source
    people[1] = people[0] = SimpleNamespace(keypoints=Keypoints2D(form, here + height, confidence))
    with pytest.raises(InputError, match="nobody found there"):
        methods["photo alone"].fit_sample(sample, "cpu")
    crown = skeleton("lsp14")  # of whose landmarks a detector in COCO's format knows neither neck nor crown
    shown = np.isin(crown.landmarks, ("neck", "head_top")).astype(np.float32)
    alone = Keypoints2D(crown, sample.keypoints.points, shown)
    with pytest.raises(InputError, match="nobody found there, inf heights off"):
        methods["photo alone"].fit_sample(replace(sample, keypoints=alone), "cpu")


def test_a_quality_changes_the_stages_and_the_mesh_stage(tmp_path, run):
    """More steps end elsewhere, and the network's body, which takes none, stays where it is."""
    write_views(tmp_path / "views.npz", made_views())
    figures = {}
    for quality in ("balanced", "accurate"):
        out = tmp_path / f"{quality}.json"
        rows = "--method network --method ellipsoids --method mesh --limit 1"
        code, _, errors = run(f"evaluate real {tmp_path} --quality {quality} {rows} --out {out}")
        assert code == 0, errors
        found = json.loads(out.read_text())["pooled"]["a"]
        figures[quality] = {name: found[name]["mpjpe_mm"] for name in ("network", "ellipsoids", "mesh")}
    balanced, accurate = figures["balanced"], figures["accurate"]
    assert balanced["network"] == accurate["network"]
    assert balanced["ellipsoids"] != accurate["ellipsoids"]
    assert balanced["mesh"] != accurate["mesh"]
    (sample,) = view_samples(made_views(), np.arange(1))
    method = real_methods("accurate")["mesh"]
    assert isinstance(method, Method)
    shorter = replace(method, options=replace(method.options, mesh=MeshOptions(iterations=2)))
    assert not np.allclose(
        method.fit_sample(sample, "cpu").vertices, shorter.fit_sample(sample, "cpu").vertices, atol=1e-3
    )


def test_a_focal_length_for_all_is_one_of_longer_sides(tmp_path, run):
    """Whoever is told of the true focal length, which is the picture's side, fits as with the true camera."""
    write_views(tmp_path / "views.npz", made_views())
    figures = []
    for camera in ("true", "1.0", "0.6"):
        out = tmp_path / f"{camera}.json"
        code, _, errors = run(f"evaluate real {tmp_path} --camera {camera} --method network --limit 1 --out {out}")
        assert code == 0, errors
        figures.append(json.loads(out.read_text())["pooled"]["a"]["network"]["mpjpe_mm"])
    assert figures[0] == pytest.approx(figures[1], abs=0.2)
    assert abs(figures[2] - figures[0]) > 1


def test_a_true_stature_that_nobody_knows_is_refused(tmp_path, run):
    views = made_views()
    joints = views.joints_camera.copy()
    joints[0, :2] = np.nan  # a leg
    write_views(tmp_path / "views.npz", replace(views, joints_camera=joints))
    code, _, told = run(f"evaluate real {tmp_path} --stature true --method network")
    assert code == 2
    assert "--stature: true, but that of a/0/5/left is not known" in told


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ("--stature 0.3", "stature: 0.3; expected metres, 0.4 to 2.8"),
        ("--stature -1", "--stature: -1; expected none, true, or a number above 0"),
        ("--convention kinect", "convention: 'kinect'; expected coco"),
        ("--camera wide", "--camera: wide; expected none, true, or a number"),
        ("--by view", "--by: view; expected set or person"),
        ("--intervals views", "intervals: 'views'; expected people or moments"),
        ("--step 0", "--step: 0; expected 1 or more"),
        ("--method shape", "--method: shape; expected network"),
        ("--cameras c.toml", "cameras: c.toml"),
        ("--rows baseline", "no array baseline"),
    ],
)
def test_the_command_refuses_what_it_does_not_know(tmp_path, run, options, error):
    write_views(tmp_path / "views.npz", made_views())
    code, _, told = run(f"evaluate real {tmp_path} {options}")
    assert code == 2
    assert error in told
