"""Landmarks lie where the body has them, and skeletons are those of the formats."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from warp_partdr.body.landmarks import (
    CONVENTIONS,
    LANDMARKS,
    landmark_points,
    landmark_positions,
    mirror_name,
    plain_landmark,
    rest_offset,
    without_side,
)
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.skeletons import MPJPE_SKELETON, SKELETONS, skeleton
from warp_partdr.body.template import JOINT_NAMES, LENGTH_NAMES, MEAN_STATURE, NUM_PARTS, PART_NAMES, template
from warp_partdr.errors import InputError
from warp_partdr.lab.measurements.landmarks import LIMB_JOINTS, ellipbody_between
from warp_partdr.lab.synthetic import people
from warp_partdr.lab.synthetic.pose_sampler import PoseBank
from warp_partdr.lab.synthetic.poses import mean_body
from warp_partdr.models.anny import anny, anny_shape
from warp_partdr.models.measuring import statures

NAMES = list(SKELETONS)


@pytest.fixture(scope="module")
def rest() -> dict[str, np.ndarray]:
    """Centres, axes, semi-axes and joints of the mean body in the rest pose, root at the origin."""
    posed = mean_body(torch.eye(3, dtype=torch.float64).expand(1, NUM_PARTS, 3, 3))
    return {name: getattr(posed, name)[0].numpy() for name in ("centres", "axes", "semi_axes", "joints")}


@pytest.fixture(scope="module")
def at(rest: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Position [m] of every landmark in the rest pose: x to the left, y up, z forward."""
    positions = landmark_positions(list(LANDMARKS), rest["centres"], rest["axes"], rest["semi_axes"])
    return dict(zip(LANDMARKS, positions, strict=True))


def test_the_models_joints_are_landmarks(at: dict[str, np.ndarray], rest: dict[str, np.ndarray]) -> None:
    for name, position in zip(JOINT_NAMES, rest["joints"], strict=True):
        np.testing.assert_allclose(at[name], position, atol=1e-12, err_msg=name)
    np.testing.assert_allclose(at["mid_hip"], (at["left_hip"] + at["right_hip"]) / 2, atol=1e-12)


def test_landmarks_are_where_a_body_has_them(at: dict[str, np.ndarray]) -> None:
    assert 1.4 < at["head_top"][1] - at["left_toe"][1] < 1.9
    head = (at["head"] + at["head_top"]) / 2
    assert at["nose"][2] > at["left_eye"][2] > at["left_ear"][2]
    assert at["nose"][2] > head[2] + 0.08
    assert at["head"][1] < at["nose"][1] < at["left_eye"][1] < at["head_top"][1]
    assert at["mouth_left"][1] < at["nose"][1]
    assert 0 < at["left_eye_inner"][0] < at["left_eye"][0] < at["left_eye_outer"][0] < at["left_ear"][0]
    for side in ("left", "right"):
        assert at[f"{side}_thumb"][2] > at[f"{side}_index"][2] > at[f"{side}_pinky"][2] + 0.03
        knuckles = [np.abs(at[f"{side}_{finger}"][0]) for finger in ("index", "pinky")]
        wrist, tip = (np.abs(at[f"{side}_{joint}"][0]) for joint in ("wrist", "fingertip"))
        assert all(wrist < knuckle < tip for knuckle in knuckles)
        assert at[f"{side}_heel"][2] < at[f"{side}_ankle"][2] < at[f"{side}_small_toe"][2] < at[f"{side}_toe"][2]
        assert at[f"{side}_heel"][1] < at[f"{side}_ankle"][1] - 0.02
        assert np.abs(at[f"{side}_small_toe"][0]) > np.abs(at[f"{side}_big_toe"][0]) + 0.03


def test_left_and_right_mirror_each_other(at: dict[str, np.ndarray]) -> None:
    for name, position in at.items():
        assert mirror_name(mirror_name(name)) == name
        np.testing.assert_allclose(at[mirror_name(name)], position * [-1, 1, 1], atol=1e-9, err_msg=name)
        if "left" in name:
            assert position[0] > 0, name


CHAINS = {
    ("shoulder", "elbow", "wrist", "fingertip"): ("upper arm", "forearm", "hand"),
    ("hip", "knee", "ankle", "toe"): ("upper leg", "lower leg", "foot"),
}


