"""People cut out of pictures by labels and by masks: as the formula book says, and many at once as each alone."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pytest
import torch
from helpers.cuts import as_format, assert_cut_as_alone, assert_twin, example, mirrored, odd_person, scaled, twin

from warp_partdr.body.labels import BACKGROUND, IGNORE
from warp_partdr.body.skeletons import SKELETONS, Skeleton, skeleton
from warp_partdr.cameras import Perspective
from warp_partdr.errors import InputError
from warp_partdr.inputs.cut_out import cut_out_people
from warp_partdr.inputs.cut_people import CutPerson
from warp_partdr.inputs.evidence import Evidence, PicturePerson, weigh_evidence
from warp_partdr.inputs.keypoints import Keypoints2D, person_height
from warp_partdr.inputs.observation import LABEL_SIZE
from warp_partdr.inputs.own_pixels import WINDOW_SIDE, Mask
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.pipelines.photo import person_evidence


def masked(keypoints: Keypoints2D, mask: np.ndarray, number: int = 1) -> PicturePerson:
    return PicturePerson(keypoints, Mask(torch.from_numpy(mask.astype(np.int32)), number))


def example_mask() -> tuple[Keypoints2D, np.ndarray]:
    """Keypoints, and whom each pixel shows: the person and nobody else."""
    keypoints, parts = example()
    return keypoints, (parts.groups != BACKGROUND).astype(np.int32)


def people_of_all_kinds(rng: np.random.Generator, count: int) -> list[PicturePerson]:
    return [odd_person(rng, masked=place % 3 == 0) for place in range(count)]


def evidence_of(person: PicturePerson) -> Evidence:
    """The first reading of a person alone."""
    if isinstance(person.pixels, Mask):
        return person_evidence(person.keypoints, person.pixels.owners.cpu().numpy(), person.pixels.number - 1)
    return weigh_evidence(person.keypoints, person.pixels, person.others)[0]


def assert_as_alone(
    people: Sequence[PicturePerson], device: str = "cpu", size: int = LABEL_SIZE
) -> list[CutPerson | InputError]:
    """Cut all at once; each is what ``weigh_evidence`` and ``crop_evidence`` make of them, with the same error."""
    found = cut_out_people(people, device, size)
    for person, cut in zip(people, found, strict=True):
        if isinstance(cut, InputError):
            with pytest.raises(InputError, match=re.escape(str(cut))):
                evidence_of(person)
        else:
            assert_cut_as_alone(cut, evidence_of(person), person.camera, device, size)
    return found


def test_people_are_cut_out_as_the_book_says(device: str, rng: np.random.Generator) -> None:
    people = people_of_all_kinds(rng, 60)
    told = []
    for person, cut in zip(people, cut_out_people(people, device, 128), strict=True):
        if isinstance(cut, CutPerson) and cut.observation.labels is not None:
            assert_twin(cut, person)
            told += cut.evidence.warnings
        else:
            assert twin(person) is None
    # Everything that may happen did.
    for what in ("far from any such bone", "exchanged, say the keypoints", "are these ids of"):
        assert any(what in each for each in told), what


@pytest.mark.parametrize("with_mask", [False, True])
def test_large_people_are_cut_out_of_a_window_as_the_book_says(with_mask: bool) -> None:
    keypoints, parts = example()
    groups = parts.groups.copy()
    groups[:60, :90] = 2  # somebody else
    groups[300:420, 100:200] = 0
    large = scaled(PicturePerson(keypoints, PartLabels(parts.label_set, groups)), 2, 5)
    if with_mask:
        assert isinstance(large.pixels, PartLabels)
        large = masked(large.keypoints, large.pixels.groups > 0)
    (cut,) = cut_out_people([large], "cpu", 128)
    assert isinstance(cut, CutPerson)
    assert cut.evidence.window.zoom < 1
    assert max(cut.evidence.window.size) <= WINDOW_SIDE
    assert_twin(cut, large)


def test_a_small_person_is_cut_out_of_part_of_a_large_picture() -> None:
    person = scaled(PicturePerson(*example()), 3)
    assert isinstance(person.pixels, PartLabels)
    groups = np.zeros((1000, 900), dtype=np.uint8)
    height, width = person.pixels.groups.shape
    groups[700 : 700 + height, 500 : 500 + width] = person.pixels.groups
    groups[980:, 880:] = 1  # somebody else
    moved = Keypoints2D("coco17", person.keypoints.points + np.float32([500, 700]), person.keypoints.confidence)
    there = PicturePerson(moved, PartLabels(person.pixels.label_set, groups))
    (cut,) = cut_out_people([there], "cpu", 128)
    assert isinstance(cut, CutPerson)
    assert cut.evidence.window.zoom == 1
    assert cut.evidence.window.left > 0
    assert_twin(cut, there)


@pytest.mark.parametrize("size", [LABEL_SIZE, 128])
def test_many_people_are_cut_out_as_each_alone(size: int, device: str, rng: np.random.Generator) -> None:
    people = people_of_all_kinds(rng, 60)
    people += [PicturePerson(each.keypoints, None) for each in people[::7]]
    people += [scaled(each, 1, 9) for each in people[1:9:3]]
    found = assert_as_alone(people, device, size)
    done = [cut for cut in found if isinstance(cut, CutPerson)]
    assert len(done) > 60
    assert any(cut.observation.labels is None for cut in done)
    assert any(cut.evidence.window.zoom < 1 for cut in done)
    assert {person.pixels.label_set.name for person in people if isinstance(person.pixels, PartLabels)} == {
        *("cdcl14", "pascal6", "full1")
    }


def test_probabilities_are_cut_out_where_they_are_wanted() -> None:
    """This holds for labels whose sides are exchanged, too."""
    keypoints, parts = example()
    people = []
    for groups in (parts.groups, mirrored(parts.label_set)[parts.groups]):
        maps = (groups == np.arange(parts.label_set.num_groups + 1)[:, None, None]).astype(np.float32)
        people.append(PicturePerson(keypoints, PartLabels(parts.label_set, groups, maps=0.9 * maps)))
    found = cut_out_people(people, "cpu", 128, probabilities=True)
    for person, cut in zip(people, found, strict=True):
        assert isinstance(cut, CutPerson)
        assert cut.observation.maps is not None
        assert_cut_as_alone(cut, evidence_of(person), None, size=128)
    (plain,) = cut_out_people(people[:1], "cpu", 128)
    assert isinstance(plain, CutPerson)
    assert plain.observation.maps is None


def test_people_whose_pictures_are_too_large_for_one_batch_are_cut_out_as_each_alone() -> None:
    assert_as_alone([scaled(masked(*example_mask()), 1, zoom) for zoom in (5, 6, 7)], size=128)


@pytest.mark.parametrize("with_mask", [False, True])
def test_pixels_beside_the_bones_of_a_tiny_person_are_theirs(with_mask: bool, device: str) -> None:
    """A person 2 px tall, in a picture that shows nobody else."""
    keypoints, parts = example("full1")
    zoom = np.float32(2 / np.ptp(keypoints.points[keypoints.visible, 1]))
    tiny = Keypoints2D(keypoints.skeleton, keypoints.points * zoom + np.float32(8), keypoints.confidence)
    shown = np.ones((20, 20), dtype=np.uint8)
    person = masked(tiny, shown) if with_mask else PicturePerson(tiny, PartLabels(parts.label_set, shown))
    (cut,) = assert_as_alone([person], device)
    assert isinstance(cut, CutPerson)
    assert bool((cut.observation.labels == 1).any())
    assert_twin(cut, person, LABEL_SIZE)


def test_people_of_one_picture_share_it_and_its_camera(device: str) -> None:
    """And what is labelled beyond a person's reach is others'."""
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
    owners = torch.from_numpy(np.where(groups == 0, 0, 1 + (np.arange(width) >= away[0])).astype(np.int32)).to(device)
    found = assert_as_alone(
        [
            PicturePerson(one, shown, [other], camera),
            PicturePerson(one, Mask(owners, 1), camera=camera),
            PicturePerson(other, shown, [one], camera),
            PicturePerson(other, Mask(owners, 2), camera=camera),
        ],
        device,
        128,
    )
    assert all(isinstance(cut, CutPerson) and (cut.observation.labels == IGNORE).any() for cut in found)


def test_each_who_cannot_be_used_has_an_error_and_nobody_else() -> None:
    keypoints, parts = example()
    there = PicturePerson(keypoints, parts)
    assert cut_out_people([], "cpu") == []
    points, sure = keypoints.points, keypoints.confidence
    unusable = [
        (points, 0 * sure, "none is visible"),
        (points * np.float32(np.nan), sure, "NaN"),
        (points * 0, sure, "in one point"),
        (points + np.float32(1e7), sure, "beyond"),
        (points + np.float32(3000), sure, "no labelled pixel"),  # beyond the picture
    ]
    wrong = [there._replace(keypoints=Keypoints2D("coco17", some, votes)) for some, votes, _ in unusable]
    wrong.append(there._replace(pixels=PartLabels(parts.label_set, parts.groups, instances=0 * parts.groups[None])))
    found = assert_as_alone([there, *wrong, there])
    assert [isinstance(each, InputError) for each in found] == [False, *[True] * len(wrong), False]
    for error, told in zip(found[1:], [*(told for *_, told in unusable), "in nobody's mask"], strict=False):
        assert told in str(error)


def test_groups_of_a_mask_tell_the_person_from_others_and_nobody(device: str) -> None:
    owners = torch.tensor([[0, 1, 2], [3, 2, 0]], dtype=torch.int32, device=device)
    assert Mask(owners, 2).groups().tolist() == [[0, 255, 1], [255, 1, 0]]
    assert Mask(owners.T, 2).groups().tolist() == [[0, 255], [255, 1], [1, 0]]


def test_of_whom_a_mask_shows_nothing_the_keypoints_are_cut_out(device: str) -> None:
    keypoints, mask = example_mask()
    hidden, shown = assert_as_alone([masked(keypoints, mask, 2), masked(keypoints, mask)], device)
    assert isinstance(hidden, CutPerson)
    assert isinstance(shown, CutPerson)
    assert hidden.observation.labels is None
    assert hidden.observation.label_set is None
    assert shown.observation.labels is not None


def test_labels_that_contradict_keypoints_are_mended() -> None:
    keypoints, parts = example()
    there = PicturePerson(keypoints, parts)
    beside = keypoints.points + np.float32([0.08 * person_height(keypoints), 0])
    stray, names = parts.groups.copy(), parts.label_set.group_names
    stray[np.nonzero(parts.groups == names.index("left_lower_leg") + 1)] = names.index("head") + 1
    people = [
        there._replace(keypoints=Keypoints2D("coco17", beside, keypoints.confidence)),
        there._replace(pixels=PartLabels(parts.label_set, mirrored(parts.label_set)[parts.groups])),
        there._replace(pixels=PartLabels(parts.label_set, stray)),
        there._replace(keypoints=Keypoints2D("coco17", keypoints.points.astype(np.float64), keypoints.confidence)),
        there._replace(pixels=PartLabels(parts.label_set, parts.groups, instances=parts.groups[None])),
    ]
    found = assert_as_alone([there, *people], size=128)
    whole, *mended = [cut for cut in found if isinstance(cut, CutPerson)]
    for cut, told in zip(mended, ("lie elsewhere", "left and right", "far from any such bone"), strict=False):
        assert told in cut.evidence.warnings[0]
    assert whole.observation.labels is not None
    assert mended[1].observation.labels is not None
    assert torch.equal(whole.observation.labels, mended[1].observation.labels)


@pytest.mark.parametrize("form", SKELETONS)
def test_all_formats(form: str) -> None:
    keypoints, parts = example()
    person = scaled(PicturePerson(as_format(keypoints, form), parts), 4)
    mask = scaled(masked(as_format(keypoints, form), parts.groups > 0), 4)
    for one, cut in zip((person, mask), assert_as_alone([person, mask], size=128), strict=True):
        assert isinstance(cut, CutPerson)
        assert_twin(cut, one)


def test_a_skeleton_without_limbs_or_faces_is_cut_out() -> None:
    """Two points of the trunk tell nothing of arms and legs."""
    keypoints, parts = example()
    rows = [keypoints.format.landmarks.index(name) for name in ("left_shoulder", "right_hip")]
    landmarks = ("left_shoulder", "right_hip")
    form = Skeleton("two", landmarks, landmarks, ((0, 1),), (0, 1), 2)
    person = PicturePerson(Keypoints2D(form, keypoints.points[rows], keypoints.confidence[rows]), parts)
    assert len(skeleton(form)) == 2
    (cut,) = assert_as_alone([person], size=128)
    assert isinstance(cut, CutPerson)
    assert bool((cut.observation.labels == IGNORE).any())
