"""Labels that contradict keypoints: sides exchanged, strangers' blobs, other ids; what is mended, told, left alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.example import example_keypoints, example_parts
from PIL import Image

from warp_partdr.body.labels import BACKGROUND, IGNORE, LabelSet, label_set
from warp_partdr.body.landmarks import mirror_name
from warp_partdr.cameras import Crop
from warp_partdr.inputs.agreement import (
    Agreement,
    Flesh,
    compare_sides,
    count_sides,
    disagreement,
    disagreement_of,
    glance,
    places_along,
    segments_of_parts,
)
from warp_partdr.inputs.evidence import WINDOW_SIDE, Evidence, weigh_evidence
from warp_partdr.inputs.ignored_labels import ignore_stray_labels
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.keypoints import Keypoints2D, choose_person, person_height
from warp_partdr.inputs.labelled_people import LabelledPerson, cut_labels
from warp_partdr.inputs.masked_people import MaskedPerson, cut_masks
from warp_partdr.inputs.observation import crop_evidence, resize_nearest
from warp_partdr.inputs.part_labels import PartLabels, read_parts
from warp_partdr.inputs.selection import select_person
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.results.overlays import draw_overlay
from warp_partdr.results.save import save_fit, score_labels
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.result import FitResult

CDCL = label_set("cdcl14")
PHOTOS = ("000000032081", "000000203864", "000000468632")
MOST_LOST = 0.03  # part F1

Person = tuple[Keypoints2D, PartLabels]


@cache
def example() -> Person:
    return example_keypoints(), example_parts()


def photo(shared: Path, name: str) -> Person:
    parts = read_parts(shared / "data" / "people" / f"{name}.parts.png", CDCL)
    people = read_keypoints(shared / "data" / "people" / f"{name}.keypoints.json")
    return choose_person(people, parts.groups), parts


def group(name: str) -> int:
    return CDCL.group_names.index(name) + 1


def mirrored_labels(parts: PartLabels, *kinds: str) -> PartLabels:
    """Left and right of all groups, or of some kinds of them, exchanged."""
    table = np.arange(256, dtype=np.uint8)
    for name in CDCL.group_names:
        if not kinds or name.partition("_")[2] in kinds:
            table[group(name)] = group(mirror_name(name))
    return replace(parts, groups=table[parts.groups])


def mirrored_keypoints(keypoints: Keypoints2D) -> Keypoints2D:
    mirror = keypoints.format.mirror
    return replace(keypoints, points=keypoints.points[mirror], confidence=keypoints.confidence[mirror])


def over_leg(person: Person, side: str) -> np.ndarray:
    """A rectangle over one leg from below the hip, a mask (H, W)."""
    keypoints, parts = person
    height = person_height(keypoints)
    names = [f"{side}_{joint}" for joint in ("hip", "knee", "ankle")]
    joints = keypoints.points[[keypoints.format.landmarks.index(name) for name in names]]
    (x0, y0), (x1, y1) = joints.min(0) - 0.06 * height, joints.max(0) + 0.06 * height
    if joints[0, 1] < joints[2, 1]:
        y0 = joints[0, 1] + 0.05 * height
    mask = np.zeros(parts.groups.shape, dtype=bool)
    mask[max(int(y0), 0) : int(y1), max(int(x0), 0) : int(x1)] = True
    return mask


def painted(parts: PartLabels, mask: np.ndarray, label: int) -> PartLabels:
    return replace(parts, groups=np.where(mask, label, parts.groups).astype(np.uint8))


def with_blob() -> tuple[np.ndarray, np.ndarray]:
    """The example's group ids with "torso" over the left leg, and where that is."""
    mask = over_leg(example(), "left")
    return painted(example()[1], mask, group("torso")).groups, mask


def ignored(groups: np.ndarray, keypoints: Keypoints2D) -> tuple[np.ndarray, set[str]]:
    return ignore_stray_labels(groups, keypoints, CDCL, glance(groups, keypoints, CDCL))


def measured(groups: np.ndarray, keypoints: Keypoints2D, labels: LabelSet) -> float:
    return disagreement(compare_sides(groups, keypoints, labels), glance(groups, keypoints, labels))


