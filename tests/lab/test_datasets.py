"""Readers of data sets, on tiny files in the real formats, and what they refuse."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.files import Trap
from PIL import Image
from scipy.io import savemat

from warp_partdr.body.labels import label_set
from warp_partdr.body.skeletons import skeleton
from warp_partdr.errors import InputError
from warp_partdr.lab.evaluation.datasets import read_folder, read_human36m, read_lsp, read_pw3d
from warp_partdr.lab.evaluation.datasets.spin import SPIN_JOINTS

# Human3.6M's 17 joints (hip first) among SPIN's 24, as SPIN's h36m.py puts them there, in the order of h36m17.
H36M = ("mid_hip left_hip left_knee left_ankle right_hip right_knee right_ankle spine neck head head_top "
        "left_shoulder left_elbow left_wrist right_shoulder right_elbow right_wrist").split()  # fmt: skip
H36M_PLACES = [14, 3, 4, 5, 2, 1, 0, 16, 12, 17, 18, 9, 10, 11, 8, 7, 6]
LSP = skeleton("lsp14").landmarks


def spin_arrays(rng: np.random.Generator, people: int = 2) -> dict[str, Any]:
    """Files as SPIN's h36m_train.py writes them, with its dtypes."""
    truth, part = np.zeros((people, 24, 4)), np.zeros((people, 24, 3))
    truth[:, H36M_PLACES, :3], truth[:, H36M_PLACES, 3] = rng.normal(size=(people, 17, 3)), 1
    part[:, H36M_PLACES, :2], part[:, H36M_PLACES, 2] = rng.uniform(0, 1000, (people, 17, 2)), 1
    return {
        "imgname": np.array([f"images/S9_Directions_1.54138969_{5 * k + 1:06d}.jpg" for k in range(people)]),
        "center": np.array([[500.0, 400.0]] * people),
        "scale": np.full(people, 1.5),
        "part": part,
        "S": truth,
    }


def refused(error: str, read: Callable[..., Iterable[Any]], *args: Any, **options: Any) -> None:
    with pytest.raises(InputError, match=error):
        list(read(*args, **options))


def save(folder: Path, name: str = "h36m_valid_protocol1.npz", **arrays: Any) -> Path:
    np.savez(folder / name, **arrays)
    return folder / name


def test_human36m_reads_spins_arrays(tmp_path, rng):
    arrays = spin_arrays(rng)
    (tmp_path / "images").mkdir()
    Image.new("RGB", (4, 4)).save(tmp_path / arrays["imgname"][1])
    first, second = read_human36m(save(tmp_path, **arrays), pictures=tmp_path)
    assert first.name == "images/S9_Directions_1.54138969_000001:0"
    assert second.name == "images/S9_Directions_1.54138969_000006:1"
    assert second.source == "Human3.6M"
    assert first.picture is None
    assert second.picture == tmp_path / arrays["imgname"][1]
    assert second.keypoints.skeleton == "h36m17"
    for place, name in zip(H36M_PLACES, H36M, strict=True):
        joint = skeleton("h36m17").landmarks.index(name)
        assert second.keypoints.points[joint] == pytest.approx(arrays["part"][1, place, :2], rel=1e-6), name
    assert (second.keypoints.confidence == 1).all()
    assert [SPIN_JOINTS[place] for place in H36M_PLACES] == H36M
    assert SPIN_JOINTS[19:] == "nose left_eye right_eye left_ear right_ear".split()
    # As SPIN evaluates: the first 13 of the 24, and joint 18 for the head.
    assert tuple(SPIN_JOINTS[:14]) == LSP
    assert second.joint_names == LSP
    np.testing.assert_array_equal(second.joints, arrays["S"][1, [*range(13), 18], :3])


def test_joints_that_are_not_known_are_nan_and_openposes_keypoints_stand_in(tmp_path, rng):
    arrays = spin_arrays(rng)
    arrays["part"][1] = 0
    arrays["S"][0, 5, 3] = 0
    openpose = rng.uniform(1, 100, (2, 25, 3))
    openpose[..., 2] = 0.7
    openpose[1, 3] = 0
    first, second = read_human36m(save(tmp_path, **arrays, openpose=openpose))
    assert np.argwhere(np.isnan(first.joints)).tolist() == [[5, 0], [5, 1], [5, 2]]
    assert np.isfinite(second.joints).all()
    assert first.keypoints.skeleton == "h36m17"
    assert second.keypoints.skeleton == "body25"
    assert second.keypoints.points == pytest.approx(openpose[1, :, :2], rel=1e-6)
    assert second.keypoints.visible.tolist() == [k != 3 for k in range(25)]


