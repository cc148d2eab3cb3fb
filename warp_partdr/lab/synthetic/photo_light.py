"""Light on people in pictures: three lamps, sky and ground, gloss, and shade where limbs are near one another."""

from __future__ import annotations

import torch
import torch.nn.functional as F

from .photo_surfaces import NUM_PIECES, PixelSurface
from .rng import TorchRng

_LAMPS = ((0.3, 1.3), (0.0, 0.5), (0.0, 0.4))  # ranges of their powers
_MOSTLY = (0.0, -0.7, -0.8)  # mean direction of lamps: above, and on the camera's side (y points down, z away)
_TINT = 0.12  # standard deviation of a lamp's colour
_SKY, _SKY_TINT, _GROUND = (0.15, 0.7), 0.1, (0.3, 0.9)  # light from above, and its share that comes from below
_SOFT = 0.4  # cosine by which the light of the softest lamp reaches behind an edge
_GLOSS, _SHARPNESS = 0.25, 24
_VIEW = (0.0, 0.0, -1.0)  # from a person to the camera
_BRIGHTEST = 2.0
_SHADE, _SHADE_DEPTH = 0.6, 0.15  # largest share that it takes, and how far behind its surroundings that is [m]
_COARSE, _SURROUNDINGS = 8, 5  # [px] of a cell, and cells that are the surroundings


def lit_colours(
    rng: TorchRng, surface: PixelSurface, colours: torch.Tensor, normals: torch.Tensor, depth: torch.Tensor
) -> torch.Tensor:
    """Colours (N, 3) of pixels of a picture under the light of each person.

    Args:
        rng: Source of chance.
        surface: Pixels.
        colours: Colours under white light, shape (N, 3).
        normals: Normals with all folds, unit vectors, shape (N, 3).
        depth: Depth of all pixels of the pictures [m], inf = background, shape (B, H, W).
    """
    count, person = len(depth), surface.person
    unit = torch.nn.functional.normalize
    lamps = unit(rng.normal(count, len(_LAMPS), 3) + torch.tensor(_MOSTLY, device=rng.device), dim=-1)
    powers = [rng.uniform(count, 1, low=low, high=high) for low, high in _LAMPS]
    tints = 1 + _TINT * rng.normal(count, len(_LAMPS), 3)
    soft = rng.uniform(count, high=_SOFT)[person]
    gloss = surface.of_pieces(rng.uniform(count, NUM_PIECES, high=_GLOSS))
    light, shine = _ambient(rng, surface, normals, count), torch.zeros_like(colours)
    for index, power in enumerate(powers):
        lamp = lamps[:, index]
        lit = (((normals * lamp[person]).sum(-1) + soft) / (1 + soft)).clamp_min(0)
        light = light + lit[:, None] * (power * tints[:, index])[person]
        halfway = unit(lamp + torch.tensor(_VIEW, device=rng.device), dim=-1)
        mirrored = (normals * halfway[person]).sum(-1).clamp_min(0) ** _SHARPNESS
        shine = shine + (mirrored * gloss)[:, None] * power[person]
    shade = 1 - rng.uniform(count, high=_SHADE)[person] * (_sunk(surface, depth) / _SHADE_DEPTH).clamp(0, 1)
    return (colours * light * shade[:, None] + shine).clamp(0, _BRIGHTEST)


def _ambient(rng: TorchRng, surface: PixelSurface, normals: torch.Tensor, count: int) -> torch.Tensor:
    """Light of sky and ground at the pixels, shape (N, 3)."""
    sky = rng.uniform(count, 1, low=_SKY[0], high=_SKY[1]) * (1 + _SKY_TINT * rng.normal(count, 3))
    ground = sky * rng.uniform(count, 1, low=_GROUND[0], high=_GROUND[1])
    upward = 0.5 - 0.5 * normals[:, 1:2]
    return torch.lerp(ground[surface.person], sky[surface.person], upward)


def _sunk(surface: PixelSurface, depth: torch.Tensor) -> torch.Tensor:
    """Distance by which the pixels lie behind the mean of the person around them [m], shape (N,)."""
    shown = torch.isfinite(depth)
    sums = torch.stack([torch.where(shown, depth, 0.0), shown.float()], dim=1)
    padding = _SURROUNDINGS // 2
    total, area = F.avg_pool2d(F.avg_pool2d(sums, _COARSE), _SURROUNDINGS, 1, padding).split(1, dim=1)
    mean = F.interpolate(total / area.clamp_min(1e-3), size=depth.shape[-2:], mode="bilinear")[:, 0]
    return (depth - mean)[surface.person, surface.row, surface.column]