def part_f1(result: FitResult, person: Person) -> float:
    """Of LSP's parts, against a person's own labels."""
    target = select_person(person[1].groups, person[0])
    shown = CDCL.part_groups[result.draw(target.shape).labels[0].numpy()]
    return float(score_labels(shown, target, CDCL)["parts_lsp6"]["part_f1"])


@pytest.mark.parametrize("name", ["example", *PHOTOS])
def test_people_with_contradictions_end_where_they_do_without(name: str, request: pytest.FixtureRequest) -> None:
    """The default fit loses at most ``MOST_LOST`` with sides exchanged and with a blob over a leg."""
    person = example() if name == "example" else photo(request.getfixturevalue("shared"), name)
    keypoints, parts = person
    clean = fit_body(keypoints, parts)
    assert clean.warnings == ()
    for contrary in (fit_body(keypoints, mirrored_labels(parts)), fit_body(mirrored_keypoints(keypoints), parts)):
        assert part_f1(contrary, person) >= part_f1(clean, person) - MOST_LOST
        assert len(contrary.warnings) == 1
        assert "left and right exchanged" in contrary.warnings[0]
    for side in ("left", "right"):
        mask = over_leg(person, side)
        spoiled = fit_body(keypoints, painted(parts, mask, group("torso")))
        told = fit_body(keypoints, painted(parts, mask, IGNORE))
        assert part_f1(spoiled, person) >= part_f1(told, person) - MOST_LOST
        assert any("torso" in warning for warning in spoiled.warnings)
        assert told.warnings == ()


def test_flesh_is_about_all_segments_of_a_group() -> None:
    """It is around its own parts and their mirror images. Where less is asked, no less is told."""
    keypoints, parts = example()
    seen = glance(parts.groups, keypoints, CDCL)
    sure = np.flatnonzero(keypoints.confident).tolist()
    found = segments_of_parts({keypoints.format.landmarks[joint]: keypoints.points[joint] for joint in sure})
    groups = seen.groups.repeat(seen.sizes)
    expected = np.full(len(groups), np.inf)
    for name, own in CDCL.groups.items():
        mine = groups == CDCL.group_names.index(name) + 1
        places = np.stack([seen.columns[mine], seen.rows[mine]], axis=1) + 0.5
        for start, end, radius in (each for part in own for side in (part, mirror_name(part)) for each in found[side]):
            way = (end - start).astype(np.float64)
            share = np.clip(((places - start) @ way) / max(way @ way, 1e-12), 0.0, 1.0)[:, None]
            beyond = np.linalg.norm(places - start - share * way, axis=1) / person_height(keypoints) - radius
            expected[mine] = np.minimum(expected[mine], beyond)
    assert seen.sizes.sum() == seen.labelled == len(seen.distances)
    np.testing.assert_allclose(seen.distances, expected, atol=1e-6)
    heights = np.full(len(groups), person_height(keypoints))
    enough = float(np.median(seen.distances))
    told = Flesh.of([keypoints], [CDCL]).distances(groups, seen.columns + 0.5, seen.rows + 0.5, heights, enough=enough)
    np.testing.assert_array_equal(told[told > enough], seen.distances[seen.distances > enough])
    assert (told > seen.distances).any()


def test_limbs_are_as_thick_as_people_s() -> None:
    """A body of 1.7 m has 5 to 13 cm from the bone to the skin of a thigh, and 2 to 6 cm at a forearm."""
    names = ("left_hip", "left_knee", "left_elbow", "left_wrist")
    found = segments_of_parts({name: name for name in names})
    ((start, end, thigh),), ((_, _, forearm),) = found["left_upper_leg"], found["left_forearm"]
    assert (start, end) == ("left_hip", "left_knee")
    assert 0.05 < 1.7 * thigh < 0.13
    assert 0.02 < 1.7 * forearm < 0.06


# --- Sides -----------------------------------------------------------------------------------------------------------


