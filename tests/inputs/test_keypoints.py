"""Keypoints that are to be relied on, the stature that bones tell, and many people side by side."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.body.skeletons import skeleton
from warp_partdr.inputs.keypoint_files import parse_keypoints
from warp_partdr.inputs.keypoints import MIN_CONFIDENCE, Keypoints2D, choose_person, person_height

COCO = skeleton("coco17").landmarks


def test_confidence_of_the_least_is_enough():
    confidence = np.full(17, 0.9, np.float32)
    confidence[0] = MIN_CONFIDENCE
    confidence[1] = np.nextafter(np.float32(MIN_CONFIDENCE), np.float32(0.0))
    confidence[2] = 0.0
    keypoints = Keypoints2D("coco17", np.zeros((17, 2), np.float32), confidence)
    assert keypoints.confident[:3].tolist() == [True, False, False]
    assert keypoints.visible[:3].tolist() == [True, True, False]
    doubtful = Keypoints2D("coco17", keypoints.points, np.minimum(confidence, np.float32(0.2)))
    np.testing.assert_array_equal(doubtful.confident, doubtful.visible)  # then any will do


@pytest.mark.parametrize("bone", ["shoulder-hip", "hip-knee", "knee-ankle", "shoulder-elbow", "elbow-wrist"])
def test_bones_are_the_mean_bodys_shares_of_its_height(bone):
    """Whichever bone alone is seen, the mean adult is as tall as it stands, from its soles to the top of its head."""
    body, scale = BodyParameters.mean(1), 100.0
    posed = body.posed()
    stature = float(np.ptp(posed.vertices(3)[0, :, 1].numpy()))
    points = scale * LandmarkGather(COCO, "cpu")(posed)[0, :, :2].numpy()
    confidence = np.zeros(17, np.float32)
    for end in bone.split("-"):
        confidence[[COCO.index(f"{side}_{end}") for side in ("left", "right")]] = 1
    keypoints = Keypoints2D("coco17", points.astype(np.float32), confidence)
    assert person_height(keypoints) == pytest.approx(scale * stature, rel=0.05)
    assert torch.isfinite(posed.joints).all()


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
    for _ in range(50):
        confidence = (rng.random(17) * (rng.random(17) < 0.7)).astype(np.float32)
        person = Keypoints2D("coco17", (rng.random((17, 2)) * 300).astype(np.float32), confidence)
        told = []
        for bone, share in shares.items():
            for side in ("left", "right"):
                start, end = (COCO.index(f"{side}_{joint}") for joint in bone.split("-"))
                if person.confident[[start, end]].all():
                    told.append(np.linalg.norm(person.points[start] - person.points[end]) / share)
        if told:
            assert person_height(person) == pytest.approx(np.quantile(told, 0.75), rel=1e-6)
    face = Keypoints2D("coco17", person.points, (np.arange(17) < 5).astype(np.float32))
    assert person_height(face) == pytest.approx(np.ptp(person.points[:5], axis=0).max())  # no bone is seen
