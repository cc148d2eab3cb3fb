"""Detailed models: skinning against a slow reference, Anny, poses from EllipBody, files that can't be trusted."""

from __future__ import annotations

import importlib.util
import pickle
import struct
import subprocess
import sys
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import torch
from scenes import draw_on_screen, loss_on_screen

from warp_partdr.body.labels import label_set
from warp_partdr.body.landmarks import LANDMARKS, landmark_positions
from warp_partdr.body.posing import Posed, pose
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.template import JOINT_NAMES, NUM_PARTS, PARENTS, PART_NAMES, template
from warp_partdr.clothing import load
from warp_partdr.clothing.anny import PHENOTYPE_ANCHORS, anny, anny_shape
from warp_partdr.clothing.load import load_model
from warp_partdr.clothing.mesh import detailed_mesh
from warp_partdr.clothing.model import DetailedModel
from warp_partdr.clothing.pose import pose_from_ellipbody
from warp_partdr.clothing.smpl import ARRAYS
from warp_partdr.render.part_mesh import ellipbody_mesh

ROOT = Path(__file__).resolve().parents[2]
LIMBS = ("upper_leg", "lower_leg", "upper_arm", "forearm", "hand")
NEUTRAL = torch.full((1, 6), 0.5)  # the adult whom EllipBody's mean body was measured on

# A tiny body in SMPL's format: a tetrahedron around each joint of a person in a T-pose, x, y, z in cm, left side only.
BODY_PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]
MIDDLE = {0: (0, 0, 0), 3: (0, 11, -3), 6: (0, 25, -3), 9: (0, 30, 0), 12: (0, 51, -3), 15: (0, 60, 2)}
LEFT = {1: (7, -9, 0), 4: (11, -47, 0), 7: (9, -87, -3), 10: (12, -93, 9), 13: (7, 42, -2), 16: (17, 45, -3)}
LEFT |= {18: (43, 44, -4), 20: (68, 45, -4)}


def smpl_arrays(num_joints: int = 24, num_shapes: int = 12) -> dict[str, np.ndarray]:
    """Arrays as in a file of SMPL (24), SMPL-H (52) or SMPL-X (55)."""
    rng = np.random.default_rng(0)
    parents, joints = list(BODY_PARENTS), np.zeros((22, 3))
    for joint, place in MIDDLE.items():
        joints[joint] = place
    for joint, place in LEFT.items():
        joints[joint], joints[joint + 1] = place, np.multiply(place, (-1, 1, 1))
    parents += {24: [], 52: [], 55: [15, 15, 15]}[num_joints]
    for wrist in (20, 21):
        for _ in range(1 if num_joints == 24 else 5):
            for knuckle in range(1 if num_joints == 24 else 3):
                parents.append(wrist if knuckle == 0 else len(parents) - 1)
    side = {parent: np.sign(joints[parent, 0]) for parent in (20, 21)}
    for joint in range(22, num_joints):
        above, wrist = parents[joint], joint
        while wrist > 21:
            wrist = parents[wrist]
        if wrist == 15:
            place = joints[15] + [0, 3, 5]
        elif above == wrist:
            first = (joint - (22 if num_joints == 52 else 25)) // 3 % 5 if num_joints > 24 else 1
            forward = {0: 3, 1: 1, 2: -3, 3: -1, 4: 4}[first]  # index, middle, pinky, ring, thumb
            place = joints[wrist] + [8 * side[wrist], 0, forward]
        else:
            place = joints[above] + [3 * side[wrist], 0, 0]
        joints = np.vstack([joints, place])
    joints /= 100
    corners = 0.02 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    vertices = (joints[:, None] + corners).reshape(-1, 3)
    weights = np.zeros((len(vertices), num_joints))
    for joint, parent in enumerate(parents):
        weights[4 * joint : 4 * joint + 4, joint] += 0.8
        weights[4 * joint : 4 * joint + 4, max(parent, 0)] += 0.2
    tetrahedron = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    return {
        "v_template": vertices,
        "shapedirs": rng.normal(0, 0.003, (len(vertices), 3, num_shapes)),
        "posedirs": rng.normal(0, 0.002, (len(vertices), 3, 9 * (num_joints - 1))),
        "J_regressor": np.kron(np.eye(num_joints), np.full((1, 4), 0.25)),
        "weights": weights,
        "kintree_table": np.array([[2**32 - 1, *parents[1:]], range(num_joints)], dtype=np.uint32),
        "f": (4 * np.arange(num_joints)[:, None, None] + tetrahedron).reshape(-1, 3).astype(np.uint32),
    }


