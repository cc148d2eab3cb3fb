"""Detailed models in the poses of EllipBody."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers.bodies import random_turns
from helpers.files import save_npz, smpl_arrays
from helpers.pictures import draw_on_screen, loss_on_screen

from warp_partdr.body.labels import label_set
from warp_partdr.body.landmarks import LANDMARKS, landmark_positions
from warp_partdr.body.rotations import rotation_from_axis_angle, rotation_to_axis_angle
from warp_partdr.body.template import JOINT_NAMES, NUM_PARTS, PARENTS, PART_NAMES
from warp_partdr.lab.synthetic.poses import mean_body
from warp_partdr.models.anny import anny, anny_shape
from warp_partdr.models.load import load_model
from warp_partdr.models.model import DetailedModel, detailed_mesh
from warp_partdr.models.pose import end_joints, pose_from_ellipbody
from warp_partdr.render.part_mesh import ellipbody_mesh

LIMBS = ("upper_leg", "lower_leg", "upper_arm", "forearm", "hand")
NEUTRAL = torch.full((1, 6), 0.5)  # the adult whom EllipBody's mean body was measured on


REST = torch.eye(3).expand(1, NUM_PARTS, 3, 3)


def at_rest(device: str = "cpu") -> tuple[DetailedModel, torch.Tensor, torch.Tensor, torch.Tensor]:
    """The neutral adult in EllipBody's rest pose."""
    model, shape = anny(device), anny_shape(NEUTRAL).to(device)
    return model, shape, *pose_from_ellipbody(model, mean_body(REST.to(device)), shape)


def test_landmarks_are_those_of_ellipbody():
    """EllipBody was measured on this very person."""
    model, shape, rotations, translation = at_rest()
    posed = mean_body(REST)
    names = [name for name in LANDMARKS if name in model.landmark_names]
    assert {name for name in LANDMARKS if not name.startswith("coco_")} <= {*names}
    solids = (getattr(posed, name)[0].numpy() for name in ("centres", "axes", "semi_axes"))
    found = model.landmarks(model.pose(shape, rotations, translation), names)[0].numpy()
    errors = np.linalg.norm(found - landmark_positions(names, *solids), axis=1)
    # COCO's marks are means over people in all poses.
    most = {name: 0.030 if name.startswith("coco_") else 0.014 for name in names}
    assert {name: error for name, error in zip(names, errors, strict=True) if error > most[name]} == {}
    assert sum(name.startswith("coco_") for name in model.landmark_names) == 14


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


def test_the_middle_of_the_hips_is_ellipbodys():
    model, shape, rotations, translation = at_rest()
    hips = model.landmarks(model.pose(shape, rotations, translation), ["left_hip", "right_hip"]).mean(1)
    torch.testing.assert_close(hips, mean_body(REST).joints[:, 1:3].mean(1), rtol=0, atol=1e-5)


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
    posed = mean_body(random_turns(16, NUM_PARTS, 0.8).float(), random_turns(16, 1, 1.0)[:, 0].float())
    names = [name if name in model.landmark_names else "neck" for name in JOINT_NAMES]
    found = model.landmarks(model.pose(shape, *pose_from_ellipbody(model, posed, shape)), names)
    for part, name in enumerate(PART_NAMES):
        if name.endswith(LIMBS):
            assert angles(bones(found, part), bones(posed.joints, part)).max() < 1, name


def test_limbs_twist_as_ellipbody_twists():
    """A limb's joints turn from the rest pose exactly as its ellipsoid does."""
    model, shape, rest_rotations, translation = at_rest()
    rest = model.pose(shape, rest_rotations, translation)
    # Hips that stay with the pelvis, as theirs do.
    local = random_turns(16, NUM_PARTS, 0.8).float()
    local[:, :2] = torch.eye(3)
    posed = mean_body(local, random_turns(16, 1, 1.0)[:, 0].float())
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

    for name in ("lowerarm02.L", "wrist.L"):  # each against the joint before it
        joint = model.joint_names.index(name)
        twist = rotation_to_axis_angle(straight[:, joint].mT @ rotations[:, joint]).norm()
        assert float(twist) == pytest.approx(1.2 / 2, abs=np.radians(5)), name


def test_pose_from_ellipbody_takes_degenerate_poses():
    """Rotations of 0 and pi give no NaN."""
    axes = torch.eye(3)[torch.arange(3).repeat(NUM_PARTS)[:NUM_PARTS]]
    local = torch.stack([REST[0], rotation_from_axis_angle(torch.pi * axes)])
    rotations, translation = pose_from_ellipbody(anny(), mean_body(local))
    assert torch.isfinite(rotations).all()
    assert torch.isfinite(translation).all()
    torch.testing.assert_close(rotations @ rotations.mT, torch.eye(3).expand_as(rotations), atol=1e-4, rtol=0)


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


def test_a_trunk_bends_halfway_at_its_first_joint():
    local = REST.clone()
    local[:, PART_NAMES.index("abdomen")] = rotation_from_axis_angle(torch.tensor([0.8, 0.0, 0.0]))
    model, shape, *_ = at_rest()
    rotations, _ = pose_from_ellipbody(model, mean_body(local), shape)
    straight, _ = pose_from_ellipbody(model, mean_body(REST), shape)
    first = model.part_joints[PART_NAMES.index("abdomen")]
    second = end_joints(model)[PART_NAMES.index("abdomen")]
    assert first != second
    for joint in (first, second):
        bent = rotation_to_axis_angle(straight[:, joint].mT @ rotations[:, joint]).norm()
        assert float(bent) == pytest.approx(0.4, abs=np.radians(2)), model.joint_names[joint]