def test_keypoints_come_from_a_detectors_files_where_arrays_have_none(tmp_path, rng):
    """SPIN's validation files have no 2D keypoints; of several people, the one in the box is meant."""
    arrays = spin_arrays(rng)
    del arrays["part"]
    path = save(tmp_path, **arrays)
    refused(r"no array part or openpose, so no 2D keypoints.*--keypoints", read_human36m, path)
    folder = tmp_path / "detected"
    folder.mkdir()
    far, near = (rng.uniform(0, 50, (17, 2)) + np.array([x, 400.0]) for x in (100.0, 480.0))
    people = [np.column_stack([points, np.ones(17)]).tolist() for points in (far, near)]
    for name in arrays["imgname"]:
        (folder / f"{Path(name).stem}_keypoints.json").write_text(json.dumps({"format": "coco17", "keypoints": people}))
    first, _ = read_human36m(path, keypoints=folder)
    assert first.keypoints.points == pytest.approx(near, rel=1e-5)
    assert first.others[0].points == pytest.approx(far, rel=1e-5)
    (folder / "S9_Directions_1.54138969_000006_keypoints.json").unlink()
    refused(
        r"no keypoints of images/S9_.*_000006.jpg; expected S9_.*_000006.json or", read_human36m, path, keypoints=folder
    )


def test_3dpw_reads_spins_arrays(tmp_path, rng):
    openpose = rng.uniform(1, 100, (2, 25, 3))
    path = save(
        tmp_path,
        "3dpw_test.npz",
        imgname=["imageFiles/downtown_arguing_00/image_00000.jpg", "imageFiles/downtown_arguing_00/image_00001.jpg"],
        center=[[10, 20], [30, 40]],
        scale=[1, 2],
        pose=rng.normal(size=(2, 72)),  # of SMPL, like the shape: not read
        shape=rng.normal(size=(2, 10)),
        openpose=openpose,
    )
    first, _ = read_pw3d(path)
    assert first.joints is None
    assert first.keypoints.confidence.max() == 1


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"scale": None}, "no array scale .*SPIN's datasets/preprocess/h36m.py"),
        ({"S": np.zeros((2, 17, 4))}, r"S: shape \(2, 17, 4\); expected \(2, 24, 4\)"),
        ({"center": np.zeros((3, 2))}, r"center: shape \(3, 2\); expected \(2, 2\)"),
        ({"part": np.full((2, 24, 3), np.nan)}, "part: float64, or NaN or infinity in it; expected finite"),
        ({"imgname": np.zeros(2)}, "imgname: float64; expected text"),
        ({"imgname": np.array("one")}, r"imgname: shape \(\); expected \(1\)"),
        ({"scale": np.array(["1", "2"])}, "scale: <U1, or NaN"),
        ({"imgname": np.array([{"a": 1}, None])}, "pickled Python objects, which could run code.*VideoPose3D"),
    ],
)
def test_wrong_arrays_are_named(tmp_path, rng, change, error):
    arrays = {name: values for name, values in (spin_arrays(rng) | change).items() if values is not None}
    refused(error, read_human36m, save(tmp_path, **arrays))


def test_files_that_are_missing_damaged_or_too_large_are_refused(tmp_path, rng, monkeypatch):
    damaged = save(tmp_path, imgname=np.zeros(1000))
    damaged.write_bytes(damaged.read_bytes()[:300])
    np.save(tmp_path / "one.npy", np.zeros(3))
    monkeypatch.setattr("warp_partdr.lab.evaluation.datasets.spin.MAX_BYTES", 10_000)
    np.savez_compressed(tmp_path / "bomb.npz", **spin_arrays(rng) | {"S": np.zeros((2, 6890, 3))})
    for name, error in (
        ("none.npz", r"none.npz: No such file.*h36m_valid_protocol1.npz.*vision.imar.ro"),
        (damaged.name, "not readable"),
        ("one.npy", "not readable"),
        ("bomb.npz", r"bomb\.npz: .* kB when unpacked; expected .*, at most 10\.0 kB"),
    ):
        refused(error, read_human36m, tmp_path / name)


