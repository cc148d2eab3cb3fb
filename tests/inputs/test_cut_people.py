"""People stacked as arrays: the same as one by one, to the network, to a refinement, and when asked for again."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from helpers.example import example_keypoints, example_parts

from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.cameras import Perspective
from warp_partdr.inputs.cut_people import CutPeople, CutPerson, batch_people
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import crop_evidence
from warp_partdr.inputs.observations import Observations
from warp_partdr.networks.regression.predict import network_inputs
from warp_partdr.solve.ellipsoids.batch import Batch
from warp_partdr.solve.ellipsoids.energy import Energy

KEYPOINTS = example_keypoints()
PARTS = example_parts()


def without(*missing: int) -> Keypoints2D:
    confidence = KEYPOINTS.confidence.copy()
    confidence[list(missing)] = 0.0
    return replace(KEYPOINTS, confidence=confidence)


def cut(keypoints: Keypoints2D, device: str, labels: bool, fov: float | None = None) -> CutPerson:
    camera = None if fov is None else Perspective.of_picture(PARTS.groups.shape, fov=fov)
    evidence = weigh_evidence(keypoints, PARTS if labels else None)[0]
    return CutPerson(evidence, *crop_evidence(evidence, device=device, camera=camera))


@pytest.fixture(params=["labels", "camera, without labels", "body25's big toes, some missing"])
def people(request: pytest.FixtureRequest, device: str) -> list[CutPerson]:
    if request.param.startswith("body25"):
        places = np.random.default_rng(0).uniform(0, 400, (25, 2)).astype(np.float32)
        missing = np.ones((3, 25), dtype=np.float32)
        missing[1, [3, 19]] = missing[2, [0, 14, 24]] = 0.0
        return [cut(Keypoints2D("body25", places, each), device, labels=False) for each in missing]
    fov = 50.0 if "camera" in request.param else None
    given = KEYPOINTS, without(9), without(0, 10, 15)
    return [cut(each, device, request.param == "labels", fov) for each in given]


def assert_same(one: object, other: object) -> None:
    for field in fields(one):  # type: ignore[arg-type]
        values = getattr(one, field.name), getattr(other, field.name)
        if isinstance(values[0], torch.Tensor):
            assert torch.equal(*values), field.name
        else:
            assert values[0] == values[1], field.name


def test_joined_people_come_back_one_by_one(people: list[CutPerson]) -> None:
    stacked = CutPeople.joined([CutPeople.of(people[:1]), CutPeople.of(people[1:])])
    assert stacked.batch_key == people[0].batch_key
    for given, found in zip(people, stacked, strict=True):
        assert_same(given.observation, found.observation)
        assert given.crop == found.crop
        assert given.evidence.window == found.evidence.window
        assert given.evidence.warnings == found.evidence.warnings
        assert np.array_equal(given.evidence.keypoints.points, found.evidence.keypoints.points)


def test_network_and_refinement_read_the_same(people: list[CutPerson], device: str) -> None:
    stacked, prior = CutPeople.of(people).observations, PosePrior().to(device)
    together, of_all = network_inputs(stacked, 64), Batch.of(Energy(stacked, 64, prior=prior))
    for row, person in enumerate(people):
        alone = Observations.of([person.observation])
        for given, found in zip(network_inputs(alone, 64), together, strict=True):
            assert torch.equal(given[0], found[row])
        of_one, own = Batch.of(Energy(alone, 64, prior=prior)), of_all.select(slice(row, row + 1))
        assert_same(replace(of_one, visible=own.visible), own)


def test_people_whose_observations_differ_in_kind_are_stacked_apart(device: str) -> None:
    kinds = [(True, None), (False, None), (True, 50.0), (True, None)]
    people = [cut(KEYPOINTS, device, *kind) for kind in kinds]
    assert [places for places, _ in batch_people(people)] == [[0, 3], [1], [2]]
    assert batch_people([]) == []
