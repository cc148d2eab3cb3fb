"""Files of models, and files that can't be trusted."""

from __future__ import annotations

import helpers.files
import numpy as np
import pytest
import torch
from helpers.bodies import random_turns
from helpers.files import save_npz, smpl_arrays
from safetensors.numpy import save_file

from warp_partdr.body.template import PART_NAMES
from warp_partdr.models import load
from warp_partdr.models.load import load_model
from warp_partdr.models.smpl import SMPL_JOINTS, joint_landmarks

smpl_file = helpers.files.smpl_file  # a fixture


@pytest.mark.parametrize("num_joints", [24, 52, 55])
@pytest.mark.parametrize("suffix", [".npz", ".safetensors"])
def test_load_model_reads_files(num_joints, suffix, tmp_path):
    arrays, path = smpl_arrays(num_joints), tmp_path / f"model{suffix}"
    if suffix == ".npz":
        np.savez(path, **arrays, other=np.array([{}], dtype=object))  # official files hold such, unneeded
    else:
        save_file(arrays | {name: arrays[name].astype(np.int64) for name in ("f", "kintree_table")}, path)
    model = load_model(path, num_shapes=4, dtype=torch.float64)
    assert model.name == {24: "smpl", 52: "smplh", 55: "smplx"}[num_joints]
    assert (model.num_joints, model.num_shapes, model.num_vertices) == (num_joints, 4, 4 * num_joints)
    assert model.parents == (-1, *arrays["kintree_table"][0, 1:])
    np.testing.assert_allclose(model.rest_joints, arrays["J_regressor"] @ arrays["v_template"], atol=1e-12)
    # As smplx computes it: pose_feature @ posedirs.
    feature = (random_turns(1, num_joints, 0.4)[0, 1:] - torch.eye(3)).reshape(1, -1).numpy()
    wanted = feature @ arrays["posedirs"].reshape(-1, arrays["posedirs"].shape[-1]).T
    np.testing.assert_allclose(feature @ model.pose_directions.numpy(), wanted, atol=1e-12)
    assert model.bone_of_part["left_hip"] == model.bone_of_part["right_hip"] == "pelvis"
    assert model.bone_of_part["left_forearm"] == "left_elbow"
    assert model.bone_of_part["left_shoulder"] == "left_collar"
    wanted = np.einsum("jv,vcs->sjc", arrays["J_regressor"], arrays["shapedirs"][..., :4])
    np.testing.assert_allclose(model.joint_directions, wanted, atol=1e-12)
    assert model.bone_of_part["right_foot"] == "right_ankle"
    assert set(PART_NAMES) - {PART_NAMES[k - 1] for k in model.face_parts.unique()} <= {"left_hip", "right_hip"}


def test_ends_of_head_feet_and_hands_are_their_outermost_vertices():
    rng = np.random.default_rng(0)
    vertices, parts = rng.normal(size=(200, 3)), rng.integers(0, len(PART_NAMES), 200)
    joints = rng.normal(size=(len(SMPL_JOINTS), 3))
    rows = joint_landmarks(SMPL_JOINTS, vertices, joints, parts)
    found = {name: row @ np.concatenate([vertices, joints]) for name, row in rows.items()}

    def of(part: str) -> np.ndarray:
        return vertices[parts == PART_NAMES.index(part)]

    assert found["head_top"][1] == of("head")[:, 1].max()  # y is up
    for side in ("left", "right"):
        assert found[f"{side}_toe"][2] == of(f"{side}_foot")[:, 2].max()  # z is ahead
        wrist = joints[SMPL_JOINTS.index(f"{side}_wrist")]
        np.testing.assert_array_equal(found[f"{side}_wrist"], wrist)
        reach = np.linalg.norm(of(f"{side}_hand") - wrist, axis=1).max()
        assert np.linalg.norm(found[f"{side}_fingertip"] - wrist) == pytest.approx(reach)
    np.testing.assert_allclose(found["mid_hip"], (found["left_hip"] + found["right_hip"]) / 2)


def test_ten_shapes_at_most_are_loaded_unless_a_number_is_given(tmp_path):
    assert load_model(save_npz(tmp_path / "many.npz")).num_shapes == 10
    assert load_model(save_npz(tmp_path / "few.npz", **smpl_arrays(num_shapes=3))).num_shapes == 3
    with pytest.raises(ValueError, match="num_shapes: 13; expected an integer from 0 to 12"):
        load_model(tmp_path / "many.npz", num_shapes=13)
    with pytest.raises(ValueError, match="num_shapes"):
        load_model("anny", num_shapes=3)


