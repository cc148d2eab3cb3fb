"""PartBench's people are the same every time, and their truth is true."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from warp_partdr.body.landmarks import CONVENTIONS
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.skeletons import MPJPE_JOINTS, Skeleton
from warp_partdr.body.template import PART_NAMES
from warp_partdr.cameras import Perspective
from warp_partdr.lab.synthetic.partbench_people import (
    COCO,
    NUM_PEOPLE,
    OTHER_FORMATS,
    Setting,
    draw_format,
    make_person,
    pose_kind,
)
from warp_partdr.lab.synthetic.people import cover_of, draw_anny
from warp_partdr.lab.synthetic.pose_recipes import POSES, TILTED_POSES, draw_pose
from warp_partdr.lab.synthetic.poses import clear_poses, mean_body


@pytest.mark.parametrize("index", [0, 1, 7])
def test_a_person_is_the_same_every_time_and_drawn_by_the_camera_with_sides_kept(index: int) -> None:
    person, threads = make_person(index), torch.get_num_threads()
    try:
        torch.set_num_threads(3 - min(threads, 2))  # 1 or 2, another number than before
        again = make_person.__wrapped__(index)
    finally:
        torch.set_num_threads(threads)
    np.testing.assert_array_equal(person.parts, again.parts)
    np.testing.assert_array_equal(person.marks, again.marks)
    labels, _ = draw_anny(torch.from_numpy(person.vertices)[None], person.camera, person.parts.shape)
    assert (labels[0].numpy() == person.parts).mean() > 0.985  # half-size pixels differ at edges
    height, width = person.parts.shape
    tested = 0
    for name, (u, v), hidden in zip(COCO.landmarks, person.keypoints(), person.hidden(), strict=True):
        side, _, joint = name.partition("_")
        if hidden or joint not in ("elbow", "knee") or not (0 <= u < width and 0 <= v < height):
            continue
        part = PART_NAMES[person.parts[int(v), int(u)] - 1]
        assert part.startswith(side), f"{name} on {part}"
        tested += 1
    assert tested


def test_any_first_people_have_all_kinds_of_poses() -> None:
    kinds = [pose_kind(index) for index in range(NUM_PEOPLE)]
    assert set(kinds[:40]) == {"prior", *POSES}
    assert abs(kinds.count("prior") / NUM_PEOPLE - 0.6) < 0.01
    counts = [kinds.count(kind) for kind in POSES]
    assert max(counts) - min(counts) <= 1


def test_poses_of_the_prior_keep_to_the_joint_limits() -> None:
    rng, prior = np.random.default_rng(0), PosePrior()
    for _ in range(3):
        pose = draw_pose("prior", rng)
        assert prior.joint_limits(torch.from_numpy(pose.rotations)[None]) < 0.021
        np.testing.assert_allclose(np.linalg.norm(pose.up), 1.0)


@pytest.mark.parametrize("kind", POSES)
def test_poses_put_together_keep_to_the_joint_limits_and_are_clear(kind: str) -> None:
    rng = np.random.default_rng(3)
    poses = [draw_pose(kind, rng) for _ in range(8)]
    rotations = torch.from_numpy(np.stack([pose.rotations for pose in poses])).float()
    assert PosePrior().joint_limits(rotations).max() < 1e-9
    assert clear_poses(rotations).all()
    np.testing.assert_allclose([np.linalg.norm(pose.up) for pose in poses], 1.0)
    again = draw_pose(kind, np.random.default_rng(3))
    np.testing.assert_array_equal(again.rotations, poses[0].rotations)
    assert not np.array_equal(poses[1].rotations, poses[0].rotations)


def _hands(kind: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Middles of left and right hands of a kind of pose, and of its heads, seen from the pelvis [m]."""
    rng = np.random.default_rng(4)
    rotations = torch.from_numpy(np.stack([draw_pose(kind, rng).rotations for _ in range(12)])).float()
    centres = mean_body(rotation_from_axis_angle(rotations)).centres
    return centres[:, [PART_NAMES.index(f"{side}_hand") for side in ("left", "right")]], centres[
        :, [PART_NAMES.index("head")]
    ]


def test_hands_of_poses_put_together_are_where_they_should_be() -> None:
    hips, _ = _hands("hands on hips")
    assert (hips[..., 0].abs() > 0.15).all()
    assert ((hips[..., 1] > -0.15) & (hips[..., 1] < 0.25) & (hips[..., 0].abs() < 0.32)).all()
    ear, heads = _hands("phone at ear")
    assert ((ear - heads).norm(dim=-1).amin(1) < 0.2).all()
    assert ((ear - heads).norm(dim=-1).amax(1) > 0.3).all()  # the other hand hangs
    clasped, _ = _hands("hands clasped")
    assert ((clasped[:, 0] - clasped[:, 1]).norm(dim=-1) < 0.16).all()
    assert (clasped[..., 2] > 0.1).all()
    behind, _ = _hands("hands behind back")
    assert (behind[..., 2] < -0.1).all()
    served, heads = _hands("serving")
    assert (served[..., 1].amax(1) > heads[:, 0, 1]).all()


