"""Peaks of heat maps."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from helpers.checkpoints import knowing_vitpose

from warp_partdr.networks.predictors.checkpoints import load_keypoint_network
from warp_partdr.networks.predictors.heat_maps import find_peaks


def gaussians(centres: np.ndarray, size: tuple[int, int], spread: float = 2.0) -> torch.Tensor:
    """Maps (N, K, h, w) of heat about centres (N, K, 2), column and row, as keypoint networks learn them."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    squares = (columns - centres[..., :1, None]) ** 2 + (rows - centres[..., 1:, None]) ** 2
    return torch.from_numpy(np.exp(-squares / (2 * spread**2))).float()


def test_peaks_are_finer_than_cells(rng: np.random.Generator) -> None:
    centres = rng.uniform(6, 40, (2, 17, 2))
    peaks = find_peaks(0.8 * gaussians(centres, (64, 48))).numpy()
    np.testing.assert_allclose(peaks[..., :2], centres, atol=0.03)
    np.testing.assert_allclose(peaks[..., 2], 0.8, atol=0.06)


def test_flat_heat_and_borders_give_no_nonsense() -> None:
    flat = find_peaks(torch.zeros(1, 2, 8, 6))
    assert flat.isfinite().all()
    at_corner = find_peaks(gaussians(np.array([[[0.0, 7.0]]]), (8, 6)))[0, 0]
    assert ((at_corner[:2] - torch.tensor([0.0, 7.0])).abs() <= 1).all()
    ridge = torch.zeros(1, 1, 8, 6)
    ridge[..., 3, :] = 1.0
    assert find_peaks(ridge)[0, 0, 1] == 3


def test_keypoints_lie_where_the_library_puts_them(tmp_path: Path, rng: np.random.Generator, monkeypatch: Any) -> None:
    """ViTPose's own way back into the picture, but for half a pixel of its input."""
    transformers = pytest.importorskip("transformers", reason="needs the extra photo")
    pytest.importorskip("scipy")
    from transformers.models.vitpose.image_processing_pil_vitpose import VitPoseImageProcessorPil

    heat = 0.9 * gaussians(rng.uniform(6, 40, (1, 17, 2)), (64, 48))
    left, top, width, height = 40.0, 30.0, 150.0, 200.0
    outputs = SimpleNamespace(heatmaps=heat)
    (((theirs,),)) = VitPoseImageProcessorPil().post_process_pose_estimation(
        outputs, boxes=np.array([[[left, top, width, height]]])
    )
    network = load_keypoint_network(str(knowing_vitpose(tmp_path, [(1, 1)] * 17)))
    monkeypatch.setattr(transformers.VitPoseForPoseEstimation, "__call__", lambda *_, **__: outputs)
    ours = network.predict(torch.zeros(1, 3, 256, 192))[0].numpy()
    crop = 1.25 * np.array([width, height])
    middle = np.array([left + width / 2, top + height / 2])
    expected = theirs["keypoints"].numpy()
    np.testing.assert_allclose(middle + (ours[:, :2] - 0.5) * crop, expected, atol=0.6 * crop[0] / 192)
    np.testing.assert_allclose(ours[:, 2], theirs["scores"].numpy(), atol=1e-5)
