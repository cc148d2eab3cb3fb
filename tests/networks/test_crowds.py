"""Photos of many people, and of none: levels that the pictures decide."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.example import example_photo
from helpers.people import crowd, cut_out
from PIL import Image, ImageDraw

from warp_partdr.networks.detection import search
from warp_partdr.networks.detection.crops import TurnedCrops, join_crops, no_crops
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


class Views:
    """Views that the detector looks at, and crops that the landmark network looks at, call by call."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.seen: list[TurnedCrops] = []
        self.people: list[TurnedCrops] = []
        detect, look = search.detect_people, search.look

        def watched_detect(networks: Any, pyramids: Any, views: TurnedCrops, min_heat: float) -> Any:
            self.seen.append(views)
            return detect(networks, pyramids, views, min_heat)

        def watched_look(networks: Any, pyramids: Any, crops: TurnedCrops) -> Any:
            self.people.append(crops)
            return look(networks, pyramids, crops)

        monkeypatch.setattr(search, "detect_people", watched_detect)
        monkeypatch.setattr(search, "look", watched_look)

    def sides(self, picture: int) -> list[list[float]]:
        """Sides of the views of a picture in each call, each once, the largest first, without empty calls."""
        sides = [sorted(set(views.sides[views.pictures == picture].tolist()), reverse=True) for views in self.seen]
        return [each for each in sides if each]


def rows_of(crops: list[TurnedCrops]) -> list[tuple[float, ...]]:
    """Numbers that describe each crop."""
    joined = join_crops([no_crops(), *crops])
    return [tuple(row) for row in np.column_stack([joined.centres, joined.sides, joined.angles, joined.pictures])]


def test_tiles_become_smaller_where_people_are_small_or_nobody_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    views = Views(monkeypatch)
    few, _ = crowd(6)
    found = find_people_in([example_photo(), few])
    assert [len(each) for each in found] == [1, 6]
    longer = max(few.shape[:2])
    assert views.sides(0) == [[512.0, 256.0]]  # the example's person is large
    assert views.sides(1)[:2] == [[longer, longer / 2], [longer / 4]]
    views.seen.clear()
    find_people(few, levels=1)
    assert {side for sides in views.sides(0) for side in sides} == {longer}
    views.seen.clear()
    find_people(np.full((300, 400, 3), 90, np.uint8))  # tiles would be too small
    assert views.sides(0) == [[400.0, 200.0]]


def test_each_view_and_each_person_is_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    views = Views(monkeypatch)
    found = find_people_in([crowd(6)[0], np.rot90(example_photo()).copy()])
    assert [len(each) for each in found] == [6, 1]
    assert len(views.seen) > 2  # tiles, turned pictures, smaller tiles
    for crops in (views.seen, views.people):
        rows = rows_of(crops)
        assert len(set(rows)) == len(rows)


def test_small_tiles_are_looked_at_only_where_somebody_is_seen_faintly(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small person stands at the left of a wide empty picture."""
    person, mask = cut_out(100)
    picture = Image.new("RGB", (1600, 800), (150, 150, 150))
    picture.paste(person, (200, 350), mask)
    views = Views(monkeypatch)
    (found,) = find_people(np.asarray(picture))
    assert found.keypoints.points[:, 0].max() < 300
    small = join_crops(views.seen)
    small = small[small.sides == 400]
    assert 0 < len(small) < 10  # of 21
    assert (small.centres[:, 0] <= 500).all()
    views.seen.clear()
    find_people(np.asarray(picture), levels=3)
    assert (join_crops(views.seen).sides == 400).sum() == 21


def test_who_is_found_clearly_is_not_looked_at_again_in_smaller_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    picture, _ = crowd(6)
    assert min(person.score for person in find_people(picture, levels=2)) >= 0.9
    views = Views(monkeypatch)
    find_people(picture, levels=2)
    before = len(join_crops(views.people))
    views.people.clear()
    find_people(picture)
    assert len(views.seen) > 3
    assert len(join_crops(views.people)) <= before + 3  # six people, looked at twice each, would be more


@pytest.mark.parametrize(("quarters", "turned"), [(0, 0), (1, 3)])
def test_the_picture_is_turned_where_not_all_is_explained_by_upright_people(
    monkeypatch: pytest.MonkeyPatch, quarters: int, turned: int
) -> None:
    views = Views(monkeypatch)
    (person,) = find_people(np.rot90(example_photo(), quarters).copy())
    assert person.score > 0.9
    assert np.count_nonzero(join_crops(views.seen).angles) == turned


def test_somebody_upside_down_beside_one_who_stands_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    both = np.concatenate([example_photo(), example_photo()[::-1, ::-1]], axis=1)
    people = find_people(both)
    assert len(people) == 2
    assert sorted(np.round(np.abs(np.cos([float(each.crop.angles[0]) for each in people])), 1)) == [1.0, 1.0]


def test_nobody_is_in_a_stick_figure() -> None:
    picture = Image.new("RGB", (400, 500), "white")
    draw = ImageDraw.Draw(picture)
    draw.ellipse((170, 40, 230, 100), outline="black", width=5)
    for a, b in (((200, 100), (200, 300)), ((200, 150), (120, 230)), ((200, 150), (280, 230))):
        draw.line((*a, *b), fill="black", width=5)
    for foot in (140, 260):
        draw.line((200, 300, foot, 450), fill="black", width=5)
    assert find_people(np.asarray(picture)) == []