def test_sides_are_compared_along_the_bones() -> None:
    keypoints, parts = example()
    for limb, found in compare_sides(parts.groups, keypoints, CDCL).items():
        assert found.own > 150, limb
        assert found.mirrored == 0
        assert not found.swapped
    assert all(found.swapped for found in compare_sides(mirrored_labels(parts).groups, keypoints, CDCL).values())


def test_samples_along_a_bone_are_those_of_the_pixels_that_it_runs_over() -> None:
    rows, columns = places_along(np.array([[0.9, 1.9]]), np.array([[2.9, 1.9]]), samples=3)
    assert rows.tolist() == [[1, 1, 1]]
    assert columns.tolist() == [[0, 1, 2]]
    shown, inside = np.array([[1, 1, 2, BACKGROUND, IGNORE, 3, 3]]), np.array([[1, 1, 1, 1, 1, 1, 0]], dtype=bool)
    assert count_sides(shown, inside, np.array([1]), np.array([2])).tolist() == [[2, 1, 1]]


def test_disagreement_needs_many_samples_or_pixels_far_away() -> None:
    few, many = np.array([[[0, 0, 30], [0, 0, 17]]]), np.array([[[24, 0, 0], [0, 0, 24]]])
    assert disagreement_of(few, np.array([100]), np.array([0])).tolist() == [0.0]
    assert disagreement_of(many, np.array([100]), np.array([0])).tolist() == [0.5]
    assert disagreement_of(few, np.array([100]), np.array([25])).tolist() == [1.0]


@pytest.mark.parametrize(
    ("own", "mirrored", "swapped"), [(0, 24, True), (0, 23, False), (25, 75, True), (26, 75, False), (100, 100, False)]
)
def test_legs_of_which_one_hides_the_other_are_not_exchanged(own: int, mirrored: int, swapped: bool) -> None:
    assert Agreement(own, mirrored, other=50).swapped == swapped


def test_a_set_without_sides_has_none_to_compare() -> None:
    keypoints, parts = example()
    pascal = label_set("pascal6")
    groups = pascal.from_parts(np.where(parts.groups > 0, 10, 0))
    assert compare_sides(groups, keypoints, pascal) == {}
    assert len(weigh_evidence(keypoints, PartLabels(pascal, groups))) == 1


@pytest.mark.parametrize(
    ("kinds", "limb"),
    [((), ""), (("upper_arm", "forearm", "hand"), " of arms"), (("upper_leg", "lower_leg", "foot"), " of legs")],
)
def test_exchanged_sides_are_read_in_two_ways(kinds: tuple[str, ...], limb: str) -> None:
    keypoints, parts = example()
    graded = keypoints.confidence * np.linspace(0.8, 1.0, len(keypoints.confidence), dtype=np.float32)
    keypoints = replace(keypoints, confidence=graded)
    contrary = mirrored_labels(parts, *kinds)
    ours, theirs = weigh_evidence(keypoints, contrary)
    np.testing.assert_array_equal(ours.groups, select_person(parts.groups, keypoints))
    np.testing.assert_array_equal(ours.keypoints.points, keypoints.points)
    np.testing.assert_array_equal(theirs.groups, select_person(contrary.groups, keypoints))
    moved = (theirs.keypoints.points != keypoints.points).any(axis=1)
    assert moved.sum() == {"": 16, " of arms": 4, " of legs": 4}[limb]
    np.testing.assert_array_equal(theirs.keypoints.points[moved], keypoints.points[keypoints.format.mirror][moved])
    np.testing.assert_array_equal(theirs.keypoints.confidence[moved], graded[keypoints.format.mirror][moved])
    assert [each.warnings for each in (ours, theirs)] == [
        (f"labels: left and right{limb} exchanged, say the keypoints; taken so",),
        (f"keypoints: left and right{limb} exchanged, say the labels; taken so",),
    ]


