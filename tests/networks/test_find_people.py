"""Everyone in a picture: the packaged example, photos beside the checkout, several pictures at once, films."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.example import example_keypoints, example_mask, example_photo

from warp_partdr import read_photo, skeleton
from warp_partdr.errors import InputError
from warp_partdr.inputs.keypoints import Keypoints2D, person_height
from warp_partdr.networks.detection.asset import packaged_people_networks
from warp_partdr.networks.detection.crops import Pyramid
from warp_partdr.networks.detection.detector import detect_people, tiles
from warp_partdr.networks.detection.look import look
from warp_partdr.networks.detection.masks import draw_mask, instance_map
from warp_partdr.networks.detection.people import find_people, find_people_in
from warp_partdr.networks.detection.person import FoundPerson
from warp_partdr.networks.detection.search import _agreement_scores

MAX_ERROR = 0.01  # of keypoints, as a share of the person's height, against MediaPipe's own
PEOPLE = {"000000032081": (1, 1), "000000203864": (2, 2), "000000468632": (3, 4)}  # to be found, and there


@cache
def example_people(device: str) -> list[FoundPerson]:
    return find_people(example_photo(), device=device)


def errors(found: Keypoints2D, truth: Keypoints2D) -> np.ndarray:
    """Distances of the landmarks that both have, as shares of the person's height."""
    names = [name for name in truth.format.landmarks if name in found.format.landmarks]
    ours, theirs = (points.points[[points.format.landmarks.index(name) for name in names]] for points in (found, truth))
    return np.linalg.norm(ours - theirs, axis=1) / person_height(truth)


def alike(one: FoundPerson, other: FoundPerson, tolerance: float) -> None:
    """Two looks at a person agree; [px]."""
    np.testing.assert_allclose(one.keypoints.points, other.keypoints.points, atol=tolerance)
    np.testing.assert_allclose(one.keypoints.confidence, other.keypoints.confidence, atol=0.01)
    assert one.score == pytest.approx(other.score, abs=0.01)


def test_the_packaged_example_is_one_person(device):
    (person,) = example_people(device)
    assert person.keypoints.skeleton == "blazepose33"
    assert person.score > 0.9
    assert person.keypoints.confidence.mean() > 0.9
    truth = example_keypoints()
    assert errors(person.keypoints, truth).mean() < 0.03  # annotators' joints are not quite BlazePose's


def test_the_mask_is_the_person(device):

    (person,) = example_people(device)
    shown = example_mask()
    mask = draw_mask(person, shown.shape)
    assert ((mask > 0.5) & shown).sum() > 0.9 * ((mask > 0.5) | shown).sum()
    clear = abs(mask - 0.5) > 1e-4  # else a matter of rounding
    assert (instance_map([person], shown.shape) == (mask > 0.5))[clear].all()
    rows, columns = np.nonzero(mask > 0.5)
    box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    np.testing.assert_allclose(person.box, box, atol=3)


def test_devices_find_the_same_person(device):
    (here,), (there,) = example_people(device), example_people("cpu")
    alike(here, there, 0.5)  # TF32


def test_nobody_is_in_empty_pictures(rng, device):
    for picture in (np.zeros((480, 640, 3)), np.full((40, 30, 3), 255), rng.integers(0, 255, (300, 500, 3))):
        assert find_people(picture.astype(np.uint8), device=device) == []
    assert find_people(np.zeros((1, 1, 3), np.uint8), device=device) == []


def test_a_batch_finds_what_each_picture_holds(device):
    empty = np.zeros((100, 200, 3), np.uint8)
    moved = np.pad(example_photo(), ((0, 0), (130, 0), (0, 0)))
    found = find_people_in([moved, empty, example_photo()], device=device)
    assert [len(people) for people in found] == [1, 0, 1]
    alike(found[2][0], example_people(device)[0], 0.5)
    alike(found[0][0], find_people(moved, device=device)[0], 0.5)
    assert find_people_in([], device=device) == []


def test_small_people_are_found_in_tiles():
    """The person has a 15th of the picture's width."""
    small = example_photo()[::4, ::4]
    picture = np.full((600, 1600, 3), 128, np.uint8)
    picture[300:428, 1000:1096] = small
    assert find_people(picture, levels=1) == []
    (person,) = find_people(picture)
    expected = example_people("cpu")[0].keypoints.points / 4 + [1000, 300]
    assert np.linalg.norm(person.keypoints.points - expected, axis=1).mean() < 3


def test_two_people_side_by_side_are_told_apart():
    both = np.concatenate([example_photo(), example_photo()[:, ::-1]], axis=1)
    people = find_people(both)
    assert len(people) == 2
    owners = instance_map(people, both.shape[:2])
    for number, person in enumerate(people, start=1):
        left = person.keypoints.points[:, 0].mean() < 384
        assert (np.nonzero(owners == number)[1] < 384).mean() == pytest.approx(float(left), abs=0.05)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_people_who_lie_or_stand_on_their_head_are_found(quarters: int) -> None:
    turned = np.ascontiguousarray(np.rot90(example_photo(), quarters))
    (person,) = find_people(turned)
    assert person.score > 0.9
    upright = example_people("cpu")[0].keypoints.points
    width, height = 384, 512
    for _ in range(quarters):
        upright = np.stack([upright[:, 1], width - upright[:, 0]], axis=1)
        width, height = height, width
    assert np.linalg.norm(person.keypoints.points - upright, axis=1).mean() < 8


