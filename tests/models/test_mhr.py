"""MHR from files of its layout, made here: 127 joints around a small person, read by ``body-models``."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.files import BODY_PARENTS, smpl_arrays

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.template import JOINT_NAMES, PART_NAMES
from warp_partdr.errors import InputError
from warp_partdr.models.load import load_model
from warp_partdr.models.mhr import mhr_model
from warp_partdr.models.model import DetailedModel
from warp_partdr.models.registration import register

body_models = pytest.importorskip("body_models", reason="needs the extra 'bodies'")

pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.*:DeprecationWarning")  # MHR's file is such a script
_SPINE = {3: "c_spine0", 6: "c_spine1", 9: "c_spine2", 12: "c_neck", 15: "c_head"}
_SIDED = {1: "upleg", 4: "lowleg", 7: "foot", 10: "ball", 13: "clavicle", 16: "uparm", 18: "lowarm", 20: "wrist"}
_CONTROLS, _IDENTITY, _FACE = 204, 45, 72
_ELBOW = 30  # a control that turns the left elbow


class Node(torch.nn.Module):
    """A part of the checkpoint: tensors, names and further parts."""

    def __init__(self, names: list[str] | None = None, parts: dict[str, Node] | None = None, **tensors: Any) -> None:
        super().__init__()
        self.joint_names = names or [""]
        for name, part in (parts or {}).items():
            setattr(self, name, part)
        for name, tensor in tensors.items():
            self.register_buffer(name, torch.as_tensor(tensor))

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        return values


def rig_joints() -> tuple[list[str], list[int], np.ndarray]:
    """Names, parents and places [m] of the joints: SMPL's body below ``body_world``, and many at the wrists."""
    arrays = smpl_arrays()
    places = arrays["J_regressor"] @ arrays["v_template"]
    names = ["body_world", "root"]
    for joint in range(1, 22):
        names.append(_SPINE.get(joint) or (f"l_{_SIDED[joint]}" if joint in _SIDED else f"r_{_SIDED[joint - 1]}"))
    parents = [-1, 0, *(1 + parent for parent in BODY_PARENTS[1:])]
    where = [places[0], *places[:22]]
    for extra in range(127 - len(names)):
        side = "lr"[extra % 2]
        wrist = names.index(f"{side}_wrist")
        names.append(f"{side}_extra{extra}")
        parents.append(wrist)
        where.append(where[wrist] + [0.05 if side == "l" else -0.05, 0.001 * extra, 0.02])
    return names, parents, np.array(where)


def write_rig(folder: Path, *, correctives: float = 0.0) -> Path:
    rng = np.random.default_rng(0)
    names, parents, places = rig_joints()
    corners = 0.02 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    vertices = 100 * (places[1:, None] + corners).reshape(-1, 3)
    joints = np.repeat(np.arange(1, 127), 4)
    count = len(vertices)
    offsets = 100 * np.array(
        [place - (places[max(parent, 0)] if parent >= 0 else 0) for place, parent in zip(places, parents, strict=True)]
    )
    turns = np.zeros((127 * 7, _CONTROLS + _IDENTITY))
    turns[7 * names.index("l_lowarm") + 5, _ELBOW] = 1.0
    turns[7 * names.index("l_upleg") + 6, 140] = turns[7 * names.index("r_upleg") + 6, 140] = 1.0  # scales legs
    inverse = np.concatenate([-100 * places, np.tile([0.0, 0, 0, 1, 1], (127, 1))], axis=1)
    tetrahedron = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    faces = (4 * np.arange(126)[:, None, None] + tetrahedron).reshape(-1, 3)
    single = np.float32
    character = {
        "skeleton": Node(
            names,
            joint_parents=np.array(parents),
            joint_translation_offsets=offsets.astype(single),
            joint_prerotations=np.tile([0, 0, 0, 1], (127, 1)).astype(single),
        ),
        "linear_blend_skinning": Node(
            vert_indices_flattened=np.arange(count),
            skin_indices_flattened=joints,
            skin_weights_flattened=np.ones(count, single),
            inverse_bind_pose=inverse.astype(single),
        ),
        "blend_shape": Node(
            base_shape=vertices.astype(single), shape_vectors=rng.normal(0, 0.3, (_IDENTITY, count, 3)).astype(single)
        ),
        "parameter_transform": Node(parameter_transform=turns.astype(single)),
        "mesh": Node(faces=faces),
    }
    face = Node(shape_vectors=rng.normal(0, 0.1, (_FACE, count, 3)).astype(single))
    whole = Node(parts={"character_torch": Node(parts=character), "face_expressions_model": face})
    folder.mkdir()
    torch.jit.script(whole).save(str(folder / "mhr_model.pt"))
    indices = np.array([[0, 1], [0, 7]])
    np.savez(
        folder / "corrective_activation.npz", **{"0.sparse_indices": indices, "0.sparse_weight": np.ones(2, single)}
    )
    basis = correctives * rng.normal(size=(3000, count, 3)) * (np.arange(3000) < 5)[:, None, None]
    np.savez_compressed(folder / "corrective_blendshapes_lod1.npz", corrective_blendshapes=basis.astype(single))
    return folder


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A place for what the package works out, away from the user's."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setattr("body_models.mhr._io.get_cache_dir", lambda: folder)
        yield


