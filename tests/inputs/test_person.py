"""One person out of a picture: height, choice, own labels and the crop."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.cuts import seen_body

from warp_partdr.body.labels import IGNORE, label_set
from warp_partdr.body.skeletons import SKELETONS
from warp_partdr.errors import InputError
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.keypoints import Keypoints2D, choose_person, person_height
from warp_partdr.inputs.own_pixels import Windows, person_extents, select_person
from warp_partdr.inputs.part_labels import PartLabels, check_sizes, read_parts, read_photo
from warp_partdr.inputs.person import crop_boxes, crop_nearest, is_labelled, person_labels
from warp_partdr.reference.own_pixels import own_pixels

PHOTOS = ("000000032081", "000000203864", "000000468632")

# Left half of a standing person facing the camera, 1 unit tall: x to the picture's right, y down from the head's top.
HALF = {
    "eye": (0.02, 0.065),
    "ear": (0.045, 0.07),
    "shoulder": (0.1, 0.19),
    "elbow": (0.13, 0.34),
    "wrist": (0.15, 0.48),
    "hip": (0.06, 0.46),
    "knee": (0.07, 0.7),
    "ankle": (0.08, 0.947),
}
STANDING = {
    "nose": (0.0, 0.08),
    **{f"left_{name}": point for name, point in HALF.items()},
    **{f"right_{name}": (-x, y) for name, (x, y) in HALF.items()},
}


def standing(x: float = 100, y: float = 10, height: float = 200) -> Keypoints2D:
    """COCO keypoints of the standing person, head's top at (x, y)."""
    points = [STANDING[name] for name in SKELETONS["coco17"].landmarks]
    return Keypoints2D("coco17", (np.array(points) * height + [x, y]).astype(np.float32), np.ones(17, dtype=np.float32))


def without(keypoints: Keypoints2D, joints: Iterable[int]) -> Keypoints2D:
    """Some of the keypoints are missing."""
    there = ~np.isin(np.arange(17), list(joints))
    return Keypoints2D("coco17", keypoints.points * there[:, None], keypoints.confidence * there)


def paint(keypoints: Keypoints2D, size: tuple[int, int], thickness: float = 0.04) -> np.ndarray:
    """Labels 1 (legs) and 2 (the rest) within ``thickness`` of the person's height from the bones."""
    v, u = np.mgrid[: size[0], : size[1]] + 0.5
    groups = np.zeros(size, dtype=np.uint8)
    for start, end in SKELETONS[keypoints.skeleton].edges:
        a, b = keypoints.points[start], keypoints.points[end]
        t = np.clip(((u - a[0]) * (b - a)[0] + (v - a[1]) * (b - a)[1]) / ((b - a) @ (b - a)), 0, 1)
        near = np.hypot(u - a[0] - t * (b - a)[0], v - a[1] - t * (b - a)[1]) < thickness * person_height(keypoints)
        groups[near] = 1 if "ankle" in SKELETONS[keypoints.skeleton].landmarks[end] else 2
    return groups


def masks_of(*people: Keypoints2D, size: tuple[int, int] = (220, 240)) -> PartLabels:
    """One mask a person, as a file of such is read."""
    masks = np.stack([(paint(person, size) > 0).astype(np.uint8) for person in people])
    return PartLabels(label_set("full1"), masks.max(axis=0), instances=masks)


def test_a_persons_mask_is_the_one_under_the_keypoints() -> None:
    """Its place in the file does not matter. Other people's pixels are ignored, but not where the masks overlap."""
    first, second = standing(100), standing(140)
    parts = masks_of(second, first)
    for person, own, other in ((first, 1, 0), (second, 0, 1)):
        groups = person_labels(parts, person).groups
        masks = parts.instances > 0
        np.testing.assert_array_equal(groups == 1, masks[own])
        np.testing.assert_array_equal(groups == IGNORE, masks[other] & ~masks[own])
    both = np.stack([parts.groups, *parts.instances])  # one mask is around both
    assert (person_labels(replace(parts, instances=both), first).groups == 1).sum() == parts.instances[1].sum()
    plain = replace(parts, instances=None)
    assert person_labels(plain, first) is plain
    with pytest.raises(InputError, match="keypoints: in nobody's mask; expected keypoints and masks to agree"):
        person_labels(parts, standing(1000))


def test_masks_tell_whose_a_pixel_is_without_others_bones() -> None:
    """Two people who stand close: a pixel nearer to somebody else's bones stays the person's."""
    first, second = standing(100), standing(115)
    parts = masks_of(first, second)
    (seen,) = weigh_evidence(first, parts, [second])
    np.testing.assert_array_equal(seen.groups == 1, parts.instances[0] > 0)
    (alone,) = weigh_evidence(first, replace(parts, instances=None), [second])
    assert (alone.groups == 1).sum() < (seen.groups == 1).sum()


