"""Masks of people, which are drawn from their crops into the picture, and the person at each pixel."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import torch
import torch.nn.functional as F
import warp as wp

from ...errors import check_each
from ...interop.arrays import warp_array
from ...interop.checks import check_image_size
from ...interop.streams import on_torch_stream
from ...interop.torch_threads import one_torch_thread
from ...kernels import masks as mask_kernels
from ...kernels.launch import launch_in_slices
from .crops import TurnedCrops, join_crops
from .person import FoundPerson

_STRIP = 256  # rows that are drawn at a time
_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])  # of a crop

Window = tuple[slice, slice]  # rows and columns of a picture


def draw_mask(person: FoundPerson, size: tuple[int, int]) -> np.ndarray:
    """Draw the probability that a pixel of the picture shows the person; it is 0 outside the crop.

    Args:
        person: Person that ``find_people`` returned.
        size: Height and width (H, W) of the picture [px].

    Returns:
        Probabilities, shape (H, W), float32.
    """
    full = np.zeros(check_image_size(size), dtype=np.float32)
    window = crop_window(person.crop, full.shape)
    full[window] = spread_maps(person.mask.cpu()[None], person.crop, window)[0][0]
    return full


def mask_shows(mask: torch.Tensor, crop: TurnedCrops, positions: np.ndarray) -> np.ndarray:
    """True where a mask shows its person.

    Args:
        mask: Probability that a pixel of the crop shows the person, shape (S, S).
        crop: The one crop that the mask belongs to.
        positions: Places in the picture [px], shape (N, 2).

    Returns:
        Whether the person is shown at each place, shape (N,), bool.
    """
    side = len(mask)
    column, row = np.floor(crop.from_picture(positions[None])[0] * side).astype(int).T
    inside = (np.minimum(column, row) >= 0) & (np.maximum(column, row) < side)
    pixels = torch.from_numpy(row.clip(0, side - 1)), torch.from_numpy(column.clip(0, side - 1))
    return inside & (mask[pixels] > 0.5).cpu().numpy()


def instance_map(people: Sequence[FoundPerson], size: tuple[int, int], *, threshold: float = 0.5) -> np.ndarray:
    """Map of the people in a picture: each pixel shows the person whose mask is strongest there.

    Args:
        people: People that ``find_people`` returned.
        size: Height and width (H, W) of the picture [px].
        threshold: Least probability of a pixel that shows a person.

    Returns:
        Number of the person at each pixel, 1 for the first, 2 for the second, and 0 for nobody, shape (H, W), int32.

    Raises:
        TypeError: If ``people`` holds something else.
    """
    return instance_maps([people], [size], threshold=threshold)[0].cpu().numpy()


@one_torch_thread()
def instance_maps(
    people: Sequence[Sequence[FoundPerson]], sizes: Sequence[tuple[int, int]], *, threshold: float = 0.5
) -> list[torch.Tensor]:
    """Maps of the people in several pictures, as ``instance_map`` returns one, on the device of the masks."""
    for some in people:
        check_each("people", some, FoundPerson, "of find_people")
    shapes = np.array([check_image_size(size) for size in sizes], dtype=np.int64).reshape(-1, 2)
    everyone = [person for some in people for person in some]
    device = everyone[0].mask.device if everyone else torch.device("cpu")
    pixels = shapes.prod(axis=1)
    owners = torch.zeros(int(pixels.sum()), dtype=torch.int32, device=device)
    if everyone:
        strongest = torch.empty_like(owners, dtype=torch.float32)
        counts = np.array([len(some) for some in people])
        crops = join_crops([person.crop for person in everyone])
        tables = (
            *_windows(crops, np.repeat(shapes, counts, axis=0)),
            _starts(shapes[:, 0]),
            _starts(pixels)[:-1],
            shapes[:, 1].astype(np.int32),
            _starts(counts),
        )
        on_device = [torch.from_numpy(each).to(device) for each in tables]
        windows, steps, pictures = on_device[0], on_device[1], on_device[2:]
        with on_torch_stream(device) as where:
            maps = torch.stack([person.mask for person in everyone])
            masks = [warp_array(maps), warp_array(windows), warp_array(steps, wp.vec2)]
            launch = partial(
                mask_kernels.launch_owners,
                masks,
                [*map(warp_array, pictures)],
                threshold,
                [warp_array(strongest), warp_array(owners)],
            )
            launch_in_slices(launch, int(shapes[:, 0].sum()), wp.get_device(where), modules=[mask_kernels])
    return [
        each.reshape(size)
        for each, size in zip(owners.split(pixels.tolist()), map(tuple, shapes.tolist()), strict=True)
    ]


def _starts(counts: np.ndarray) -> np.ndarray:
    """Sums of the counts before each count, and the sum of all."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)