def save_npz(path: Path, **changes: np.ndarray | None) -> Path:
    arrays = {name: value for name, value in (smpl_arrays() | changes).items() if value is not None}
    np.savez_compressed(path, **arrays)
    return path


@pytest.fixture(scope="module")
def smpl_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_npz(tmp_path_factory.mktemp("models") / "smpl.npz")


def turns(count: int, num_joints: int, scale: float, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return rotation_from_axis_angle(scale * torch.randn(count, num_joints, 3, generator=generator, dtype=torch.float64))


def slow_pose(model: DetailedModel, shape: np.ndarray, rotations: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Vertices of one body: one vertex and one joint at a time."""
    rest = model.rest_vertices.numpy() + np.einsum("s,svi->vi", shape, model.shape_directions.numpy())
    joints = model.rest_joints.numpy() + np.einsum("s,sji->ji", shape, model.joint_directions.numpy())
    if model.pose_directions is not None:
        rest = rest + ((rotations[1:] - np.eye(3)).ravel() @ model.pose_directions.numpy()).reshape(-1, 3)
    skin_weights = model.skin_weights.numpy()
    vertices = np.zeros_like(rest)
    for v, vertex in enumerate(rest):
        for joint in np.flatnonzero(skin_weights[v]):
            point, j = vertex, int(joint)
            while j >= 0:  # turn about each joint on the way to the root
                point, j = joints[j] + rotations[j] @ (point - joints[j]), model.parents[j]
            vertices[v] += skin_weights[v, joint] * (point - joints[0] + translation)
    return vertices


@pytest.mark.parametrize("name", ["anny", "smpl"])
def test_pose_is_linear_blend_skinning(name, smpl_file, device):
    model = load_model("anny" if name == "anny" else smpl_file, dtype=torch.float64)
    shape = torch.randn(2, model.num_shapes, dtype=torch.float64)
    rotations, translation = turns(2, model.num_joints, 0.4), torch.randn(2, 3, dtype=torch.float64)
    moved = model.to(device)
    posed = moved.pose(shape.to(device), rotations.to(device), translation.to(device))
    wanted = slow_pose(model, shape[1].numpy(), rotations[1].numpy(), translation[1].numpy())
    np.testing.assert_allclose(posed.vertices[1].cpu(), wanted, atol=1e-10)
    np.testing.assert_allclose(posed.joints[:, 0].cpu(), translation, atol=1e-12)
    assert torch.equal(posed.transforms[..., :3, 3], posed.joints)


def test_pose_in_float32_is_that_in_float64(device):
    model = anny(device)
    shape, rotations = torch.randn(3, model.num_shapes), turns(3, model.num_joints, 0.4)
    single = model.pose(shape.to(device), rotations.float().to(device), torch.ones(3, 3, device=device))
    double = anny("cpu", torch.float64).pose(shape.double(), rotations, torch.ones(3, 3, dtype=torch.float64))
    np.testing.assert_allclose(single.vertices.cpu(), double.vertices, atol=2e-5)


def test_pose_has_the_gradient_of_its_value(smpl_file):
    model = load_model(smpl_file, num_shapes=3, dtype=torch.float64)
    inputs = (
        torch.randn(2, 3, dtype=torch.float64),
        turns(2, model.num_joints, 0.4),
        torch.randn(2, 3, dtype=torch.float64),
        0.01 * torch.randn(2, model.num_vertices, 3, dtype=torch.float64),
    )
    for tensor in inputs:
        tensor.requires_grad_()

    def numbers(shape, rotations, translation, offsets):
        posed = model.pose(shape, rotations, translation, offsets=offsets)
        return posed.vertices[:, ::7], posed.joints, model.landmarks(posed, ["head_top", "left_wrist"])

    assert torch.autograd.gradcheck(numbers, inputs, fast_mode=True)


def test_no_bodies(smpl_file):
    for model in (anny(), load_model(smpl_file)):
        posed = model.pose(torch.zeros(0, model.num_shapes), torch.zeros(0, model.num_joints, 3, 3), torch.zeros(0, 3))
        assert posed.vertices.shape == (0, model.num_vertices, 3)
        assert model.landmarks(posed, ["neck"]).shape == (0, 1, 3)


def test_wrong_arguments_are_named(smpl_file):
    model = load_model(smpl_file)
    shape, rotations, translation = torch.zeros(2, 10), torch.eye(3).expand(2, 24, 3, 3), torch.zeros(2, 3)
    for name, values in {
        "shape": (shape[:, :5], rotations, translation),
        "rotations": (shape, rotations[:, :5], translation),
        "translation": (shape, rotations, translation[:1]),
    }.items():
        with pytest.raises(ValueError, match=rf"^{name}: shape .*; expected"):
            model.pose(*values)
    with pytest.raises(ValueError, match=r"^rotations: torch.float64"):
        model.pose(shape, rotations.double(), translation)
    with pytest.raises(ValueError, match="offsets: shape"):
        model.pose(shape, rotations, translation, offsets=torch.zeros(2, 5, 3))
    with pytest.raises(ValueError, match="names: smpl has no landmark 'left_eye'"):
        model.landmarks(model.rest(shape), ["neck", "left_eye"])


# Anny


@pytest.mark.slow
def test_asset_is_the_package():
    pytest.importorskip("anny")
    sys.path.insert(0, str(ROOT / "scripts"))
    from anny_person import PersonFactory, body_from_anny

    factory = PersonFactory()
    model = anny()
    assert tuple(factory.bones) == model.joint_names
    assert factory.model.phenotype_labels == list(PHENOTYPE_ANCHORS)
    phenotypes, rotations = torch.rand(10, 6), turns(10, model.num_joints, 0.3).float()
    to_anny = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    matrices = torch.eye(4).repeat(10, model.num_joints, 1, 1)
    matrices[..., :3, :3] = to_anny @ rotations @ to_anny.T
    with torch.no_grad():
        output = factory.model(pose_parameters=matrices, phenotype_kwargs=phenotypes, pose_parameterization="local-ref")
    wanted = body_from_anny(output["vertices"].numpy())
    joints = body_from_anny(output["bone_poses"][..., :3, 3].numpy())
    posed = model.pose(anny_shape(phenotypes), rotations, torch.from_numpy(joints[:, 0]))
    assert np.linalg.norm(posed.vertices.numpy() - wanted, axis=-1).mean() < 0.0025
    assert np.linalg.norm(posed.joints.numpy() - joints, axis=-1).mean() < 0.002


def test_skinning_has_four_weights_a_vertex():
    weights = anny().skin_weights
    assert ((weights > 0).sum(1) <= 4).all()
    torch.testing.assert_close(weights.sum(1), torch.ones(len(weights)))


def test_mesh_is_closed_and_symmetric():
    model = anny()
    faces, vertices = model.faces.long(), model.rest_vertices
    edges = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there, back = (edges[:, i] * len(vertices) + edges[:, 1 - i] for i in (0, 1))
    assert len(there.unique()) == len(there)
    assert torch.equal(there.sort().values, back.sort().values), "an edge without a neighbour"
    corners = vertices[faces]
    volume = (torch.linalg.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]).sum() / 6
    assert 0.03 < volume < 0.12, "faces must show outward"


def stature(phenotypes: list[float]) -> float:
    vertices = anny().rest(anny_shape(torch.tensor([phenotypes]))).vertices
    return float(vertices[0, :, 1].max() - vertices[0, :, 1].min())


def test_phenotypes_say_who_it_is():
    assert stature([0.5] * 6) == pytest.approx(1.625, abs=0.005)  # as Anny's package has it
    assert 0.5 < stature([0.5, 0.0, 0.5, 0.5, 0.5, 0.5]) < stature([0.5, 1 / 3, 0.5, 0.5, 0.5, 0.5]) < 1.5
    assert stature([0.0, 0.7, 0.5, 0.5, 0.9, 0.5]) > stature([0.0, 0.7, 0.5, 0.5, 0.1, 0.5]) + 0.2
    assert stature([0.5, 9.0, 0.5, 0.5, 0.5, 0.5]) == stature([0.5, 1.0, 0.5, 0.5, 0.5, 0.5])
    between = anny_shape(torch.rand(50, 6, dtype=torch.float64))
    assert between.dtype == torch.float64
    assert 0.5 < between.std() < 2
    with pytest.raises(ValueError, match=r"phenotypes: shape \(1, 5\)"):
        anny_shape(torch.zeros(1, 5))


def mean_body(rotations: torch.Tensor, global_orient: torch.Tensor | None = None) -> Posed:
    """EllipBody's mean body with these local rotations."""
    batch, constants, device = len(rotations), template(), rotations.device
    identity = torch.eye(3, device=device).expand(batch, 3, 3)
    sizes = (
        torch.from_numpy(values).float().to(device).expand(batch, -1).contiguous()
        for values in (constants.mean_lengths, constants.mean_thicknesses)
    )
    orient = identity.contiguous() if global_orient is None else global_orient
    return pose(orient, torch.zeros(batch, 3, device=device), rotations.contiguous(), *sizes)


REST = torch.eye(3).expand(1, NUM_PARTS, 3, 3)


def at_rest(device: str = "cpu") -> tuple[DetailedModel, torch.Tensor, torch.Tensor, torch.Tensor]:
    """The neutral adult in EllipBody's rest pose."""
    model, shape = anny(device), anny_shape(NEUTRAL).to(device)
    return model, shape, *pose_from_ellipbody(model, mean_body(REST.to(device)), shape)


def test_landmarks_are_those_of_ellipbody():
    """EllipBody was measured on this very person."""
    model, shape, rotations, translation = at_rest()
    posed = mean_body(REST)
    names = list(LANDMARKS)
    solids = (getattr(posed, name)[0].numpy() for name in ("centres", "axes", "semi_axes"))
    found = model.landmarks(model.pose(shape, rotations, translation), names)[0].numpy()
    errors = np.linalg.norm(found - landmark_positions(names, *solids), axis=1)
    assert {name: error for name, error in zip(names, errors, strict=True) if error > 0.012} == {}
    assert sum(name.startswith("coco_") for name in model.landmark_names) == 12


def test_parts_are_where_ellipbody_has_them():
    model, shape, rotations, translation = at_rest()
    corners = model.pose(shape, rotations, translation).vertices[0][model.faces.long()]
    areas = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=-1, keepdim=True)
    centres = mean_body(REST).centres[0]
    for part, name in enumerate(PART_NAMES):
        mine = model.face_parts == part + 1
        middle = (corners[mine].mean(1) * areas[mine]).sum(0) / areas[mine].sum()
        assert (middle - centres[part]).norm() < 0.07, name
        if not name.startswith(("left", "right")):
            assert abs(middle[0]) < 0.01, name
    table = torch.from_numpy(label_set("body14").part_groups)
    assert torch.equal(model.face_parts14, table[model.face_parts.long()])


# Poses from EllipBody


def angles(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Between directions [degrees]."""
    a, b = (torch.nn.functional.normalize(vector, dim=-1) for vector in (a, b))
    return torch.rad2deg(2 * torch.atan2((a - b).norm(dim=-1), (a + b).norm(dim=-1)))


def bones(joints: torch.Tensor, part: int) -> torch.Tensor:
    return joints[:, part + 1] - joints[:, PARENTS[part] + 1]


@pytest.mark.parametrize("num_joints", [0, 24, 52, 55], ids=["anny", "smpl", "smplh", "smplx"])
def test_limbs_point_where_ellipbody_points(num_joints, tmp_path):
    model = anny()
    if num_joints:
        arrays = smpl_arrays(num_joints)
        arrays["posedirs"] *= 0  # they move the fingertips against the hands
        model = load_model(save_npz(tmp_path / "model.npz", **arrays))
    shape = torch.randn(16, model.num_shapes)
    posed = mean_body(turns(16, NUM_PARTS, 0.8).float(), turns(16, 1, 1.0)[:, 0].float())
    names = [name if name in model.landmark_names else "neck" for name in JOINT_NAMES]
    found = model.landmarks(model.pose(shape, *pose_from_ellipbody(model, posed, shape)), names)
    for part, name in enumerate(PART_NAMES):
        if name.endswith(LIMBS):
            assert angles(bones(found, part), bones(posed.joints, part)).max() < 1, name


def test_limbs_twist_as_ellipbody_twists():
    """From the rest pose on, a limb's joints turn exactly as its ellipsoid."""
    model, shape, rest_rotations, translation = at_rest()
    rest = model.pose(shape, rest_rotations, translation)
    # Hips that stay with the pelvis, as theirs do.
    local = turns(16, NUM_PARTS, 0.8).float()
    local[:, :2] = torch.eye(3)
    posed = mean_body(local, turns(16, 1, 1.0)[:, 0].float())
    shapes = shape.expand(16, -1)
    found = model.pose(shapes, *pose_from_ellipbody(model, posed, shapes))
    for bone, part in {
        "upperleg02": "upper_leg", "lowerleg01": "lower_leg", "foot": "foot", "upperarm02": "upper_arm",
        "lowerarm01": "forearm", "wrist": "hand", "clavicle": "shoulder", "pelvis": "hip",
    }.items():  # fmt: skip
        for side in ("left", "right"):
            joint = model.joint_names.index(f"{bone}.{side[0].upper()}")
            wanted = posed.rotations[:, PART_NAMES.index(f"{side}_{part}")] @ rest.transforms[:, joint, :3, :3]
            torch.testing.assert_close(found.transforms[:, joint, :3, :3], wanted, atol=1e-4, rtol=0, msg=bone)
    palms = [model.landmarks(found, [f"{side}_pinky", f"{side}_index"]).diff(dim=1)[:, 0] for side in ("left", "right")]
    for side, palm in zip(("left", "right"), palms, strict=True):
        hand = PART_NAMES.index(f"{side}_hand")
        along = bones(posed.joints, hand)
        across = palm - (palm * along).sum(-1, keepdim=True) / (along * along).sum(-1, keepdim=True) * along
        assert angles(across, posed.rotations[:, hand, :, 2]).max() < 1, "palms are down at rest: thumbs forward"
    torch.testing.assert_close(
        model.landmarks(found, ["mid_hip"])[:, 0], posed.joints[:, 1:3].mean(1), atol=1e-5, rtol=0
    )


def test_forearm_shares_the_twist_of_the_hand():
    local = REST.clone()
    local[:, PART_NAMES.index("left_hand")] = rotation_from_axis_angle(torch.tensor([1.2, 0.0, 0.0]))
    model, shape, *_ = at_rest()
    rotations, _ = pose_from_ellipbody(model, mean_body(local), shape)
    straight, _ = pose_from_ellipbody(model, mean_body(REST), shape)

    def angle(turn: torch.Tensor) -> float:
        return float(torch.rad2deg(torch.arccos((turn.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2)))

    half = np.rad2deg(1.2) / 2
    for name in ("lowerarm02.L", "wrist.L"):  # each against the joint before it
        joint = model.joint_names.index(name)
        assert angle(straight[:, joint].mT @ rotations[:, joint]) == pytest.approx(half, abs=5), name


def test_pose_from_ellipbody_takes_degenerate_poses():
    """No NaN at rotations of 0 and pi."""
    axes = torch.eye(3)[torch.arange(3).repeat(NUM_PARTS)[:NUM_PARTS]]
    local = torch.stack([REST[0], rotation_from_axis_angle(torch.pi * axes)])
    rotations, translation = pose_from_ellipbody(anny(), mean_body(local))
    assert torch.isfinite(rotations).all()
    assert torch.isfinite(translation).all()
    torch.testing.assert_close(rotations @ rotations.mT, torch.eye(3).expand_as(rotations), atol=1e-4, rtol=0)


# Rendering


def project(vertices: torch.Tensor, size: int) -> torch.Tensor:
    """Seen from the front, weak perspective."""
    scale = size / 2.2
    return torch.stack(
        [vertices[..., 0] * scale + size / 2, size / 2 - vertices[..., 1] * scale, 5 - vertices[..., 2]], dim=-1
    )


def test_parts_look_like_those_of_ellipbody(device):
    model, shape = anny(device), anny_shape(NEUTRAL).to(device)
    local = REST.to(device, copy=True)
    for name, vector in {
        "left_upper_arm": (0.0, 0, -1.0),
        "right_upper_arm": (0.0, 0, -1.0),
        "head": (0.0, 0.4, 0),
    }.items():
        local[:, PART_NAMES.index(name)] = rotation_from_axis_angle(torch.tensor(vector, device=device))
    posed = mean_body(local)
    detailed = model.pose(shape, *pose_from_ellipbody(model, posed, shape))
    mine = draw_on_screen(project(detailed.vertices, 128), detailed_mesh(model), (128, 128)).labels.cpu()
    other = draw_on_screen(project(posed.vertices(2), 128), ellipbody_mesh(2, device=device), (128, 128)).labels.cpu()
    both = (mine > 0) & (other > 0)
    assert both.sum() > 0.75 * ((mine > 0) | (other > 0)).sum()
    groups = torch.from_numpy(label_set("body14").part_groups)
    assert (groups[mine.long()] == groups[other.long()])[both].float().mean() > 0.85
    assert (mine == other)[both].float().mean() > 0.75


def test_label_loss_moves_a_detailed_model(device):
    """PartDR + SMPL: the target is the body itself, shifted, wider and with its arms elsewhere."""
    model, *start = at_rest(device)
    mesh = detailed_mesh(model)
    inputs = [value.clone().requires_grad_() for value in start]
    with torch.no_grad():
        bigger = anny_shape(torch.tensor([[0.5, 0.5, 0.5, 0.9, 0.8, 0.5]])).to(device)
        moved = model.pose(bigger, inputs[1], inputs[2] + torch.tensor([0.05, 0.02, 0.0], device=device))
        target = draw_on_screen(project(moved.vertices, 96), mesh, (96, 96)).labels
    loss, _ = loss_on_screen(project(model.pose(*inputs).vertices, 96), mesh, target)
    loss.sum().backward()
    for tensor in inputs:
        assert torch.isfinite(tensor.grad).all()
        assert tensor.grad.abs().max() > 0
    assert inputs[2].grad[0, 0] < 0, "the target lies to the right"
    arm = model.joint_names.index("upperarm01.L")
    assert inputs[1].grad[0, arm].abs().max() > 0
    maps = draw_on_screen(project(model.pose(*inputs).vertices, 96), mesh, (96, 96), num_maps=NUM_PARTS).maps
    assert maps.shape == (1, NUM_PARTS, 96, 96)


# Files


@pytest.mark.parametrize("num_joints", [24, 52, 55])
@pytest.mark.parametrize("suffix", [".npz", ".safetensors"])
def test_load_model_reads_files(num_joints, suffix, tmp_path):
    arrays, path = smpl_arrays(num_joints), tmp_path / f"model{suffix}"
    if suffix == ".npz":
        np.savez(path, **arrays, other=np.array([{}], dtype=object))  # official files hold such, unneeded
    else:
        numpy_files = pytest.importorskip("safetensors.numpy")
        numpy_files.save_file(
            arrays | {"f": arrays["f"].astype(np.int64), "kintree_table": arrays["kintree_table"].astype(np.int64)},
            path,
        )
    model = load_model(path, num_shapes=4, dtype=torch.float64)
    assert model.name == {24: "smpl", 52: "smplh", 55: "smplx"}[num_joints]
    assert (model.num_joints, model.num_shapes, model.num_vertices) == (num_joints, 4, 4 * num_joints)
    assert model.parents == (-1, *arrays["kintree_table"][0, 1:])
    np.testing.assert_allclose(model.rest_joints, arrays["J_regressor"] @ arrays["v_template"], atol=1e-12)
    # As smplx computes it: pose_feature @ posedirs.
    feature = (turns(1, num_joints, 0.4)[0, 1:] - torch.eye(3)).reshape(1, -1).numpy()
    wanted = feature @ arrays["posedirs"].reshape(-1, arrays["posedirs"].shape[-1]).T
    np.testing.assert_allclose(feature @ model.pose_directions.numpy(), wanted, atol=1e-12)
    assert model.bone_of_part["left_hip"] == model.bone_of_part["right_hip"] == "pelvis"
    assert model.bone_of_part["left_forearm"] == "left_elbow"
    assert model.bone_of_part["right_foot"] == "right_ankle"
    missing = {"left_hip", "right_hip"} - {PART_NAMES[k - 1] for k in model.face_parts.unique()}
    assert len(set(PART_NAMES) - {PART_NAMES[k - 1] for k in model.face_parts.unique()} - missing) == 0


def test_default_number_of_shapes(tmp_path):
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
    arrays |= {"weights": np.eye(96, 23) + np.eye(96, 23, -23), "J_regressor": arrays["J_regressor"][:23]}
    arrays["weights"] = np.full((96, 23), 1 / 23)
    arrays |= {"kintree_table": arrays["kintree_table"][:, :23], "posedirs": arrays["posedirs"][..., : 9 * 22]}
    with pytest.raises(ValueError, match=r"23 joints; expected 24 \(smpl\), 52 \(smplh\), 55 \(smplx\)"):
        load_model(save_npz(tmp_path / "model.npz", **arrays))


def test_files_that_are_no_models(tmp_path, smpl_file):
    with pytest.raises(ValueError, match=r"none\.npz: No such file"):
        load_model(tmp_path / "none.npz")
    with pytest.raises(ValueError, match=r"pickles can run code.*convert_smpl_pickle"):
        load_model(tmp_path / "model.pkl")
    with pytest.raises(ValueError, match=r"model\.obj: expected 'anny', or"):
        load_model(tmp_path / "model.obj")
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


@pytest.mark.parametrize("compression", [zipfile.ZIP_BZIP2, zipfile.ZIP_DEFLATED])
def test_lying_headers_make_no_room(compression, tmp_path):
    """An array that says it is huge is refused before NumPy makes room for it."""
    header = BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**9, 3)})
    with zipfile.ZipFile(tmp_path / "model.npz", "w", compression) as archive:
        archive.writestr("v_template.npy", header.getvalue() + bytes(1000))
    with pytest.raises(ValueError, match=r"v_template: (says that its shape is|compressed in a way)"):
        load_model(tmp_path / "model.npz")