def test_probabilities_change_sides_with_their_groups() -> None:
    keypoints, parts = example()
    mirrored = mirrored_labels(parts)
    maps = (mirrored.groups == np.arange(CDCL.num_groups + 1)[:, None, None]).astype(np.float32)
    ours, theirs = weigh_evidence(keypoints, replace(mirrored, maps=maps))
    np.testing.assert_array_equal(ours.labels.maps.argmax(0), parts.groups)
    np.testing.assert_array_equal(ours.labels.groups, parts.groups)
    np.testing.assert_array_equal(theirs.labels.maps, maps)
    observation, _ = crop_evidence(ours, trust_background=True)
    assert observation.maps.shape[0] == CDCL.num_groups
    shown = (observation.labels > BACKGROUND) & (observation.labels < IGNORE)
    assert torch.equal(1 + observation.maps.argmax(0)[shown], observation.labels[shown].long())


@pytest.mark.parametrize("start", ["network", "search"])
def test_the_wrong_one_is_mended_whichever_it_is(start: str) -> None:
    keypoints, parts = example()
    options = FitOptions.at("fast", start)  # type: ignore[arg-type]
    clean = fit_body(keypoints, parts, options=options)
    for contrary in ((keypoints, mirrored_labels(parts)), (mirrored_keypoints(keypoints), parts)):
        mended = fit_body(*contrary, options=options)
        np.testing.assert_array_equal(mended.parameters.rotations, clean.parameters.rotations)
        np.testing.assert_array_equal(mended.evidence.keypoints.points, keypoints.points)
        assert mended.start == clean.start
        shown = [np.asarray(draw_overlay(result, parts.groups.shape)) for result in (clean, mended)]
        np.testing.assert_array_equal(*shown)  # keypoints as they are believed to be: sides have colours


# --- Blobs -----------------------------------------------------------------------------------------------------------


def test_a_blob_far_from_its_bones_is_ignored_and_the_part_itself_is_not() -> None:
    keypoints, parts = example()
    groups, mask = with_blob()
    cleaned, names = ignored(groups, keypoints)
    assert names == {"torso"}
    (seen,) = weigh_evidence(keypoints, replace(parts, groups=groups))
    assert seen.warnings == ("labels: torso also far from any such bone; ignored there",)
    assert (cleaned[mask] == IGNORE).mean() > 0.9
    assert (cleaned[~mask] == parts.groups[~mask]).all()
    cleaned, names = ignored(parts.groups, keypoints)  # where nothing is wrong
    assert names == set()
    np.testing.assert_array_equal(cleaned, parts.groups)


def test_a_part_whose_keypoints_are_missing_or_in_doubt_has_no_blob() -> None:
    keypoints, parts = example()
    groups, mask = with_blob()
    for joint in ("left_hip", "right_shoulder"):
        confidence = keypoints.confidence.copy()
        confidence[keypoints.format.landmarks.index(joint)] = 0.1
        assert ignored(groups, replace(keypoints, confidence=confidence))[1] == set()
    groups[~mask & (parts.groups == group("torso"))] = BACKGROUND  # all of the part is elsewhere
    assert ignored(groups, keypoints)[1] == set()


# --- Other ids -------------------------------------------------------------------------------------------------------


def test_labels_of_another_set_are_told() -> None:
    keypoints, parts = example()
    ids = CDCL.to_ids(parts.groups)
    for name in ("sapiens28", "atr18"):
        other = label_set(name)
        contrary = PartLabels(other, other.to_groups(ids))
        assert measured(select_person(contrary.groups, keypoints), keypoints, other) > 1.0
        assert any(f"are these ids of {name}?" in text for text in weigh_evidence(keypoints, contrary)[0].warnings)


def test_people_with_noise_are_not_told_that_their_labels_are_others() -> None:
    for index in range(20):
        sample = make_sample(index, "realistic")
        selected = select_person(sample.parts.groups, sample.keypoints, sample.others)
        assert measured(selected, sample.keypoints, CDCL) < 0.9


def test_an_implausible_end_is_told() -> None:
    keypoints, parts = example()
    twenty = label_set("ellipbody20")
    wrong = PartLabels(twenty, twenty.to_groups(CDCL.to_ids(parts.groups)))
    result = fit_body(keypoints, wrong, options=FitOptions(search=()))
    assert any("are these ids of ellipbody20?" in warning for warning in result.warnings)
    points = keypoints.points[np.random.default_rng(0).permutation(len(keypoints.points))]
    result = fit_body(replace(keypoints, points=points), options=FitOptions(search=()))
    assert [warning.split(":")[0] for warning in result.warnings] == ["keypoints"]
    assert result.warnings[0].endswith("; are these keypoints of coco17, not of h36m17 or posetrack17?")


