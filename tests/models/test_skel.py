"""SKEL from files of its layout, made here: SMPL's skin on 24 joints, read from what the converter makes of them."""

from __future__ import annotations

import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.files import save_npz, smpl_arrays
from scipy.sparse import coo_matrix
from scipy.spatial.transform import Rotation

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.template import JOINT_NAMES, PART_NAMES
from warp_partdr.errors import InputError
from warp_partdr.models.load import load_model
from warp_partdr.models.model import DetailedModel
from warp_partdr.models.registration import register
from warp_partdr.models.skel import SKEL_ARRAYS
from warp_partdr.models.smpl import SMPL_JOINTS

BONES = (
    "pelvis femur_r tibia_r talus_r calcn_r toes_r femur_l tibia_l talus_l calcn_l toes_l lumbar_body thorax head "
    "scapula_r humerus_r ulna_r radius_r hand_r scapula_l humerus_l ulna_l radius_l hand_l"
).split()
PARENTS = [-1, 0, 1, 2, 3, 4, 0, 6, 7, 8, 9, 0, 11, 12, 12, 14, 15, 16, 17, 12, 19, 20, 21, 22]
# Joint of SMPL whose pose correctives each has, none being 0: as in the code of SKEL's makers.
TAKEN_FOR = [0, 2, 5, 8, 8, 11, 1, 4, 7, 7, 10, 3, 6, 15, 14, 17, 19, 0, 21, 13, 16, 18, 0, 20]
# Of SMPL's joints that lie next to each of SKEL's, how much: for the regressor, and which of the skin follows it.
MIXED = {"pelvis": {"pelvis": 0.7, "spine1": 0.3}, "lumbar_body": {"spine1": 0.4, "spine2": 0.6}}
MIXED |= {"thorax": {"spine3": 0.3, "neck": 0.7}, "head": {"head": 0.9, "spine1": 0.1}}
SIDED = {"femur": {"hip": 1.0}, "tibia": {"knee": 1.0}, "talus": {"ankle": 1.0}, "calcn": {"ankle": 0.7, "foot": 0.3}}
SIDED |= {"toes": {"foot": 1.0}, "scapula": {"collar": 0.4, "shoulder": 0.6}, "humerus": {"shoulder": 1.0}}
SIDED |= {"ulna": {"elbow": 1.0}, "radius": {"elbow": 0.8, "wrist": 0.2}, "hand": {"wrist": 1.0}}
FOLLOWS = {"pelvis": "pelvis", "spine1": "lumbar_body", "spine2": "thorax", "spine3": "thorax", "neck": "head"}
FOLLOWS |= {"head": "head", "hip": "femur", "knee": "tibia", "ankle": "talus", "foot": "toes", "collar": "scapula"}
FOLLOWS |= {"shoulder": "humerus", "elbow": "ulna", "wrist": "hand", "hand": "hand"}
SECTIONS = [11, 12, 13]
OPENSIM = np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]])


def skel_arrays(**changes: np.ndarray | None) -> dict[str, np.ndarray]:
    """The arrays of a file that the converter makes; those changed to None are missing."""
    smpl = smpl_arrays()
    rng = np.random.default_rng(3)
    shares = rng.dirichlet(np.full(4, 20.0), size=24)  # no joint is just in the middle of its corners
    regressor, weights = np.zeros((24, 96)), np.zeros((96, 24))
    for joint, bone in enumerate(BONES):
        side = {"_r": "right_", "_l": "left_"}.get(bone[-2:], "")
        for name, share in (SIDED[bone[:-2]] if side else MIXED[bone]).items():
            corners = 4 * SMPL_JOINTS.index(side + name) + np.arange(4)
            regressor[joint, corners] += share * shares[joint]
    for joint, name in enumerate(SMPL_JOINTS):
        side, _, own = name.partition("_")
        bone = BONES.index(f"{FOLLOWS[own]}_{side[0]}" if own else FOLLOWS[name])
        weights[4 * joint : 4 * joint + 4, bone] += 0.8
        weights[4 * joint : 4 * joint + 4, max(PARENTS[bone], 0)] += 0.2
    arrays = {
        "skin_template_v": smpl["v_template"],
        "skin_template_f": smpl["f"].astype(np.int64),
        "shapedirs": smpl["shapedirs"],
        "posedirs": smpl["posedirs"],
        "J_regressor": smpl["J_regressor"],
        "J_regressor_osim": regressor,
        "skin_weights": weights,
        "osim_kintree_table": np.array([PARENTS, range(24)]),
    }
    return {name: value for name, value in (arrays | changes).items() if value is not None}


