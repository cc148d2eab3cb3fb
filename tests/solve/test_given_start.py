"""Bodies of other methods: read from their files, refined against labels, and the same again where nothing pulls."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import helpers.files
import numpy as np
import pytest
import torch
from helpers.bodies import random_turns
from helpers.files import save_npz, smpl_arrays

from warp_partdr.body.labels import label_set
from warp_partdr.body.skeletons import MPJPE_JOINTS
from warp_partdr.cameras import Camera, Perspective, WeakPerspective
from warp_partdr.errors import InputError
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.metrics import pa_mpjpe
from warp_partdr.models.anny import anny, anny_shape
from warp_partdr.models.joint_turns import turn_joints
from warp_partdr.models.load import load_model
from warp_partdr.models.model import detailed_mesh
from warp_partdr.models.pose import free_joints, turning_joints
from warp_partdr.models.registration import Registered, ungrown
from warp_partdr.models.smpl_parameters import to_smplx
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.solve.mesh.given_files import is_given, read_given
from warp_partdr.solve.mesh.given_poses import GivenPoses
from warp_partdr.solve.mesh.given_start import refine_given
from warp_partdr.solve.mesh.mesh_options import MeshOptions

smpl_file = helpers.files.smpl_file  # a fixture
SIZE = (240, 200)
CAMERAS: dict[str, Camera] = {
    "perspective": Perspective(torch.tensor([[420.0, 420.0]]), torch.tensor([[100.0, 120.0]])),
    "weak": WeakPerspective(torch.tensor([105.0]), torch.tensor([[100.0, 120.0]])),
}


def standing(turns: float = 0.0, seed: int = 0) -> Registered:
    """An adult 4 m away whose joints, fingers among them, are turned by so much."""
    model, rng = anny(), torch.Generator().manual_seed(seed)
    rotations = torch.eye(3).repeat(1, model.num_joints, 1, 1)
    rotations[:, 0] = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
    everywhere = torch.arange(1, model.num_joints)
    rotations = turn_joints(rotations, everywhere, turns * torch.randn(1, len(everywhere), 3, generator=rng))
    return ungrown(model, anny_shape(torch.full((1, 6), 0.5)), rotations, torch.tensor([[0.0, 0.0, 4.0]]), {})


def labels_of(body: Registered, camera: Camera) -> PartLabels:
    shown = draw_mesh(body.detailed.vertices, detailed_mesh(body.model), camera, SIZE).labels[0].numpy()
    chosen = label_set("body14")
    return PartLabels(chosen, chosen.part_groups[shown])


def test_joints_that_are_not_turned_keep_their_turns() -> None:
    body = standing(0.2)
    turning = torch.tensor(turning_joints(body.model))
    given = GivenPoses.of([body], turning)
    few = given.turning_rotations()
    assert few.shape == (1, len(turning), 3, 3)
    torch.testing.assert_close(given.whole(few), body.rotations, atol=1e-5, rtol=0)
    # Turned by so much, all joints below turn with it and none above.
    few[:, 3] = few[:, 3] @ torch.diag(torch.tensor([-1.0, -1.0, 1.0]))
    again = ungrown(body.model, body.shape, given.whole(few), body.translation, {})
    moved = (again.detailed.transforms[..., :3, :3] - body.detailed.transforms[..., :3, :3]).abs().amax((2, 3))[0]
    below = [joint for joint in range(body.model.num_joints) if int(turning[3]) in ancestors(body, joint)]
    assert sorted(torch.nonzero(moved > 1e-3)[:, 0].tolist()) == below


def ancestors(body: Registered, joint: int) -> list[int]:
    """The joint and those above it."""
    return [joint] + ([] if joint == 0 else ancestors(body, body.model.parents[joint]))


@pytest.mark.parametrize("kind", CAMERAS)
def test_without_iterations_the_body_stays(kind: str) -> None:
    body, camera = standing(0.1), CAMERAS[kind]
    fit = refine_given(body, camera, labels_of(body, camera), options=MeshOptions(iterations=0))
    pixels, wanted = (
        each.project(there.detailed.vertices)[..., :2] for each, there in ((fit.camera, fit.body), (camera, body))
    )
    torch.testing.assert_close(pixels, wanted, atol=5e-3, rtol=0)
    torch.testing.assert_close(fit.body.rotations, body.rotations, atol=1e-5, rtol=0)
    if kind == "perspective":
        torch.testing.assert_close(fit.body.detailed.vertices, body.detailed.vertices, atol=1e-3, rtol=0)
        torch.testing.assert_close(fit.body.translation, body.translation, atol=1e-3, rtol=0)


@pytest.mark.parametrize("kind", CAMERAS)
def test_labels_bring_a_body_nearer_to_the_truth(kind: str) -> None:
    truth, camera = standing(0.02), CAMERAS[kind]
    turns = 0.08 * torch.randn(1, len(free_joints(truth.model)), 3, generator=torch.Generator().manual_seed(1))
    wrong = turn_joints(truth.rotations, torch.tensor(free_joints(truth.model)), turns)
    start = ungrown(truth.model, truth.shape, wrong, truth.translation, {})
    fit = refine_given(start, camera, labels_of(truth, camera))
    names = MPJPE_JOINTS
    joints = [each.model.landmarks(each.detailed, names)[0] for each in (start, fit.body, truth)]
    before, after = (1000 * float(pa_mpjpe(found, joints[2])) for found in joints[:2])
    assert before > 20
    assert after < 0.8 * before


def layouts(folder: Path, arguments: dict[str, np.ndarray], pelvis: np.ndarray) -> dict[str, Path]:
    """One SMPL-X body as several methods write it; principal point in the picture's middle."""
    poses = {name: each for name, each in arguments.items() if name.endswith("pose") or name == "global_orient"}
    vectors = ["global_orient", "body_pose", "left_hand_pose", "right_hand_pose", "jaw_pose"]
    betas, transl = arguments["betas"], arguments["transl"]
    files: dict[str, dict[str, Any]] = {
        "smplx": {**poses, "betas": betas, "transl": transl, "focal_length": np.array(500.0)},
        "hmr2": {**poses, "betas": betas[0], "pred_cam_t_full": transl[0], "scaled_focal_length": np.array([500.0])},
        "multi-hmr": {
            "rotvec": np.concatenate([arguments[name].reshape(-1, 3) for name in vectors]),
            "shape": betas[0],
            "transl": np.full(3, 9.0),  # of the head
            "transl_pelvis": pelvis,
            "K": np.array([[500.0, 0, 100], [0, 500, 120], [0, 0, 1]]),
        },
    }
    paths = {name: folder / f"{name}.npz" for name in files}
    for name, path in paths.items():
        np.savez(path, **files[name])
    whole = {"pred_smpl_params": {**poses, "betas": betas}, "pred_cam_t": transl, "focal_length": 500.0}
    paths["json"] = folder / "hmr2.json"
    paths["json"].write_text(
        json.dumps(
            whole,
            default=lambda value: (
                value.tolist()
                if isinstance(value, np.ndarray)
                else {name: each.tolist() for name, each in value.items()}
            ),
        )
    )
    return paths