@pytest.mark.parametrize(("setting", "least", "most"), [("near", 1.5, 3.0), ("far", 9.0, 40.0)])
def test_near_and_far_people_are_the_same_before_another_camera(setting: Setting, least: float, most: float) -> None:
    aside = []
    for index in range(4):
        person, usual = make_person(index, setting), make_person(index)
        assert isinstance(person.camera, Perspective)
        middle = person.vertices.mean(0)
        assert least <= middle[2] <= most
        aside.append(np.degrees(np.arctan2(np.abs(middle[:2]), middle[2])))
        same = person.joints - person.joints[0], usual.joints - usual.joints[0]
        np.testing.assert_allclose(*same, atol=1e-5)
    assert 9.0 < np.max(aside) < 25.0


def test_who_walks_away_shows_the_back_of_the_head() -> None:
    walking = [index for index in range(20) if pose_kind(index) == "walking away"]
    person = make_person(walking[0])
    assert person.hidden()[COCO.landmarks.index("nose")]
    left, right = (person.keypoints()[COCO.landmarks.index(f"{side}_hip"), 0] for side in ("left", "right"))
    assert left < right  # from behind, the person's left is the picture's


def test_keypoints_of_other_data_sets_lie_where_their_table_says() -> None:
    person, (h36m, shelf) = make_person(10), OTHER_FORMATS  # stands upright
    joints = person.camera.project(torch.from_numpy(person.joints)[None])[0, :, :2].numpy()

    def away(form: Skeleton, name: str) -> np.ndarray:
        """Way from the body's own joint to the keypoint, to the picture's right and down [mm]."""
        keypoint = person.keypoints(form)[form.landmarks.index(name)]
        return 1000 * (keypoint - joints[MPJPE_JOINTS.index(name)]) * person.stature / person.height

    for form, convention, name in (
        (h36m, "h36m", "head_top"),
        (h36m, "h36m", "neck"),
        (shelf, "shelf", "neck"),
        (shelf, "shelf", "left_hip"),
    ):
        _, (_, up, _) = CONVENTIONS[convention][name.removeprefix("left_")]
        np.testing.assert_allclose(-away(form, name)[1], up, atol=20.0)
    for form in OTHER_FORMATS:
        np.testing.assert_allclose(away(form, "left_knee"), 0.0, atol=0.1)  # which stands in no table
    assert 5.0 < np.linalg.norm(away(COCO, "left_knee")) < 30.0


def test_people_have_formats_of_their_own_with_the_chance_of_a_level() -> None:
    drawn = [draw_format(index, 0.4) for index in range(NUM_PEOPLE)]
    assert drawn == [draw_format(index, 0.4) for index in range(NUM_PEOPLE)]
    shares = [drawn.count(form) / NUM_PEOPLE for form in (COCO, *OTHER_FORMATS)]
    np.testing.assert_allclose(shares, [0.6, 0.2, 0.2], atol=0.08)
    assert all(draw_format(index, 0.0) is COCO for index in range(20))


def test_the_middle_of_the_hips_is_no_more_hidden_than_the_hips() -> None:
    middle, left = cover_of(("mid_hip", "left_hip"))
    assert middle == left > 0.1


def test_partbench_keeps_its_people() -> None:
    # Of the release that introduced PartBench 3: the check of poses that training shares must not change its people.
    np.testing.assert_allclose(make_person(7).joints.sum(0), [3.9101, -3.9391, 41.9159], atol=2e-3)


def test_people_are_before_lenses_as_phones_and_cameras_have_them() -> None:
    people = [make_person(index) for index in range(16, 40)]
    real = [person for person in people if isinstance(person.camera, Perspective)]
    assert len(real) >= 20
    lenses, distances, places, cut = [], [], [], 0
    for person in real:
        height, width = person.parts.shape
        focal, centre = person.camera.intrinsics[0, 0].item(), person.camera.intrinsics[0, 2:]
        lenses.append(focal / max(height, width))
        distances.append(person.vertices[:, 2].mean())
        assert centre.tolist() == [width / 2, height / 2]
        assert max(height, width) <= 1024
        assert min(height, width) / max(height, width) == pytest.approx(0.75, abs=0.01)
        rows, columns = np.nonzero(person.parts)
        assert len(rows) > 500
        places.append((columns.mean() / width, rows.mean() / height))
        cut += min(rows.min(), columns.min()) == 0 or rows.max() == height - 1 or columns.max() == width - 1
    assert 0.6 < min(lenses) < max(lenses) < 1.65
    assert np.mean((np.array(lenses) > 0.7) & (np.array(lenses) < 1.2)) > 0.7
    assert 1.4 < min(distances) < 2.5 < 7.0 < max(distances) < 11.0
    assert (np.std(places, axis=0) > 0.1).all()  # not in the middle always
    assert 1 <= cut <= 8


def test_tilted_people_lie_recline_and_sit_before_askew_cameras():
    people = [make_person(index, "tilted") for index in range(16)]
    assert {person.kind for person in people} == set(TILTED_POSES)
    hips, shoulders = (
        [MPJPE_JOINTS.index(f"{side}_{name}") for side in ("left", "right")] for name in ("hip", "shoulder")
    )
    level = []
    for person in people:
        trunk = person.joints[shoulders].mean(0) - person.joints[hips].mean(0)
        level.append(abs(trunk[1]) < np.linalg.norm(trunk) / 2)  # 30 degrees to the picture's rows
    lying = [flat for flat, person in zip(level, people, strict=True) if person.kind == "lying"]
    assert np.mean(lying) > np.mean(level)
    assert 0.15 < np.mean(level) < 0.7
    usual = make_person(0)
    assert people[0].height != usual.height
    assert (pose_kind(5, "tilted"), pose_kind(5)) == ("lying", "prior")
