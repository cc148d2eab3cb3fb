"""Pictures that look like photos, made on the fly: dressed people in light, before pictures, strangers and things.

Each is a square about a person who stands upright in it, as the landmark network sees people in photos.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
import torch.nn.functional as F

from ...body.labels import BACKGROUND, IGNORE
from ...body.template import JOINT_NAMES
from ...cameras import ScreenCamera
from ...errors import InputError
from ...networks.detection.part_head import PICTURE_SIDE
from ...render.mesh import draw_mesh
from .backdrops import Backdrops, log_uniform, sample_affinely
from .photo_colours import folds, surface_colours
from .photo_effects import BLOCK, photographed
from .photo_light import lit_colours
from .photo_surfaces import clothes_tables, facing, surface_of
from .rng import TorchRng, exact_float32
from .training_people import DressedPeople, PeopleMaker
from .wardrobe import wardrobe

_SAMPLES = 2  # a side of a pixel, for smooth outlines
_SEED_APART = 1 << 40  # from the seeds of the people's own generators
_HIPS = [JOINT_NAMES.index(f"{side}_hip") for side in ("left", "right")]
_SHOULDERS = [JOINT_NAMES.index(f"{side}_shoulder") for side in ("left", "right")]
# The crop is upright and about the middle of the hips, as the landmark network's: its side in distances of the farthest
# point; and standard deviations of its turn [rad], of its side's logarithm, and of its middle in sides.
_SIDE, _TURN_OFF, _SIDE_OFF, _MIDDLE_OFF = 2.5, 0.12, 0.13, 0.04
_BALD = 0.12


@dataclass(frozen=True)
class _Strangers:
    """Other people of the batch in the same picture."""

    chance: float
    far: float = 1.0  # factor of their distance


_BEHIND, _BEFORE = (_Strangers(0.35), _Strangers(0.35)), _Strangers(0.18, 1.25)
_ASIDE = (0.35, 1.3)  # of a stranger from the person, in halves of the picture
_ABOVE = 0.3  # standard deviation, in the same unit
_SMALLER = (math.exp(-0.3), math.exp(0.7))  # factors by which they are smaller
_THINGS, _THING, _THING_MIDDLE, _THING_HALF = 2, 0.22, 0.25, (0.03, 0.3)  # number, chance, spread, sides' halves
_TRANSPARENT = 0.5  # coverage up to which the person behind has the pixel
_CUT, _KEPT = 0.3, (0.5, 0.97)  # share of pictures that the border cuts off, and how much is kept
_CUT_SIDES = (1 / 2, 1 / 6, 1 / 6, 1 / 6)  # bottom, top, right, left
_BOTTOM, _TOP, _RIGHT, _LEFT = range(4)


@dataclass(frozen=True)
class PhotoBatch:
    """B pictures of people with the truth.

    Attributes:
        pictures: Pictures, from 0 to 1, shape (B, 3, S, S), float32.
        labels: Part labels of the person in the middle, 0 = background, 255 = beyond the picture's border, where its
            last row or column is repeated, shape (B, S, S), uint8.
        joints: Joints in the order of ``JOINT_NAMES``, x and y from 0 to 1 across the picture, also hidden ones and
            those beyond it, shape (B, 21, 2).
    """

    pictures: torch.Tensor
    labels: torch.Tensor
    joints: torch.Tensor


class PhotoPeopleMaker:
    """Makes pictures of people, the same for a seed and a device; on CUDA up to rounding of the colours.

    Args:
        people: Maker of the people.
        backdrops: Pictures of ``load_backdrops``, shape (N, 3, H, W), uint8.
        seed: Seed of all but the people.
        size: Side of the pictures [px], a multiple of 8.

    Raises:
        InputError: If the size is another one.
    """

    def __init__(self, people: PeopleMaker, backdrops: torch.Tensor, *, seed: int, size: int = PICTURE_SIDE) -> None:
        if size < BLOCK or size % BLOCK:
            raise InputError(f"size: {size}; expected a multiple of {BLOCK}")
        self.size, self.device = size, people.device
        self._people, self._mesh, self._tables = people, wardrobe(people.device).mesh, clothes_tables(people.device)
        self._rng = TorchRng(_SEED_APART + seed, people.device)
        self._backdrops = Backdrops(backdrops, self._rng)

    def state_dict(self) -> dict[str, Any]:
        """State of the generators, which makes the next pictures what they are."""
        return {"generator": self._rng.generator.get_state(), "people": self._people.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from such a state of a maker with the same arguments."""
        self._rng.generator.set_state(state["generator"].cpu())
        self._people.load_state_dict(state["people"])

    @torch.no_grad()
    def __call__(self, count: int) -> PhotoBatch:
        """Make ``count`` pictures."""
        people = self._people.dressed(count)
        with exact_float32(self.device):
            crop = _draw_crop(people, self._rng)
            layers, labels = self._shaded(people, crop)
            pictures, labels = self._composed(layers, labels)
            return PhotoBatch(*_cut(photographed(pictures, self._rng), labels, self._rng), crop(people.joints))

    def _shaded(self, people: DressedPeople, crop: _Crop) -> tuple[torch.Tensor, torch.Tensor]:
        """People alone: colours times coverage, and coverage, shape (B, 4, S, S); and labels, shape (B, S, S)."""
        rng, count, fine = self._rng, len(people.worn), self.size * _SAMPLES
        screen = torch.cat([crop(people.seen[..., :2]) * fine, people.seen[..., 2:]], dim=-1)
        drawn = draw_mesh(screen, self._mesh, ScreenCamera(perspective=True), (fine, fine), validate=False)
        surface = surface_of(self._tables, people, screen, drawn, rng.chance(_BALD, count))
        colours = surface_colours(rng, surface, self._backdrops, count)
        normals = facing(F.normalize(surface.normal + folds(rng, surface, count), dim=-1))
        layers = colours.new_zeros(count, fine, fine, 4)
        lit = lit_colours(rng, surface, colours, normals, drawn.depth)
        layers[surface.person, surface.row, surface.column] = F.pad(lit, (0, 1), value=1.0)
        middle = slice(_SAMPLES // 2, None, _SAMPLES)
        return F.avg_pool2d(layers.permute(0, 3, 1, 2), _SAMPLES), drawn.labels[:, middle, middle]

    def _composed(self, layers: torch.Tensor, labels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Pictures of the people between all else, and labels, which are 0 where something hides them."""
        rng, count, size = self._rng, len(layers), self.size
        pictures = self._backdrops.behind(count, size)
        for number, strangers in enumerate(_BEHIND, start=1):
            pictures = _over(pictures, _moved(layers.roll(number, 0), strangers, rng))
        pictures = _over(pictures, layers)
        before = _moved(layers.roll(len(_BEHIND) + 1, 0), _BEFORE, rng)
        pictures, hidden = _over(pictures, before), before[:, 3] > _TRANSPARENT
        for _ in range(_THINGS):
            mask = _thing(rng, count, size)
            plain = rng.chance(0.5, count, 1, 1, 1)
            fill = torch.where(plain, rng.uniform(count, 3, 1, 1), self._backdrops.parts(count, size))
            pictures, hidden = torch.where(mask[:, None], fill, pictures), hidden | mask
        return pictures, labels.masked_fill(hidden, BACKGROUND)


@dataclass(frozen=True)
class _Crop:
    """Squares in the plane at the pelvis' depth."""

    middle: torch.Tensor  # [m], (B, 2)
    side: torch.Tensor  # [m], (B,)
    turn: torch.Tensor  # from the plane's axes to the square's, (B, 2, 2)

    def __call__(self, points: torch.Tensor) -> torch.Tensor:
        """Points (B, N, 2) [m] in the squares, from 0 to 1."""
        turned = (points - self.middle[:, None]) @ self.turn.mT
        return turned / self.side[:, None, None] + 0.5


def _draw_crop(people: DressedPeople, rng: TorchRng) -> _Crop:
    count = len(people.worn)
    hips = people.joints[:, _HIPS].mean(1)
    up = people.joints[:, _SHOULDERS].mean(1) - hips
    angle = torch.atan2(up[:, 0], -up[:, 1]) + _TURN_OFF * rng.normal(count)
    farthest = (people.seen[..., :2] - hips[:, None]).norm(dim=-1).amax(1)
    side = _SIDE * farthest * torch.exp(_SIDE_OFF * rng.normal(count))
    cos, sin = angle.cos(), angle.sin()
    turn = torch.stack([torch.stack([cos, sin], dim=-1), torch.stack([-sin, cos], dim=-1)], dim=1)
    return _Crop(hips + _MIDDLE_OFF * side[:, None] * rng.normal(count, 2), side, turn)


def _over(pictures: torch.Tensor, layers: torch.Tensor) -> torch.Tensor:
    """Pictures (B, 3, S, S) below layers (B, 4, S, S) of colours times coverage, and coverage."""
    return pictures * (1 - layers[:, 3:]) + layers[:, :3]


def _moved(layers: torch.Tensor, strangers: _Strangers, rng: TorchRng) -> torch.Tensor:
    """Layers of people in another place and size, half of them mirrored; empty where nobody is."""
    count, size = len(layers), layers.shape[-1]
    aside = strangers.far * rng.uniform(count, low=_ASIDE[0], high=_ASIDE[1])
    aside = torch.where(rng.chance(0.5, count), aside, -aside)
    smaller, above = log_uniform(rng, _SMALLER, count), _ABOVE * rng.normal(count)
    mirror, zero = torch.where(rng.chance(0.5, count), 1.0, -1.0), torch.zeros(count, device=rng.device)
    across = torch.stack([mirror * smaller, zero, aside * smaller], dim=-1)
    maps = torch.stack([across, torch.stack([zero, smaller, above], dim=-1)], dim=1)
    return sample_affinely(layers, maps, size) * rng.chance(strangers.chance, count, 1, 1, 1)


def _thing(rng: TorchRng, count: int, size: int) -> torch.Tensor:
    """Ellipses and boxes, turned anyhow; none in most pictures, shape (count, size, size), bool."""
    there, box = rng.chance(_THING, count, 1, 1), rng.chance(0.5, count, 1, 1)
    middle = (0.5 + _THING_MIDDLE * rng.normal(count, 2))[..., None, None]
    half = log_uniform(rng, _THING_HALF, count, 2)[..., None, None]
    turn = rng.uniform(count, 1, 1, high=math.pi)
    centres = (torch.arange(size, device=rng.device) + 0.5) / size
    right, down = centres - middle[:, 0], centres[:, None] - middle[:, 1]
    along = (right * turn.cos() + down * turn.sin()) / half[:, 0]
    across = (down * turn.cos() - right * turn.sin()) / half[:, 1]
    inside = torch.where(box, torch.maximum(along.abs(), across.abs()) < 1, along.square() + across.square() < 1)
    return inside & there


def _cut(pictures: torch.Tensor, labels: torch.Tensor, rng: TorchRng) -> tuple[torch.Tensor, torch.Tensor]:
    """Pictures some of which end before a border, beyond which their last row is repeated and labels are unknown."""
    count, size = len(pictures), pictures.shape[-1]
    cut, side = rng.chance(_CUT, count), rng.choice(_CUT_SIDES, count)
    kept = (rng.uniform(count, low=_KEPT[0], high=_KEPT[1]) * size).long()
    index, last = torch.arange(size, device=rng.device), torch.full_like(kept, size - 1)

    def within(first_side: int, last_side: int) -> torch.Tensor:
        """Row or column that each one shows, shape (B, S)."""
        low = torch.where(cut & (side == first_side), size - kept, 0)
        high = torch.where(cut & (side == last_side), kept - 1, last)
        return torch.minimum(torch.maximum(index, low[:, None]), high[:, None])

    rows, columns = within(_TOP, _BOTTOM), within(_LEFT, _RIGHT)
    person = torch.arange(count, device=rng.device)[:, None, None]
    shown = pictures.permute(0, 2, 3, 1)[person, rows[:, :, None], columns[:, None]]
    beyond = (rows != index)[:, :, None] | (columns != index)[:, None]
    return shown.permute(0, 3, 1, 2).contiguous(), labels.masked_fill(beyond, IGNORE)