@pytest.fixture(scope="module")
def files(cache: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rig(tmp_path_factory.mktemp("rigs") / "mhr")


@pytest.fixture(scope="module")
def rig(files: Path) -> tuple[DetailedModel, Any]:
    return mhr_model(files, dtype=torch.float64), body_models.create_model("mhr", model_path=files)


def test_parts_and_joints_are_the_bodys(rig: tuple[DetailedModel, Any]) -> None:
    model, _ = rig
    assert (model.name, model.num_joints, model.num_shapes) == ("mhr", 126, 63)
    assert model.parents[:2] == (-1, 0)
    carrying = model.bone_of_part
    assert (carrying["left_hip"], carrying["abdomen"], carrying["chest"]) == ("root", "c_spine0", "c_spine2")
    assert (carrying["right_shoulder"], carrying["left_hand"]) == ("r_clavicle", "l_wrist")
    shown = {PART_NAMES[int(part) - 1] for part in model.face_parts.unique()}
    assert shown == set(PART_NAMES)
    assert set(JOINT_NAMES) <= set(model.landmark_names)


def test_shape_and_pose_are_the_rigs(rig: tuple[DetailedModel, Any]) -> None:
    model, own = rig
    rest = {name: np.asarray(value) for name, value in own.get_rest_pose().items()}
    values = np.random.default_rng(1).normal(size=45).astype(np.float32)
    bent = rest["body_pose"].copy()
    bent[27] = 0.7  # controls 27 to 29 are the head's
    given = rest | {"shape": values, "body_pose": bent}
    shape = torch.zeros(1, 63, dtype=torch.float64)
    shape[0, :45] = torch.from_numpy(values)
    frames = torch.from_numpy(np.asarray(own.forward_skeleton(**given), dtype=np.float64))[1:, :3, :3]
    turns = torch.stack(
        [
            frames[max(parent, 0)].mT @ frame if parent >= 0 else frame
            for parent, frame in zip(model.parents, frames, strict=True)
        ]
    )
    assert (turns[model.joint_names.index("l_lowarm")] - torch.eye(3)).abs().max() > 0.5
    posed = model.pose(shape, turns[None], model.rest(shape).joints[:, 0])
    np.testing.assert_allclose(posed.vertices[0], own.forward_vertices(**given), atol=1e-5)


def test_scales_are_right_to_first_order(rig: tuple[DetailedModel, Any]) -> None:
    model, own = rig
    rest = {name: np.asarray(value) for name, value in own.get_rest_pose().items()}
    place = 79 + 140 - 139  # body_pose's last 15 are the controls 139 to 153
    shape = torch.zeros(1, 63, dtype=torch.float64)
    shape[0, 45 + 1] = 1.0
    scaled = rest["body_pose"].copy()
    scaled[place] = 0.1
    found = model.rest(shape)
    wanted = own.forward_vertices(**(rest | {"body_pose": scaled}))
    grown = np.abs(found.vertices[0].numpy() - model.rest_vertices.numpy()).max()
    assert grown > 0.04  # legs, by 7 %
    assert np.abs(found.vertices[0].numpy() - wanted).max() < 0.05 * grown
    np.testing.assert_allclose(
        found.joints[0], own.forward_skeleton(**(rest | {"body_pose": scaled}))[1:, :3, 3], atol=3e-3
    )


def test_correctives_are_nothing_at_rest(tmp_path: Path, rig: tuple[DetailedModel, Any]) -> None:
    other = mhr_model(write_rig(tmp_path / "corrected", correctives=5.0), dtype=torch.float64)
    np.testing.assert_allclose(other.rest_vertices, rig[0].rest_vertices, atol=1e-9)


def test_mhr_is_registered_to_an_ellipbody(files: Path) -> None:
    model = load_model(f"mhr:{files}")
    posed = BodyParameters.mean(1).posed()
    registered = register(posed, model)
    joints = [JOINT_NAMES.index(name) for name in ("left_knee", "right_elbow")]
    found = model.landmarks(registered.detailed, ["left_knee", "right_elbow"])
    assert (found - posed.joints[:, joints]).norm(dim=-1).max() < 0.03


def test_what_is_no_rig_is_refused(tmp_path: Path, files: Path) -> None:
    (tmp_path / "empty").mkdir()
    for folder, says in ((tmp_path / "none", "does not exist"), (tmp_path / "empty", "missing required assets")):
        with pytest.raises(InputError, match=f"{says}.*expected a folder of MHR's files"):
            mhr_model(folder)
    broken = Path(shutil.copytree(files, tmp_path / "broken"))
    (broken / "mhr_model.pt").write_bytes(b"no checkpoint")
    with pytest.raises(InputError, match="expected a folder of MHR's files"):
        mhr_model(broken)
    with pytest.raises(ValueError, match="num_shapes"):
        load_model(f"mhr:{broken}", num_shapes=3)
