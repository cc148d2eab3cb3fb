"""Labels that contradict keypoints: sides exchanged, strangers' blobs, other ids; what is mended, told, left alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.example import example_keypoints, example_parts
from PIL import Image

from warp_partdr.body.labels import BACKGROUND, IGNORE, label_set
from warp_partdr.body.landmarks import mirror_name
from warp_partdr.body.skeletons import Skeleton
from warp_partdr.cameras import Crop
from warp_partdr.inputs.body_lines import flesh_of, segments_of_parts
from warp_partdr.inputs.cut_out import cut_out_people
from warp_partdr.inputs.cut_people import CutPerson
from warp_partdr.inputs.evidence import (
    Evidence,
    PicturePerson,
    WeighedPeople,
    are_swapped,
    disagreements,
    weigh_evidence,
    weigh_people,
)
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.keypoints import Keypoints2D, choose_person, person_height
from warp_partdr.inputs.observation import crop_evidence, resize_nearest
from warp_partdr.inputs.own_pixels import CPU, WINDOW_SIDE, Mask, OwnPixels, Windows, select_person
from warp_partdr.inputs.part_labels import PartLabels, read_parts
from warp_partdr.interop.streams import on_torch_stream
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


def ignored(groups: np.ndarray, keypoints: Keypoints2D) -> tuple[np.ndarray, bool]:
    """Group ids without stray ones, and if there are any."""
    evidence = weigh_evidence(keypoints, PartLabels(CDCL, groups))[0]
    return evidence.groups, any("far from any such bone" in text for text in evidence.warnings)


def weighed(person: Person, others: Sequence[Keypoints2D] = ()) -> WeighedPeople:
    with on_torch_stream(CPU):
        return weigh_people([PicturePerson(*person, others)], CPU)


def measured(person: Person, others: Sequence[Keypoints2D] = ()) -> float:
    """Disagreement of labels and keypoints."""
    found = weighed(person, others)
    known = np.where(found.measures.complete, found.measures.counts, 0).sum(axis=1)
    return float(disagreements(found.pixels.sides(), known, found.measures.far.sum(axis=1))[0])


def part_f1(result: FitResult, person: Person) -> float:
    """The F1 of LSP's parts is against a person's own labels."""
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
    """It has segments of its own parts and of their mirror images, or none if a keypoint is not known."""
    keypoints, _ = example()
    names = keypoints.format.landmarks
    confidence = np.where(np.arange(len(names)) == names.index("left_knee"), 0, keypoints.confidence)
    flesh = flesh_of(keypoints.skeleton, keypoints.points[None], confidence[None], CDCL)
    found = segments_of_parts({name: name for name in names})
    for number, own in enumerate(CDCL.groups.values(), start=1):
        every = {each for part in own for side in (part, mirror_name(part)) for each in found[side]}
        rows = flesh.lines[0, flesh.firsts[number] : flesh.firsts[number + 1]]
        assert len(rows) == len(every)
        missing = any("left_knee" in each for each in every)
        assert flesh.complete[0, number] == (not missing)
        expected = sorted(
            (*keypoints.points[names.index(start)].tolist(), *keypoints.points[names.index(end)].tolist(), radius)
            for start, end, radius in every
            if "left_knee" not in (start, end)
        )
        there = rows[rows[:, 5] >= 0]
        ends = np.concatenate([there[:, :2], there[:, :2] + there[:, 2:4], there[:, 5:]], axis=1)
        np.testing.assert_allclose(sorted(map(tuple, ends.tolist())), expected, atol=1e-4)
        np.testing.assert_allclose(there[:, 4], np.maximum((there[:, 2:4] ** 2).sum(axis=1), 1e-12), rtol=1e-6)


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
    sides = weighed((keypoints, parts)).pixels.sides()[0]
    assert (sides[:, 0] > 150).all()
    assert not sides[:, 1].any()
    assert not are_swapped(sides).any()
    assert are_swapped(weighed((keypoints, mirrored_labels(parts))).pixels.sides()).all()


def test_samples_along_a_bone_are_those_of_the_pixels_that_it_runs_over() -> None:
    """48 along the middle 80 % of an upper arm; neither background nor ignored pixels nor those beyond count."""
    names = ("left_shoulder", "left_elbow")
    form = Skeleton("arm", names, names, ((0, 1),), (0, 1), 2)
    groups = np.full((12, 50), group("left_upper_arm"), dtype=np.uint8)
    groups[:, 20:26], groups[:, 26:30], groups[:, 30:34] = group("right_upper_arm"), group("torso"), IGNORE
    groups[:, 34:37] = BACKGROUND
    points, confidence = np.float32([[[10, 5.5], [58, 5.5]]]), np.ones((1, 2), np.float32)
    windows = Windows.of(form, points, confidence, np.array([groups.shape]))
    with on_torch_stream(CPU):
        sides = OwnPixels([groups], windows, CPU, labels=CDCL, known=groups).sides()
    columns = np.floor(10 + 48 * np.linspace(0.1, 0.9, 48)).astype(int)
    shown = groups[5, columns[columns < 50]]
    expected = [np.count_nonzero(shown == group(each)) for each in ("left_upper_arm", "right_upper_arm", "torso")]
    assert min(expected) > 2
    assert sides.tolist() == [[expected, [0, 0, 0]]]


def test_disagreement_needs_many_samples_or_pixels_far_away() -> None:
    few, many = np.array([[[0, 0, 30], [0, 0, 17]]]), np.array([[[24, 0, 0], [0, 0, 24]]])
    assert disagreements(few, np.array([100]), np.array([0])).tolist() == [0.0]
    assert disagreements(many, np.array([100]), np.array([0])).tolist() == [0.5]
    assert disagreements(few, np.array([100]), np.array([25])).tolist() == [1.0]


@pytest.mark.parametrize(
    ("own", "mirrored", "swapped"), [(0, 24, True), (0, 23, False), (25, 75, True), (26, 75, False), (100, 100, False)]
)
def test_legs_of_which_one_hides_the_other_are_not_exchanged(own: int, mirrored: int, swapped: bool) -> None:
    assert are_swapped(np.array([own, mirrored, 50])) == swapped


def test_a_set_without_sides_has_none_to_compare() -> None:
    keypoints, parts = example()
    pascal = label_set("pascal6")
    groups = pascal.from_parts(np.where(parts.groups > 0, 10, 0))
    assert not weighed((keypoints, PartLabels(pascal, groups))).pixels.sides().any()
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
    cleaned, stray = ignored(groups, keypoints)
    assert stray
    (seen,) = weigh_evidence(keypoints, replace(parts, groups=groups))
    assert seen.warnings == ("labels: torso also far from any such bone; ignored there",)
    assert (cleaned[mask] == IGNORE).mean() > 0.9
    assert (cleaned[~mask] == parts.groups[~mask]).all()
    cleaned, stray = ignored(parts.groups, keypoints)  # where nothing is wrong
    assert not stray
    np.testing.assert_array_equal(cleaned, parts.groups)


def test_a_part_whose_keypoints_are_missing_or_in_doubt_has_no_blob() -> None:
    keypoints, parts = example()
    groups, mask = with_blob()
    for joint in ("left_hip", "right_shoulder"):
        confidence = keypoints.confidence.copy()
        confidence[keypoints.format.landmarks.index(joint)] = 0.1
        assert not ignored(groups, replace(keypoints, confidence=confidence))[1]
    groups[~mask & (parts.groups == group("torso"))] = BACKGROUND  # all of the part is elsewhere
    assert not ignored(groups, keypoints)[1]


# --- Other ids -------------------------------------------------------------------------------------------------------


def test_labels_of_another_set_are_told() -> None:
    keypoints, parts = example()
    ids = CDCL.to_ids(parts.groups)
    for name in ("sapiens28", "atr18"):
        other = label_set(name)
        contrary = PartLabels(other, other.to_groups(ids))
        assert measured((keypoints, contrary)) > 1.0
        assert any(f"are these ids of {name}?" in text for text in weigh_evidence(keypoints, contrary)[0].warnings)


def test_people_with_noise_are_not_told_that_their_labels_are_others() -> None:
    for index in range(20):
        sample = make_sample(index, "realistic")
        assert measured((sample.keypoints, sample.parts), sample.others) < 0.9


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
    mask = Mask(torch.ones(parts.groups.shape, dtype=torch.int32), 1)
    odd = PicturePerson(replace(known, warnings=("keypoints: odd",)), parts)
    many = [PicturePerson(keypoints), PicturePerson(keypoints, mask), PicturePerson(keypoints, everywhere), odd]
    cut = cut_out_people(many, "cpu")
    for person, expected in zip(cut, (*[warnings] * 3, ("keypoints: odd",)), strict=True):
        assert isinstance(person, CutPerson)
        assert person.evidence.warnings[: len(expected)] == expected


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
