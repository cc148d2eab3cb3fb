"""Fits take perspective of the distance that the network says, where no camera is known and it was near."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from warp_partdr import FitOptions, fit_body
from warp_partdr.cameras import Crop, Perspective
from warp_partdr.evaluation.partbench.samples import FAR, NEAR, make_sample
from warp_partdr.evaluation.scoring import score_fit
from warp_partdr.fit.camera_guess import guess_camera
from warp_partdr.inputs.sample import Sample
from warp_partdr.network.checkpoint import packaged_network
from warp_partdr.network.predict import ask_network
from warp_partdr.results.save import describe_body

FAST = FitOptions.at("fast")


def fitted(sample: Sample, **changes):
    camera = changes.pop("camera", None)
    options = replace(FAST, **changes)
    return fit_body(sample.keypoints, sample.parts, others=sample.others, options=options, camera=camera)


@pytest.mark.parametrize(("nearness", "distance"), [(0.5, 2.0), (0.125, 8.0), (0.06, 10.0), (0.04, None)])
def test_the_guess_is_the_lens_that_shows_a_person_so_near_in_that_size(nearness, distance):
    seen = fitted(make_sample(0, NEAR), stages=(), guess_camera=False).observation
    predicted = ask_network([seen], packaged_network("cpu"))
    said = replace(predicted.uncertainty, nearness=torch.tensor([nearness]))
    crop = Crop(left=30.0, top=20.0, zoom=2.0, size=(256, 256))
    camera = guess_camera(replace(predicted, log_scale=torch.tensor([0.0]), uncertainty=said), crop, (300, 400), 20.0)
    if distance is None:
        assert camera is None
    else:  # a metre is a half side of the crop, 128 px of it, 64 px of the picture
        assert camera.intrinsics.tolist() == [pytest.approx([64 * distance, 64 * distance, 200.0, 150.0])]


def test_who_is_near_stands_before_a_guessed_camera_and_is_nearer_to_the_truth():
    errors = []
    for index in range(2, 8):
        near = make_sample(index, NEAR)
        guessed, weak = fitted(near), fitted(near, guess_camera=False)
        if not guessed.camera_guessed:  # the network does not see it of all
            continue
        assert isinstance(guessed.camera, Perspective)
        assert not weak.camera.perspective
        assert not weak.camera_guessed
        assert describe_body(guessed)["camera"]["guessed"] is True
        assert "guessed" not in describe_body(weak)["camera"]
        errors.append([score_fit(near, "", each, 0.0).pa_mpjpe for each in (guessed, weak)])
    assert len(errors) >= 3
    better, without = np.mean(errors, axis=0)
    assert better < without - 2.0


def test_nothing_is_guessed_of_others():
    with pytest.raises(ValueError, match=r"guess_within: 0\.0"):
        FitOptions(guess_within=0.0)
    near, far = make_sample(2, NEAR), make_sample(0, FAR)
    assert not fitted(far).camera.perspective
    assert not fitted(near, camera=near.camera).camera_guessed
    assert not fitted(near, guess_within=0.5).camera.perspective
    assert not fitted(replace(near, parts=None)).camera_guessed  # the picture's size is not known
    assert not fitted(near, start="search", stages=FAST.search[:1]).camera_guessed
