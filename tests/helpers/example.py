"""The packaged example: a photo of one person with keypoints and part labels, read once a session.

Tests must not write into what these functions return.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from helpers.files import EXAMPLE
from warp_partdr.body.labels import BACKGROUND, label_set
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.part_labels import PartLabels, read_parts, read_photo


@cache
def example_photo() -> np.ndarray:
    """The photo, RGB, shape (512, 384, 3), uint8."""
    return read_photo(EXAMPLE / "photo.png")


@cache
def example_keypoints() -> Keypoints2D:
    """Keypoints of the person, in COCO's format."""
    return read_keypoints(EXAMPLE / "keypoints.json")[0]


@cache
def example_parts() -> PartLabels:
    """Part labels of the person, in the label set cdcl14."""
    return read_parts(EXAMPLE / "parts.png", label_set("cdcl14"))


@cache
def example_mask() -> np.ndarray:
    """Mask of the person's pixels, shape (512, 384), bool."""
    return example_parts().groups != BACKGROUND