def test_other_arrays_are_not_read(tmp_path):
    np.savez(tmp_path / "model.npz", **smpl_arrays())
    with zipfile.ZipFile(tmp_path / "model.npz", "a") as archive:
        archive.writestr("other.npy", b"rubbish")
    assert load_model(tmp_path / "model.npz").name == "smpl"


# The converter of legacy pickles

_spec = importlib.util.spec_from_file_location("convert_smpl_pickle", ROOT / "scripts" / "convert_smpl_pickle.py")
converter = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(converter)


class LegacyPickler(pickle._Pickler):
    """Writes as Python 2 did, protocol 2: bytes are strings, and a class is whatever it calls itself."""

    dispatch = pickle._Pickler.dispatch.copy()

    def save_bytes(self, value: bytes) -> None:
        self.write(pickle.BINSTRING + struct.pack("<i", len(value)) + value)
        self.memoize(value)

    dispatch[bytes] = save_bytes

    def save_global(self, value: type, name: str | None = None) -> None:
        self.write(pickle.GLOBAL + f"{value.__module__}\n{name or value.__name__}\n".encode())
        self.memoize(value)


def chumpy_object(kind: str, state: dict[str, object]) -> object:
    """An object of a class that calls itself one of chumpy's."""
    module, _, name = kind.rpartition(".")
    value = type(name, (), {"__module__": module})()
    value.__dict__.update(state)
    return value


