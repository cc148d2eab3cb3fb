"""Keypoints at the joints of data sets that lie elsewhere are moved to where networks expect them."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from helpers.bodies import seen_by, walker

from warp_partdr.body.landmarks import CONVENTIONS
from warp_partdr.body.lens import place_bodies, turn_to_rays
from warp_partdr.body.skeletons import SKELETONS
from warp_partdr.inputs.observation import Observation, observe
from warp_partdr.inputs.observations import Observations
from warp_partdr.networks.regression.checkpoint import load_label_network
from warp_partdr.networks.regression.conventions import keypoints_at_landmarks, lies_elsewhere
from warp_partdr.networks.regression.predict import ask_network
from warp_partdr.networks.regression.predicted import posed_landmarks


def test_the_formats_whose_points_lie_off_the_landmarks_are_known():
    assert lies_elsewhere(("left_hip", "h36m_neck"))
    assert not lies_elsewhere(("left_hip", "coco_left_hip", "neck"))
    assert {name for name, form in SKELETONS.items() if lies_elsewhere(form.marks)} == {"h36m17", "shelf14"}
    assert set(CONVENTIONS) == {"h36m", "shelf"}


@pytest.mark.parametrize("lens", [None, (2.5, 0.3, -0.2)])
def test_keypoints_move_by_what_lies_between_both_points_of_the_first_body(lens):
    network = load_label_network()
    seen = replace(observe(*seen_by(walker()))[0], lens=None if lens is None else torch.tensor(lens))
    plain = _joints(seen)
    assert keypoints_at_landmarks(Observations.of([plain]), ask_network(Observations.of([plain]), network)) is None

    first = ask_network(Observations.of([plain]), network)
    bodies = first.parameters() if lens is None else turn_to_rays(first.parameters(), seen.lens)
    posed, camera = place_bodies(bodies, bodies.posed(), seen.lens, 2)
    form = SKELETONS["h36m17"]
    ends, starts = (camera.project(posed_landmarks(posed, names))[0, :, :2] for names in (form.marks, form.landmarks))
    seen = replace(plain, landmarks=form.landmarks, marks=form.marks, points=ends)
    seen = replace(seen, confidence=torch.ones(len(form)))
    moved = keypoints_at_landmarks(Observations.of([seen]), first)
    assert torch.allclose(moved.points[0], starts, atol=1e-5)
    assert (ends - starts).norm(dim=1).max() > 0.03


def _joints(seen: Observation) -> Observation:
    """Keypoints without labels, before no lens."""
    return replace(seen, labels=None, label_set=None, marks=None)
