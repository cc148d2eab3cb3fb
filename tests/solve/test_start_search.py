"""The search's hypotheses are all that a picture of bones of known length allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from helpers.bodies import observation_of, walker

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.inputs.observation import Observation
from warp_partdr.solve.ellipsoids.start_search import (
    _ACROSS,
    _JOINTS,
    _LIMBS,
    _TRUNK,
    AMBIGUOUS,
    distinct,
    hypothesize,
    rest_positions,
)


def test_hypotheses_hold_every_way_of_every_bone():
    """Each bone has its own length, and whatever points toward the camera in one points away from it in another."""
    starts, targets, known = hypothesize(observation_of(walker()), 10**6)
    assert known.all()
    scale, rest = float(starts.log_scale[0].exp()), rest_positions("cpu")
    places = {name: targets[:, index].numpy() for index, name in enumerate(_JOINTS)}
    ambiguous = 0
    for pair in (*_LIMBS, *_ACROSS):
        way = places[pair[1]] - places[pair[0]]
        full = scale * np.linalg.norm(rest[pair[1]] - rest[pair[0]])
        if np.sqrt(max(full**2 - np.square(way[0, :2]).sum(), 0.0)) > AMBIGUOUS * full:
            np.testing.assert_allclose(np.linalg.norm(way, axis=1), full, rtol=1e-4)
            assert {-1.0, 1.0} == set(np.sign(way[:, 2]).tolist())
            ambiguous += 1
        else:
            np.testing.assert_allclose(way[:, 2], 0.0, atol=1e-6)
    assert ambiguous >= 4
    for middle, (left, right) in zip(_TRUNK, _ACROSS, strict=True):
        np.testing.assert_allclose((places[left] + places[right])[:, 2] / 2, places[middle][:, 2], atol=1e-6)


def test_what_is_seen_from_behind_is_a_hypothesis_too():
    """A weak camera sees a body and its mirror image in depth alike, so the hypotheses are mirrored into themselves."""
    seen = observation_of(walker())
    # A trunk that looks too short leans.
    points = seen.points.clone()
    for index, name in enumerate(seen.landmarks):
        if name.endswith(("shoulder", "elbow", "wrist")) or name in ("nose",):
            points[index, 1] += 0.35
    seen = type(seen)(seen.landmarks, points, seen.confidence, None, None)
    _, targets, _ = hypothesize(seen, 10**6)
    depths = targets[:, :, 2]
    assert len(depths[:, _JOINTS.index("neck")].unique()) == 3  # upright, and leaning either way
    ways = {tuple(row) for row in depths.mul(1e4).round().int().tolist()}
    assert {tuple(-value for value in row) for row in ways} == ways
    assert torch.isfinite(depths).all()


def test_hypotheses_hold_the_truth():
    """One of the hypotheses has every joint on the right side of the body in depth."""
    body = walker()
    seen = observation_of(body)
    starts, targets, known = hypothesize(seen, 4096)
    assert known.all()
    assert starts.batch_size > 1
    truth = LandmarkGather(_JOINTS, "cpu")(body.posed())[0]
    truth = (truth - truth[:1])[:, 2] * body.log_scale.exp()
    errors = (targets[:, :, 2] - truth).abs().mean(1)
    assert errors.min() < 0.06
    assert errors.max() > 3 * errors.min()
    few, _, _ = hypothesize(seen, 1)
    assert few.batch_size == 1


def test_hypotheses_without_a_trunk_are_finite():
    names = ("left_knee", "left_ankle")
    seen = Observation(names, torch.tensor([[0.0, 0.0], [0.1, 0.5]]), torch.ones(2), None, None)
    starts, targets, known = hypothesize(seen, 16)
    assert torch.isfinite(targets).all()
    assert torch.isfinite(starts.orientation).all()
    assert known.sum() == 2


def test_distinct_keeps_the_best_of_equals():
    body = walker()
    other = replace(body, rotations=body.rotations + 0.5)
    three = BodyParameters(**{n: torch.cat([t, t + 1e-5, other.tensors()[n]]) for n, t in body.tensors().items()})
    assert distinct(three, torch.tensor([2.0, 1.0, 3.0]), 3).tolist() == [1, 2]
