"""Colours of people's skin, hair and clothes, which are plain, striped, checked, blotched or printed; and folds."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F

from .backdrops import Backdrops, log_uniform
from .photo_surfaces import DARK, HAIR, NUM_PIECES, SKIN, PixelSurface
from .rng import TorchRng

_FULL_TURN = 2 * math.pi
_LIGHTEST_SKIN, _DARKEST_SKIN = (0.93, 0.72, 0.60), (0.24, 0.14, 0.10)
_SKIN_TINT = 0.06  # standard deviation of a colour's channels, as a share, also:
_HAIR_TINT, _GREY_TINT = 0.1, 0.04
_FAIREST_HAIR, _DARKEST_HAIR, _DARK_HAIR = (0.9, 0.7, 0.45), 0.02, 2.2  # dark hair is more frequent, by this power
_GREY_HAIR, _GREYS = 0.15, (0.4, 0.9)
_EYES = 0.3  # of the skin's brightness: eyes and mouth
_SUIT = 0.12  # share of people whose lower garment has the upper one's colour
_CLOTHES = (0.3, 0.35, 0.17, 0.18)  # any colour, grey, blue as jeans are, pastel
_JEANS, _JEANS_BRIGHTNESS = (0.22, 0.30, 0.45), (0.3, 1.9)
_PASTEL = 0.6  # least of its channels
_NUDE, _NUDE_COLOUR, _NUDE_BRIGHTNESS = 0.06, (0.8, 0.62, 0.5), (0.4, 1.1)  # clothes whose colour is as skin's
_LEAST = 0.01

_PLAIN, _PRINT, _STRIPES, _CHECKS, _BLOTCHES = range(5)
_PATTERNS = (0.3, 0.2, 0.2, 0.1, 0.2)
_DENSITY = (25.0, 250.0)  # [rad/m], of stripes and checks
_STRIPE_WIDTHS = (-0.6, 0.8)  # values of a sine where the second colour begins
_BLOTCH_WAVES, _BLOTCH_DENSITY, _BLOTCH_EDGE = 4, 25.0, 0.15
_MIXED, _PRINTED = (0.3, 1.0), (0.4, 1.0)  # how much of the second colour and of a print shows
_PRINT_SCALES = (0.6, 4.0)  # pictures a metre
_FINE_WAVES, _FINE_DENSITY, _FINE = 4, 90.0, 0.06  # variation of all colours
_FOLDS, _FOLD_DENSITY, _FOLD_DEPTH = 5, (20.0, 120.0), 0.35
_SKIN_FOLDS = 0.25  # of the depth that clothes' folds have


def piece_colours(rng: TorchRng, count: int) -> torch.Tensor:
    """Colours of people's pieces, RGB from 0 to 1, shape (count, 6, 3)."""

    def colour(values: tuple[float, ...]) -> torch.Tensor:
        return torch.tensor(values, device=rng.device)

    skin = torch.lerp(colour(_LIGHTEST_SKIN), colour(_DARKEST_SKIN), rng.uniform(count, 1))
    skin = skin * (1 + _SKIN_TINT * rng.normal(count, 3))
    hair = colour(_FAIREST_HAIR) * rng.uniform(count, 1) ** _DARK_HAIR
    hair = hair * (1 + _HAIR_TINT * rng.normal(count, 3)) + _DARKEST_HAIR
    grey = rng.uniform(count, 1, low=_GREYS[0], high=_GREYS[1]).expand(-1, 3)
    hair = torch.where(rng.chance(_GREY_HAIR, count, 1), grey, hair)
    upper, lower, feet = cloth_colours(rng, count, 3).unbind(1)
    lower = torch.where(rng.chance(_SUIT, count, 1), upper, lower)
    return torch.stack([skin, upper, lower, hair, feet, _EYES * skin], dim=1).clamp(_LEAST, 1)


def cloth_colours(rng: TorchRng, *shape: int) -> torch.Tensor:
    """Colours of clothes, RGB from 0 to 1, shape (*shape, 3)."""
    anything = rng.uniform(*shape, 3)
    grey = rng.uniform(*shape, 1) * (1 + _GREY_TINT * rng.normal(*shape, 3))
    jeans = _toned(rng, _JEANS, _JEANS_BRIGHTNESS, *shape)
    pastel = _PASTEL + (1 - _PASTEL) * anything
    kind = rng.choice(_CLOTHES, *shape)[..., None]
    found = torch.where(kind == 0, anything, torch.where(kind == 1, grey, torch.where(kind == 2, jeans, pastel)))
    nude = _toned(rng, _NUDE_COLOUR, _NUDE_BRIGHTNESS, *shape)
    return torch.where(rng.chance(_NUDE, *shape, 1), nude, found).clamp(_LEAST, 1)


def _toned(rng: TorchRng, colour: tuple[float, ...], between: tuple[float, float], *shape: int) -> torch.Tensor:
    """Darker and brighter colours of one kind, shape (*shape, 3)."""
    return torch.tensor(colour, device=rng.device) * rng.uniform(*shape, 1, low=between[0], high=between[1])


