"""People of pictures in batches: who is cut out, in which order rows come, and rows one by one."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from helpers.files import EXAMPLE

from warp_partdr import InputError
from warp_partdr.bulk.batches import group_rows, made_by, people_pool
from warp_partdr.bulk.cutting import Cutter, Held
from warp_partdr.bulk.rows import PeopleRows, RowPart
from warp_partdr.bulk.sources import KnownPerson, SourcePicture
from warp_partdr.inputs.cut_people import CutPeople
from warp_partdr.inputs.keypoint_files import read_keypoints

SIZE = (512, 512)


def picture(people: int) -> SourcePicture:
    (keypoints,) = read_keypoints(EXAMPLE / "keypoints.json")
    person = KnownPerson(keypoints, 1.0, (0.0, 0.0, 9.0, 9.0))
    return SourcePicture(np.zeros((*SIZE, 3), np.uint8), (person,) * people)


@dataclass
class Counting:
    """Work that numbers its batches; the first one takes the longest."""

    device: str = "cpu"
    batch: int = 2
    workers: int = 2
    cutter: Cutter = field(default_factory=Cutter)
    sizes: list[int] = field(default_factory=list)

    def find(self, pictures: Sequence[SourcePicture]) -> list[SourcePicture]:
        return [picture(1) for _ in pictures]

    def bodies(self, people: CutPeople) -> list[RowPart]:
        self.sizes.append(len(people))
        if len(self.sizes) == 1:
            time.sleep(0.05)
        return [RowPart(np.arange(len(people)), {"left": [crop.left for crop in people.crops]})]


def test_rows_come_in_the_order_of_pictures_and_batches_end_with_their_group() -> None:
    work, told = Counting(), list[str]()
    groups: list[list[Held]] = [
        [("a", picture(2)), ("b", picture(0)), ("c", picture(1))],
        [("d", InputError("torn")), ("e", SourcePicture(np.zeros((*SIZE, 3), np.uint8)))],
    ]
    with people_pool(work) as pool:
        first, second = (rows.each() for rows in group_rows(work, pool, groups, told.append))
    assert told == ["a", "b", "c", "d", "e"]
    assert [(row["picture"], row.get("person"), "left" in row) for row in first] == [
        ("a", 0, True),
        ("a", 1, True),
        ("b", None, False),
        ("c", 0, True),
    ]
    assert second[0] == {"picture": "d", "error": "torn"}
    assert (second[1]["picture"], "left" in second[1]) == ("e", True)  # who was not known was found
    assert sorted(work.sizes) == [1, 1, 2]


def test_one_person_alone_is_cut_out_if_asked_for() -> None:
    cut = Cutter(person=1).cut([("a", picture(3)), ("b", picture(1))], {})
    assert [row["person"] for row in cut.rows.each()] == [0, 1, 2, 0]
    ((numbers, people),) = cut.people
    assert (numbers.tolist(), len(people)) == ([1], 1)


def test_pictures_that_show_nobody_need_no_camera() -> None:
    def unknown(name: str, size: tuple[int, int]) -> None:
        raise InputError(f"{name}: no focal length")

    rows = Cutter(camera=unknown).cut([("a", picture(0)), ("b", picture(1))], {}).rows.each()
    assert [(row.get("people"), row.get("error")) for row in rows] == [(0, None), (None, "b: no focal length")]


def test_rows_one_by_one_have_what_their_parts_hold() -> None:
    rows = PeopleRows.of([{"picture": "a", "score": 0.5}, {"picture": "b"}, {"picture": "c", "score": None}])
    rows.parts.append(RowPart(np.array([2, 0]), {"box": np.array([[1.0, 2.0], [3.0, 4.0]]), "score": [0.25, 0.75]}))
    first, second, third = rows.each()
    assert (first["picture"], first["score"], first["box"].tolist()) == ("a", 0.75, [3.0, 4.0])
    assert second == {"picture": "b"}
    assert (third["score"], third["box"].tolist()) == (0.25, [1.0, 2.0])


def test_items_are_made_by_the_threads_of_a_pool() -> None:
    with people_pool(Counting()) as pool:
        assert list(made_by(pool, iter(range(1, 4)))) == [1, 2, 3]

        def broken() -> object:
            yield 1
            raise InputError("torn")

        with pytest.raises(InputError, match="torn"):
            list(made_by(pool, broken()))