def test_the_largest_sure_person_on_labels_is_chosen_unless_one_is_named() -> None:
    small, large = standing(30, 10, 60), standing(100, 10, 150)
    faint = Keypoints2D("coco17", large.points + 200, large.confidence / 10)
    people = [small, large, faint]
    assert choose_person(people) is large
    assert choose_person(people, index=2) is faint
    assert choose_person([small]) is small
    only_small = paint(small, (200, 200))
    assert choose_person(people, only_small) is small
    for index in (3, -1):
        with pytest.raises(InputError, match=f"person: {index}; expected an integer from 0 to 2"):
            choose_person(people, index=index)
    with pytest.raises(InputError, match="keypoints: nobody; expected at least one person"):
        choose_person([])


def test_background_and_what_is_ignored_are_no_part():
    assert is_labelled(np.array([0, 1, 254, IGNORE], dtype=np.uint8)).tolist() == [False, True, True, False]


def test_select_person_ignores_others_and_blobs() -> None:
    me, other = standing(100), standing(300)
    size = (230, 400)
    mine = paint(me, size)
    groups = mine + paint(other, size)
    groups[100:104, 20:24] = 1  # A stray blob, near me but not part of me.
    groups[5, 200] = IGNORE
    selected = select_person(groups, me)
    assert selected.dtype == np.uint8
    np.testing.assert_array_equal(selected[mine > 0], mine[mine > 0])
    np.testing.assert_array_equal(selected == 0, groups == 0)
    assert (selected[(groups > 0) & (mine == 0)] == IGNORE).all()
    np.testing.assert_array_equal(select_person(selected, me), selected)


def test_select_person_keeps_loose_limbs_and_what_the_border_leaves() -> None:
    me, cut_off = standing(100), standing(5, -60)
    loose = paint(me, (230, 200))
    loose[158:166] = 0  # No label at the knees: shins and feet hang on nothing.
    corner = paint(cut_off, (100, 60))
    assert 0 < (corner > 0).sum() < corner.size
    for keypoints, labels in ((me, loose), (cut_off, corner)):
        np.testing.assert_array_equal(select_person(labels, keypoints), labels)


def test_others_bones_part_people_who_touch() -> None:
    me, other = standing(100), standing(146)
    size = (230, 300)
    mine, theirs = paint(me, size), paint(other, size)
    groups = np.maximum(mine, theirs)
    far = paint(standing(246), size)  # A row of people hand in hand.
    groups[105, 60:290] = 2
    groups = np.maximum(groups, far)
    alone = select_person(groups, me)
    assert (alone[(far > 0) & (theirs == 0)] == IGNORE).all()
    assert (alone[(mine > 0)] == groups[mine > 0]).all()
    told = select_person(groups, me, others=[other])
    assert (told[:, 146:][groups[:, 146:] > 0] == IGNORE).all()
    assert (told[:, :108][mine[:, :108] > 0] != IGNORE).all()


def test_missing_keypoints_lose_no_pixels_of_a_lone_person() -> None:
    me = standing(100)
    mine = paint(me, (230, 200))
    for missing in ([13, 15], [9], list(range(5)), [7, 9, 8, 10], [0, 1, 2, 3, 4, 13, 14, 15, 16]):
        np.testing.assert_array_equal(select_person(mine, without(me, missing)), mine)


def test_a_person_without_labels_on_the_bones_is_refused() -> None:
    groups = np.zeros((230, 400), dtype=np.uint8)
    groups[100:140, 300:340] = 1
    for keypoints in (standing(100), standing(5000), standing(-5000)):
        with pytest.raises(InputError, match="keypoints: no labelled pixel along the person's bones; expected"):
            select_person(groups, keypoints)


@pytest.mark.parametrize("name", PHOTOS)
def test_pixels_of_the_main_person_are_selected_on_the_shared_photos(name: str, shared: Path) -> None:
    folder = shared / "data/people"
    (keypoints,) = read_keypoints(folder / f"{name}.keypoints.json")
    assert keypoints.skeleton == "blazepose33"
    assert keypoints.visible.all()
    assert 250 < person_height(keypoints) < 400
    parts = read_parts(folder / f"{name}.parts.png", label_set("cdcl14"))
    check_sizes(photo=read_photo(folder / f"{name}.jpg").shape[:2], parts=parts.groups.shape)
    selected = select_person(parts.groups, keypoints)
    kept = (selected > 0) & (selected < IGNORE)
    # Counted by eye: nothing of the lone player is lost; of the others, about these shares are the main person's.
    share = kept.sum() / (parts.groups > 0).sum()
    assert share == pytest.approx({"000000032081": 1.0, "000000203864": 0.722, "000000468632": 0.379}[name], abs=0.005)
    (x0, y0), (x1, y1) = np.concatenate(crop_boxes(*person_extents(keypoints, selected), 0.1)).astype(int)
    assert kept[max(y0, 0) : y1, max(x0, 0) : x1].sum() == kept.sum()
    assert 0.9 < (y1 - y0) / person_height(keypoints) < 1.5