def test_pickles_are_refused_and_nothing_in_them_runs(tmp_path):
    made = tmp_path / "made"
    sequences = tmp_path / "sequenceFiles" / "test"
    sequences.mkdir(parents=True)
    (sequences / "downtown_arguing_00.pkl").write_bytes(pickle.dumps(Trap(made)))
    for path in (tmp_path, sequences / "downtown_arguing_00.pkl"):
        refused(r"pickles.*3dpw_test.npz.*datasets/preprocess/pw3d.py", read_pw3d, path)
    # VideoPose3D's layout: a dictionary in an object array.
    video = save(tmp_path, "data_3d_h36m.npz", positions_3d=np.array({"S9": {"Walking": Trap(made)}}, dtype=object))
    refused(r"no array imgname.*\(but positions_3d\).*VideoPose3D's data_3d_h36m.npz", read_human36m, video)
    named = save(tmp_path, imgname=np.array([Trap(made)]), center=np.zeros((1, 2)), scale=np.zeros(1))
    refused("pickled Python objects", read_human36m, named)
    bare = tmp_path / "bare.npz"
    bare.write_bytes(pickle.dumps(Trap(made)))
    refused("not readable", read_human36m, bare)
    assert not made.exists()


@pytest.fixture
def lsp(tmp_path, rng) -> tuple[Path, Path, np.ndarray]:
    """LSP with two pictures of the test set: the folder, that of UPi-S1h's labels, and the joints (3, 14, N)."""
    folder, parts = tmp_path / "lsp_dataset", tmp_path / "upi-s1h" / "data" / "lsp"
    (folder / "images").mkdir(parents=True)
    parts.mkdir(parents=True)
    joints = rng.uniform(1, 60, (3, 14, 1002))
    savemat(folder / "joints.mat", {"joints": joints})
    for number in (1001, 1002):
        Image.new("RGB", (60, 70)).save(folder / "images" / f"im{number}.jpg")
        ids = np.zeros((70, 60), np.uint8)
        ids[10:20, 10:30], ids[20:40, 10:30], ids[60:] = 3, 6, 255
        Image.fromarray(ids).save(parts / f"im{number}_part_segmentation.png")
    mask = np.zeros((70, 60, 3), np.uint8)
    mask[5:50, 5:50] = 255
    Image.fromarray(mask).save(parts / "im1001_segmentation.png")
    return folder, parts, joints


def test_lsp_reads_the_test_set(lsp):
    folder, parts, joints = lsp
    first, second = read_lsp(folder, parts=parts)
    assert (first.name, second.name) == ("im1001", "im1002")
    assert first.keypoints.skeleton == "lsp14"
    assert second.keypoints.points == pytest.approx(joints[:2, :, 1001].T, rel=1e-6)
    assert first.parts.label_set.name == "lsp6"
    assert np.unique(first.target).tolist() == [0, 3, 6, 255]
    assert first.mask.sum() == 45 * 45
    assert second.mask is None
    assert first.picture == folder / "images" / "im1001.jpg"
    keypoints_alone = list(read_lsp(folder, test_only=False))
    assert len(keypoints_alone) == 1002
    assert keypoints_alone[0].parts is None


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2)])
def test_lsp_reads_joints_without_scipy(lsp, order):
    folder, _, joints = lsp
    (folder / "joints.mat").unlink()
    np.savez(folder / "joints.npz", joints=joints.transpose(order))
    first, _ = read_lsp(folder)
    assert first.keypoints.points == pytest.approx(joints[:2, :, 1000].T, rel=1e-6)


def test_lsp_is_read_from_an_annotation_file_of_spin(lsp):
    """SPIN's lsp_dataset.py writes such files."""
    folder, parts, joints = lsp
    part = np.zeros((1, 24, 3))
    part[0, :14, :2], part[0, :14, 2] = joints[:2, :, 1000].T, 1
    path = save(
        folder,
        "lsp_dataset_test.npz",
        imgname=["images/im1001.jpg"],
        partname=["data/lsp/im1001_part_segmentation.png"],
        maskname=["data/lsp/im1001_segmentation.png"],
        center=[[30.0, 30.0]],
        scale=[0.3],
        part=part,
    )
    (sample,) = read_lsp(path, parts=parts.parents[1], pictures=folder)
    (same, _) = read_lsp(folder, parts=parts)
    assert sample.keypoints.skeleton == "lsp14"
    for name in ("target", "mask"):
        np.testing.assert_array_equal(getattr(sample, name), getattr(same, name))
    np.testing.assert_array_equal(sample.keypoints.points, same.keypoints.points)
    assert sample.picture == same.picture
    refused(r"im1001_part_segmentation.png: No such file; expected part labels", read_lsp, path, parts=folder)