@pytest.mark.parametrize(
    ("points", "told"),
    [
        ([[100, 50], [130, 300]], "keypoints: only 2 are visible; most of the body is a guess"),
        ([[100, 50], [130, 300], [90, 200]], "keypoints: only 3 are visible; most of the body is a guess"),
        ([[100 + 5 * k, 50 + 11 * k] for k in range(17)], "keypoints: all lie in a line; most of the body is a guess"),
        ([[200, 50 + 20 * k + k % 2] for k in range(9)], "keypoints: all lie in a line; most of the body is a guess"),
        ([[100, 50], [110, 300], [90, 200], [150, 110]], None),
    ],
)
def test_keypoints_that_tell_no_pose_are_a_warning(points: list[list[float]], told: str | None) -> None:
    """The warning is the same with labels, without labels, and in batches."""
    known, parts = example()
    places, confidence = np.zeros((17, 2), np.float32), np.zeros(17, np.float32)
    places[: len(points)], confidence[: len(points)] = points, 1
    keypoints = Keypoints2D("coco17", places, confidence, ("keypoints: odd",))
    warnings = ("keypoints: odd",) if told is None else ("keypoints: odd", told)
    assert weigh_evidence(keypoints)[0].warnings == warnings
    everywhere = PartLabels(label_set("full1"), np.ones(parts.groups.shape, np.uint8))
    assert weigh_evidence(keypoints, everywhere)[0].warnings[: len(warnings)] == warnings
    owners = torch.ones(parts.groups.shape, dtype=torch.int32)
    ((evidence, _, _),) = cut_masks([MaskedPerson(keypoints, owners, 1)], "cpu")
    assert evidence.warnings[: len(warnings)] == warnings
    cut = cut_labels([LabelledPerson(replace(known, warnings=("keypoints: odd",)), parts)])[0]
    assert cut is not None
    assert cut[0].warnings == ("keypoints: odd",)


# --- Large pictures --------------------------------------------------------------------------------------------------


def enlarged(person: Person, factor: int) -> Person:
    keypoints, parts = person
    groups = np.kron(parts.groups, np.ones((factor, factor), dtype=np.uint8))
    return replace(keypoints, points=keypoints.points * np.float32(factor)), replace(parts, groups=groups)


def test_nothing_is_known_beyond_the_picture() -> None:
    (seen,) = weigh_evidence(*example())
    height, width = example()[1].groups.shape
    target = seen.target((3, 3), (-1.0, -1.0, 2.0, 2.0))
    np.testing.assert_array_equal(target[0], IGNORE)
    np.testing.assert_array_equal(target[1:, 1:], seen.groups[:2, :2])
    assert (seen.target((4, 4), (width + 1.0, height + 1.0, width + 9.0, height + 9.0)) == IGNORE).all()


def test_a_large_picture_is_looked_at_in_a_window() -> None:
    large, small = enlarged(example(), 6), example()
    (seen,) = weigh_evidence(*large)
    assert max(seen.window.size) <= WINDOW_SIDE
    assert seen.groups.shape == seen.window.size
    target = seen.target(small[1].groups.shape)
    expected = select_person(small[1].groups, small[0])
    assert (target != expected).mean() < 5e-3
    coarse = seen.target((300, 225))  # what lies under each of its pixels' centres: nothing moves
    places, wanted = (np.argwhere(each == group("torso")).mean(0) + 0.5 for each in (coarse, expected))
    np.testing.assert_allclose(places / (300, 225), wanted / expected.shape, atol=5e-4)
    whole = seen.target(large[1].groups.shape)
    assert whole.shape == large[1].groups.shape
    assert (whole != select_person(large[1].groups, large[0])).mean() < 5e-3
    fitted, plain = (fit_body(*person, quality="fast") for person in (large, small))
    shown, expected = (each.camera.project(each.posed.joints)[0, :, :2] for each in (fitted, plain))
    assert (shown.amax(0) - shown.amin(0)).tolist() == pytest.approx(
        (6 * (expected.amax(0) - expected.amin(0))).tolist(), rel=0.03
    )
    # A guess of the distance would stretch the focal length, too, by what pixels that differ a little say.
    unguessed = replace(FitOptions.at("fast"), guess_camera=False)
    focal, of_small = (fit_body(*person, options=unguessed).camera.intrinsics[0, 0] for person in (large, small))
    assert float(focal / of_small) == pytest.approx(6, rel=0.03)
    assert part_f1(fitted, large) == pytest.approx(part_f1(plain, small), abs=1e-2)


