"""Hypotheses are all that a picture of bones of known length allows."""

import numpy as np
import torch
from test_fitting import observation_of, walker

from warp_partdr.fit.start_search import _ACROSS, _JOINTS, _LIMBS, _TRUNK, AMBIGUOUS, hypothesize, rest_positions


def test_hypotheses_hold_every_way_of_every_bone():
    """Each bone has its own length, and whatever points toward the camera in one points away from it in another."""
    starts, targets, known = hypothesize(observation_of(walker(), "cpu"), 10**6)
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
    seen = observation_of(walker(), "cpu")
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
