"""SOMA from files of its layout, made here: 77 joints in turned frames and a twist joint, read by ``body-models``."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.files import smpl_arrays
from scipy.sparse import csc_matrix
from scipy.spatial.transform import Rotation

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.template import JOINT_NAMES, PART_NAMES
from warp_partdr.errors import InputError
from warp_partdr.models.load import load_model
from warp_partdr.models.model import DetailedModel
from warp_partdr.models.registration import register
from warp_partdr.models.soma import soma_model

body_models = pytest.importorskip("body_models", reason="needs the extra 'bodies'")

pytestmark = pytest.mark.filterwarnings("ignore:Sparse invariant checks:UserWarning")

_BODY = {"Hips": ("Root", 0), "Spine1": ("Hips", 3), "Spine2": ("Spine1", 6), "Chest": ("Spine2", 9)}
_BODY |= {"Neck1": ("Chest", 12), "Neck2": ("Neck1", 15), "Head": ("Neck2", 15), "HeadEnd": ("Head", 15)}
_BODY |= {"Jaw": ("Head", 15), "LeftEye": ("Head", 15), "RightEye": ("Head", 15)}
_ARM = {"Shoulder": ("Chest", 13), "Arm": ("Shoulder", 16), "ForeArm": ("Arm", 18), "Hand": ("ForeArm", 20)}
_LEG = {"Leg": ("Hips", 1), "Shin": ("Leg", 4), "Foot": ("Shin", 7), "ToeBase": ("Foot", 10), "ToeEnd": ("ToeBase", 10)}
_FINGERS = {"Thumb": "1 2 3 End", **dict.fromkeys(("Index", "Middle", "Ring", "Pinky"), "1 2 3 4 End")}


def rig_joints() -> tuple[list[str], list[int], np.ndarray]:
    """Names, parents and places [m] of the control rig's joints, the root first."""
    arrays = smpl_arrays()
    body = arrays["J_regressor"] @ arrays["v_template"]
    names, parents, places = ["Root"], [0], [np.zeros(3)]

    def add(name: str, parent: str, place: np.ndarray) -> None:
        near = sum(np.abs(place - other).max() < 1e-6 for other in places[1:])
        names.append(name)
        parents.append(names.index(parent))
        places.append(place + 0.03 * near * np.array([0.1, 0.9, 0.4]))

    for name, (parent, joint) in _BODY.items():
        add(name, parent, body[joint])
    for offset, side in enumerate(("Left", "Right")):
        for name, (parent, joint) in _ARM.items():
            add(side + name, parent if parent == "Chest" else side + parent, body[joint + offset])
        for row, (finger, knuckles) in enumerate(_FINGERS.items()):
            parent = f"{side}Hand"
            for step, knuckle in enumerate(knuckles.split()):
                shift = np.array([(1 - 2 * offset) * (0.05 + 0.02 * step), 0.002 * step, 0.03 - 0.015 * row])
                add(name := f"{side}Hand{finger}{knuckle}", parent, body[20 + offset] + shift)
                parent = name
    for offset, side in enumerate(("Left", "Right")):
        for name, (parent, joint) in _LEG.items():
            add(side + name, parent if parent == "Hips" else side + parent, body[joint + offset])
    places = np.array(places) - body[0]
    places[0] = 0
    return names, parents, places


def rig_arrays(names: list[str], parents: list[int], places: np.ndarray, weights: np.ndarray) -> dict[str, np.ndarray]:
    """The arrays of a rig, which rests as it was bound; vertices are left to the caller [cm]."""
    frames = np.tile(np.eye(4), (len(names), 1, 1))
    frames[1:, :3, :3] = Rotation.random(len(names), random_state=0).as_matrix()[1:]
    frames[:, :3, 3] = 100 * places
    local = np.linalg.inv(frames[parents]) @ frames
    local[0] = frames[0]
    sparse = csc_matrix(weights)
    poses = {"bind_pose_world": frames, "t_pose_world": frames, "bind_pose_local": local, "t_pose_local": local}
    return {name: pose.astype(np.float32) for name, pose in poses.items()} | {
        "joint_parent_ids": np.array(parents, np.int32),
        "joint_names": np.array(names),
        "skinning_weights_data": sparse.data.astype(np.float32),
        "skinning_weights_indices": sparse.indices,
        "skinning_weights_indptr": sparse.indptr,
        "skinning_weights_shape": np.array(sparse.shape, np.int32),
    }