def legacy_file(path: Path, **changes: object) -> Path:
    sparse = pytest.importorskip("scipy.sparse")
    arrays = smpl_arrays()
    all_shapes = np.concatenate([arrays["shapedirs"], np.ones((96, 3, 5))], axis=-1)
    chosen = np.arange(all_shapes.size).reshape(all_shapes.shape)[..., :12]
    source = chumpy_object("chumpy.ch.Ch", {"x": all_shapes, "_dirty_vars": set(), "_status": "new"})
    content = {
        **arrays,
        "v_template": chumpy_object("chumpy.ch.Ch", {"x": arrays["v_template"]}),
        "shapedirs": chumpy_object(
            "chumpy.reordering.Select",
            {"a": source, "idxs": chosen.ravel(), "preferred_shape": chosen.shape},
        ),
        "posedirs": np.asfortranarray(arrays["posedirs"]),
        "J_regressor": sparse.csc_matrix(arrays["J_regressor"]),
        "weights": arrays["weights"].astype(">f8"),
        "J": chumpy_object("chumpy.ch.MatVecMult", {"mtx": sparse.csr_matrix(np.eye(3))}),
        "bs_type": "lrotmin",
        **changes,
    }
    buffer = BytesIO()
    LegacyPickler(buffer, protocol=2).dump(content)
    path.write_bytes(buffer.getvalue())
    return path


