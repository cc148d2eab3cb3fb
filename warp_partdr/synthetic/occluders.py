"""Strangers and things before a person, and holes in the labels, in batches on a device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch

from ..body.labels import BACKGROUND, IGNORE
from ..body.template import NUM_PARTS
from ..network.heads import cell_centres
from .label_noise import look_up
from .rng import TorchRng

_STRANGER = 0.12  # chance at strength 1


class _Thing(NamedTuple):
    chance: float  # of each, at strength 1
    radii: tuple[float, float]  # or half sides of a box, crop coordinates
    aside: float  # standard deviation from a point of the person
    unknown: float  # chance of labels to say so; else they say background
    hides: bool


_HOLE = _Thing(0.2, (0.02, 0.09), 0.0, 0.3, hides=False)
_OCCLUDER = _Thing(0.12, (0.06, 0.4), 0.2, 0.6, hides=True)


@dataclass(frozen=True)
class Occluders:
    """Things between camera and person in a crop."""

    mask: torch.Tensor  # pixels whose labels it changes, shape (B, S, S), bool
    hiding: torch.Tensor  # pixels where it hides the person, too: all but the holes, shape (B, S, S), bool
    groups: torch.Tensor  # group ids that labels have there, 0 and 255 included, shape (B, S, S), uint8


def draw_occluders(
    rng: TorchRng,
    parts: torch.Tensor,  # (B, S, S), true part labels, 255 beyond the border
    tables: torch.Tensor,  # (B, 22), of ``LabelNoise.tables``: group id of each part label in the samples' label sets
    places: torch.Tensor,  # (B, 6, 2), points of each person in the crop, for four holes and two things
    strength: torch.Tensor,  # (B,)
) -> Occluders:
    """Strangers, things before the person, and holes; a sample's stranger is the one before it."""
    count, size, _ = parts.shape
    there, column = _stranger(rng, parts)
    stranger = parts.roll(1, 0).gather(2, column[:, None].expand(-1, size, -1))
    mask = there[:, None] & (stranger > 0) & (stranger <= NUM_PARTS)
    mask &= rng.chance(strength * _STRANGER, count)[:, None, None]
    behind = rng.chance(0.3, count)[:, None, None]
    mask &= ~(behind & (parts != BACKGROUND))
    ignored = rng.chance(0.75, count)[:, None, None]
    groups = torch.where(ignored, IGNORE, look_up(tables, stranger)).to(torch.uint8)

    hiding = mask.clone()
    centres = cell_centres(size, rng.device)
    for place, thing in zip(places.unbind(1), (*[_HOLE] * 4, *[_OCCLUDER] * 2), strict=True):
        place = place + thing.aside * rng.normal(count, 2)
        radii = rng.uniform(count, 2, low=thing.radii[0], high=thing.radii[1])
        radii = radii if thing.hides else radii[:, :1].expand(-1, 2)
        across, down = ((centres - place[:, i, None]).div(radii[:, i, None]).square() for i in range(2))
        inside = across[:, None, :] + down[:, :, None] < 1
        if thing.hides:
            box = (across[:, None, :] < 1) & (down[:, :, None] < 1)
            inside = torch.where(rng.chance(0.5, count)[:, None, None], box, inside)
        inside &= rng.chance(strength * thing.chance, count)[:, None, None]
        shown = torch.where(rng.chance(thing.unknown, count), IGNORE, BACKGROUND).to(torch.uint8)
        groups = torch.where(inside, shown[:, None, None], groups)
        mask |= inside
        if thing.hides:
            hiding |= inside
    return Occluders(mask, hiding, groups)


def _stranger(rng: TorchRng, parts: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Column of the other's crop that comes to each column, and True where there is one, shape (B, S) each."""
    count, size, _ = parts.shape
    columns = torch.arange(size, device=rng.device)
    shown = ((parts > 0) & (parts <= NUM_PARTS)).any(1)
    low = torch.where(shown, columns, size).amin(1)
    high = torch.where(shown, columns, -1).amax(1)
    overlap = rng.uniform(count, low=0.05, high=0.35) * (high - low)
    left, right = low + overlap - high.roll(1), high - overlap - low.roll(1)
    shift = torch.where(rng.chance(0.5, count), left, right).round().long()
    source = columns - shift[:, None]
    return (source >= 0) & (source < size), source.clamp(0, size - 1)
