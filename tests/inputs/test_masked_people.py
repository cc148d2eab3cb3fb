"""Crops of many people by their masks, cut at once: of each, to the bit, what is made of a person alone."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
import torch
from helpers.cuts import assert_cut_as_alone
from helpers.example import example_keypoints, example_parts

from warp_partdr.body.labels import BACKGROUND
from warp_partdr.body.skeletons import SKELETONS, skeleton
from warp_partdr.cameras import Perspective
from warp_partdr.errors import InputError
from warp_partdr.inputs import masked_people
from warp_partdr.inputs.evidence import WINDOW_SIDE
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.masked_people import MaskedPerson, cut_masks
from warp_partdr.inputs.observation import CutOut
from warp_partdr.pipelines.photo import person_evidence


@cache
def example() -> tuple[Keypoints2D, np.ndarray]:
    """Keypoints, and whom each pixel shows: the person and nobody else."""
    parts = example_parts()
    return example_keypoints(), (parts.groups != BACKGROUND).astype(np.int32)


def as_format(keypoints: Keypoints2D, form: str) -> Keypoints2D:
    """Keypoints in another format, as far as it has them; hips, knees and the like have the same names in all."""
    points, confidence = np.zeros((len(skeleton(form)), 2), np.float32), np.zeros(len(skeleton(form)), np.float32)
    for row, name in enumerate(skeleton(form).landmarks):
        if name in keypoints.format.landmarks:
            other = keypoints.format.landmarks.index(name)
            points[row], confidence[row] = keypoints.points[other], keypoints.confidence[other]
    return Keypoints2D(form, points, confidence)


def odd_people(rng: np.random.Generator, count: int) -> list[MaskedPerson]:
    """The example's person with moved and missing keypoints, holes, strangers and specks, in pictures of all sizes."""
    known, mask = example()
    people = []
    for _ in range(count):
        keypoints, owners = as_format(known, str(rng.choice(["coco17", "blazepose33", "lsp14"]))), mask.copy()
        points, confidence = keypoints.points.copy(), keypoints.confidence.copy()
        points += rng.normal(0, rng.choice([0, 3, 40]), points.shape).astype(np.float32)
        confidence *= rng.random(len(confidence)) > rng.choice([0.0, 0.0, 0.1, 0.5])
        confidence[:2] = np.maximum(confidence[:2], 0.1)
        points[confidence == 0] = 0
        for _ in range(rng.integers(0, 6)):
            row, column = rng.integers(0, owners.shape)
            height, width = rng.integers(5, 150, 2)
            owners[row : row + height, column : column + width] = rng.choice([0, 1, 1, 2])
        owners[rng.random(owners.shape) < rng.choice([0.0, 0.4, 1.0], p=[0.7, 0.2, 0.1])] = 0
        zoom = int(rng.choice([1, 1, 1, 3]))
        owners = owners.repeat(zoom, axis=0).repeat(zoom, axis=1)[: -int(rng.integers(1, 200))]
        people.append(
            MaskedPerson(
                Keypoints2D(keypoints.skeleton, points * np.float32(zoom), confidence), torch.from_numpy(owners), 1
            )
        )
    return people


def assert_as_alone(people: Sequence[MaskedPerson], device: str) -> list[CutOut]:
    """Cut all at once; each is what ``person_evidence`` and ``crop_evidence`` make of them."""
    found = cut_masks(people, device)
    for person, cut in zip(people, found, strict=True):
        alone = person_evidence(person.keypoints, person.owners.cpu().numpy(), person.number - 1)
        assert_cut_as_alone(cut, alone, person.camera, device)
    return found


def test_many_people_are_cut_out_as_each_alone(device, rng):
    found = assert_as_alone(odd_people(rng, 60), device)
    # Everything that may happen did.
    labels = [seen.labels for _, seen, _ in found if seen.labels is not None]
    assert len(labels) < len(found)
    told = {warning for evidence, _, _ in found for warning in evidence.warnings}
    assert any("far from any such bone" in each for each in told)
    assert any(evidence.window.zoom < 1 for evidence, _, _ in found)
    assert any(max(each.window.size) <= WINDOW_SIDE for each, _, _ in found)


def test_pixels_beside_the_bones_of_a_tiny_person_are_theirs(device):
    """A person 4 px tall, in a picture that shows nobody else."""
    keypoints, _ = example()
    zoom = np.float32(4 / np.ptp(keypoints.points[keypoints.visible, 1]))
    tiny = Keypoints2D(keypoints.skeleton, keypoints.points * zoom + np.float32(8), keypoints.confidence)
    ((_, observation, _),) = assert_as_alone([MaskedPerson(tiny, torch.ones(20, 20, dtype=torch.int32), 1)], device)
    assert bool((observation.labels == 1).any())


def test_people_in_parts_of_the_batch_are_the_same(device, rng, monkeypatch):
    """Memory holds a few people at a time."""
    monkeypatch.setattr(masked_people, "_PIXELS", {"cpu": 2**18, "cuda": 2**18})
    assert_as_alone(odd_people(rng, 12), device)


def test_people_of_one_picture_share_it_and_its_camera(device):
    keypoints, mask = example()
    other = Keypoints2D(keypoints.skeleton, keypoints.points + np.float32([30, 0]), keypoints.confidence)
    owners = torch.from_numpy(mask + np.roll(mask, 30, axis=1) * (1 - mask) * 2).to(device)
    camera = Perspective.of_picture(mask.shape, focal=600.0)
    found = assert_as_alone(
        [MaskedPerson(keypoints, owners, 1, camera), MaskedPerson(other, owners, 2, camera)], device
    )
    assert [evidence.window.size for evidence, _, _ in found] == [mask.shape] * 2


def test_nobody_is_cut_out_of_nothing_and_unusable_keypoints_are_refused(device):
    assert cut_masks([], device) == []
    keypoints, mask = example()
    there = MaskedPerson(keypoints, torch.from_numpy(mask), 1)
    for points, confidence, told in (
        (keypoints.points, np.zeros_like(keypoints.confidence), "none is visible"),
        (keypoints.points * np.float32(np.nan), keypoints.confidence, "NaN"),
        (keypoints.points * 0, keypoints.confidence, "in one point"),
    ):
        bad = Keypoints2D(keypoints.skeleton, points, confidence)
        with pytest.raises(InputError, match=told):
            cut_masks([there, there._replace(keypoints=bad)], device)


@pytest.mark.parametrize("form", SKELETONS)
def test_people_of_each_format_are_cut_out(form: str) -> None:
    keypoints, mask = example()
    assert_as_alone([MaskedPerson(as_format(keypoints, form), torch.from_numpy(mask), 1)], "cpu")