def _windows(crops: TurnedCrops, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of pictures that crops meet, shape (N, 4), as ``MaskArrays`` has them, and ``_steps``."""
    corners = crops.to_picture(np.broadcast_to(_CORNERS, (len(crops), 4, 2)))
    limits = sizes[:, ::-1]
    low = np.floor(corners.min(axis=1)).clip(0, limits).astype(int)
    high = np.ceil(corners.max(axis=1)).clip(0, limits).astype(int)
    windows = np.stack([low[:, 1], high[:, 1], low[:, 0], high[:, 0]], axis=1)
    return windows.astype(np.int32), _steps(crops, low)


def _steps(crops: TurnedCrops, pixels: np.ndarray) -> np.ndarray:
    """Positions of pixels (x, y) (N, 2) in the crops, from -1 to 1, and steps across and down: (N, 3, 2), float32."""
    positions = crops.from_picture(pixels[:, None] + np.array([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5]])) * 2 - 1
    positions[:, 1:] -= positions[
        :, :1
    ]  # in float64, because a thousand steps between rounded positions would go astray
    return positions.astype(np.float32)


def crop_window(crop: TurnedCrops, size: tuple[int, ...]) -> Window:
    """Rows and columns of a picture of (H, W) that a single crop meets."""
    top, bottom, left, right = _windows(crop, np.array([size]))[0][0].tolist()
    return slice(top, bottom), slice(left, right)


def spread_maps(
    maps: torch.Tensor, crop: TurnedCrops, window: Window, *, mode: str = "bilinear"
) -> tuple[np.ndarray, np.ndarray]:
    """Resample maps of one crop at the centres of the picture's pixels.

    Args:
        maps: Maps of the crop, shape (C, h, w), on CPU.
        crop: Crop that the maps belong to.
        window: Rows and columns of the picture to draw, which ``crop_window`` returns.
        mode: Interpolation, "bilinear" or "nearest".

    Returns:
        Maps, 0 outside the crop, shape (C, R, S), float32; and flags of the pixels within it, shape (R, S), bool.
    """
    rows, columns = window
    drawn = np.zeros((len(maps), rows.stop - rows.start, columns.stop - columns.start), dtype=np.float32)
    within = np.zeros(drawn.shape[1:], dtype=bool)
    for first in range(0, len(within) if within.size else 0, _STRIP):
        strip = slice(first, min(first + _STRIP, len(within)))
        start, across, down = torch.from_numpy(_steps(crop, np.array([[columns.start, rows.start + first]]))[0])
        x, y = torch.arange(within.shape[1])[:, None], torch.arange(strip.stop - first)[:, None, None]
        grid = start + across * x + down * y
        values = F.grid_sample(maps[None], grid[None], mode=mode, align_corners=False, padding_mode="border")[0]
        inside = (grid[..., 0].abs() <= 1) & (grid[..., 1].abs() <= 1)
        drawn[:, strip] = torch.where(inside, values, 0.0).numpy()
        within[strip] = inside.numpy()
    return drawn, within
