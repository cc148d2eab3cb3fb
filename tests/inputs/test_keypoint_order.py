"""Keypoints in another order than their number says are told; those in their own are not."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from warp_partdr.body.landmarks import LANDMARKS, without_side
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.skeletons import SKELETONS, skeleton
from warp_partdr.body.template import MEAN_STATURE, NUM_PARTS
from warp_partdr.inputs.keypoint_files import parse_keypoints
from warp_partdr.inputs.keypoint_order import _SHARES, alternatives, mirror_warning, order_question, order_warning
from warp_partdr.lab.synthetic.pose_sampler import PoseBank
from warp_partdr.lab.synthetic.poses import mean_body

COUNT = 60
NAMES = list(LANDMARKS)
BY_COUNT = {14: "lsp14", 17: "coco17", 25: "body25"}
OTHERS = [name for form in BY_COUNT.values() for name in (other.name for other in alternatives(SKELETONS[form]))]


@pytest.fixture(scope="module")
def seen() -> np.ndarray:
    """Landmarks of people in random poses from all sides [px], 415 px tall, shape (N, L, 2)."""
    posed = mean_body(rotation_from_axis_angle(PoseBank.of_prior(COUNT, seed=11).rotations))
    points = LandmarkGather(NAMES, "cpu")(posed).numpy()
    turns = np.random.default_rng(4).uniform(0, 2 * np.pi, COUNT)[:, None]
    across = np.cos(turns) * points[..., 0] + np.sin(turns) * points[..., 2]
    return np.stack([300 + 250 * across, 300 - 250 * points[..., 1]], axis=-1)


def keypoints(seen: np.ndarray, name: str) -> np.ndarray:
    """People's keypoints in a format, a few pixels off."""
    places = seen[:, [NAMES.index(mark) for mark in SKELETONS[name].marks]]
    return places + np.random.default_rng(5).normal(0, 3, places.shape)


def test_shares_are_the_mean_bodys() -> None:
    rest = mean_body(torch.eye(3, dtype=torch.float64).expand(1, NUM_PARTS, 3, 3))
    at = dict(zip(NAMES, LandmarkGather(NAMES, "cpu")(rest)[0].numpy(), strict=True))
    found: dict[str, float] = {}
    for name in (*BY_COUNT.values(), *OTHERS):
        landmarks = SKELETONS[name].landmarks
        for first, second in SKELETONS[name].edges:
            ends = landmarks[first], landmarks[second]
            length = float(np.linalg.norm(at[ends[0]] - at[ends[1]]))
            found["-".join(sorted(map(without_side, ends)))] = length / MEAN_STATURE
    assert found.keys() == _SHARES.keys()
    assert found == pytest.approx(_SHARES, rel=0.04, abs=0.001)


@pytest.mark.parametrize("name", [*BY_COUNT.values(), *OTHERS])
def test_keypoints_in_their_own_order_are_not_told(seen: np.ndarray, name: str) -> None:
    form = SKELETONS[name]
    for points in keypoints(seen, name):
        assert order_warning(form, points, np.ones(len(form))) is None


@pytest.mark.parametrize("name", OTHERS)
def test_keypoints_in_another_order_are_told(seen: np.ndarray, name: str) -> None:
    form = SKELETONS[BY_COUNT[SKELETONS[name].count]]
    told = [order_warning(form, points, np.ones(len(form))) for points in keypoints(seen, name)]
    named = sum(text is not None and name in text.split(",")[0] for text in told)
    assert named >= 0.9 * COUNT
    assert any(f"not {form.name}; expected --format" in text for text in told if text)


def test_too_few_bones_tell_no_order(seen: np.ndarray) -> None:
    form, points = SKELETONS["body25"], keypoints(seen, "body25b")[0]
    confidence = np.zeros(25)
    confidence[:6] = 1
    assert order_warning(form, points, confidence) is None
    assert order_warning(form, np.zeros((25, 2)), np.ones(25)) is None


def test_a_file_in_another_order_is_told(seen: np.ndarray) -> None:
    """The number of points and the stated format count, and not the names of points."""
    points = keypoints(seen, "body25b")[0].tolist()
    told = "keypoints: they look like body25b, not body25; expected --format body25b if they are"
    for data, given in ((points, None), ({"format": "body25", "keypoints": points}, None), (points, "body25")):
        assert parse_keypoints(data, given)[0].warnings == (told,)
    assert parse_keypoints(points, "body25b")[0].warnings == ()
    names = {"keypoint_names": [*SKELETONS["body25"].landmarks], "keypoints": points}
    assert parse_keypoints(names)[0].warnings == ()


def test_the_question_names_formats_of_the_same_number() -> None:
    assert order_question(SKELETONS["lsp14"]) == "are these keypoints of lsp14, not of crowdpose14 or aic14?"
    assert order_question(skeleton("coco17")) == "are these keypoints of coco17, not of h36m17 or posetrack17?"
    assert order_question(SKELETONS["mpii16"]) is None


def face(*, mirrored: bool = False, turned: float = 0.0) -> np.ndarray:
    """COCO's points of a face and shoulders that the camera looks at; the others lie far below."""
    points = np.tile([[0.0, 300.0]], (17, 1))
    points[:7] = [[0, 10], [8, 0], [-8, 0], [15, 5], [-15, 5], [40, 60], [-40, 60]]
    points[:, 0] *= -1 if mirrored else 1
    angle = np.radians(turned)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return points @ turn + 400


@pytest.mark.parametrize("turned", [0, 70, 180])
def test_a_face_as_in_a_mirror_is_told(turned: float) -> None:
    form = SKELETONS["coco17"]
    sure = np.array([0.9] * 7 + [0.7] * 10)
    told = "keypoints: the face is seen, but lies as in a mirror; are left and right exchanged?"
    assert mirror_warning(form, face(mirrored=True, turned=turned), sure) == told
    assert mirror_warning(form, face(turned=turned), sure) is None
    assert parse_keypoints(np.column_stack([face(mirrored=True), sure]).tolist())[0].warnings == (told,)
    for doubtful in (np.ones(17), sure * 0.8, np.where(np.arange(17) == 0, 0.5, sure)):
        assert mirror_warning(form, face(mirrored=True), doubtful) is None
    narrow = face(mirrored=True)
    narrow[5:7] = [[405, 460], [395, 460]]
    assert mirror_warning(form, narrow, sure) is None
    assert mirror_warning(SKELETONS["lsp14"], face(mirrored=True)[:14], sure[:14]) is None
