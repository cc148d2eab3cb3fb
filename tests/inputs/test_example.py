"""The packaged example is whole and agrees with itself; that it looks right was judged by eye."""

from __future__ import annotations

import json

import numpy as np
from helpers.files import EXAMPLE
from PIL import Image

from warp_partdr.body.labels import label_set
from warp_partdr.body.skeletons import skeleton

COCO17 = skeleton("coco17").landmarks
LABELS = label_set("cdcl14")
PARTS = np.array(Image.open(EXAMPLE / "parts.png"))
GIVEN = json.loads((EXAMPLE / "keypoints.json").read_text(encoding="utf-8"))
KEYPOINTS = np.array(GIVEN["keypoints"])
TRUTH = json.loads((EXAMPLE / "truth.json").read_text(encoding="utf-8"))
CAMERA = TRUTH["camera"]
COCO, LSP = (
    dict(zip(TRUTH["joints"][name]["names"], np.array(TRUTH["joints"][name]["points_m"]), strict=True))
    for name in ("coco17", "lsp14")
)
# What a joint may show: the parts that meet in it.
MEETING = {
    "shoulder": ("upper_arm", "torso"),
    "elbow": ("upper_arm", "forearm"),
    "wrist": ("forearm", "hand"),
    "hip": ("upper_leg", "torso"),
    "knee": ("upper_leg", "lower_leg"),
    "ankle": ("lower_leg", "foot"),
}


def test_files_are_small_and_say_their_licence() -> None:
    names = ("photo.png", "parts.png", "keypoints.json", "truth.json", "README.md")
    assert sum(len((EXAMPLE / name).read_bytes()) for name in names) < 300_000
    assert "CC0" in (EXAMPLE / "README.md").read_text(encoding="utf-8")


def test_picture_and_labels_agree_in_size() -> None:
    with Image.open(EXAMPLE / "photo.png") as photo:
        assert photo.mode == "RGB"
        assert photo.size == PARTS.shape[::-1]
    assert list(PARTS.shape) == CAMERA["image_size"]
    assert PARTS.dtype == np.uint8
    assert PARTS.shape[0] != PARTS.shape[1]  # So that a swap of height and width shows.


def test_every_part_is_seen() -> None:
    assert set(np.unique(LABELS.to_groups(PARTS))) == set(range(LABELS.num_groups + 1))
    assert np.bincount(PARTS.ravel())[1:].min() > 300
    border = np.concatenate([PARTS[[0, -1]].ravel(), PARTS[:, [0, -1]].ravel()])
    assert not border.any(), "the person is cut off"


def test_keypoints_lie_on_their_parts() -> None:
    assert GIVEN["format"] == "coco17"
    assert KEYPOINTS.shape == (len(COCO17), 3)
    for name, (u, v, confidence) in zip(COCO17, KEYPOINTS, strict=True):
        assert confidence == 1.0
        side, _, joint = name.partition("_")
        shown = LABELS.group_names[PARTS[int(v), int(u)] - 1] if PARTS[int(v), int(u)] else "background"
        expected = [part if part == "torso" else f"{side}_{part}" for part in MEETING.get(joint, ())] or ["head"]
        assert shown in expected, f"{name} shows {shown}"


def test_truth_projects_onto_the_keypoints() -> None:
    assert tuple(COCO) == COCO17
    points = np.array(list(COCO.values()))
    projected = points[:, :2] / points[:, 2:] * np.array(CAMERA["focal_px"]) + np.array(CAMERA["centre_px"])
    np.testing.assert_allclose(projected, KEYPOINTS[:, :2], atol=0.02)  # [px], both files are rounded


def test_lsp_joints_lie_by_coco_joints() -> None:
    """Two sources, bones and a regressor, agree to a few centimetres, left with left."""
    assert tuple(LSP) == skeleton("lsp14").landmarks
    for name in LSP.keys() & COCO.keys():
        assert np.linalg.norm(LSP[name] - COCO[name]) < 0.05, name
    assert 1.4 < max(point[1] for point in LSP.values()) - LSP["head_top"][1] < 1.9  # [m], ankle to crown, y down


def test_a_forearm_hides_the_torso() -> None:
    assert LSP["right_wrist"][2] < min(LSP[f"{side}_shoulder"][2] for side in ("left", "right")) - 0.1
    assert LSP["left_shoulder"][0] > LSP["right_shoulder"][0]  # She faces the camera.
