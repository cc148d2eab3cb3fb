"""Confidence in the bodies of films beside their true errors."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers.motions import COUNT, made_fit, with_confidence

from warp_partdr.body.skeletons import BODY_LANDMARKS
from warp_partdr.errors import InputError
from warp_partdr.lab.evaluation.datasets.views import Views
from warp_partdr.lab.measurements.film_confidence import figures, stated_and_true
from warp_partdr.pipelines.film import FilmFit

STEP = 0.01  # [m], error that each frame has more than the one before


def true_views(fit: FilmFit, person: int, way: tuple[float, float, float]) -> Views:
    """True joints of a person whose shoulders are moved by an error that grows from frame to frame."""
    motion = fit.motions[person]
    with torch.no_grad():
        joints = motion.model.landmarks(motion.bodies().detailed, BODY_LANDMARKS)
    keypoints = fit.camera.project(joints)[..., :2].numpy()
    errors = np.zeros(joints.shape)
    left, right = (BODY_LANDMARKS.index(f"{side}_shoulder") for side in ("left", "right"))
    errors[:, left] = 6 * STEP * motion.frames[:, None] * np.array(way)
    errors[:, right] = -errors[:, left]  # so the mean stays
    count = len(motion.frames)
    return Views(
        joint_names=np.array(BODY_LANDMARKS),
        joints_camera=joints.numpy() + errors,
        keypoints=keypoints,
        person=np.full(count, "0"),
        set=np.full(count, "made"),
        film=np.full(count, "walk.mp4"),
        film_frame=motion.frames,
        frame=motion.frames,
    )


@pytest.mark.parametrize("way", [(0.0, 0.0, 1.0), (0.6, 0.8, 0.0)])
def test_errors_are_those_of_the_person_whose_joints_are_known(way: tuple[float, float, float]) -> None:
    fit = with_confidence(made_fit())
    stated, errors = stated_and_true(fit, true_views(fit, 1, way), "walk.mp4")
    frames = [frame for frame in fit.motions[1].frames if frame != 12]
    np.testing.assert_allclose(stated, 0.6)
    np.testing.assert_allclose(errors, STEP * np.array(frames), atol=1e-6)
    with pytest.raises(InputError, match=r"other\.mp4: no frame with a body and known joints"):
        stated_and_true(fit, true_views(fit, 1, way), "other.mp4")


def test_figures_say_how_well_confidence_tells_errors() -> None:
    errors = np.linspace(0.0, 0.18, COUNT)
    count, median, mean, right, area, correlation = figures(np.stack([1 - errors, errors]))
    assert (count, median, mean, right) == (COUNT, pytest.approx(90), pytest.approx(0.91), pytest.approx(11 / COUNT))
    assert (area, correlation) == (1.0, pytest.approx(-1.0))
    assert figures(np.stack([errors, errors]))[-2:] == (0.0, pytest.approx(1.0))
