"""Costs of observations with noise of unknown size: the better a body agrees with an observation, the more it counts.

Errors of keypoints have a Laplace distribution of unknown width. Integrated over all widths, the likelihood of n errors
is a power of their sum (Gelman et al., Bayesian Data Analysis, on unknown scales), and the cost is its negative
logarithm. Wrong labels are not independent from pixel to pixel. They come in blobs, and wide blobs are rarer than
narrow ones.
"""

from __future__ import annotations

import torch

from ...body.labels import IGNORE
from ...inputs.observation import REFERENCE_SIZE

# Usual errors at the end of a fit, at which costs are as steep as the sum of errors [px of ``REFERENCE_SIZE``]:
# distances from keypoints, and widths of the strips of wrong labels along the labels' borders. They are medians over
# PartBench's people at "clothed".
_DISTANCE = 2.9
_STRIP = 1.5
_LEAST = 0.02  # share of the usual error below which a smaller error hardly makes a cost steeper
_NO_COUNT = 1e-6  # replaces a count of 0 in a division


def keypoint_costs(distances: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Costs of distances from keypoints.

    Args:
        distances: Weighted sums of distances [px of ``REFERENCE_SIZE``], shape (B,).
        weights: Weights of the keypoints, shape (B, L).

    Returns:
        Costs [px of ``REFERENCE_SIZE``], shape (B,).
    """
    return noise_costs(distances, weights.sum(1), _DISTANCE)


def label_costs(wrong: torch.Tensor, borders: torch.Tensor, size: int) -> torch.Tensor:
    """Costs of wrong pixels.

    Args:
        wrong: Numbers of wrong pixels, shape (B,).
        borders: Lengths of the labels' borders [px], shape (B,).
        size: Side of the drawn labels [px].

    Returns:
        Costs [px], shape (B,).
    """
    return blob_costs(wrong, borders, _STRIP * size / REFERENCE_SIZE)


def noise_costs(errors: torch.Tensor, counts: torch.Tensor, usual: float) -> torch.Tensor:
    """Costs of errors of unknown size, whose slope is 1 if the errors have their usual size.

    Args:
        errors: Sums of errors, shape (B,).
        counts: Numbers of errors in each sum, shape (B,).
        usual: Usual size of one error.

    Returns:
        Costs in the unit of errors, shape (B,).
    """
    shares = _shares(errors, counts, usual)
    return (1 + _LEAST) * usual * counts * torch.log1p(shares / _LEAST)


def blob_costs(errors: torch.Tensor, counts: torch.Tensor, usual: float) -> torch.Tensor:
    """Costs of errors that come in blobs; the arguments are those of ``noise_costs``.

    Far above the usual size, slopes fall with the square of the errors.
    """
    shares = _shares(errors, counts, usual)
    factor = 2 * (1 + _LEAST) / (1 - _LEAST) * usual
    return factor * counts * (torch.log1p(shares / _LEAST) - torch.log1p(shares))


def _shares(errors: torch.Tensor, counts: torch.Tensor, usual: float) -> torch.Tensor:
    """Means of errors in units of the usual error, shape (B,); finite if there are none."""
    return errors / (usual * counts).clamp_min(_NO_COUNT)


def border_lengths(labels: torch.Tensor) -> torch.Tensor:
    """Count the pairs of neighbours in label pictures with different labels, of which none is ignored.

    Args:
        labels: Label pictures, shape (B, H, W).

    Returns:
        Lengths of the borders [px], shape (B,).
    """
    known = labels != IGNORE
    down = (labels[:, 1:] != labels[:, :-1]) & known[:, 1:] & known[:, :-1]
    across = (labels[..., 1:] != labels[..., :-1]) & known[..., 1:] & known[..., :-1]
    return (down.sum((1, 2)) + across.sum((1, 2))).float()
