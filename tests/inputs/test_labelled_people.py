"""Crops of many people by their part labels, cut at once: of each, to the bit, what is made of a person alone."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from helpers.cuts import assert_cut_as_alone
from helpers.example import example_keypoints, example_parts

from warp_partdr.body.labels import IGNORE, label_set
from warp_partdr.body.skeletons import SKELETONS, skeleton
from warp_partdr.cameras import Perspective
from warp_partdr.inputs import agreement, labelled_people, selection
from warp_partdr.inputs.evidence import WINDOW_SIDE, weigh_evidence
from warp_partdr.inputs.keypoints import Keypoints2D, person_height
from warp_partdr.inputs.labelled_people import LabelledPerson, cut_labels
from warp_partdr.inputs.observation import LABEL_SIZE, CutOut
from warp_partdr.inputs.part_labels import PartLabels

LABELS = ("cdcl14", "pascal6", "full1")


@cache
def example(labels: str = "cdcl14") -> tuple[Keypoints2D, PartLabels]:
    """The example's person in the groups of a label set."""
    parts = example_parts()
    own, known = label_set(labels), parts.label_set
    table = np.zeros(256, dtype=np.uint8)
    table[IGNORE] = IGNORE
    table[1 : known.num_groups + 1] = [
        own.part_groups[np.flatnonzero(known.part_groups == group)[0]] for group in range(1, known.num_groups + 1)
    ]
    return example_keypoints(), PartLabels(own, table[parts.groups])


def as_format(keypoints: Keypoints2D, form: str) -> Keypoints2D:
    """Keypoints in another format, as far as it has them."""
    points, confidence = np.zeros((len(skeleton(form)), 2), np.float32), np.zeros(len(skeleton(form)), np.float32)
    for row, name in enumerate(skeleton(form).landmarks):
        if name in keypoints.format.landmarks:
            other = keypoints.format.landmarks.index(name)
            points[row], confidence[row] = keypoints.points[other], keypoints.confidence[other]
    return Keypoints2D(form, points, confidence)


def disturbed(keypoints: Keypoints2D, rng: np.random.Generator, *, spread: float) -> Keypoints2D:
    """The same, moved, with some missing."""
    points = keypoints.points + rng.normal(0, spread, keypoints.points.shape).astype(np.float32)
    confidence = keypoints.confidence * (rng.random(len(points)) > rng.choice([0.0, 0.0, 0.1, 0.4])).astype(np.float32)
    seen = np.flatnonzero(keypoints.confidence)[:2]
    confidence[seen] = np.maximum(confidence[seen], np.float32(0.1))
    points[(confidence == 0) & (rng.random(len(points)) < 0.5)] = 0
    return Keypoints2D(keypoints.skeleton, points, confidence)


