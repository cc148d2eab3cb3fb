"""Keypoints that are to be relied on, and the stature that each bone tells."""

import numpy as np
import pytest
import torch

from warp_partdr.body.skeletons import skeleton
from warp_partdr.energy import LandmarkGather
from warp_partdr.keypoints import MIN_CONFIDENCE, Keypoints2D, person_height
from warp_partdr.parameters import BodyParameters

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
