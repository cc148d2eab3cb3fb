"""Observations of many people as arrays of all: each is what it was alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from warp_partdr.body.labels import label_set
from warp_partdr.body.skeletons import skeleton
from warp_partdr.cameras import Perspective
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import Observation, crop_evidence
from warp_partdr.inputs.observations import Observations
from warp_partdr.inputs.part_labels import PartLabels

COCO = skeleton("coco17")
LABELS, SIDE = label_set("full1"), 64  # [px] of labels that are kept


@pytest.fixture
def people(rng) -> list[Observation]:
    """Five people before one camera, of whom some keypoints are missing."""
    camera = Perspective.of_picture((240, 320), focal=300)
    seen = []
    for number in range(5):
        points = rng.uniform((60, 40), (260, 200), (17, 2)).astype(np.float32)
        confidence = rng.uniform(0.5, 1.0, 17).astype(np.float32)
        confidence[rng.permutation(17)[:number]] = 0
        points[confidence == 0] = 0
        keypoints = Keypoints2D("coco17", points, confidence)
        groups = np.zeros((240, 320), dtype=np.uint8)
        groups[40:200, 60:260] = 1
        (evidence,) = weigh_evidence(keypoints, PartLabels(LABELS, groups))
        seen.append(crop_evidence(evidence, camera=camera, label_size=SIDE)[0])
    return seen


def assert_same(one: Observation, other: Observation) -> None:
    assert (one.landmarks, one.marks, one.label_set) == (other.landmarks, other.marks, other.label_set)
    for name in ("points", "confidence", "labels", "lens"):
        assert torch.equal(getattr(one, name), getattr(other, name)), name


def test_each_stacked_observation_is_what_it_was_alone(people):
    seen = people
    stacked = Observations.of(seen, COCO)
    assert len(stacked) == 5
    assert stacked.points.shape == (5, 17, 2)
    assert not stacked.points[~torch.from_numpy(stacked.visible)].any()
    for row, alone in enumerate(seen):
        assert_same(stacked[row], alone)
    some = stacked.select(slice(1, 4))
    for row in range(3):
        assert_same(some[row], seen[1 + row])


def test_joined_parts_are_the_same_as_all_at_once(people):
    seen = people
    whole = Observations.of(seen, COCO)
    parts = [Observations.of(seen[some], COCO) for some in (slice(0, 2), slice(2, 3), slice(3, 5))]
    joined = Observations.joined(parts)
    assert len(joined) == 5
    for row in range(5):
        assert_same(joined[row], whole[row])


def test_labels_of_two_sizes_get_the_larger_one(people):
    seen = people
    small = replace(seen[1], labels=seen[1].labels[::2, ::2].contiguous())
    both = [seen[0], small]
    for stacked in (
        Observations.of(both, COCO),
        Observations.joined([Observations.of([one], COCO) for one in both]),
    ):
        assert stacked.labels.shape == (2, SIDE, SIDE)
        assert torch.equal(stacked.labels[0], seen[0].labels)
        assert torch.equal(stacked.labels[1][::2, ::2], small.labels)
