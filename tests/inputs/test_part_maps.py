"""Probability maps as networks write them, and the box around a person's labels."""

import numpy as np
import pytest

from warp_partdr.errors import InputError
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.part_labels import read_label_set, read_parts
from warp_partdr.inputs.person import person_crop


@pytest.mark.parametrize(("total", "taken"), [(0.995, True), (1.005, True), (0.95, False), (1.05, False)])
def test_probabilities_add_up_to_one_but_for_rounding(total, taken, tmp_path):
    maps = np.full((15, 6, 5), 0.02, np.float32)
    for channel, rows in ((0, slice(0, 2)), (1, slice(2, 4)), (2, slice(4, 6))):  # background, head and torso
        maps[channel, rows] = 0.72
    maps[:, 1, 1] *= total  # at one pixel
    np.save(tmp_path / "soft.npy", maps)
    if taken:
        assert read_parts(tmp_path / "soft.npy", read_label_set("cdcl14")).maps is not None
    else:
        with pytest.raises(InputError, match=r"class probabilities add up to .*; expected 1 at each pixel"):
            read_parts(tmp_path / "soft.npy", read_label_set("cdcl14"))


def test_a_box_without_a_margin_holds_the_labels_and_no_more():
    groups = np.zeros((30, 40), np.uint8)
    groups[5:21, 7:12], groups[2, 3] = 1, 255
    points = np.full((17, 2), 10.5, np.float32)
    keypoints = Keypoints2D("coco17", points, np.ones(17, np.float32))
    assert person_crop(keypoints, groups, margin=0.0) == (7, 5, 12, 21)
    points[0] = [2.25, 24.5]
    assert person_crop(keypoints, groups, margin=0.0) == (2, 5, 12, 25)