def changed(name: str, index: tuple[int, ...], value: float) -> dict[str, np.ndarray]:
    array = smpl_arrays()[name].copy()
    array[index] = value
    return {name: array}


WRONG = {
    "missing": ({"posedirs": None}, "no array 'posedirs'"),
    "shape": ({"shapedirs": np.zeros((96, 2, 10))}, r"shapedirs: shape \(96, 2, 10\); expected \(V = 96, 3, S = 10\)"),
    "dimensions": ({"weights": np.zeros(96)}, r"weights: shape \(96,\); expected \(V = 96, J = 24\)"),
    "pose blend shapes": ({"posedirs": np.zeros((96, 3, 93))}, r"posedirs: .*expected .*9 \(J - 1\) = 207"),
    "empty": ({"f": np.zeros((0, 3), dtype=int)}, r"f: shape \(0, 3\)"),
    "NaN": (changed("v_template", (5, 1), np.nan), "v_template: holds NaN"),
    "infinity": (changed("J_regressor", (5, 1), np.inf), "J_regressor: holds NaN or infinity"),
    "dtype": ({"f": smpl_arrays()["f"].astype(float)}, "f: float64; expected integers"),
    "text": ({"v_template": np.full((96, 3), "x")}, "v_template: <U1; expected floating"),
    "vertex too high": (changed("f", (0, 0), 96), "f: vertex 0 to 96; expected 0 to 95"),
    "vertex negative": ({"f": smpl_arrays()["f"].astype(int) - 1}, "f: vertex -1"),
    "parent after child": (changed("kintree_table", (0, 5), 9), "kintree_table: expected joints"),
    "second root": (changed("kintree_table", (0, 5), 2**32 - 1), "kintree_table: expected joints"),
    "weights": (changed("weights", (5, 1), 3.0), "weights: rows sum to 1 to"),
    "objects": ({"f": np.array([[{}]], dtype=object)}, "f: holds pickled Python objects"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_arrays_are_named(case, tmp_path):
    changes, message = WRONG[case]
    path = save_npz(tmp_path / "model.npz", **changes)
    with pytest.raises(ValueError, match=message) as caught:
        load_model(path)
    assert str(caught.value).startswith(str(path))


def test_unknown_skeleton_is_refused(tmp_path):
    arrays = smpl_arrays()
    arrays |= {"weights": np.full((96, 23), 1 / 23), "J_regressor": arrays["J_regressor"][:23]}
    arrays |= {"kintree_table": arrays["kintree_table"][:, :23], "posedirs": arrays["posedirs"][..., : 9 * 22]}
    with pytest.raises(ValueError, match=r"23 joints; expected 24 \(smpl\), 52 \(smplh\), 55 \(smplx\)"):
        load_model(save_npz(tmp_path / "model.npz", **arrays))


def test_files_that_are_no_models_are_refused(tmp_path, smpl_file):
    for name, says in (
        ("none.npz", r"none\.npz: No such file"),
        ("model.pkl", r"pickles can run code.*partdr convert"),
        ("model.obj", r"model\.obj: expected 'anny', or"),
    ):
        with pytest.raises(ValueError, match=says):
            load_model(tmp_path / name)
    for suffix in (".npz", ".safetensors"):
        for content in (b"", b"no model", smpl_file.read_bytes()[:4000], b"\xff" * 200):
            path = tmp_path / f"broken{suffix}"
            path.write_bytes(content)
            with pytest.raises(ValueError, match=r"^.*broken.*; expected a file of SMPL"):
                load_model(path)
    damaged = bytearray(smpl_file.read_bytes())
    damaged[3000:3400] = bytes(400)
    (tmp_path / "damaged.npz").write_bytes(damaged)
    with pytest.raises(ValueError, match=r"damaged\.npz: "):
        load_model(tmp_path / "damaged.npz")


def test_archive_bombs_are_not_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(load, "MAX_BYTES", 10_000_000)
    bomb = save_npz(tmp_path / "bomb.npz", posedirs=np.zeros((96, 3, 100_000)))
    assert bomb.stat().st_size < 1_000_000
    with pytest.raises(ValueError, match=r"230\.\d MB when unpacked; expected a file of SMPL.*, at most 10\.0 MB"):
        load_model(bomb)
