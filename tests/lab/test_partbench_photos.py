"""PartBench's level "photo": what the packaged detector finds in people's pictures, and the truth of other levels."""

from __future__ import annotations

import numpy as np
import pytest

from warp_partdr.body.labels import IGNORE
from warp_partdr.errors import InputError
from warp_partdr.lab.evaluation.partbench import photos
from warp_partdr.lab.evaluation.partbench.methods import METHODS
from warp_partdr.lab.evaluation.partbench.photos import PHOTO, TRIES, find_in_photo, shade_person
from warp_partdr.lab.evaluation.partbench.report import draw_case
from warp_partdr.lab.evaluation.partbench.samples import LABELS, make_sample, partbench_samples, source_name
from warp_partdr.lab.evaluation.scoring import score_fit
from warp_partdr.lab.synthetic.partbench_people import COCO, make_person
from warp_partdr.networks.detection.people import find_people


def test_photos_show_the_people_of_other_levels_and_nothing_else_is_given() -> None:
    for index in (0, 3):
        (sample,), clean = partbench_samples(index + 1, [PHOTO])[index:], make_sample(index, "clean")
        assert (sample.source, sample.name) == (source_name(PHOTO), clean.name)
        for name in ("target", "joints", "vertices"):
            np.testing.assert_array_equal(getattr(sample, name), getattr(clean, name))
        assert sample.target_set == LABELS
        assert sample.keypoints.skeleton == "blazepose33"
        assert sample.parts is not None
        assert sample.parts.label_set.name == "ellipbody20"
        assert sample.others == ()
        groups, true = sample.parts.groups, sample.target > 0
        mine, known = groups > 0, groups != IGNORE
        assert (mine & true)[known].sum() > 0.85 * (mine | true)[known].sum()
        assert known.mean() > 0.95
        person, names = make_person(index), sample.keypoints.format.landmarks
        found = sample.keypoints.points[[names.index(name) for name in COCO.landmarks]]
        off = np.linalg.norm(found - person.keypoints(), axis=1) / person.height
        assert 0 < np.median(off) < 0.04


def test_keypoints_are_those_that_the_detector_finds() -> None:
    sample = make_sample(0, PHOTO)
    assert isinstance(sample.picture, np.ndarray)
    np.testing.assert_array_equal(sample.picture, shade_person(0))
    person = find_people(sample.picture, landmarks="heavy")[0]
    np.testing.assert_array_equal(sample.keypoints.points, person.keypoints.points)
    np.testing.assert_array_equal(sample.keypoints.confidence, person.keypoints.confidence)


def test_parts_are_scored_though_a_fit_sees_the_mask_alone() -> None:
    sample = make_sample(0, PHOTO)
    result = METHODS["network"].fit_sample(sample, "cpu")
    score = score_fit(sample, "network", result, 0.0)
    assert score.pixels is not None
    assert score.pixels.classes == score_fit(make_sample(0, "clean"), "network", result, 0.0).pixels.classes  # type: ignore[union-attr]
    assert score.pixels.parts.shape == (7, 7)
    assert score.pa_mpjpe < 80
    assert draw_case(sample, result).height == sample.target.shape[0]  # type: ignore[union-attr]


def test_where_nobody_is_found_another_photo_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    first, tried = photos.person_in_photo, []

    def look(photo: np.ndarray) -> object:
        tried.append(photo)
        if len(tried) < 3:
            raise InputError("photo: nobody found in it")
        return first(photo)

    monkeypatch.setattr(photos, "person_in_photo", look)
    found, before = find_in_photo.__wrapped__(0)
    assert before == 2
    assert found.photo is tried[2]
    assert not any(np.array_equal(tried[0], other) for other in tried[1:])

    def find_nobody(photo: np.ndarray) -> object:
        raise InputError("photo: nobody found in it")

    monkeypatch.setattr(photos, "person_in_photo", find_nobody)
    monkeypatch.setattr(photos, "shade_person", lambda index, attempt: np.zeros((8, 8, 3), dtype=np.uint8))
    with pytest.raises(InputError, match=f"person 0: found in none of {TRIES} photos"):
        find_in_photo.__wrapped__(0)
