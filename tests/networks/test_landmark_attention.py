"""Attention between landmarks: what each is shown of the picture, and whom it hears."""

from __future__ import annotations

import pytest
import torch

from warp_partdr.networks.regression.heads import cell_centres
from warp_partdr.networks.regression.landmark_attention import NUM_SAID, LandmarkAttention, at_keypoints
from warp_partdr.networks.regression.landmarks import LANDMARKS


def keypoints_at(*places: tuple[float, float, float]) -> torch.Tensor:
    """One person's keypoints, those at the end missing."""
    keypoints = torch.zeros(1, len(LANDMARKS), 3)
    keypoints[0, : len(places)] = torch.tensor(places)
    return keypoints


def test_landmarks_are_shown_what_lies_at_their_keypoints(device):
    keypoints = keypoints_at((0.25, -0.5, 0.9), (-0.1, 0.6, 0.2), (3.0, 0.0, 1.0)).to(device)
    ramps = []  # maps of two sizes, whose values are the crop coordinates
    for size in (8, 16):
        across = cell_centres(size, device).expand(1, size, size)
        ramps.append(torch.stack([across, across.mT], dim=1))
    shown = at_keypoints(ramps, keypoints)
    assert shown.shape == (1, len(LANDMARKS), 4)
    torch.testing.assert_close(shown[0, :2], keypoints[0, :2, [0, 1, 0, 1]])
    assert (shown[0, 2:] == 0).all()  # one outside of the picture, and those that are missing


@pytest.mark.parametrize("asked", range(4))
def test_each_landmark_hears_of_the_others_and_of_the_picture(asked, device):
    torch.manual_seed(0)
    attention = LandmarkAttention([2, 3], 7, width=8, layers=1).to(device).eval()
    maps = [torch.rand(1, 2, 8, 8, device=device), torch.rand(1, 3, 4, 4, device=device)]
    keypoints, conditions = keypoints_at((0.1, 0.2, 1.0), (0.5, 0.5, 1.0)).to(device), torch.zeros(1, 4, device=device)
    moved, other = keypoints.clone(), [each.clone() for each in maps]
    moved[0, 1, 0] -= 0.3
    other[1][0, :, 3, 2:] += 1.0  # about the second keypoint
    before = attention(maps, keypoints, conditions)
    assert before.shape == (1, NUM_SAID)
    for changed in (
        attention(maps, moved, conditions),
        attention(other, keypoints, conditions),
        attention(maps, keypoints, conditions + 1),
    ):
        assert ((changed - before).view(len(LANDMARKS), -1)[asked].abs() > 1e-5).any()