def test_lsp_says_what_is_missing(lsp, tmp_path, monkeypatch):
    folder, parts, _ = lsp
    (parts / "im1002_part_segmentation.png").unlink()
    refused(r"im1002_part_segmentation.png: No such file.*UPi-S1h.*classner/up", read_lsp, folder, parts=parts)
    refused(r"joints.mat: No such file.*lsp_dataset.*Johnson and Everingham", read_lsp, tmp_path)
    np.savez(folder / "joints.npz", joints=np.zeros((14, 2, 5)))
    refused(r"joints: float64 \(14, 2, 5\); expected numbers of shape \(3, 14, N\)", read_lsp, folder)
    np.savez(folder / "joints.npz", joints=np.zeros((3, 14, 5)))
    refused("5 people, none of the test set", read_lsp, folder)
    (folder / "joints.npz").unlink()
    (folder / "joints.mat").write_bytes(b"MATLAB 5.0 MAT-file, no more")
    refused(r"joints.mat: not readable", read_lsp, folder)
    monkeypatch.setitem(__import__("sys").modules, "scipy.io", None)
    refused(r"need SciPy; expected it \(pip install 'scipy>=1.15'\), or joints.npz", read_lsp, folder)
    (tmp_path / "00000_body.pkl").write_bytes(b"")
    refused(r"UP-3D's bodies are pickles.*up_3d_\*.npz of GraphCMR", read_lsp, tmp_path)


def person(folder: Path, name: str, *, ids: np.ndarray | None = None, size: tuple[int, int] = (40, 80)) -> None:
    """A picture of somebody who stands upright in its middle."""
    points = [[18.0 + 4 * (k % 2), y, 1.0] for k, y in enumerate(np.linspace(5, 75, 17).tolist())]
    Image.new("RGB", size).save(folder / f"{name}.jpg")
    (folder / f"{name}.keypoints.json").write_text(json.dumps({"format": "coco17", "keypoints": points}))
    if ids is not None:
        Image.fromarray(ids).save(folder / f"{name}.parts.png")


def standing() -> np.ndarray:
    """Labels of cdcl14: head, torso and both thighs, and a stray blob."""
    ids = np.zeros((80, 40), np.uint8)
    ids[2:20, 12:28], ids[20:45, 12:28], ids[45:78, 12:20], ids[45:78, 20:28] = 1, 2, 9, 10
    ids[0:3, 0:3] = 2
    return ids


def test_folder_reads_pictures_keypoints_and_labels(tmp_path):
    person(tmp_path, "b", ids=standing())
    person(tmp_path, "a", ids=standing())
    names = label_set("cdcl14").class_names
    (tmp_path / "labels.json").write_text(json.dumps({str(number): name for number, name in names.items()}))
    first, second = read_folder(tmp_path)
    assert (first.name, second.name) == ("a", "b")
    assert first.parts.label_set.name == "cdcl14"
    assert first.target[1, 1] == 255  # the blob is nobody's
    assert first.target[30, 20] == 2
    assert first.source == tmp_path.name
    assert first.picture == tmp_path / "a.jpg"


def test_a_folder_is_read_with_or_without_labels(tmp_path, shared):
    person(tmp_path, "a")
    (sample,) = read_folder(tmp_path)
    assert (sample.parts, sample.target) == (None, None)
    samples = list(read_folder(shared / "data" / "people"))
    assert [sample.name for sample in samples] == ["000000032081", "000000203864", "000000468632"]
    assert {sample.parts.label_set.name for sample in samples} == {"cdcl14"}


@pytest.mark.parametrize(
    ("spoil", "error"),
    [
        (lambda folder: (folder / "a.jpg").unlink(), "no pictures; expected a folder of pictures N.jpg"),
        (
            lambda folder: (folder / "a.keypoints.json").unlink(),
            r"a.keypoints.json: no such file; expected pictures.*partdr dataset and",
        ),
        (
            lambda folder: (folder / "labels.json").unlink(),
            r"labels.json: No such file; expected the label set .*--lab",
        ),
        (lambda folder: (folder / "labels.json").write_text("{"), "not JSON"),
        (lambda folder: (folder / "labels.json").write_text('{"1": "head"}'), "no known label set; expected .*cdcl14"),
        (lambda folder: person(folder, "b"), r"b.parts.png: No such file; expected part labels as of the other"),
        (lambda folder: person(folder, "a", size=(30, 80)), r"a.jpg: 30x80; a.parts.png: 40x80; expected one size"),
    ],
)
def test_folder_says_what_is_wrong(tmp_path, spoil, error):
    person(tmp_path, "a", ids=standing())
    groups = {"head": ["head"], "torso": ["chest"], "r": ["right_upper_leg"], "l": ["left_upper_leg"]}
    ids = {"0": "background", "1": "head", "2": "torso", "9": "r", "10": "l"}
    (tmp_path / "labels.json").write_text(json.dumps({"groups": groups, "ids": ids}))
    assert len(list(read_folder(tmp_path))) == 1
    spoil(tmp_path)
    refused(error, read_folder, tmp_path)
