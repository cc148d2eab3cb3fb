"""The packaged example is whole and agrees with itself; that it looks right was judged by eye."""

from __future__ import annotations

import json
from importlib import resources
from typing import Any

import numpy as np
import pytest
from PIL import Image

from warp_partdr.body.labels import label_set
from warp_partdr.body.skeletons import skeleton

EXAMPLE = resources.files("warp_partdr").joinpath("assets", "example")
COCO17 = skeleton("coco17").landmarks
LABELS = label_set("cdcl14")


def _json(name: str) -> Any:
    return json.loads(EXAMPLE.joinpath(name).read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def parts() -> np.ndarray:
    with EXAMPLE.joinpath("parts.png").open("rb") as file:
        return np.array(Image.open(file))


@pytest.fixture(scope="module")
def keypoints() -> np.ndarray:
    data = _json("keypoints.json")
    assert data["format"] == "coco17"
    return np.array(data["keypoints"])


@pytest.fixture(scope="module")
def truth() -> dict[str, Any]:
    return _json("truth.json")


def _project(points: np.ndarray, camera: dict[str, Any]) -> np.ndarray:
    return points[:, :2] / points[:, 2:] * np.array(camera["focal_px"]) + np.array(camera["centre_px"])


def test_files_are_small_and_say_their_licence() -> None:
    names = ("photo.png", "parts.png", "keypoints.json", "truth.json", "README.md")
    assert sum(len(EXAMPLE.joinpath(name).read_bytes()) for name in names) < 300_000
    assert "CC0" in EXAMPLE.joinpath("README.md").read_text(encoding="utf-8")


def test_picture_and_labels_agree_in_size(parts: np.ndarray, truth: dict[str, Any]) -> None:
    with EXAMPLE.joinpath("photo.png").open("rb") as file:
        photo = Image.open(file)
        assert photo.mode == "RGB"
        assert photo.size == parts.shape[::-1]
    assert list(parts.shape) == truth["camera"]["image_size"]
    assert parts.dtype == np.uint8
    assert parts.shape[0] != parts.shape[1]  # So that a swap of height and width shows.


def test_every_part_is_seen(parts: np.ndarray) -> None:
    assert set(np.unique(LABELS.to_groups(parts))) == set(range(LABELS.num_groups + 1))
    assert np.bincount(parts.ravel())[1:].min() > 300
    border = np.concatenate([parts[[0, -1]].ravel(), parts[:, [0, -1]].ravel()])
    assert not border.any(), "the person is cut off"


def test_keypoints_lie_on_their_parts(parts: np.ndarray, keypoints: np.ndarray) -> None:
    assert keypoints.shape == (len(COCO17), 3)
    # What a joint may show: the parts that meet in it.
    meeting = {
        "shoulder": ("upper_arm", "torso"),
        "elbow": ("upper_arm", "forearm"),
        "wrist": ("forearm", "hand"),
        "hip": ("upper_leg", "torso"),
        "knee": ("upper_leg", "lower_leg"),
        "ankle": ("lower_leg", "foot"),
    }
    for name, (u, v, confidence) in zip(COCO17, keypoints, strict=True):
        assert confidence == 1.0
        side, _, joint = name.partition("_")
        shown = LABELS.group_names[parts[int(v), int(u)] - 1] if parts[int(v), int(u)] else "background"
        expected = [part if part == "torso" else f"{side}_{part}" for part in meeting.get(joint, ())] or ["head"]
        assert shown in expected, f"{name} shows {shown}"


def test_truth_projects_onto_the_keypoints(keypoints: np.ndarray, truth: dict[str, Any]) -> None:
    joints = truth["joints"]["coco17"]
    assert tuple(joints["names"]) == COCO17
    projected = _project(np.array(joints["points_m"]), truth["camera"])
    np.testing.assert_allclose(projected, keypoints[:, :2], atol=0.02)  # [px], both files are rounded


def test_lsp_joints_lie_by_coco_joints(truth: dict[str, Any]) -> None:
    """Two sources, bones and a regressor, agree to a few centimetres, left with left."""
    lsp = dict(zip(truth["joints"]["lsp14"]["names"], truth["joints"]["lsp14"]["points_m"], strict=True))
    coco = dict(zip(COCO17, truth["joints"]["coco17"]["points_m"], strict=True))
    assert tuple(lsp) == skeleton("lsp14").landmarks
    for name in lsp.keys() & coco.keys():
        assert np.linalg.norm(np.subtract(lsp[name], coco[name])) < 0.05, name
    height = max(point[1] for point in lsp.values()) - lsp["head_top"][1]
    assert 1.4 < height < 1.9  # [m], ankle to crown, y down


def test_a_forearm_hides_the_torso(truth: dict[str, Any]) -> None:
    lsp = dict(zip(truth["joints"]["lsp14"]["names"], np.array(truth["joints"]["lsp14"]["points_m"]), strict=True))
    assert lsp["right_wrist"][2] < min(lsp[f"{side}_shoulder"][2] for side in ("left", "right")) - 0.1
    assert lsp["left_shoulder"][0] > lsp["right_shoulder"][0]  # She faces the camera.
