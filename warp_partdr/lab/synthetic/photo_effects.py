"""Effects of cameras and files on pictures: colours, exposure, sharpness, noise and compression."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F

from ...interop.device_cache import device_cache
from .backdrops import coarser, log_uniform
from .rng import TorchRng

BLOCK = 8  # [px], side of the blocks that compression changes together
_WHITE = 0.12  # standard deviation of the white balance
_EXPOSURE = 0.45  # largest logarithm of its factor, and of the power of ``_GAMMA``
_GAMMA = 0.35
_SATURATION, _CONTRAST = (0.3, 1.4), (0.7, 1.3)
_BRIGHTEST = 1.2  # before gamma
_COARSER = ((2, 0.3), (4, 0.12))  # factors, and shares of pictures that are so much coarser
_SOFT = 0.4  # share of pictures that are blurred by a pixel
_GRAINY, _GRAIN = 0.6, 0.05  # share of pictures with grain, and its largest standard deviation
_COMPRESSED, _STEPS = 0.6, (0.003, 0.04)  # share of compressed pictures, and steps of the lowest frequencies


def photographed(pictures: torch.Tensor, rng: TorchRng) -> torch.Tensor:
    """Pictures (B, 3, S, S) as cameras and files make them, from 0 to 1. The side is a multiple of ``BLOCK``."""
    count, size = len(pictures), pictures.shape[-1]

    def factors(low: float, high: float) -> torch.Tensor:
        return rng.uniform(count, 1, 1, 1, low=low, high=high)

    pictures = pictures * (1 + _WHITE * rng.normal(count, 3, 1, 1)) * factors(-_EXPOSURE, _EXPOSURE).exp()
    grey = pictures.mean(1, keepdim=True)
    pictures = torch.lerp(grey, pictures, factors(*_SATURATION))
    mean = pictures.mean((2, 3), keepdim=True)
    pictures = torch.lerp(mean, pictures, factors(*_CONTRAST)).clamp(0, _BRIGHTEST)
    pictures = pictures.clamp_min(1e-4) ** factors(-_GAMMA, _GAMMA).exp()
    for factor, share in _COARSER:
        pictures = torch.where(rng.chance(share, count, 1, 1, 1), coarser(pictures, factor), pictures)
    pictures = torch.where(rng.chance(_SOFT, count, 1, 1, 1), _blurred(pictures), pictures)
    grain = factors(0.0, _GRAIN) * rng.chance(_GRAINY, count, 1, 1, 1)
    pictures = (pictures + grain * rng.normal(count, 3, size, size)).clamp(0, 1)
    steps = log_uniform(rng, _STEPS, count)
    return torch.where(rng.chance(_COMPRESSED, count, 1, 1, 1), compressed(pictures, steps), pictures)


def _blurred(pictures: torch.Tensor) -> torch.Tensor:
    weights = torch.tensor([1.0, 2.0, 1.0], device=pictures.device) / 4
    kernel = (weights[:, None] * weights).expand(3, 1, 3, 3)
    return F.conv2d(F.pad(pictures, (1, 1, 1, 1), mode="replicate"), kernel, groups=3)


def compressed(pictures: torch.Tensor, steps: torch.Tensor) -> torch.Tensor:
    """Pictures after a compression as JPEG's: cosines of blocks of 8 x 8 pixels, rounded.

    Args:
        pictures: Pictures, from 0 to 1, shape (B, 3, S, S), S being a multiple of ``BLOCK``.
        steps: Step of the lowest frequencies of each picture; higher ones have larger steps, shape (B,).
    """
    cosines, coarseness = _cosines(pictures.device)
    blocks = pictures.unflatten(3, (-1, BLOCK)).unflatten(2, (-1, BLOCK)).transpose(3, 4)  # (B, 3, rows, columns, 8, 8)
    step = steps[:, None, None, None, None, None] * coarseness
    shares = torch.round(cosines @ blocks @ cosines.T / step) * step
    return (cosines.T @ shares @ cosines).transpose(3, 4).flatten(4, 5).flatten(2, 3).clamp(0, 1)


@device_cache(2)
def _cosines(device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """Matrix of the cosine transform of 8 values, orthonormal, and steps of the frequencies, shape (8, 8) each."""
    number = torch.arange(BLOCK, dtype=torch.float64)
    cosines = torch.cos((2 * number + 1) * number[:, None] * math.pi / (2 * BLOCK)) * math.sqrt(2 / BLOCK)
    cosines[0] /= math.sqrt(2)
    return cosines.float().to(device), (1 + number[:, None] + number).float().to(device)
