"""People found in marked photos: who is found, missed and false."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from helpers.example import example_photo
from PIL import Image

from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.lab.measurements import found_people
from warp_partdr.lab.measurements.found_people import MarkedPhoto, Outcome, measure_found_people
from warp_partdr.lab.tables import FigureTable
from warp_partdr.networks.detection.people import find_people
from warp_partdr.networks.detection.person import FoundPerson

SIZE = (100, 200)


@pytest.fixture(scope="module")
def standing() -> Callable[[float, float, float, float], FoundPerson]:
    """People whose keypoints fill a box [px]."""
    (someone,) = find_people(example_photo(), levels=1)

    def person(left: float, top: float, right: float, bottom: float) -> FoundPerson:
        points = np.tile(np.array([left, top], np.float32), (33, 1))
        points[1] = right, bottom
        return replace(someone, keypoints=Keypoints2D("blazepose33", points, np.ones(33, np.float32)), score=0.777)

    return person


def photo(people: list[list[float]], ignored: list[list[float]]) -> MarkedPhoto:
    return MarkedPhoto.from_json({"file": "a.png", "held_out": False, "people": people, "ignored": ignored})


def test_each_marked_person_is_found_once(standing: Callable[..., FoundPerson]) -> None:
    marked = photo([[0.1, 0.1, 0.3, 0.9], [0.5, 0.1, 0.7, 0.9]], [])
    twice = [standing(20, 10, 60, 90), standing(22, 10, 60, 90)]
    assert marked.judge(twice, SIZE) == Outcome(1, (1,), (0.78,))
    both = [standing(100, 10, 140, 90), standing(20, 10, 60, 90)]
    assert marked.judge(both, SIZE) == Outcome(2, (), ())
    assert marked.judge([], SIZE) == Outcome(0, (0, 1), ())
    beside = [standing(52, 10, 92, 90)]  # an overlap of 11 %
    assert marked.judge(beside, SIZE) == Outcome(0, (0, 1), (0.78,))


def test_keypoints_beyond_the_border_count_at_the_border(standing: Callable[..., FoundPerson]) -> None:
    marked = photo([[0.0, 0.5, 0.2, 1.0]], [])
    assert marked.judge([standing(-20, 50, 40, 400)], SIZE) == Outcome(1, (), ())


def test_whoever_is_ignored_is_neither_right_nor_false(standing: Callable[..., FoundPerson]) -> None:
    marked = photo([], [[0.0, 0.0, 0.5, 1.0]])
    assert marked.judge([standing(10, 10, 20, 30)], SIZE) == Outcome(0, (), ())
    assert marked.judge([standing(110, 10, 120, 30)], SIZE) == Outcome(0, (), (0.78,))


def test_photos_are_measured_turned(tmp_path: Path) -> None:
    Image.fromarray(example_photo()).save(tmp_path / "a.png")
    rows = [
        {"file": "a.png", "held_out": False, "people": [[0.1, 0.0, 0.9, 1.0]], "ignored": []},
        {"file": "a.png", "held_out": True, "turn": 90, "people": [[0.0, 0.1, 1.0, 0.9]], "ignored": []},
    ]
    (tmp_path / "photos.json").write_text(json.dumps({"photos": rows}))
    (table,) = measure_found_people(tmp_path, photos=tmp_path / "photos.json")
    assert isinstance(table, FigureTable)
    assert [row[:4] for row in table.rows] == [("chosen on", 1, 1, 1), ("held out", 1, 1, 1), ("all", 2, 2, 2)]


def test_the_marked_photos_are_whole() -> None:
    marks = json.loads(resources.files(found_people.__package__).joinpath("found_people.json").read_text("utf-8"))
    photos = [MarkedPhoto.from_json(row) for row in marks["photos"]]
    assert {each.file.partition("/")[0] for each in photos} == set(marks["packages"])
    halves = {each.file: each.held_out for each in photos}
    for each in photos:
        assert each.held_out == halves[each.file]  # turned copies and frames of a film are in one half
        for boxes in (each.people, each.ignored):
            assert (boxes[:, :2] < boxes[:, 2:]).all()
            assert ((boxes >= 0) & (boxes <= 1)).all()
    assert sum(len(each.people) for each in photos) == 127