def surface_colours(rng: TorchRng, surface: PixelSurface, prints: Backdrops, count: int) -> torch.Tensor:
    """Colours of the pixels of ``count`` people, RGB from 0 to 1, shape (N, 3).

    Args:
        rng: Source of chance.
        surface: Pixels.
        prints: Pictures that some clothes are printed with.
        count: Number of people.
    """
    colours = surface.of_pieces(piece_colours(rng, count))
    patterns = rng.choice(_PATTERNS, count, NUM_PIECES)
    patterns[:, [SKIN, HAIR, DARK]] = _PLAIN
    pattern = surface.of_pieces(patterns)
    second = surface.of_pieces(cloth_colours(rng, count, NUM_PIECES))
    shown = surface.of_pieces(rng.uniform(count, NUM_PIECES, low=_MIXED[0], high=_MIXED[1]))
    share = shown * _second_colour(rng, surface, pattern, count)
    colours = torch.lerp(colours, second, share[:, None])
    shown = surface.of_pieces(rng.uniform(count, NUM_PIECES, low=_PRINTED[0], high=_PRINTED[1]))
    colours = torch.lerp(colours, _prints(rng, surface, prints, count), (shown * (pattern == _PRINT))[:, None])
    fine = torch.sin(_wave_angles(surface, _FINE_DENSITY * rng.normal(count, 3, _FINE_WAVES), rng)).mean(
        -1, keepdim=True
    )
    return (colours * (1 + _FINE * fine)).clamp(0, 1)


def _second_colour(rng: TorchRng, surface: PixelSurface, pattern: torch.Tensor, count: int) -> torch.Tensor:
    """Flags of pixels where stripes, checks and blotches have their second colour, 0 or 1, shape (N,)."""
    density = surface.of_pieces(log_uniform(rng, _DENSITY, count, NUM_PIECES))
    axis = surface.of_pieces(rng.integers(3, count, NUM_PIECES))
    width = surface.of_pieces(rng.uniform(count, NUM_PIECES, low=_STRIPE_WIDTHS[0], high=_STRIPE_WIDTHS[1]))
    along, across = (
        torch.sin(density * surface.place.gather(1, each[:, None])[:, 0]) for each in (axis, (axis + 1) % 3)
    )
    waves = surface.of_pieces(_BLOTCH_DENSITY * rng.normal(count, NUM_PIECES, 3, _BLOTCH_WAVES))
    phases = surface.of_pieces(rng.uniform(count, NUM_PIECES, _BLOTCH_WAVES, high=_FULL_TURN))
    blotch = torch.sin(torch.einsum("nd,ndk->nk", surface.place, waves) + phases).mean(-1)
    found = torch.where(pattern == _STRIPES, along > width, (pattern == _CHECKS) & ((along > 0) ^ (across > 0)))
    return torch.where(pattern == _BLOTCHES, 2 * blotch > _BLOTCH_EDGE, found).float()


def _prints(rng: TorchRng, surface: PixelSurface, prints: Backdrops, count: int) -> torch.Tensor:
    """Colours of pictures that are laid on people from the front and from the side, again and again, shape (N, 3)."""
    pictures = prints.some(count)
    scale, shift = log_uniform(rng, _PRINT_SCALES, count), rng.uniform(count, 2)
    flat = torch.stack([surface.place[:, 0] + surface.place[:, 2], surface.place[:, 1]], dim=-1)
    share = (flat * scale[surface.person, None] + shift[surface.person]) % 1.0
    height, width = pictures.shape[-2:]
    row, column = (share[:, 1] * height).long(), (share[:, 0] * width).long()
    return pictures[surface.person, :, row.clamp(max=height - 1), column.clamp(max=width - 1)]


def _wave_angles(surface: PixelSurface, waves: torch.Tensor, rng: TorchRng) -> torch.Tensor:
    """Angles of each person's waves (B, 3, K) [rad/m] at the pixels, their phases being random, shape (N, K)."""
    phases = rng.uniform(len(waves), waves.shape[-1], high=_FULL_TURN)
    return torch.einsum("nd,ndk->nk", surface.place, waves[surface.person]) + phases[surface.person]


def folds(rng: TorchRng, surface: PixelSurface, count: int) -> torch.Tensor:
    """Changes of normals by the folds of clothes and by what is uneven on skin, shape (N, 3)."""
    waves = rng.normal(count, 3, _FOLDS) * log_uniform(rng, _FOLD_DENSITY, count, 1, _FOLDS)
    slopes = torch.cos(_wave_angles(surface, waves, rng))
    ways = F.normalize(waves, dim=1)[surface.person]
    depth = rng.uniform(count, NUM_PIECES, high=_FOLD_DEPTH)
    depth[:, SKIN] *= _SKIN_FOLDS
    depth[:, DARK] = 0
    return torch.einsum("nk,ndk->nd", slopes, ways) * surface.of_pieces(depth)[:, None]