@pytest.mark.parametrize("side", ["left", "right"])
def test_limbs_hang_on_their_own_side(at: dict[str, np.ndarray], side: str) -> None:
    """The bones from the shoulder to the fingertip and from the hip to the toe are as long as they are called."""
    for joints, bones in CHAINS.items():
        for start, end, bone in zip(joints, joints[1:], bones, strict=False):
            length = template().mean_lengths[LENGTH_NAMES.index(bone)]
            assert np.linalg.norm(at[f"{side}_{end}"] - at[f"{side}_{start}"]) == pytest.approx(length), bone


def test_landmarks_follow_their_part(rest: dict[str, np.ndarray], rng: np.random.Generator) -> None:
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turned = rest["axes"].copy()
    part = PART_NAMES.index("head")
    turned[part] = rotation @ turned[part]
    before, after = (
        landmark_positions(["nose", "left_thumb"], rest["centres"], axes, rest["semi_axes"])
        for axes in (rest["axes"], turned)
    )
    centre = rest["centres"][part]
    np.testing.assert_allclose(after[0] - centre, rotation @ (before[0] - centre), atol=1e-12)
    np.testing.assert_array_equal(after[1], before[1])


def test_landmark_points_gather_any_landmarks_and_batch(rest: dict[str, np.ndarray]) -> None:
    parts, normalised, weights = landmark_points(SKELETONS["body25"].landmarks)
    assert parts.shape == weights.shape == normalised.shape[:2] == (25, 2)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert landmark_points(SKELETONS["coco17"].landmarks).parts.shape == (17, 1)
    assert landmark_points([]).parts.shape == (0, 1)
    batch = {key: np.broadcast_to(value, (4, 2, *value.shape)) for key, value in rest.items() if key != "joints"}
    assert landmark_positions(["nose", "mid_hip"], **batch).shape == (4, 2, 2, 3)
    with pytest.raises(ValueError, match=r"names: no landmark 'tail'; expected some of pelvis"):
        landmark_points(["nose", "tail"])


@pytest.mark.parametrize("name", NAMES)
def test_skeleton_tables_are_complete_and_symmetric(name: str) -> None:
    this = SKELETONS[name]
    assert this.count == int("".join(filter(str.isdigit, name.replace("h36m", ""))))
    assert len(set(this.landmarks)) == len(this) == len(this.marks) == len(set(this.places))
    assert set(this.places) == set(range(this.count)) or name in ("wholebody133", "halpe136", "body135")
    np.testing.assert_array_equal(this.mirror[this.mirror], np.arange(len(this)))
    edges = {frozenset(edge) for edge in this.edges}
    assert len(edges) == len(this.edges)
    assert edges == {frozenset(this.mirror[list(edge)].tolist()) for edge in this.edges}
    assert {joint for edge in edges for joint in edge} == set(range(len(this)))


@pytest.mark.parametrize(
    ("name", "joints", "sides"),
    [  # Spot checks against the formats' own documentation.
        ("coco17", {0: "nose", 5: "left_shoulder", 10: "right_wrist"}, "-" + "lr" * 8),
        ("body25", {1: "neck", 8: "mid_hip", 19: "left_big_toe", 24: "right_heel"}, "--rrrlll-rrrlllrlrllllrrr"),
        ("coco18", {1: "neck", 4: "right_wrist", 11: "left_hip", 17: "left_ear"}, "--rrrlllrrrlllrlrl"),
        (
            "halpe26",
            {17: "head_top", 19: "mid_hip", 22: "left_small_toe", 25: "right_heel"},
            "-" + "lr" * 8 + "---lrlrlr",
        ),
        (
            "wholebody133",
            {17: "left_big_toe", 22: "right_heel", 59: "right_eye_outer", 77: "mouth_left", 96: "left_index"},
            "-" + "lr" * 8 + "lllrrr" + "rrllrl" + "lllrrr",
        ),
        ("blazepose33", {9: "mouth_left", 18: "right_pinky", 21: "left_thumb"}, "-lllrrr" + "lr" * 13),
        ("h36m17", {0: "mid_hip", 1: "right_hip", 7: "spine", 10: "head_top"}, "-rrrlll----lllrrr"),
        ("lsp14", {0: "right_ankle", 6: "right_wrist", 12: "neck", 13: "head_top"}, "rrrlllrrrlll--"),
        ("body25b", {17: "head", 18: "head_top", 19: "left_big_toe", 24: "right_heel"}, "-" + "lr" * 8 + "--lllrrr"),
        ("body135", {17: "head", 18: "head_top", 19: "left_big_toe", 24: "right_heel"}, "-" + "lr" * 8 + "--lllrrr"),
        (
            "halpe136",
            {17: "head_top", 25: "right_heel", 62: "right_eye_outer", 80: "mouth_left", 97: "left_thumb"},
            "-" + "lr" * 8 + "---lrlrlr" + "rrllrl" + "lllrrr",
        ),
        ("crowdpose14", {0: "left_shoulder", 11: "right_ankle", 12: "head_top", 13: "neck"}, "lr" * 6 + "--"),
        ("aic14", {0: "right_shoulder", 5: "left_wrist", 11: "left_ankle", 12: "head_top"}, "rrrlllrrrlll--"),
        ("posetrack17", {1: "neck", 2: "head_top", 3: "left_ear", 16: "right_ankle"}, "---" + "lr" * 7),
        ("mpii16", {6: "mid_hip", 7: "neck", 8: "head", 9: "head_top", 15: "left_wrist"}, "rrrlll----rrrlll"),
    ],
)
def test_joints_have_the_order_and_sides_of_their_format(name: str, joints: dict[int, str], sides: str) -> None:
    this = SKELETONS[name]
    assert joints.items() <= dict(zip(this.places, this.landmarks, strict=True)).items()
    words = [set(landmark.split("_")) for landmark in SKELETONS[name].landmarks]
    assert "".join("l" if "left" in word else "r" if "right" in word else "-" for word in words) == sides