def odd_people(rng: np.random.Generator, count: int) -> list[LabelledPerson]:
    """The example's person with others beside, holes, blobs and ignored pixels, in pictures of all sizes and sets."""
    people = []
    for _ in range(count):
        known, parts = example(str(rng.choice(LABELS)))
        groups = parts.groups.copy()
        keypoints = disturbed(
            as_format(known, str(rng.choice(["coco17", "blazepose33", "lsp14"]))), rng, spread=rng.choice([0, 3, 30])
        )
        others = [disturbed(known, rng, spread=20.0) for _ in range(rng.choice([0, 0, 1, 3]))]
        others = [
            Keypoints2D(each.skeleton, each.points + rng.choice([25, 60, 900], 2).astype(np.float32), each.confidence)
            for each in others
        ]
        if others and rng.random() < 0.5:
            groups = np.maximum(groups, np.roll(groups, 40, axis=1))
        for _ in range(rng.integers(0, 5)):
            row, column = rng.integers(0, groups.shape)
            height, width = rng.integers(5, 120, 2)
            shown = rng.choice([0, 0, IGNORE, 1, parts.label_set.num_groups])
            groups[row : row + height, column : column + width] = shown
        groups[rng.random(groups.shape) < rng.choice([0.0, 0.05], p=[0.8, 0.2])] = 0
        if rng.random() < 0.2:  # tiny
            step = 8
            groups, factor = groups[::step, ::step], np.float32(1 / step)
            keypoints, *others = (
                Keypoints2D(each.skeleton, each.points * factor, each.confidence) for each in (keypoints, *others)
            )
        groups = np.ascontiguousarray(groups[: -int(rng.integers(1, len(groups) // 3))])
        people.append(LabelledPerson(keypoints, PartLabels(parts.label_set, groups), others))
    return people


def assert_as_alone(people: Sequence[LabelledPerson], size: int = LABEL_SIZE) -> list[CutOut | None]:
    """Cut all at once; each is what ``weigh_evidence`` and ``crop_evidence`` make of them, or None."""
    found = cut_labels(people, size)
    assert len(found) == len(people)
    for person, cut in zip(people, found, strict=True):
        if cut is not None:
            alone = weigh_evidence(person.keypoints, person.parts, person.others)[0]
            assert_cut_as_alone(cut, alone, person.camera, size=size)
    return found


@pytest.mark.parametrize("size", [LABEL_SIZE, 128])
def test_many_people_are_cut_out_as_each_alone(size: int, rng: np.random.Generator) -> None:
    people = odd_people(rng, 120)
    found = assert_as_alone(people, size)
    # Everything that may happen did.
    done = [(person, cut) for person, cut in zip(people, found, strict=True) if cut is not None]
    assert 60 < len(done) < len(people)
    assert any((np.asarray(cut[1].labels) == IGNORE).any() for _, cut in done)
    assert any(person.others for person, _ in done)
    assert any(max(person.parts.groups.shape) < 100 for person, _ in done)
    assert {person.parts.label_set.name for person, _ in done} == set(LABELS)


def test_people_in_parts_of_the_batch_are_the_same(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory and caches hold a few at a time."""
    people = odd_people(rng, 20)
    monkeypatch.setattr(labelled_people, "_PIXELS", 2**18)
    monkeypatch.setattr(selection, "_PAIRS", 500)
    monkeypatch.setattr(agreement, "_AT_ONCE", 100)
    assert any(cut is not None for cut in assert_as_alone(people))


def test_people_of_one_picture_share_it_and_its_camera() -> None:
    """Pixels that are labelled beyond a person's reach are others'."""
    keypoints, parts = example()
    height, width = parts.groups.shape
    factor, away = np.float32(0.4), np.float32([width * 0.6, 0])
    small = parts.groups[(np.arange(int(height * factor)) / factor).astype(int)]
    small = small[:, (np.arange(int(width * factor)) / factor).astype(int)]
    groups = np.zeros_like(parts.groups)
    groups[: small.shape[0], : small.shape[1]] = small
    groups[: small.shape[0], int(away[0]) :][:, : small.shape[1]] = small[:, : width - int(away[0])]
    camera = Perspective.of_picture(groups.shape, focal=600.0)
    one, other = (
        Keypoints2D(keypoints.skeleton, keypoints.points * factor + shift, keypoints.confidence)
        for shift in (0 * away, np.floor(away))
    )
    shown = PartLabels(parts.label_set, groups)
    found = assert_as_alone(
        [LabelledPerson(one, shown, [other], camera), LabelledPerson(other, shown, [one], camera)], 128
    )
    assert all(cut is not None and (cut[1].labels == IGNORE).any() for cut in found)


def test_people_who_need_a_closer_look_are_left_to_it() -> None:
    keypoints, parts = example()
    there = LabelledPerson(keypoints, parts)
    assert cut_labels([]) == []
    points, sure = keypoints.points, keypoints.confidence
    unusable = [
        Keypoints2D(keypoints.skeleton, some, confidence)
        for some, confidence in (
            (points, 0 * sure),
            (points * np.float32(np.nan), sure),
            (points * 0, sure),
            (points + np.float32(1e7), sure),
            (points + np.float32(3000), sure),  # beyond the picture
            (points.astype(np.float64), sure),
        )
    ]
    beside = points + np.float32([0.08 * person_height(keypoints), 0])
    unusable.append(Keypoints2D(keypoints.skeleton, beside, sure))
    mirrored = parts.groups.copy()
    names = parts.label_set.group_names
    for group, name in enumerate(names, 1):
        other = name.replace("left", "right") if "left" in name else name.replace("right", "left")
        mirrored[parts.groups == group] = names.index(other) + 1
    stray, head = parts.groups.copy(), names.index("head") + 1
    rows, columns = np.nonzero(parts.groups == names.index("left_lower_leg") + 1)
    stray[rows, columns] = head
    many = np.zeros((len(names) + 1, *parts.groups.shape), dtype=np.float32)
    large = np.zeros((WINDOW_SIDE + 1, parts.groups.shape[1]), dtype=np.uint8)
    large[: len(parts.groups)] = parts.groups
    others = [
        PartLabels(parts.label_set, parts.groups, instances=parts.groups[None]),
        PartLabels(parts.label_set, parts.groups, maps=many),
        *(PartLabels(parts.label_set, each) for each in (large, mirrored, stray)),
    ]
    left = [*(there._replace(keypoints=each) for each in unusable), *(there._replace(parts=each) for each in others)]
    found = assert_as_alone([there, *left, there])
    assert [cut is None for cut in found] == [False, *[True] * len(left), False]
    for person, told in (
        (left[6], "lie elsewhere"),
        (left[-2], "left and right"),
        (left[-1], "far from any such bone"),
    ):
        (warning, *_) = weigh_evidence(person.keypoints, person.parts)[0].warnings
        assert told in warning


@pytest.mark.parametrize("form", SKELETONS)
def test_people_of_each_format_are_cut_out(form: str) -> None:
    keypoints, parts = example()
    (cut,) = assert_as_alone([LabelledPerson(as_format(keypoints, form), parts)])
    assert cut is not None
