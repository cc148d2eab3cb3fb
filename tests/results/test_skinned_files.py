"""Files of detailed bodies: a GLB's skin, OBJ, PLY and BVH hold the posed mesh."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import helpers.bodies
import numpy as np
import pytest
import torch
import trimesh
from helpers.skins import moving, posed_vertices, read_glb, standing
from scipy.spatial.transform import Rotation

from warp_partdr.models.registration import Registered
from warp_partdr.models.suit import in_suit, suit_of
from warp_partdr.results.binding import to_quaternions
from warp_partdr.results.ellipbody_files import GLTF_FROM_CAMERA
from warp_partdr.results.palette import PART_COLOURS
from warp_partdr.results.skinned_files import Poses, bvh, glb, save_detailed

registered = helpers.bodies.registered  # a fixture


@pytest.mark.parametrize("bare", [True, False])
def test_glb_s_skin_gives_the_posed_mesh(registered: Registered, bare: bool) -> None:
    data = glb(registered, bare=bare)
    document, arrays = read_glb(data)
    # trimesh follows the nodes, and applies no skin.
    scene = trimesh.load(io.BytesIO(data), file_type="glb")
    skin = document["skins"][0]
    names = [document["nodes"][joint]["name"] for joint in skin["joints"]]
    world = np.stack([scene.graph.get(name)[0] for name in names])
    joints = standing(registered, registered.detailed.joints[0])
    assert np.abs(world[:, :3, 3] - joints).max() < 1e-4
    weights = arrays[document["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"]]
    assert np.abs(weights.sum(1) - 1).max() < 1e-5
    posed = posed_vertices(document, arrays, 0)
    shown = registered if bare else in_suit(registered)
    assert np.abs(posed - standing(registered, shown.detailed.vertices[0])).max() < 1e-4
    assert next(iter(scene.geometry.values())).faces.shape == (27420, 3)


@pytest.mark.parametrize("bare", [True, False])
def test_obj_and_ply_read_back(registered: Registered, tmp_path: Path, bare: bool) -> None:
    save_detailed(registered, tmp_path, bare=bare)
    assert {path.name for path in tmp_path.iterdir()} == {f"detailed.{kind}" for kind in ("glb", "obj", "ply", "bvh")}
    shown = registered if bare else in_suit(registered)
    expected = standing(registered, shown.detailed.vertices[0])
    for kind in ("obj", "ply"):
        mesh = trimesh.load(tmp_path / f"detailed.{kind}", process=False)
        assert mesh.faces.shape == (27420, 3)
        assert np.abs(mesh.triangles - expected[registered.model.faces.cpu().numpy()]).max() < 1e-4
    parts = registered.model.face_parts.cpu().numpy()
    np.testing.assert_array_equal(mesh.visual.face_colors[:, :3], PART_COLOURS[parts])


def test_a_glb_is_matt_and_neutral_and_the_suit_is_darker_than_skin(registered: Registered) -> None:
    document, arrays = read_glb(glb(registered))
    (material,) = document["materials"]
    surface = material["pbrMetallicRoughness"]
    assert surface["metallicFactor"] == 0
    assert 0.6 < surface["roughnessFactor"] <= 1
    assert np.ptp(surface["baseColorFactor"][:3]) < 0.15
    tones = arrays[document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    worn = suit_of(registered.model).cloth > 0
    assert (tones[~worn.any(1)] == 1).all()
    assert 0.9 > tones[worn[:, 0]].min() > tones[worn[:, 1]].max() > 0.3
    bare, _ = read_glb(glb(registered, bare=True))
    assert "COLOR_0" not in bare["meshes"][0]["primitives"][0]["attributes"]


def test_bvh_has_the_skeleton_where_it_is(registered: Registered) -> None:
    words = iter(bvh(registered).split())
    names, offsets, parents, channels, stack = [], [], [], [], []
    for word in words:
        if word in ("ROOT", "JOINT"):
            parents.append(stack[-1] if stack else -1)
            names.append(next(words))
        elif word == "End":
            next(words)
            names.append("")
            parents.append(stack[-1])
        elif word == "{":
            stack.append(len(names) - 1)
        elif word == "}":
            stack.pop()
        elif word == "OFFSET":
            offsets.append([float(next(words)) for _ in range(3)])
        elif word == "CHANNELS":
            channels.append((len(names) - 1, [next(words) for _ in range(int(next(words)))]))
        elif word == "Time:":
            next(words)
            break
    values = iter(map(float, words))
    world: dict[int, np.ndarray] = {}
    for joint, given in channels:
        local = np.eye(4)
        local[:3, 3] = offsets[joint]
        for channel in given:
            value = next(values)
            if channel.endswith("position"):
                local["XYZ".index(channel[0]), 3] += value
            else:
                local[:3, :3] = local[:3, :3] @ Rotation.from_euler(channel[0].lower(), value, degrees=True).as_matrix()
        world[joint] = (world[parents[joint]] if parents[joint] >= 0 else np.eye(4)) @ local
    assert next(values, None) is None
    joints = standing(registered, registered.detailed.joints[0])
    for joint, matrix in world.items():
        expected = 100 * joints[registered.model.joint_names.index(names[joint])]
        assert np.abs(matrix[:3, 3] - expected).max() < 0.01


def test_a_motion_s_glb_has_the_poses_over_time(registered: Registered) -> None:
    poses = moving(registered)
    document, arrays = read_glb(glb(registered, poses))
    (animation,) = document["animations"]
    tracks = {
        (channel["target"]["node"], channel["target"]["path"]): animation["samplers"][channel["sampler"]]
        for channel in animation["channels"]
    }
    assert tracks.keys() == {(0, "translation"), (5, "rotation")}  # who stands still has no track
    for sampler in tracks.values():
        np.testing.assert_allclose(arrays[sampler["input"]][:, 0], np.arange(5) / 10)
    times = document["accessors"][animation["samplers"][0]["input"]]
    assert (times["min"], times["max"]) == ([0.0], pytest.approx([0.4]))
    turns = arrays[tracks[5, "rotation"]["output"]]
    expected = poses.rotations[:, 5].double().cpu().numpy()
    np.testing.assert_allclose(Rotation.from_quat(turns).as_matrix(), expected, atol=1e-5)
    assert ((turns[1:] * turns[:-1]).sum(1) > 0).all()  # or viewers would turn the long way
    moved = arrays[tracks[0, "translation"]["output"]]
    np.testing.assert_allclose(moved, poses.translation.cpu().numpy(), atol=1e-6)
    still, _ = read_glb(glb(registered))
    assert "animations" not in still


def test_a_motion_s_bvh_has_a_row_a_pose_and_no_jumps(registered: Registered) -> None:
    poses = moving(registered)
    hierarchy, motion = bvh(registered, poses).split("MOTION\n")
    first, second, *rows = motion.splitlines()
    assert (first, second) == ("Frames: 5", "Frame Time: 0.1000000")
    numbers = np.array([[float(each) for each in row.split()] for row in rows])
    assert numbers.shape == (5, hierarchy.count("CHANNELS") * 3 + 3)
    alone = np.array([float(each) for each in bvh(registered).splitlines()[-1].split()])
    np.testing.assert_allclose(numbers[0], alone, atol=1e-5)
    np.testing.assert_allclose(np.diff(numbers[:, 0]), 10, atol=1e-3)  # centimetres
    assert np.abs(np.diff(numbers, axis=0)).max() < 181


def uneven(registered: Registered) -> Poses:
    """The motion with the third pose half a second later than it would come evenly, ten a second."""
    return replace(moving(registered), times=np.array([0.0, 0.1, 0.7, 0.8, 0.9]))


def test_a_motion_s_glb_has_the_poses_at_their_times(registered: Registered) -> None:
    document, arrays = read_glb(glb(registered, uneven(registered)))
    for sampler in document["animations"][0]["samplers"]:
        np.testing.assert_allclose(arrays[sampler["input"]][:, 0], [0.0, 0.1, 0.7, 0.8, 0.9])


def test_a_motion_that_is_made_even_passes_through_its_poses(registered: Registered) -> None:
    poses = moving(registered)
    assert poses.evenly() is poses
    late = uneven(registered)
    even = late.evenly()
    np.testing.assert_allclose(even.times, np.arange(10) / 10)
    assert (even.rate, even.lowest) == (10.0, late.lowest)
    for place, pose in ((0, 0), (1, 1), (7, 2), (8, 3), (9, 4)):
        torch.testing.assert_close(even.rotations[place], late.rotations[pose], atol=1e-5, rtol=0)
        torch.testing.assert_close(even.translation[place], late.translation[pose], atol=1e-5, rtol=0)
    # Between 0.1 and 0.7 s the joint turns by 90 degrees and the root goes 0.1 m, steadily.
    turned = (even.rotations[1, 5].mT @ even.rotations[1:8, 5]).cpu().numpy()
    angles = np.linalg.norm(Rotation.from_matrix(turned).as_rotvec(degrees=True), axis=1)
    np.testing.assert_allclose(angles, 15 * np.arange(7), atol=0.05)
    gone = (even.translation[1:8] - even.translation[1]).norm(dim=1).cpu()
    np.testing.assert_allclose(gone, np.arange(7) / 60, atol=1e-5)
    between = replace(poses, times=np.array([2.0, 2.06, 2.13, 2.31, 2.4])).evenly()  # ends with the film's end
    np.testing.assert_allclose(between.times, 2 + np.arange(5) / 10)
    torch.testing.assert_close(between.translation[-1], poses.translation[-1])


def test_a_motion_with_a_day_between_two_poses_is_no_file_of_a_day(registered: Registered) -> None:
    poses = replace(moving(registered), times=np.array([0.0, 0.1, 0.2, 0.3, 86_400.0]))
    even = poses.evenly()
    assert len(even.times) == 65
    assert even.rate == pytest.approx(64 / 86_400)


def test_a_motion_s_bvh_is_at_one_rate(registered: Registered) -> None:
    rows = bvh(registered, uneven(registered)).split("MOTION\n")[1].splitlines()
    assert rows[:2] == ["Frames: 10", "Frame Time: 0.1000000"]
    numbers = np.array([[float(each) for each in row.split()] for row in rows[2:]])
    np.testing.assert_allclose(np.diff(numbers[1:8, 0]), 10 / 6, atol=1e-3)  # centimetres
    third = [float(each) for each in bvh(registered, moving(registered)).splitlines()[-3].split()]
    np.testing.assert_allclose(numbers[7], third, atol=1e-3)


def test_quaternions_of_whole_turns_never_leap() -> None:
    angles = np.linspace(0, 13, 60)[:, None, None] * np.array([1.0, -0.5])[:, None]
    turns = Rotation.from_rotvec((angles * [0.6, 0.0, 0.8]).reshape(-1, 3))
    found = to_quaternions(turns.as_matrix().reshape(60, 2, 3, 3))
    assert np.abs(np.diff(found, axis=0)).max() < 0.2
    np.testing.assert_allclose(Rotation.from_quat(found.reshape(-1, 4)).as_matrix(), turns.as_matrix(), atol=1e-9)


def test_bvh_s_angles_hold_where_y_is_at_a_right_angle(registered: Registered) -> None:
    """There two of the angles turn about one axis."""
    turn = Rotation.from_euler("ZYX", [20, 90, 50], degrees=True).as_matrix()
    poses = moving(registered)
    rotations = poses.rotations.clone()
    rotations[:, 0] = torch.from_numpy(GLTF_FROM_CAMERA.T @ turn).to(rotations)
    rows = bvh(registered, replace(poses, rotations=rotations)).split("MOTION\n")[1].splitlines()[2:]
    for row in rows:
        angles = [float(each) for each in row.split()[3:6]]
        np.testing.assert_allclose(Rotation.from_euler("ZYX", angles, degrees=True).as_matrix(), turn, atol=1e-3)