def write_pickle(path: Path, **changes: Any) -> Path:
    """A file as SKEL's makers pass on, version 1.1.1: sparse matrices, and much that is not needed."""
    rng = np.random.default_rng(4)
    arrays: dict[str, Any] = skel_arrays()
    for name in ("J_regressor", "J_regressor_osim", "skin_weights"):
        arrays[name] = coo_matrix(arrays[name])
    bones = coo_matrix(np.kron(np.eye(24), np.ones((4, 1))))
    frames = np.tile(np.eye(4), (24, 1, 1))
    frames[:, :3, :3] = Rotation.random(24, random_state=5).as_matrix()
    frames[:, :3, 3] = rng.normal(0, 0.2, (24, 3))
    aims = Rotation.from_rotvec(rng.normal(0, 0.2, (24, 3))).as_matrix()
    # The spine's axes are OpenSim's, x forward, y up and z to the right, along the section from lumbar_body to thorax.
    joints = skel_arrays()["J_regressor_osim"] @ skel_arrays()["skin_template_v"]
    aims[SECTIONS], frames[SECTIONS, :3, :3] = OPENSIM, np.eye(3)
    frames[12:14, :3, 3] = OPENSIM.T @ (joints[12] - joints[11])
    unneeded = {
        "version": "1.1.1",
        "bone_names": BONES,
        "joints_name": np.array(BONES),
        "num_betas": np.float64(10),
        "skel_template_v": rng.normal(0, 0.1, (96, 3)),
        "skel_template_f": arrays["skin_template_f"],
        "skel_weights": bones,
        "skel_weights_rigid": bones,
        "per_joint_rot": aims,
        "apose_rel_transfo": frames,
    }
    path.write_bytes(pickle.dumps(arrays | unneeded | changes))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("skel")
    source = write_pickle(folder / "skel_male.pkl")
    line = [sys.executable, "-m", "warp_partdr", "convert", source, folder / "skel_male.npz"]
    done = subprocess.run(line, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "skel, 96 vertices" in done.stdout
    return folder


@pytest.fixture(scope="module")
def model(folder: Path) -> DetailedModel:
    return load_model(f"skel:{folder / 'skel_male.npz'}", num_shapes=12, dtype=torch.float64)


def moved(model: DetailedModel, **turns: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    """Vertices and joints with some joints turned by rotation vectors, the root where it rests."""
    vectors = np.array([turns.get(name, np.zeros(3)) for name in model.joint_names])
    matrices = torch.from_numpy(Rotation.from_rotvec(vectors).as_matrix())[None]
    body = model.pose(matrices.new_zeros(1, model.num_shapes), matrices, model.rest_joints[:1])
    return body.vertices[0], body.joints[0]


def with_no_correctives(model: DetailedModel) -> DetailedModel:
    return replace(model, pose_directions=None)


def test_skel_at_rest_is_the_body_in_its_file(model: DetailedModel) -> None:
    arrays = skel_arrays()
    assert (model.name, model.num_joints, model.num_shapes, model.num_vertices) == ("skel", 25, 12, 96)
    assert model.joint_names == (*BONES, "skull")
    assert model.parents == (*PARENTS, 13)
    shape = np.random.default_rng(0).normal(size=12)
    rest = model.rest(torch.from_numpy(shape)[None])
    skin = arrays["skin_template_v"] + arrays["shapedirs"] @ shape
    joints, of_smpl = arrays["J_regressor_osim"] @ skin, arrays["J_regressor"] @ skin
    np.testing.assert_allclose(rest.vertices[0], skin, atol=1e-12)
    limbs = [joint for joint in range(24) if joint not in SECTIONS]
    np.testing.assert_allclose(rest.joints[0, limbs], joints[limbs], atol=1e-12)
    np.testing.assert_allclose(rest.joints[0, 24], of_smpl[SMPL_JOINTS.index("head")], atol=1e-12)
    for joint in SECTIONS:
        low, high = joints[PARENTS[joint]], joints[joint]
        np.testing.assert_allclose(rest.joints[0, joint], [high[0], (low[1] + high[1]) / 2, high[2]], atol=1e-12)


def test_parts_and_landmarks_are_the_bodys(model: DetailedModel) -> None:
    carrying = model.bone_of_part
    assert (carrying["left_hip"], carrying["abdomen"], carrying["chest"]) == ("pelvis", "lumbar_body", "thorax")
    assert (carrying["neck"], carrying["head"], carrying["right_foot"]) == ("head", "skull", "talus_r")
    assert (carrying["left_shoulder"], carrying["left_forearm"]) == ("scapula_l", "ulna_l")
    parts = {PART_NAMES[int(part) - 1] for part in model.face_parts.unique()}
    assert parts == set(PART_NAMES)
    smpl = smpl_arrays()
    of_smpl = smpl["J_regressor"] @ smpl["v_template"]
    rest = model.rest(torch.zeros(1, 12, dtype=torch.float64))
    found = dict(zip(model.landmark_names, model.landmarks(rest, model.landmark_names)[0].numpy(), strict=True))
    assert set(JOINT_NAMES) <= set(found)
    for name, source in (("pelvis", "pelvis"), ("spine", "spine2"), ("head", "head")):
        np.testing.assert_allclose(found[name], of_smpl[SMPL_JOINTS.index(source)], atol=1e-12)
    pairs = {"hip": "femur", "knee": "tibia", "ankle": "talus", "shoulder": "humerus", "elbow": "ulna", "wrist": "hand"}
    for side in ("left", "right"):
        for name, bone in pairs.items():
            joint = model.rest_joints[BONES.index(f"{bone}_{side[0]}")]
            np.testing.assert_allclose(found[f"{side}_{name}"], joint, atol=1e-12)
        assert (found[f"{side}_fingertip"][0] > 0.5) == (side == "left")


def test_a_turned_joint_moves_what_hangs_on_it(model: DetailedModel) -> None:
    plain = with_no_correctives(model)
    vertices, joints = moved(plain, humerus_l=np.array([0, 0, 1.0]))
    below = [BONES.index(name) for name in ("ulna_l", "radius_l", "hand_l")]
    still = [joint for joint in range(25) if joint not in below]
    turn = Rotation.from_rotvec([0, 0, 1.0]).as_matrix()
    centre = plain.rest_joints[BONES.index("humerus_l")].numpy()
    np.testing.assert_allclose(joints[still], plain.rest_joints[still], atol=1e-12)
    np.testing.assert_allclose(joints[below], (plain.rest_joints[below].numpy() - centre) @ turn.T + centre, atol=1e-12)
    hand = 4 * SMPL_JOINTS.index("left_hand") + np.arange(4)
    wanted = (plain.rest_vertices[hand].numpy() - centre) @ turn.T + centre
    np.testing.assert_allclose(vertices[hand], wanted, atol=1e-12)
    assert vertices[hand, 1].mean() > plain.rest_vertices[hand, 1].mean() + 0.2  # the left arm is raised
    other = 4 * SMPL_JOINTS.index("right_hand") + np.arange(4)
    np.testing.assert_allclose(vertices[other], plain.rest_vertices[other], atol=1e-12)


def test_a_section_of_the_spine_is_an_arc_to_first_order(model: DetailedModel) -> None:
    plain = with_no_correctives(model)
    joints = skel_arrays()["J_regressor_osim"] @ plain.rest_vertices.numpy()
    low, top = joints[11], joints[12]
    length, skin = top[1] - low[1], 4 * SMPL_JOINTS.index("spine3") + np.arange(4)
    for angle in (0.02, 0.2):
        found, _ = moved(plain, thorax=np.array([angle, 0, 0]))
        end = top + length * np.array([0, np.sin(angle) / angle - 1, (1 - np.cos(angle)) / angle])
        turned = (plain.rest_vertices[skin].numpy() - top) @ Rotation.from_rotvec([angle, 0, 0]).as_matrix().T + end
        wanted = 0.8 * turned + 0.2 * plain.rest_vertices[skin].numpy()
        np.testing.assert_allclose(found[skin], wanted, atol=0.1 * length * angle**2)


def test_the_skull_alone_is_not_skels_head(model: DetailedModel) -> None:
    arrays, plain = skel_arrays(), with_no_correctives(model)
    weights = plain.skin_weights.numpy()
    whole = weights[:, 13] + weights[:, 24]
    np.testing.assert_allclose(whole, arrays["skin_weights"][:, 13], atol=1e-12)
    neck, head = (
        (arrays["J_regressor"] @ arrays["skin_template_v"])[SMPL_JOINTS.index(name)] for name in ("neck", "head")
    )
    up = (head - neck) / np.linalg.norm(head - neck)
    share = ((arrays["skin_template_v"] - neck) @ up / np.linalg.norm(head - neck)).clip(0, 1)
    np.testing.assert_allclose(weights[:, 24], whole * share, atol=1e-12)


def test_correctives_are_of_the_joints_that_skel_takes_for_smpls(model: DetailedModel) -> None:
    matrices = Rotation.from_rotvec(0.3 * np.random.default_rng(6).normal(size=(25, 3))).as_matrix()
    turned = np.tile(np.eye(3), (24, 1, 1))
    for joint, taken_for in enumerate(TAKEN_FOR):
        turned[taken_for] = matrices[joint]
    wanted = skel_arrays()["posedirs"] @ (turned[1:] - np.eye(3)).ravel()
    found = (matrices[1:] - np.eye(3)).ravel() @ model.pose_directions.numpy()
    np.testing.assert_allclose(found.reshape(-1, 3), wanted, atol=1e-12)


def test_poses_agree_with_skels_own_code(folder: Path, model: DetailedModel) -> None:
    """Limbs, correctives and all, against ``body-models``; with a bent spine to first order."""
    body_models = pytest.importorskip("body_models", reason="needs the extra 'bodies'")
    own = body_models.create_model("skel", model_path=folder / "skel_male.pkl", gender="male", runtime="numpy")
    rng = np.random.default_rng(1)
    limbs, spine = 0.4 * rng.normal(size=43), rng.normal(size=9)
    limbs[[0, 1, 2, *range(17, 26), *range(33, 36)]] = 0  # root, spine and scapulae; the head's come by themselves
    for bend in (0.0, 0.02, 0.2):
        limbs[17:23] = bend * spine[:6]
        given = {name: np.asarray(value) for name, value in own.get_rest_pose().items()}
        given |= {"body_pose": limbs, "head_pose": bend * spine[6:]}
        world = own.forward_skeleton(**given)[:, :3, :3]
        local = np.concatenate([world[:1], world[PARENTS[1:]].transpose(0, 2, 1) @ world[1:], np.eye(3)[None]])
        shape = torch.zeros(1, 12, dtype=torch.float64)
        found = model.pose(shape, torch.from_numpy(local)[None].double(), model.rest_joints[:1])
        np.testing.assert_allclose(found.vertices[0], own.forward_vertices(**given), atol=1e-5 + 0.3 * bend**2)


def test_skel_is_registered_to_an_ellipbody(folder: Path) -> None:
    model = load_model(f"skel:{folder}", num_shapes=2)
    body = BodyParameters.mean(1).posed()
    registered = register(body, model)
    names = ["left_knee", "right_elbow"]
    found = model.landmarks(registered.detailed, names)
    assert (found - body.joints[:, [JOINT_NAMES.index(name) for name in names]]).norm(dim=-1).max() < 0.05


def saved(path: Path, **changes: np.ndarray | None) -> str:
    np.savez(path, **skel_arrays(**changes))
    return f"skel:{path}"


def test_what_is_no_skel_is_named(tmp_path: Path, folder: Path) -> None:
    arrays = skel_arrays()
    mirrored = arrays["skin_template_v"] * [-1, 1, 1]
    fewer = {"J_regressor": arrays["J_regressor"][:23], "J_regressor_osim": arrays["J_regressor_osim"][:23]}
    fewer |= {"skin_weights": np.full((96, 23), 1 / 23), "osim_kintree_table": arrays["osim_kintree_table"][:, :23]}
    fewer |= {"posedirs": arrays["posedirs"][..., :198]}
    path = tmp_path / "model.npz"
    wrong: list[tuple[dict[str, np.ndarray | None], str]] = [
        *(({name: None}, f"no array '{name}'; expected skin_template_v") for name in SKEL_ARRAYS),
        (
            {"skin_weights": arrays["skin_weights"][:, :20]},
            r"skin_weights: shape \(96, 20\); expected \(V = 96, J = 24\)",
        ),
        ({"skin_weights": 2 * arrays["skin_weights"]}, "skin_weights: rows sum to 2 to 2"),
        ({"J_regressor": arrays["J_regressor"][:20]}, r"J_regressor: shape \(20, 96\)"),
        ({"J_regressor_osim": np.full((24, 96), np.nan)}, "J_regressor_osim: holds NaN"),
        ({"skin_template_f": arrays["skin_template_f"] + 1}, "skin_template_f: vertex 1 to 96"),
        ({"osim_kintree_table": arrays["osim_kintree_table"][:, ::-1]}, "osim_kintree_table: expected joints 0 to 23"),
        (fewer, "osim_kintree_table: 23 joints; expected 24"),
        ({"skin_template_v": mirrored}, "x to the person's left"),
    ]
    for changes, says in wrong:
        source = saved(path, **changes)
        with pytest.raises(ValueError, match=f"^{path}: .*{says}"):
            load_model(source)
    for source, says in (
        (f"skel:{folder / 'skel_male.pkl'}", "pickles can run code.*partdr convert"),
        (f"skel:{tmp_path / 'none.npz'}", "No such file.*expected a file of SKEL"),
        (f"skel:{save_npz(tmp_path / 'smpl.npz')}", "no array 'skin_template_v'"),
        (str(folder / "skel_male.npz"), "no array 'v_template'"),
    ):
        with pytest.raises(ValueError, match=says):
            load_model(source)
    with pytest.raises(ValueError, match="num_shapes: 13"):
        load_model(saved(path), num_shapes=13)


def test_a_folder_holds_one_body(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none; expected one skel_\*\.npz"):
        load_model(f"skel:{tmp_path}")
    saved(tmp_path / "skel_male.npz")
    assert load_model(f"skel:{tmp_path}").num_shapes == 10
    saved(tmp_path / "skel_female.npz")
    with pytest.raises(InputError, match=r"skel_female\.npz, skel_male\.npz; expected one"):
        load_model(f"skel:{tmp_path}")


def test_sparse_matrices_of_older_scipys_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """A matrix by coordinates had ``row`` and ``col`` where it now has ``coords``."""
    from warp_partdr.models import model_pickles as converter

    class Numbers(converter._Array):
        def __init__(self, values: np.ndarray) -> None:
            dtype = converter._DType(values.dtype.str[1:])
            self.state = (1, values.shape, dtype, False, values.tobytes())

    wanted = skel_arrays()["skin_weights"]
    matrix = coo_matrix(wanted)
    row, column, data = (Numbers(values) for values in (matrix.row, matrix.col, matrix.data))
    for places in ({"row": row, "col": column}, {"coords": (row, column)}):
        found = type("coo_matrix", (converter._Shell,), {"kind": "coo_matrix"})()
        found.state = {**places, "_shape": matrix.shape, "data": data}
        np.testing.assert_array_equal(converter._to_array(found), wanted)
