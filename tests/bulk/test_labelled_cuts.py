"""People of part labels, cut out of pictures together: of each what is cut out alone, and faults in their own rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from warp_partdr.body.labels import label_set
from warp_partdr.bulk import cutting
from warp_partdr.bulk.cutting import Cut, Cutter, one_line
from warp_partdr.bulk.sources import KnownPerson, SourcePicture
from warp_partdr.errors import InputError
from warp_partdr.inputs.cut_people import CutPerson
from warp_partdr.inputs.evidence import PicturePerson
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.lab.evaluation.partbench.samples import make_sample

# In small pictures; left and right of some are exchanged.
SAMPLES = [make_sample(index, "hard") for index in (0, 1, 3, 10, 12, 14, 16, 17, 19, 21, 22, 25)]
FAULTY = {2: "no labelled pixel along the person's bones", 5: "or near them", 7: "no such file"}


def pictures() -> list[tuple[str, SourcePicture | Exception]]:
    """The samples, of whom one has labels elsewhere, one lies beyond the picture, one can't be read, one no labels."""
    held: list[tuple[str, SourcePicture | Exception]] = []
    for number, sample in enumerate(SAMPLES):
        assert sample.parts is not None
        keypoints, parts = sample.keypoints, sample.parts
        if number == 2:
            groups = np.zeros_like(parts.groups)
            groups[:4, :4] = 1
            parts = PartLabels(parts.label_set, groups)
        if number == 5:
            keypoints = Keypoints2D(keypoints.skeleton, keypoints.points + np.float32(1e4), keypoints.confidence)
        people = tuple(KnownPerson(each, 1.0, (0.0, 0.0, 1.0, 1.0)) for each in (keypoints, *sample.others))
        seen = SourcePicture(np.zeros((*sample.parts.groups.shape, 3), np.uint8), people, parts=parts)
        if number == 9:
            seen = replace(seen, parts=None)
        held.append((f"{number}.jpg", InputError("no such file") if number == 7 else seen))
    return held


def told(cut: Cut) -> dict[int, str]:
    return {
        int(row): str(error)
        for part in cut.rows.parts
        if "error" in part.columns
        for row, error in zip(part.rows, part.columns["error"], strict=True)
    }


@pytest.mark.parametrize("size", [640, 128])
def test_people_cut_out_together_are_as_alone(size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    cutter, held = Cutter(label_size=size), pictures()
    cut = cutter.cut(held, {})
    together = cutting.cut_out_people

    def failing(people: Sequence[PicturePerson], *given: object) -> list[CutPerson | InputError]:
        """It fails as if memory held one person."""
        if len(people) > 1:
            raise MemoryError("no memory")
        return together(people, *given)

    monkeypatch.setattr(cutting, "cut_out_people", failing)
    same = cutter.cut(held, {})
    assert told(cut) == told(same)
    kinds = [(people.skeleton, people.observations.labels is None) for _, people in cut.people]
    assert len(kinds) == len(set(kinds)) == len(same.people)  # a batch for each format, with labels and without
    assert {without for _, without in kinds} == {True, False}
    for (places, people), (others, expected) in zip(cut.people, same.people, strict=True):
        np.testing.assert_array_equal(places, others)
        assert (people.crops, people.windows, people.warnings) == (expected.crops, expected.windows, expected.warnings)
        np.testing.assert_array_equal(people.observations.points, expected.observations.points)
        np.testing.assert_array_equal(people.observations.confidence, expected.observations.confidence)
        assert (people.observations.labels is None) == (expected.observations.labels is None)
        if people.observations.labels is not None and expected.observations.labels is not None:
            assert people.observations.labels.shape[1:] == (size, size)
            np.testing.assert_array_equal(people.observations.labels, expected.observations.labels)


def test_whoever_is_at_fault_has_an_error_and_nobody_else() -> None:
    held = pictures()
    cut = Cutter(label_size=128).cut(held, {})
    names = [
        name
        for name, seen in held
        for _ in range(len(seen.people) if isinstance(seen, SourcePicture) and seen.people else 1)
    ]
    first = {number: names.index(f"{number}.jpg") for number in FAULTY}
    errors = told(cut)
    assert [names[row] for row in errors if row not in first.values()] == ["2.jpg"] * (names.count("2.jpg") - 1)
    for number, says in FAULTY.items():
        assert says in errors[first[number]]
    fitted = sorted(int(place) for places, _ in cut.people for place in places)
    assert fitted == sorted(set(range(len(names))) - errors.keys())


def test_labels_whose_ids_are_the_groups_are_taken_as_they_are() -> None:
    known = label_set("ellipbody20")
    ids = np.array([[0, 1, 20, 255]], dtype=np.uint8)
    groups = known.to_groups(ids)
    np.testing.assert_array_equal(groups, known.to_groups(ids.astype(np.int32)))
    assert not np.shares_memory(groups, ids)
    for strange in (21, 254):
        with pytest.raises(ValueError, match=rf"labels: ids {strange} not in ellipbody20"):
            known.to_groups(np.array([strange, 1], dtype=np.uint8))
    assert label_set("densepose24").to_groups(ids[:, :2]).tolist() == [[0, label_set("densepose24").id_groups[1]]]


def test_an_error_is_one_line() -> None:
    assert one_line(InputError("photo.png: cut off;\n  expected a picture")) == "photo.png: cut off; expected a picture"
    assert one_line(ValueError("\n")) == "ValueError: ValueError"
    assert len(one_line(RuntimeError(900 * "x"))) == 300