def test_a_small_person_in_a_large_picture_is_seen_pixel_by_pixel() -> None:
    keypoints, parts = example()

    def inside(size: tuple[int, int], top: int, left: int) -> Person:
        groups = np.zeros(size, dtype=np.uint8)
        groups[top : top + 512, left : left + 384] = parts.groups
        return replace(keypoints, points=keypoints.points + np.float32([left, top])), replace(parts, groups=groups)

    moved, large = inside((2400, 1700), 1000, 700)
    large.groups[2300:, 1600:] = group("torso")  # somebody else
    (seen,) = weigh_evidence(moved, large)
    assert seen.window.zoom == 1.0
    target = seen.target(large.groups.shape)
    np.testing.assert_array_equal(target[1000:1512, 700:1084], select_person(parts.groups, keypoints))
    assert (target[2300:, 1600:] == IGNORE).all()
    (there, crop), (here, same) = (
        crop_evidence(weigh_evidence(*person)[0])
        for person in ((moved, large), inside((WINDOW_SIDE, WINDOW_SIDE), 128, 192))
    )
    np.testing.assert_array_equal(there.labels, here.labels)
    np.testing.assert_allclose(there.points, here.points, atol=1e-6)
    assert (crop.left - same.left, crop.top - same.top, crop.zoom) == (508, 872, same.zoom)


@pytest.mark.parametrize("size", [128, 640])
@pytest.mark.parametrize("place", [(0, 0), (37, 61), (1000, 700)])
def test_labels_that_are_kept_small_are_those_of_the_large_ones(size: int, place: tuple[int, int]) -> None:
    """It holds in small pictures, in windows of large ones, beyond the border, and for probabilities."""
    keypoints, parts = example()
    top, left = place
    groups = np.zeros((512 + 2 * top, 384 + 2 * left), dtype=np.uint8)
    groups[top : top + 512, left : left + 384] = parts.groups
    moved = replace(keypoints, points=keypoints.points + np.float32([left, top]))
    maps = (groups == np.arange(parts.label_set.num_groups + 1)[:, None, None]).astype(np.float32)
    for each in (replace(parts, groups=groups), replace(parts, groups=groups, maps=maps)):
        (evidence,) = weigh_evidence(moved, each)
        (large, crop), (small, same) = crop_evidence(evidence), crop_evidence(evidence, label_size=size)
        assert crop == same
        for given, thinned in ((large.labels, small.labels), (large.maps, small.maps), (large.known, small.known)):
            assert (given is None) == (thinned is None)
            if given is not None and thinned is not None:
                assert torch.equal(resize_nearest(given, size), thinned)


def test_scores_of_a_large_picture_are_of_a_smaller_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = fit_body(*example(), quality="fast")
    plain = save_fit(result, tmp_path)["parts"]
    monkeypatch.setattr("warp_partdr.results.overlays.OVERLAY_SIDE", 256)
    scores = save_fit(result, tmp_path)["parts"]
    assert Image.open(tmp_path / "overlay.png").size == (192, 256)
    assert scores["pixels"]["person"] < 0.5 * plain["pixels"]["person"]
    assert abs(scores["part_f1"] - plain["part_f1"]) < 0.01


def test_evidence_without_labels_has_no_target() -> None:
    seen = Evidence(example()[0], None, Crop(0.0, 0.0, 1.0, (1, 1)), None)
    for ask in (lambda: seen.target((4, 4)), lambda: seen.labels):
        with pytest.raises(ValueError, match=r"evidence: without part labels; expected some"):
            ask()
