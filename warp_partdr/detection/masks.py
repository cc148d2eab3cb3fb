"""Masks of people, from their crops into the picture, and to whom each pixel belongs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F

from ..errors import check_each
from ..interop.checks import check_image_size
from .crops import TurnedCrops
from .person import FoundPerson

_STRIP = 256  # rows that are drawn at a time

Window = tuple[slice, slice]  # rows and columns of a picture


def draw_mask(person: FoundPerson, size: tuple[int, int]) -> np.ndarray:
    """Probability that a pixel of the picture shows the person, 0 outside the crop.

    Args:
        person: Of ``find_people``.
        size: (H, W) of the picture.

    Returns:
        Shape (H, W), float32.
    """
    full = np.zeros(check_image_size(size), dtype=np.float32)
    window = crop_window(person.crop, full.shape)
    full[window] = _drawn(person, window)
    return full


def instance_map(people: Sequence[FoundPerson], size: tuple[int, int], *, threshold: float = 0.5) -> np.ndarray:
    """Whom each pixel shows: the person whose mask is strongest there.

    Args:
        people: Of ``find_people``.
        size: (H, W) of the picture.
        threshold: Least probability of a pixel that shows a person.

    Returns:
        1 for the first person, 2 for the second, 0 for nobody, shape (H, W), int32.

    Raises:
        TypeError: If these are no people.
    """
    check_each("people", people, FoundPerson, "of find_people")
    owners = np.zeros(check_image_size(size), dtype=np.int32)
    strongest = np.full(owners.shape, threshold, dtype=np.float32)
    for number, person in enumerate(people, start=1):
        window = crop_window(person.crop, owners.shape)
        mask = _drawn(person, window)
        stronger = mask > strongest[window]
        owners[window][stronger] = number
        strongest[window][stronger] = mask[stronger]
    return owners


def crop_window(crop: TurnedCrops, size: tuple[int, ...]) -> Window:
    """Rows and columns of a picture of (H, W) that the one crop meets."""
    corners = crop.to_picture(np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]]))[0]
    low = np.floor(corners.min(axis=0)).astype(int)
    high = np.ceil(corners.max(axis=0)).astype(int)
    (left, right), (top, bottom) = (
        (min(max(a, 0), n), min(max(b, 0), n)) for a, b, n in zip(low, high, size[::-1], strict=True)
    )
    return slice(top, bottom), slice(left, right)


def _drawn(person: FoundPerson, window: Window) -> np.ndarray:
    """The mask at the centres of a window's pixels."""
    return spread_maps(torch.from_numpy(person.mask)[None], person.crop, window)[0][0]


def spread_maps(
    maps: torch.Tensor, crop: TurnedCrops, window: Window, *, mode: str = "bilinear"
) -> tuple[np.ndarray, np.ndarray]:
    """Maps across one crop, at the centres of the picture's pixels.

    Args:
        maps: Shape (C, h, w), on CPU.
        crop: Of which they are.
        window: The rows and columns of the picture to draw, of ``crop_window``.
        mode: "bilinear" or "nearest".

    Returns:
        The maps, 0 outside the crop, shape (C, R, S), float32; and the pixels within it, shape (R, S), bool.
    """
    rows, columns = window
    drawn = np.zeros((len(maps), rows.stop - rows.start, columns.stop - columns.start), dtype=np.float32)
    within = np.zeros(drawn.shape[1:], dtype=bool)
    for first in range(0, len(within) if within.size else 0, _STRIP):
        strip = slice(first, min(first + _STRIP, len(within)))
        corners = np.array([columns.start, rows.start + first]) + np.array([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5]])
        places = crop.from_picture(corners[None])[0].astype(np.float32)
        start, across, down = torch.from_numpy(places * 2 - 1)
        x, y = torch.arange(within.shape[1])[:, None], torch.arange(strip.stop - first)[:, None, None]
        grid = start + (across - start) * x + (down - start) * y
        values = F.grid_sample(maps[None], grid[None], mode=mode, align_corners=False, padding_mode="border")[0]
        inside = (grid[..., 0].abs() <= 1) & (grid[..., 1].abs() <= 1)
        drawn[:, strip] = torch.where(inside, values, 0.0).numpy()
        within[strip] = inside.numpy()
    return drawn, within