def test_crop_beyond_the_picture_is_ignored() -> None:
    groups = np.arange(12, dtype=np.uint8).reshape(3, 4)
    np.testing.assert_array_equal(crop_nearest(groups, (0, 0, 4, 3), (3, 4)), groups)
    beyond = crop_nearest(groups, (-1, -2, 5, 4), (6, 6))
    np.testing.assert_array_equal(beyond[2:5, 1:5], groups)
    assert (beyond == IGNORE).sum() == 36 - 12
    maps = crop_nearest(np.ones((2, 3, 4), dtype=np.float32), (-4, 0, 4, 3), (3, 8), fill=0)
    assert maps.shape == (2, 3, 8)
    assert maps.sum() == 24
    assert (crop_nearest(groups, (100, 100, 104, 103), (3, 4)) == IGNORE).all()
    np.testing.assert_array_equal(crop_nearest(groups, (0, 0, 4, 3), (6, 8)), groups.repeat(2, 0).repeat(2, 1))
    assert crop_nearest(groups, (0, 0, 4, 3), (1, 1)).item() == groups[1, 2]  # The one at the box's centre.


def test_keypoints_and_labels_are_seen_alike_in_a_window() -> None:
    me = without(standing(100), [3])
    groups = np.zeros((230, 200), dtype=np.uint8)
    for joint, (x, y) in enumerate(me.points):
        groups[int(y), int(x)] = joint + 1
    box, size = (20, -30, 180, 240), (540, 320)  # twice as large
    one = "coco17", me.points[None], me.confidence[None]
    windows = Windows.at(*one, np.array([[20.0, -30.0]]), np.array([2.0]), np.array([size]))
    (points,), labels = windows.points, crop_nearest(groups, box, size)
    seen = [int(labels[int(y), int(x)]) - 1 for x, y in points[me.visible]]
    assert seen == [joint for joint in range(17) if joint != 3]
    assert not points[3].any()
    assert windows.heights[0] == pytest.approx(2 * person_height(me), rel=1e-5)


def test_the_box_holds_the_labels_and_the_margin_and_no_more():
    groups = np.zeros((30, 40), np.uint8)
    groups[5:21, 7:12], groups[2, 3] = 1, 255
    points = np.full((17, 2), 10.5, np.float32)
    keypoints = Keypoints2D("coco17", points, np.ones(17, np.float32))
    np.testing.assert_array_equal(person_extents(keypoints, groups), [[[7, 5]], [[12, 21]]])
    low, high = crop_boxes(*person_extents(keypoints, groups), 0.1)
    np.testing.assert_array_equal([low, high], [[[5, 3]], [[14, 23]]])  # 1.6 more on each side
    points[0] = [2.25, 24.5]
    np.testing.assert_array_equal(crop_boxes(*person_extents(keypoints, groups), 0.0), [[[2, 5]], [[12, 25]]])
    np.testing.assert_array_equal(person_extents(keypoints, None), [[[2.25, 10.5]], [[10.5, 24.5]]])


@pytest.mark.parametrize("others", [0, 1, 2])
def test_stretches_of_pixels_are_judged_as_each_pixel_is(rng: np.random.Generator, others: int) -> None:
    """Against the formula book; many blobs, so that borders lie everywhere."""
    differ = 0
    for _ in range(12):
        size = rng.integers(60, 200, 2)
        groups = (rng.random((*-(-size // 9), 1)) < 0.75).astype(np.uint8) * rng.integers(1, 4, (*-(-size // 9), 1))
        groups = groups[..., 0].repeat(9, axis=0).repeat(9, axis=1)[: size[0], : size[1]].astype(np.uint8)
        people = []
        for _ in range(1 + others):
            points = (rng.random((17, 2)) * size[::-1] * 0.3 + rng.random(2) * size[::-1] * 0.6).astype(np.float32)
            confidence = (rng.random(17) < 0.8).astype(np.float32)
            people.append(Keypoints2D("coco17", points * (confidence[:, None] > 0), confidence))
        keypoints, *rest = people
        body = seen_body(keypoints, label_set("full1"), rest)
        expected, along = own_pixels(groups, body)
        assert along
        np.testing.assert_array_equal(select_person(groups, keypoints, rest), expected)
        differ += int((expected != groups).any() and ((expected > 0) & (expected < IGNORE)).any())
    assert differ > 6
