"""Parameters as the ``smplx`` package takes them: it makes the same bodies of them, and they come back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.bodies import random_turns
from helpers.files import smpl_arrays
from scipy.spatial.transform import Rotation

from warp_partdr.errors import InputError
from warp_partdr.models.anny import anny
from warp_partdr.models.load import load_model
from warp_partdr.models.model import DetailedModel
from warp_partdr.models.smpl_parameters import from_smplx, to_smplx

SIZES = {"smpl": 24, "smplh": 52, "smplx": 55}


def official_arrays(num_joints: int) -> dict[str, np.ndarray]:
    """All that ``smplx`` reads of a file; shape directions are 300 and 100 of the face in SMPL-X's."""
    arrays = smpl_arrays(num_joints, 400 if num_joints == 55 else 12)
    rng = np.random.default_rng(1)
    kinds = (("components", (45, 45)), ("mean", 45))
    hands = {f"hands_{kind}{side}": rng.normal(0, 0.3, shape) for side in "lr" for kind, shape in kinds}
    face = {"lmk_faces_idx": np.arange(51), "lmk_bary_coords": np.full((51, 3), 1 / 3)}
    return arrays | hands | face


@pytest.fixture(scope="module", params=SIZES)
def known(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[DetailedModel, Path]:
    path = tmp_path_factory.mktemp("smplx") / f"{request.param.upper()}_NEUTRAL.npz"
    np.savez(path, **official_arrays(SIZES[request.param]))
    return load_model(path, dtype=torch.float64), path


def bodies(model: DetailedModel, largest: float = 1.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Two bodies; the first is turned by nearly half a turn."""
    rotations = random_turns(2, model.num_joints, largest)
    rotations[0, 0] = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64)) @ rotations[0, 0]
    place = torch.tensor([[0.3, -0.2, 4.0], [0.0, 0.1, 6.0]], dtype=torch.float64)
    return torch.randn(2, model.num_shapes, dtype=torch.float64), rotations, place


def test_a_finger_of_the_left_hand_is_one_of_the_left_hand_s_pose(tmp_path: Path) -> None:
    np.savez(tmp_path / "hands.npz", **official_arrays(SIZES["smplh"]))
    model = load_model(tmp_path / "hands.npz")
    rotations = torch.eye(3).repeat(1, model.num_joints, 1, 1)
    (finger,) = (joint for joint, name in enumerate(model.joint_names) if name == "left_index1")
    rotations[0, finger] = random_turns(1, 1, 0.5)[0, 0]
    found = to_smplx(model, torch.zeros(1, model.num_shapes), rotations, torch.zeros(1, 3))
    assert found["left_hand_pose"].any()
    assert not found["right_hand_pose"].any()


def skin(arrays: dict[str, np.ndarray], betas: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vertices of SMPL (Loper et al., 2015), slowly, without any of the package."""
    shaped = arrays["v_template"] + arrays["shapedirs"][..., : len(betas)] @ betas
    joints, turns = arrays["J_regressor"] @ shaped, Rotation.from_rotvec(vectors).as_matrix()
    bent = shaped + arrays["posedirs"] @ (turns[1:] - np.eye(3)).ravel()
    frames: list[np.ndarray] = []
    for joint, parent in enumerate(arrays["kintree_table"][0].astype(int)):
        above = np.eye(4) if joint == 0 else frames[parent]
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = turns[joint], joints[joint] - (0 if joint == 0 else joints[parent])
        frames.append(above @ local)
    moved = [(bent - joint) @ frame[:3, :3].T + frame[:3, 3] for joint, frame in zip(joints, frames, strict=True)]
    return np.einsum("vj,jvi->vi", arrays["weights"], np.stack(moved))


def test_smplx_makes_the_same_body(known: tuple[DetailedModel, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    smplx = pytest.importorskip("smplx", reason="needs the smplx package")
    from smplx.utils import Struct

    model, path = known
    ids = smplx.body_models.VERTEX_IDS
    for name, of_whole_mesh in ids.items():
        monkeypatch.setitem(ids, name, dict.fromkeys(of_whole_mesh, 0))
    options = {"ext": "npz", "use_pca": False, "flat_hand_mean": True, "batch_size": 2, "dtype": torch.float64}
    if model.name == "smplx":
        made = smplx.SMPLX(str(path), **options)
    else:  # of these, the package reads pickles alone
        with np.load(path) as file:
            arrays = Struct(**file)
        made = {"smpl": smplx.SMPL, "smplh": smplx.SMPLH}[model.name](str(path), data_struct=arrays, **options)
    body = bodies(model)
    arguments = to_smplx(model, *body)
    with torch.no_grad():
        shown = made(**{name: torch.from_numpy(each).double() for name, each in arguments.items()})
    np.testing.assert_allclose(model.pose(*body).vertices, shown.vertices, atol=1e-5)


def test_smpls_equations_make_the_same_body(known: tuple[DetailedModel, Path]) -> None:
    model, path = known
    body = bodies(model)
    arguments = to_smplx(model, *body)
    transl = arguments.pop("transl")
    betas = arguments.pop("betas")
    with np.load(path) as file:
        arrays = dict(file)
    for row in range(2):
        turns = np.concatenate([each[row].reshape(-1, 3) for each in arguments.values()])
        found = skin(arrays, betas[row].astype(float), turns.astype(float)) + transl[row]
        np.testing.assert_allclose(model.pose(*body).vertices[row], found, atol=1e-5)


def test_parameters_come_back(known: tuple[DetailedModel, Path]) -> None:
    model, _ = known
    body = bodies(model)
    arguments = to_smplx(model, *body)
    for found, wanted in zip(from_smplx(model, arguments, "file"), body, strict=True):
        assert found.dtype == torch.float64
        np.testing.assert_allclose(found, wanted, atol=1e-6)
    # As networks give them: matrices, and of one person without rows.
    single = {name: each[0] for name, each in arguments.items()}
    count = 23 if model.name == "smpl" else 21
    single["body_pose"] = body[1][0, 1 : 1 + count].numpy()
    np.testing.assert_allclose(from_smplx(model, single, "file")[1][0], body[1][0], atol=1e-6)


def test_few_betas_and_missing_poses_are_zero(known: tuple[DetailedModel, Path]) -> None:
    model, _ = known
    given = {"betas": np.ones(3), "transl": np.zeros(3)}
    shape, rotations, translation = from_smplx(model, given, "file")
    assert shape.tolist() == [[1.0] * 3 + [0.0] * 7]
    assert torch.equal(rotations[0], torch.eye(3, dtype=torch.float64).expand(model.num_joints, 3, 3))
    np.testing.assert_allclose(translation, model.rest(shape).joints[:, 0])


def test_wrong_parameters_are_named(known: tuple[DetailedModel, Path]) -> None:
    model, _ = known
    good = to_smplx(model, *bodies(model))
    for name, value, says in (
        ("betas", None, "file: no 'betas'; expected betas, transl, global_orient"),
        ("betas", np.ones((2, 11)), r"file: betas: float64 \(2, 11\); expected"),
        ("transl", np.ones((1, 3)), r"file: transl: .*expected 6 numbers"),
        ("global_orient", np.full((2, 3), np.nan), "file: global_orient: holds NaN"),
        ("body_pose", np.array(["x"]), "file: body_pose: <U1"),
    ):
        given = {key: each for key, each in (good | {name: value}).items() if each is not None}
        with pytest.raises(InputError, match=says):
            from_smplx(model, given, "file")
    with pytest.raises(InputError, match="model: anny; expected one of smpl, smplh, smplx"):
        to_smplx(anny(), *bodies(anny("cpu", torch.float64)))
