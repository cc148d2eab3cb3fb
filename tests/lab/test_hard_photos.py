"""Photos of hard situations: their people, what they hide, and how bodies are measured on them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from warp_partdr.body.skeletons import MPJPE_JOINTS, skeleton
from warp_partdr.errors import InputError
from warp_partdr.lab.measurements.hard_cases import (
    HardCase,
    describe_cases,
    hard_cases,
    measure_hard_cases,
    read_cases,
    save_cases,
)
from warp_partdr.lab.photo_truth import seen_errors
from warp_partdr.lab.synthetic.hard_photos import KINDS, make_hard_photo
from warp_partdr.lab.synthetic.partbench_people import PersonRequest, make_person
from warp_partdr.models.anny import anny
from warp_partdr.models.measuring import statures

COCO = skeleton("coco17").landmarks
PEOPLE = {"stranger": 2, "crowd": 4, "child": 2, "overlap": 2}


@pytest.mark.parametrize("kind", KINDS)
def test_photos_of_each_kind_are_the_same_each_time_and_show_their_people(kind: str) -> None:
    photo, again = make_hard_photo(70_000, kind), make_hard_photo(70_000, kind)
    np.testing.assert_array_equal(photo.pixels, again.pixels)
    assert photo.kind == kind
    assert len(photo.people) == PEOPLE.get(kind, 1)
    height, width = photo.pixels.shape[:2]
    for person in photo.people:
        inside = ((person.keypoints >= 0) & (person.keypoints <= [width, height])).all(axis=1)
        assert not (person.seen & ~inside).any()
        assert person.joints[:, 2].min() > 0
    assert photo.people[0].seen.any()


def test_the_index_decides_the_kind_if_none_is_given() -> None:
    kinds = {make_hard_photo(index).kind for index in range(4)}
    assert len(kinds) > 1
    assert kinds <= set(KINDS)


def test_half_bodies_show_no_knees_but_shoulders() -> None:
    for index in range(70_000, 70_003):
        (person,) = make_hard_photo(index, "half body").people
        seen = dict(zip(COCO, person.seen.tolist(), strict=True))
        height = make_hard_photo(index, "half body").pixels.shape[0]
        below = [person.keypoints[COCO.index(f"{side}_knee"), 1] > height for side in ("left", "right")]
        assert all(below)
        assert seen["left_shoulder"] or seen["right_shoulder"]


def test_what_a_rider_sits_on_hides_the_far_ankle_or_knee_more_often_than_the_near_one() -> None:
    near, far = 0, 0
    for index in range(70_000, 70_004):
        photo = make_hard_photo(index, "rider")
        (person,) = photo.people
        depth = {name: person.joints[MPJPE_JOINTS.index(name), 2] for name in ("left_ankle", "right_ankle")}
        sides = ("left", "right") if depth["left_ankle"] < depth["right_ankle"] else ("right", "left")
        near += sum(person.seen[COCO.index(f"{sides[0]}_{name}")] for name in ("knee", "ankle"))
        far += sum(person.seen[COCO.index(f"{sides[1]}_{name}")] for name in ("knee", "ankle"))
    assert far < near


def test_a_child_beside_an_adult_has_the_size_that_its_stature_says() -> None:
    for index in (70_000, 70_001, 70_003):
        adult, child = make_hard_photo(index, "child").people
        assert child.stature < 1.5 < adult.stature
        assert child.height / child.stature == pytest.approx(adult.height / adult.stature, rel=0.01)


def test_a_request_changes_age_pose_distance_and_clothes_alone() -> None:
    usual = make_person(70_001)
    child = make_person(70_001, request=PersonRequest(age=(0.0, 0.06)))
    assert child.stature < 1.5 < usual.stature
    assert float(statures(anny(), child.shape)) == pytest.approx(child.stature)
    near = make_person(70_001, request=PersonRequest(distance=(0.8, 1.0)))
    assert 0.3 < near.vertices[:, 2].mean() < 1.3
    skirt = make_person(70_001, request=PersonRequest(tube=True))
    np.testing.assert_array_equal(skirt.vertices, usual.vertices)
    assert (skirt.parts > 0).sum() > (usual.parts > 0).sum()
    assert len(skirt.shown[0]) > len(usual.shown[0]) == len(usual.vertices)
    assert make_person(70_001, request=PersonRequest(pose="riding")).kind == "riding"


def test_errors_are_of_seen_joints_after_a_move_for_a_person_of_one_size() -> None:
    (person,) = make_hard_photo(70_001, "plain").people
    person = replace(person, seen=np.ones(len(COCO), dtype=bool), stature=1.7)
    depth, across, limbs = seen_errors(person.joints + np.array([0.3, -0.2, 5.0]), person)
    assert max(depth, across, limbs.max()) == pytest.approx(0, abs=1e-6)
    wrong = person.joints.copy()
    wrong[MPJPE_JOINTS.index("left_wrist"), 2] += 0.6
    depth, across, limbs = seen_errors(wrong, person)
    assert depth == pytest.approx(0.6 / 12 * (1 + 11 / 12 - 1 / 12 * 11 / 11), rel=0.2)
    assert across == pytest.approx(0, abs=1e-6)
    assert limbs.argmax() == 1  # the left arm
    halved, _, _ = seen_errors(wrong, replace(person, stature=3.4))
    assert halved == pytest.approx(depth / 2)
    hidden = person.seen.copy()
    hidden[COCO.index("left_wrist")] = False
    assert seen_errors(wrong, replace(person, seen=hidden))[0] == pytest.approx(0, abs=1e-6)


def test_cases_of_a_photo_name_who_is_found(tmp_path: Path) -> None:
    cases = list(hard_cases(70_001, "half body", "cpu"))
    (case,) = cases
    assert case.found
    assert 0 < case.pa_mpjpe < 0.2
    assert 0.7 < case.stature < 1.3
    assert case.exchanged == 0
    save_cases(tmp_path / "cases.npz", [*cases, HardCase(3, "crowd", 1)])
    again, missed = read_cases(tmp_path / "cases.npz")
    assert again == case
    assert not missed.found


def test_a_table_has_a_row_for_each_kind_with_shares_of_right_wrong_and_warned() -> None:
    errors = [0.05, 0.05, 0.3, 0.15]
    found = [
        HardCase(index, "rider", 0, 0.1 if error == 0.3 else 0.9, error, 0.02, 0.06, 1.02, 1.1, float(error == 0.3))
        for index, error in enumerate(errors)
    ]
    table = describe_cases([*found, HardCase(9, "rider", 0), HardCase(9, "crowd", 0)])
    rider, crowd = (dict(zip(table.columns, row, strict=True)) for row in table.rows)
    assert (rider["people"], rider["found [%]"]) == (5, 80.0)
    assert (rider["right [%]"], rider["wrong [%]"], rider["exchanged [%]"]) == (50.0, 25.0, 25.0)
    assert (rider["right, warned [%]"], rider["wrong, warned [%]"]) == (0.0, 100.0)
    assert rider["stature off [%]"] == pytest.approx(2.0)
    assert crowd["found [%]"] == 0.0
    assert crowd["depth [cm]"] is None


def test_a_kind_that_is_not_known_is_named() -> None:
    with pytest.raises(InputError, match=r"^kinds: 'horse'; expected some of plain, table"):
        next(iter(measure_hard_cases(kinds=("horse",))))