def test_annotators_marks_are_points_of_their_own(at: dict[str, np.ndarray]) -> None:
    """COCO's, and those of OpenPose, which learned from it; inside the limb, up to 3 cm from the joint."""
    for name in SKELETONS.keys() - {"blazepose33", "h36m17", "lsp14", "mpii16", "shelf14"}:
        marks = dict(zip(SKELETONS[name].landmarks, SKELETONS[name].marks, strict=True))
        own = {mark.removeprefix("coco_") for mark in marks.values() if mark.startswith("coco_")}
        assert own == marks.keys() & {*JOINT_NAMES, "mid_hip"} - {"head", "head_top"}
        assert [mirror_name(mark) for mark in marks.values()] == [marks[mirror_name(joint)] for joint in marks]
    for name in ("blazepose33", "lsp14", "mpii16"):
        assert SKELETONS[name].marks == SKELETONS[name].landmarks
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"):
        left, right = (at[f"coco_{side}_{joint}"] for side in ("left", "right"))
        np.testing.assert_allclose(left * (-1, 1, 1), right, atol=1e-9)
        assert 0.004 < np.linalg.norm(left - at[f"left_{joint}"]) < 0.032, joint
    np.testing.assert_allclose(at["coco_neck"], (at["coco_left_shoulder"] + at["coco_right_shoulder"]) / 2)


def test_annotators_marks_are_those_of_annys_regressor() -> None:
    """For people that the table was not measured on, each mark is nearer to COCO's place than the joint is."""
    count, model = 60, anny()
    rng = np.random.default_rng(7)
    shape = anny_shape(rng.uniform(*people.PHENOTYPE_RANGES.T, (count, 6)))
    posed = mean_body(rotation_from_axis_angle(PoseBank.of_prior(count, seed=7).rotations))
    person = people.pose_anny(model, shape, posed)
    body = ellipbody_between(model.landmarks(person, JOINT_NAMES), posed, statures(model, shape) / MEAN_STATURE)
    for joint in LIMB_JOINTS:
        names = [f"left_{joint}", f"coco_left_{joint}"]
        plain, mark = LandmarkGather(names, "cpu")(body).unbind(1)
        place = model.landmarks(person, (f"coco_left_{joint}",))[:, 0]
        assert (mark - place).norm(dim=1).mean() < 0.8 * (plain - place).norm(dim=1).mean(), joint


def test_body25_and_human36m_hold_the_mpjpe_joints() -> None:
    joints = set(skeleton(MPJPE_SKELETON).landmarks)
    assert joints <= set(skeleton("h36m17").landmarks)
    assert joints - set(skeleton("body25").landmarks) == {"head_top"}
    with pytest.raises(ValueError, match=r"skeleton: 'coco'; expected one of coco17, body25"):
        skeleton("coco")


def own_skeleton(path: Path, data: Any) -> Path:
    path.write_text(json.dumps(data))
    return path


