"""Many people in one file are read and compared side by side, as each alone would be."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from warp_partdr.body.skeletons import SKELETONS
from warp_partdr.inputs.keypoint_files import parse_keypoints
from warp_partdr.inputs.keypoints import Keypoints2D, choose_person, person_height


def test_many_people_are_read_as_each_alone(rng: np.random.Generator) -> None:
    """People are looked at side by side; flat lists, rows and missing keypoints in one file."""
    data: list[Any] = []
    for index in range(60):
        values: list[Any] = (rng.random((17, 3)) * [300, 300, 1]).tolist()
        for joint in rng.choice(17, 5, replace=False).tolist():
            values[joint] = [None, [0.0, 0.0, 0.0], [math.nan] * 3][joint % 3]
        if index % 3 == 0:
            values = [row[:2] if row else row for row in values]
        if index % 3 == 1:
            values = [value for row in values for value in row or [0.0] * 3]
        data.append({"keypoints": values, "format": "coco17"})
    people = parse_keypoints(data)
    assert len(people) == 60
    for person, entry in zip(people, data, strict=True):
        (alone,) = parse_keypoints(entry)
        np.testing.assert_array_equal(person.points, alone.points)
        np.testing.assert_array_equal(person.confidence, alone.confidence)
    groups = (rng.random((300, 300)) < 0.5).astype(np.uint8)
    for labels in (None, groups):
        chosen = choose_person(people, labels)
        assert all(choose_person([chosen, person], labels) is chosen for person in people)


def test_height_is_the_upper_quartile_of_what_long_bones_say(rng: np.random.Generator) -> None:
    shares = {"shoulder-hip": 0.27, "hip-knee": 0.24, "knee-ankle": 0.247}
    landmarks = SKELETONS["coco17"].landmarks
    for _ in range(50):
        confidence = (rng.random(17) * (rng.random(17) < 0.7)).astype(np.float32)
        person = Keypoints2D("coco17", (rng.random((17, 2)) * 300).astype(np.float32), confidence)
        told = []
        for bone, share in shares.items():
            for side in ("left", "right"):
                start, end = (landmarks.index(f"{side}_{joint}") for joint in bone.split("-"))
                if person.confident[[start, end]].all():
                    told.append(np.linalg.norm(person.points[start] - person.points[end]) / share)
        if told:
            assert person_height(person) == pytest.approx(np.quantile(told, 0.75), rel=1e-6)
