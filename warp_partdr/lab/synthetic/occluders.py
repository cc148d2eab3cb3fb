"""Strangers and things before a person, and holes in the labels, in batches on a device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
import warp as wp

from ...body.labels import BACKGROUND, IGNORE
from ...body.template import NUM_PARTS
from ...interop.arrays import warp_array
from ...interop.streams import launch_bodies_on
from ...kernels import occluders
from ...networks.regression.heads import cell_centres
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
_HOLES = 4  # so many of these come first
_THINGS = *[_HOLE] * _HOLES, *[_OCCLUDER] * 2


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
    count = len(parts)
    shifts = _shifts(rng, parts)
    there = rng.chance(strength * _STRANGER, count)
    behind = rng.chance(0.3, count)
    ignored = rng.chance(0.75, count)
    things = [_draw_thing(rng, thing, place, strength) for place, thing in zip(places.unbind(1), _THINGS, strict=True)]
    middles, radii, present, boxes, shown = (torch.stack(each, dim=1) for each in zip(*things, strict=True))
    centres = cell_centres(parts.shape[-1], rng.device)
    mask, hiding = (torch.empty_like(parts, dtype=torch.bool) for _ in range(2))
    groups = torch.empty_like(parts, dtype=torch.uint8)

    def launch(part: slice) -> None:
        strangers = [warp_array(each[part]) for each in (shifts, there, behind, ignored, tables)]
        points = [warp_array(each[part], wp.vec2) for each in (middles, radii)]
        flags = [warp_array(each[part]) for each in (present, boxes, shown)]
        found = [warp_array(each[part]) for each in (mask, hiding, groups)]
        labels, numbers = warp_array(parts), (part.start, NUM_PARTS, _HOLES)
        occluders.launch_drawing(labels, numbers, strangers, [*points, *flags], warp_array(centres), found)

    launch_bodies_on(parts.device, launch, count, [occluders])
    return Occluders(mask, hiding, groups)


def _draw_thing(rng: TorchRng, thing: _Thing, places: torch.Tensor, strength: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Middles and radii, (B, 2) each, who has one, which are boxes, and their groups, (B,) each, about ``places``."""
    count = len(places)
    middles = places + thing.aside * rng.normal(count, 2)
    radii = rng.uniform(count, 2, low=thing.radii[0], high=thing.radii[1])
    radii = radii if thing.hides else radii[:, :1].expand(-1, 2)
    boxes = rng.chance(0.5, count) if thing.hides else torch.zeros(count, dtype=torch.bool, device=rng.device)
    present = rng.chance(strength * thing.chance, count)
    shown = torch.where(rng.chance(thing.unknown, count), IGNORE, BACKGROUND).to(torch.uint8)
    return middles, radii, present, boxes, shown


def _shifts(rng: TorchRng, parts: torch.Tensor) -> torch.Tensor:
    """Columns that the person of the sample before each is moved to the right by, beside its own, (B,), int32."""
    count, size, _ = parts.shape
    low, high = (torch.full((count,), end, dtype=torch.int32, device=rng.device) for end in (size, -1))

    def launch(part: slice) -> None:
        labels, first, last = (warp_array(each[part]) for each in (parts, low, high))
        occluders.launch_columns(labels, NUM_PARTS, first, last)

    launch_bodies_on(parts.device, launch, count, [occluders])
    overlap = rng.uniform(count, low=0.05, high=0.35) * (high - low)
    left, right = low + overlap - high.roll(1), high - overlap - low.roll(1)
    return torch.where(rng.chance(0.5, count), left, right).round().int()