def test_a_custom_skeleton_is_read_from_a_file(tmp_path: Path) -> None:
    points = ["coco_left_hip", None, "coco_right_hip", "left_knee", "right_knee", None, "neck", "coco_mid_hip"]
    form = skeleton(own_skeleton(tmp_path / "mine.json", {"landmarks": points}))
    assert (form.name, form.count, len(form)) == ("mine", 8, 6)
    assert form.landmarks == ("left_hip", "right_hip", "left_knee", "right_knee", "neck", "mid_hip")
    assert form.marks == tuple(name for name in points if name)
    assert form.places == (0, 2, 3, 4, 6, 7)
    bones = {tuple(sorted(form.landmarks[joint] for joint in edge)) for edge in form.edges}
    assert bones >= {("left_hip", "left_knee"), ("mid_hip", "neck"), ("left_hip", "mid_hip")}
    assert ("left_knee", "right_knee") not in bones
    assert skeleton(form) is form
    assert skeleton(own_skeleton(tmp_path / "b.json", {"name": "x", "landmarks": points})).name == "x"
    assert len({form, skeleton(tmp_path / "mine.json")}) == 1  # people of one format are looked at side by side


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ([], 'no list of "landmarks"; expected {"landmarks": '),
        ({"landmarks": {"0": "nose"}}, 'no list of "landmarks"'),
        ({"landmarks": ["nose", "tail"]}, "point 1: 'tail'; expected null or one of pelvis, mid_hip"),
        ({"landmarks": ["nose", 3]}, "point 1: 3; expected null or one of"),
        ({"landmarks": ["nose", None]}, "1 landmarks; expected 2 at least"),
        ({"landmarks": ["nose", "neck", "nose"]}, "nose twice; expected each landmark once, and null"),
        ({"landmarks": ["neck", "coco_neck"]}, "neck twice"),
        ({"landmarks": ["neck", "left_hip"]}, "left_hip without right_hip; expected both sides"),
    ],
)
def test_a_faulty_custom_skeleton_is_refused_in_a_line(data: Any, message: str, tmp_path: Path) -> None:
    path = own_skeleton(tmp_path / "mine.json", data)
    with pytest.raises(InputError) as raised:
        skeleton(path)
    assert str(raised.value).startswith(f"{path}: {message}")
    with pytest.raises(InputError, match=r"none\.json: No such file or directory; expected a skeleton in JSON"):
        skeleton(tmp_path / "none.json")


def test_data_set_joints_lie_where_the_table_of_offsets_says(at: dict[str, np.ndarray]) -> None:
    for name, convention in (("h36m17", "h36m"), ("shelf14", "shelf")):
        form = SKELETONS[name]
        off = {mark for mark in form.marks if mark.startswith(f"{convention}_")}
        assert {without_side(plain_landmark(mark)) for mark in off} == CONVENTIONS[convention].keys()
        for mark, landmark in zip(form.marks, form.landmarks, strict=True):
            assert plain_landmark(mark) == landmark
            way = np.array(CONVENTIONS[convention].get(without_side(landmark), ("", (0, 0, 0)))[1]) / 1000
            if landmark.startswith("right_"):
                way[0] *= -1
            np.testing.assert_allclose(at[mark] - at[landmark], way, atol=1e-9)
            np.testing.assert_allclose(rest_offset(mark), way, atol=1e-9)


def test_a_model_has_the_joints_of_data_sets_where_the_mean_body_has_them() -> None:
    """Anny of the mean shape has them as far off, as a share of its height, and they move with the part."""
    model = anny()
    rest = model.rest(torch.zeros(1, model.num_shapes))
    growth = float(statures(model, torch.zeros(1, model.num_shapes))) / MEAN_STATURE
    for mark in (name for name in LANDMARKS if name.split("_")[0] in CONVENTIONS):
        start, end = model.landmarks(rest, (plain_landmark(mark), mark))[0].numpy()
        np.testing.assert_allclose(end - start, growth * rest_offset(mark), atol=2e-4)
    turn = rotation_from_axis_angle(torch.tensor([[0.0, 0.7, 0.0]]))
    rotations = torch.eye(3).repeat(1, model.num_joints, 1, 1)
    rotations[0, 0] = turn[0]
    turned = model.pose(torch.zeros(1, model.num_shapes), rotations, rest.joints[:, 0])
    start, end = model.landmarks(turned, ("neck", "h36m_neck"))[0].numpy()
    np.testing.assert_allclose(end - start, growth * turn[0].numpy() @ rest_offset("h36m_neck"), atol=2e-4)