def test_somebody_before_another_leaves_two_people() -> None:
    """The second of the two hides a good part of the first."""
    photo, shown = example_photo(), example_mask()
    picture = np.concatenate([photo, np.broadcast_to(photo[:, -1:], (512, 128, 3))], axis=1)
    picture[:, 100:484][shown] = photo[shown]
    people = find_people(picture)
    assert len(people) == 2
    middles = sorted(person.keypoints.points[:, 0].mean() for person in people)
    assert middles[1] - middles[0] == pytest.approx(100, abs=25)


def test_a_score_is_lower_where_the_networks_disagree() -> None:
    photo = example_photo()
    networks = packaged_people_networks("cpu")
    pyramids = [Pyramid(photo, "cpu")]
    detected = detect_people(networks, pyramids, tiles(pyramids[0].size, 0), 0.5)
    found = look(networks, pyramids, detected.crops())
    (agreed,) = _agreement_scores(detected, found)
    mirrored = skeleton("coco17").mirror
    exchanged = replace(detected, points=detected.points[:, mirrored], confidence=detected.confidence[:, mirrored])
    assert _agreement_scores(exchanged, found) == pytest.approx(agreed)
    side = float(found.next_crops.sides[0])
    (moved,) = _agreement_scores(replace(detected, points=detected.points + 0.1 * side), found)
    assert moved < 0.5 * agreed
    (unsure,) = _agreement_scores(replace(detected, scores=detected.scores * 0 + 0.075), found)
    assert unsure == pytest.approx(agreed * 0.25 ** (2 / 3))


def test_a_film_follows_people_without_the_detector(monkeypatch):
    """The person moves from frame to frame. A frame without them ends the track."""
    before = example_people("cpu")
    shifted = np.roll(example_photo(), (6, 10), axis=(0, 1))
    monkeypatch.setattr("warp_partdr.networks.detection.search.detect_people", lambda *_: pytest.fail("it ran"))
    (person,) = find_people(shifted, previous=before)
    moved = person.keypoints.points - before[0].keypoints.points
    assert np.linalg.norm(moved - [10, 6], axis=1).mean() < 3
    assert find_people(np.zeros_like(shifted), previous=before) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"picture": [[0]]}, "picture: list; expected ndarray"),
        ({"picture": np.zeros((5, 5), np.uint8)}, r"picture: uint8 \(5, 5\); expected uint8 \(H, W, 3\)"),
        ({"picture": np.zeros((5, 5, 3))}, "picture: float64"),
        ({"picture": np.zeros((0, 5, 3), np.uint8)}, r"picture: uint8 \(0, 5, 3\)"),
        ({"picture": Pyramid(np.zeros((9, 9, 3), np.uint8), "meta")}, "picture: a pyramid on meta"),
        ({"min_score": 1.5}, "min_score: 1.5; expected a number"),
        ({"levels": 0}, "levels: 0; expected an integer"),
        ({"previous": [3]}, r"previous\[0\]: int; expected FoundPerson"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises((InputError, ValueError, TypeError), match=message):
        find_people(**{"picture": np.zeros((9, 9, 3), np.uint8), **arguments})


def test_previous_people_must_be_given_for_each_picture():
    with pytest.raises(ValueError, match="previous: of 1 pictures; expected 2"):
        find_people_in([np.zeros((9, 9, 3), np.uint8)] * 2, previous=[[]])


def photo(shared: Path, name: str) -> tuple[np.ndarray, Keypoints2D]:
    """A photo and MediaPipe's keypoints of one of the people in it."""
    folder = shared / "data" / "people"
    rows = np.array(json.loads((folder / f"{name}.keypoints.json").read_text())["keypoints"], dtype=np.float32)
    assert len(rows) == len(skeleton("blazepose33").landmarks)
    return read_photo(folder / f"{name}.jpg"), Keypoints2D("blazepose33", rows[:, :2].copy(), rows[:, 2].clip(0, 1))


def test_keypoints_are_near_those_of_mediapipe(shared, device):
    """The mean is over the photos, which MediaPipe scaled and cut in its own way. Each person is found once."""
    means = []
    for name, (least, there) in PEOPLE.items():
        picture, truth = photo(shared, name)
        people = find_people(picture, device=device)
        assert least <= len(people) <= there
        means.append(min(errors(person.keypoints, truth).mean() for person in people))
        owners = instance_map(people, picture.shape[:2])
        for number, person in enumerate(people, start=1):
            rows, columns = np.floor(person.keypoints.points[person.keypoints.confidence > 0.9]).astype(int).T[::-1]
            seen = (rows < owners.shape[0]) & (columns < owners.shape[1])
            assert (owners[rows[seen], columns[seen]] == number).mean() > 0.8
    assert np.mean(means) < MAX_ERROR
