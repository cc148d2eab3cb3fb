"""Photos of many people, and of none: levels that the pictures decide."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.example import example_photo
from helpers.people import crowd
from PIL import Image, ImageDraw

from warp_partdr.networks.detection import people
from warp_partdr.networks.detection.masks import instance_map
from warp_partdr.networks.detection.people import find_people, find_people_in


@pytest.mark.slow
def test_sixty_people_are_found_each_once() -> None:
    picture, places = crowd(60)
    found = find_people(picture)
    assert 56 <= len(found) <= 60
    middles = np.array([[(box[0] + box[2]) / 2, (box[1] + box[3]) / 2] for box in (person.box for person in found)])
    distances = np.linalg.norm(middles[:, None] - places, axis=2)
    assert len(set(distances.argmin(axis=1))) == len(found)
    assert distances.min(axis=1).max() < 25
    owners = instance_map(found, picture.shape[:2])
    assert set(np.unique(owners)) == set(range(len(found) + 1))


def test_tiles_become_smaller_where_people_are_small_or_nobody_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    detect = people.detect_people

    def spy(networks: object, pyramids: list[object], new: object, min_score: float, levels: int) -> object:
        asked.append((levels, len(pyramids)))
        return detect(networks, pyramids, new, min_score, levels)

    monkeypatch.setattr(people, "detect_people", spy)
    example = example_photo()
    nobody = np.full((900, 1200, 3), 90, np.uint8)
    few, _ = crowd(6)
    found = find_people_in([example, nobody, few])
    assert [len(each) for each in found] == [1, 0, 6]
    assert asked[:2] == [(2, 3), (3, 2)]  # the example's person is large
    assert all(count <= 1 for _, count in asked[2:])  # nobody is looked for only once more
    asked.clear()
    find_people(few, levels=1)
    assert asked == [(1, 1)]
    asked.clear()
    find_people(np.full((300, 400, 3), 90, np.uint8))  # tiles would be too small
    assert {count for _, count in asked[1:]} <= {0}


def test_nobody_is_in_a_stick_figure() -> None:
    picture = Image.new("RGB", (400, 500), "white")
    draw = ImageDraw.Draw(picture)
    draw.ellipse((170, 40, 230, 100), outline="black", width=5)
    for a, b in (((200, 100), (200, 300)), ((200, 150), (120, 230)), ((200, 150), (280, 230))):
        draw.line((*a, *b), fill="black", width=5)
    for foot in (140, 260):
        draw.line((200, 300, foot, 450), fill="black", width=5)
    assert find_people(np.asarray(picture)) == []