def test_legacy_pickles_are_converted(tmp_path):
    path = legacy_file(tmp_path / "model.pkl")
    arrays = converter.read_pickle(path)
    assert sorted(arrays) == sorted(ARRAYS)
    for name, wanted in smpl_arrays().items():
        np.testing.assert_array_equal(arrays[name], wanted, err_msg=name)
    done = subprocess.run(
        [sys.executable, ROOT / "scripts" / "convert_smpl_pickle.py", path, tmp_path / "model.npz"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "smpl, 96 vertices" in done.stdout
    assert load_model(tmp_path / "model.npz").num_joints == 24
    assert sorted(file.name for file in tmp_path.iterdir()) == ["model.npz", "model.pkl"]


class Foreign:
    def __init__(self, function: object, *arguments: object) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> tuple[object, ...]:
        return self.call


def test_foreign_objects_are_refused_and_not_run(tmp_path):
    marker = tmp_path / "ran"
    for foreign in (
        Foreign(Path.touch, marker),
        Foreign(eval, f"open({str(marker)!r}, 'w')"),
        Foreign(getattr, "", "join"),
    ):
        path = legacy_file(tmp_path / "model.pkl", v_template=foreign)
        with pytest.raises(ValueError, match="which no SMPL file needs"):
            converter.read_pickle(path)
    assert not marker.exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "Ran out of input"),
        (b"not a pickle", "expected a pickle"),
        (pickle.dumps([1, 2]), "list; expected a dictionary"),
        (pickle.dumps({"f": "text"}), "f: str; expected an array"),
        (pickle.dumps({"f": np.array([object])}), "(f: an array of 'O8'|type, which no SMPL file needs)"),
    ],
)
def test_pickles_that_are_no_models(content, message, tmp_path):
    path = tmp_path / "model.pkl"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message):
        converter.read_pickle(path)


def test_expressions_are_refused(tmp_path):
    value = chumpy_object("chumpy.ch.MatVecMult", {"mtx": 1})
    with pytest.raises(ValueError, match=r"weights: an expression of chumpy\.ch\.MatVecMult"):
        converter.read_pickle(legacy_file(tmp_path / "model.pkl", weights=value))


def test_a_failed_conversion_leaves_nothing(tmp_path):
    path = legacy_file(tmp_path / "model.pkl", f=np.full((4, 3), 1000))
    old = tmp_path / "model.npz"
    old.write_bytes(b"old")
    done = subprocess.run(
        [sys.executable, ROOT / "scripts" / "convert_smpl_pickle.py", path, old], capture_output=True, text=True
    )
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert "Traceback" not in done.stderr
    assert old.read_bytes() == b"old"
    missing = tmp_path / "none" / "model.npz"
    done = subprocess.run(
        [sys.executable, ROOT / "scripts" / "convert_smpl_pickle.py", legacy_file(path), missing],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