def write_rig(folder: Path, *, upright: bool = True) -> Path:
    rng = np.random.default_rng(0)
    names, parents, places = rig_joints()
    count = len(names)
    assert count == 78
    if not upright:
        places = places * [-1, 1, 1]
    corners = 0.02 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    vertices = (100 * (places[1:, None] + corners).reshape(-1, 3)).astype(np.float32)
    weights = np.repeat(np.eye(count)[1:], 4, axis=0)
    arm, elbow = names.index("LeftArm"), names.index("LeftForeArm")
    twisted = np.column_stack([weights, 0.5 * weights[:, arm]])  # half of the upper arm's skin
    twisted[:, arm] *= 0.5
    full = rig_arrays(
        [*names, "LeftArmTwist"], [*parents, arm], np.vstack([places, places[[arm, elbow]].mean(0)]), twisted
    )
    moving = np.eye(count + 1)
    moving[count, count], moving[count, [arm, elbow]] = 0, 0.5
    turning = np.zeros((1, count), np.float32)
    turning[0, elbow] = 0.5
    arrays = full | {f"public_{name}": value for name, value in rig_arrays(names, parents, places, weights).items()}
    procedural = {
        "public_joint_indices_full": np.arange(count),
        "rotation_matrix": turning,
        "translation_matrix": moving.astype(np.float32),
        "twist_joint_indices": np.array([count]),
        "twist_axis_ids": np.array([0]),
        "twist_axis_signs": np.ones(1, np.float32),
        "segment_start_joint_indices": np.array([arm]),
        "segment_end_joint_indices": np.array([elbow]),
        "segment_parent_joint_indices": np.array([parents[arm]]),
        "segment_reverse_indices": np.array([], np.int64),
        "segment_alignment_rotations": np.eye(3, dtype=np.float32)[None],
    }
    tetrahedron = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    arrays |= {f"procedural_{name}": value for name, value in procedural.items()}
    arrays |= {
        "bind_shape": vertices,
        "public_bind_shape": vertices,
        "mean": vertices,
        "shapedirs": rng.normal(0, 0.3, (128, vertices.size)).astype(np.float32),
        "eigenvalues": np.linspace(2, 0.5, 128).astype(np.float32),
        "triangles": (4 * np.arange(count - 1)[:, None, None] + tetrahedron).reshape(-1, 3),
        "segment_eye_bags": np.array([], np.int64),
        "segment_mouth_bag": np.array([], np.int64),
    }
    folder.mkdir()
    np.savez(folder / "SOMA_neutral.npz", **arrays)
    correctives = {
        "W1": torch.sparse_coo_tensor([[0], [0]], [1.0], (6 * count, count)).coalesce(),
        "W2": torch.sparse_coo_tensor([[0], [0]], [0.0], (count, vertices.size)).coalesce(),
        "bindpose": torch.eye(3).expand(count, 3, 3).clone(),
        "C_max": 1,
        "use_tanh": False,
    }
    torch.save(correctives, folder / "correctives_model.pt")
    return folder


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A place for what the package works out, away from the user's."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setattr("body_models.soma._derive.get_cache_dir", lambda: folder)
        yield


