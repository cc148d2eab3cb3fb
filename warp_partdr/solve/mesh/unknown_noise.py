"""Costs of what was seen with noise that nobody knows: the better a body agrees with it, the more it counts.

The likelihood of errors with a Laplace distribution, over all its widths: with as many errors as there are, that is a
power of their sum (Gelman et al., Bayesian Data Analysis, on unknown scales), so costs are its logarithm. Wrong labels
are no errors of their own, pixel by pixel, but come in blobs, of which there are the fewer the wider they are.
"""

from __future__ import annotations

import torch

from ...body.labels import IGNORE
from ...inputs.observation import REFERENCE_SIZE

# Errors of a fit's end at which costs are as steep as their sum [px of ``REFERENCE_SIZE``]: distances of keypoints, and
# widths of the strips of wrong labels along the labels' borders. Medians of PartBench's people at "clothed".
_DISTANCE, _STRIP = 2.9, 1.5
_LEAST = 0.02  # of the usual errors: smaller ones are not believed to be noise
_NO_COUNT = 1e-6  # stands for 0, by which nothing can be divided


def keypoint_costs(distances: torch.Tensor, votes: torch.Tensor) -> torch.Tensor:
    """Costs of weighted sums of distances from keypoints [px of ``REFERENCE_SIZE``] (B,), whose weights are (B, L)."""
    return noise_costs(distances, votes.sum(1), _DISTANCE)


def label_costs(wrong: torch.Tensor, borders: torch.Tensor, size: int) -> torch.Tensor:
    """Costs of numbers of wrong pixels (B,) beside borders so long (B,), of labels drawn so large [px]."""
    return blob_costs(wrong, borders, _STRIP * size / REFERENCE_SIZE)


def noise_costs(errors: torch.Tensor, counts: torch.Tensor, usual: float) -> torch.Tensor:
    """Costs of sums of errors (B,), of so many each (B,), whose usual size is known; slopes are 1 at that size."""
    shares = _shares(errors, counts, usual)
    return (1 + _LEAST) * usual * counts * torch.log1p(shares / _LEAST)


def blob_costs(errors: torch.Tensor, counts: torch.Tensor, usual: float) -> torch.Tensor:
    """Costs as of ``noise_costs``, for errors that come in blobs.

    Far above the usual size, slopes fall with the square of the errors.
    """
    shares = _shares(errors, counts, usual)
    factor = 2 * (1 + _LEAST) / (1 - _LEAST) * usual
    return factor * counts * (torch.log1p(shares / _LEAST) - torch.log1p(shares))


def _shares(errors: torch.Tensor, counts: torch.Tensor, usual: float) -> torch.Tensor:
    """Means of errors in units of the usual one (B,); finite where there are none."""
    return errors / (usual * counts).clamp_min(_NO_COUNT)


def border_lengths(labels: torch.Tensor) -> torch.Tensor:
    """Numbers of neighbours in pictures (B, H, W) that have different labels, none of them ignored, shape (B,)."""
    known = labels != IGNORE
    down = (labels[:, 1:] != labels[:, :-1]) & known[:, 1:] & known[:, :-1]
    across = (labels[..., 1:] != labels[..., :-1]) & known[..., 1:] & known[..., :-1]
    return (down.sum((1, 2)) + across.sum((1, 2))).float()