def test_files_of_other_methods_are_one_body(tmp_path: Path) -> None:
    model = load_model(save_npz(tmp_path / "smplx.npz", **smpl_arrays(55)))
    rotations = random_turns(1, 55, 0.3).float()
    rotations[:, 23:25] = torch.eye(3)  # eyes, of which Multi-HMR says nothing
    pose = torch.randn(1, 10), rotations, torch.tensor([[0.1, 0.2, 5.0]])
    wanted = model.pose(*pose)
    (tmp_path / "out").mkdir()
    for path in layouts(tmp_path / "out", to_smplx(model, *pose), wanted.joints[0, 0].numpy()).values():
        assert is_given(path)
        body, camera = read_given(path, model, SIZE)
        torch.testing.assert_close(body.detailed.vertices, wanted.vertices, atol=2e-5, rtol=0)
        assert camera.intrinsics.tolist() == [[500.0, 500.0, 100.0, 120.0]]


def test_wrong_files_are_named(tmp_path: Path, smpl_file: Path) -> None:
    model = load_model(smpl_file)
    good = {"betas": np.zeros(10), "transl": np.array([0.0, 0, 4]), "focal_length": np.array(500.0)}
    for changes, says in (
        ({"betas": None}, "no betas or shape; expected another method's body"),
        ({"transl": None}, "no transl_pelvis or transl or pred_cam_t_full"),
        ({"focal_length": None}, "no focal_length or scaled_focal_length or focal"),
        ({"focal_length": np.array(-1.0)}, "focal length -1; expected a positive"),
        ({"focal_length": np.array(np.nan)}, "focal_length: .*finite"),
        ({"betas": np.zeros((2, 10))}, r"betas: shape \(2, 10\); expected one person's"),
        ({"rotvec": np.zeros((24, 3))}, r"rotvec: shape \(24, 3\); expected \(53, 3\)"),
        ({"transl": np.array([0.0, 0, -4])}, "expected a body before the camera"),
        ({"mhr_model_params": np.zeros(204)}, "parameters of MHR; expected those of SMPL"),
        ({"betas": np.array([{}], dtype=object)}, "betas: holds pickled"),
    ):
        path = tmp_path / "wrong.npz"
        np.savez(path, **{name: each for name, each in (good | changes).items() if each is not None})
        with pytest.raises(InputError, match=says):
            read_given(path, model, SIZE)
    (tmp_path / "wrong.json").write_text('{"betas": "many", "transl": [0, 0, 4]}')
    with pytest.raises(InputError, match="betas: expected numbers"):
        read_given(tmp_path / "wrong.json", model, SIZE)
    np.savez(tmp_path / "good.npz", **good)
    with pytest.raises(InputError, match="model: anny; expected one of smpl"):
        read_given(tmp_path / "good.npz", anny(), SIZE)