@pytest.fixture(scope="module")
def files(cache: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rig(tmp_path_factory.mktemp("rigs") / "soma")


@pytest.fixture(scope="module")
def rig(files: Path) -> tuple[DetailedModel, Any]:
    return soma_model(files, dtype=torch.float64), body_models.create_model("soma", model_path=files)


def test_parts_and_joints_are_the_bodys(rig: tuple[DetailedModel, Any]) -> None:
    model, _ = rig
    assert (model.name, model.num_joints, model.num_shapes) == ("soma", 77, 10)
    carrying = model.bone_of_part
    assert (carrying["left_hip"], carrying["abdomen"], carrying["chest"]) == ("Hips", "Spine1", "Chest")
    assert (carrying["right_shoulder"], carrying["left_hand"]) == ("RightShoulder", "LeftHand")
    assert {PART_NAMES[int(part) - 1] for part in model.face_parts.unique()} == set(PART_NAMES)
    assert {*JOINT_NAMES, "left_thumb", "right_index"} <= set(model.landmark_names)


def test_poses_agree_with_the_rigs_own_code(rig: tuple[DetailedModel, Any]) -> None:
    model, own = rig
    rest = {name: np.asarray(value) for name, value in own.get_rest_pose().items()}
    turns = 0.5 * np.random.default_rng(1).normal(size=(77, 3))
    turns[0] = 0
    groups = {"body_pose": [*range(1, 6), *range(11, 15), *range(39, 43), *range(67, 77)], "head_pose": range(6, 11)}
    groups["hand_pose"] = [*range(15, 39), *range(43, 67)]
    given = rest | {name: turns[list(places)] for name, places in groups.items()}
    matrices = torch.from_numpy(Rotation.from_rotvec(turns).as_matrix())[None]
    shape = torch.zeros(1, 10, dtype=torch.float64)
    posed = model.pose(shape, matrices, model.rest(shape).joints[:, 0])
    np.testing.assert_allclose(posed.joints[0], own.forward_skeleton(**given)[:, :3, 3], atol=1e-5)
    wanted = own.forward_vertices(**given)
    arm = model.joint_names.index("LeftArm")
    alike = np.delete(np.arange(model.num_vertices), 4 * arm + np.arange(4))
    np.testing.assert_allclose(posed.vertices[0, alike], wanted[alike], atol=1e-5)
    assert np.abs(posed.vertices[0].numpy() - wanted).max() < 0.03  # the twist joint's share, left out


def test_shapes_are_right_to_first_order(rig: tuple[DetailedModel, Any]) -> None:
    model, own = rig
    rest = {name: np.asarray(value) for name, value in own.get_rest_pose().items()}
    values = np.zeros(128)
    values[:10] = 0.1 * np.random.default_rng(2).normal(size=10)
    found = model.rest(torch.from_numpy(values[None, :10]))
    given = rest | {"shape": values}
    grown = np.abs(found.vertices[0].numpy() - model.rest_vertices.numpy()).max()
    assert grown > 1e-3
    assert np.abs(found.vertices[0].numpy() - own.forward_vertices(**given)).max() < 0.1 * grown
    assert np.abs(found.joints[0].numpy() - own.forward_skeleton(**given)[:, :3, 3]).max() < 0.1 * grown


def test_soma_is_registered_to_an_ellipbody(files: Path) -> None:
    model = load_model(f"soma:{files}", num_shapes=2)
    assert model.num_shapes == 2
    posed = BodyParameters.mean(1).posed()
    registered = register(posed, model)
    joints = [JOINT_NAMES.index(name) for name in ("left_knee", "right_elbow")]
    found = model.landmarks(registered.detailed, ["left_knee", "right_elbow"])
    assert (found - posed.joints[:, joints]).norm(dim=-1).max() < 0.05


def test_what_is_no_rig_is_refused(tmp_path: Path, files: Path) -> None:
    (tmp_path / "empty").mkdir()
    for folder, says in ((tmp_path / "none", "does not exist"), (tmp_path / "empty", "missing required assets")):
        with pytest.raises(InputError, match=f"{says}.*expected a folder of SOMA's files"):
            soma_model(folder)
    broken = Path(shutil.copytree(files, tmp_path / "broken"))
    (broken / "correctives_model.pt").write_bytes(b"no checkpoint")
    with pytest.raises(InputError, match="expected a folder of SOMA's files"):
        soma_model(broken)
    with pytest.raises(InputError, match="x to the person's left"):
        soma_model(write_rig(tmp_path / "mirrored", upright=False))
    with pytest.raises(ValueError, match="num_shapes"):
        load_model(f"soma:{files}", num_shapes=129)
