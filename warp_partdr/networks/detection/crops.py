"""Turned crops of pictures, which are cut out for a network, and the way back into the picture.

Within a crop, (0, 0) is the top left corner and (1, 1) the bottom right corner, as the crop is turned. Positions in a
picture are in pixels. Pixel (row v, column u) has its centre at (u + 0.5, v + 0.5).
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
import torch
import torch.nn.functional as F
import warp as wp

from ...interop.arrays import tensor_over, warp_array
from ...interop.streams import on_torch_stream
from ...interop.torch_threads import one_torch_thread
from ...kernels import crops as crop_kernels
from ...kernels.launch import get_num_threads, run_slices

_MARGIN = 1.25  # side of a person's crop, as a share of the diameter of the circle about the person
_LARGEST = 4096  # [px], longer side of the finest picture that crops are cut from
_SHARPER = 0.5  # levels that crops are sharper than free of all aliasing
_BATCH = {"cpu": 3, "cuda": 256}  # crops at a time: on CPU, as many as need no pages of memory anew from the system
_STRIP = 512  # rows that are halved at a time, even
_UPLOAD = 2**25  # bytes of pictures that go to a device at a time: while one part goes there, the next is gathered
_UPLOADERS = 4  # threads that gather them

Result = TypeVar("Result")


@dataclass(frozen=True)
class TurnedCrops:
    """N crops of pictures, square unless ``aspect`` says else.

    Attributes:
        centres: Centres [px], shape (N, 2), float64.
        sides: Heights [px], shape (N,).
        angles: Angle from the picture's x axis to the crop's, clockwise as seen [rad], shape (N,).
        pictures: Index of each crop's picture, shape (N,), int64.
        aspect: Width of every crop, as a share of the height.
    """

    centres: np.ndarray
    sides: np.ndarray
    angles: np.ndarray
    pictures: np.ndarray
    aspect: float = 1.0

    def __len__(self) -> int:
        return len(self.sides)

    def __getitem__(self, rows: slice | np.ndarray) -> TurnedCrops:
        return TurnedCrops(self.centres[rows], self.sides[rows], self.angles[rows], self.pictures[rows], self.aspect)

    def to_picture(self, positions: np.ndarray) -> np.ndarray:
        """Map positions in the crops, shape (N, K, 2), to positions in the pictures [px]."""
        offsets = self._extents * (positions - 0.5)
        return self.centres[:, None] + np.einsum("nij,nkj->nki", self._turns, offsets)

    def from_picture(self, positions: np.ndarray) -> np.ndarray:
        """Map positions in the pictures [px], shape (N, K, 2), to positions in the crops."""
        offsets = np.einsum("nji,nkj->nki", self._turns, positions - self.centres[:, None])
        return offsets / self._extents + 0.5

    def zoomed(self, zoom: float) -> TurnedCrops:
        """Crops of the same pictures at another size, ``zoom`` times as large."""
        return replace(self, centres=self.centres * zoom, sides=self.sides * zoom)

    @property
    def _extents(self) -> np.ndarray:
        """Widths and heights [px], shape (N, 1, 2)."""
        return self.sides[:, None, None] * np.array([self.aspect, 1.0])

    @property
    def _turns(self) -> np.ndarray:
        cosines, sines = np.cos(self.angles), np.sin(self.angles)
        return np.stack([cosines, -sines, sines, cosines], axis=-1).reshape(-1, 2, 2)


def crops_of_people(centres: np.ndarray, tops: np.ndarray, pictures: np.ndarray) -> TurnedCrops:
    """Crops that show whole people upright.

    Args:
        centres: Middles of the hips [px], shape (N, 2).
        tops: Points on the circle about the whole body, above the head as the person stands, shape (N, 2).
        pictures: Index of each person's picture, shape (N,).
    """
    up = tops - centres
    sides = np.maximum(2 * _MARGIN * np.linalg.norm(up, axis=1), 1.0)
    return TurnedCrops(centres, sides, np.arctan2(up[:, 0], -up[:, 1]), pictures)


def join_crops(parts: Sequence[TurnedCrops]) -> TurnedCrops:
    """All of the crops, which are square, in a row."""
    return TurnedCrops(
        np.concatenate([part.centres for part in parts]),
        np.concatenate([part.sides for part in parts]),
        np.concatenate([part.angles for part in parts]),
        np.concatenate([part.pictures for part in parts]),
    )


def no_crops() -> TurnedCrops:
    """Make an empty set of crops."""
    return TurnedCrops(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64))


def work_on_crops(work: Callable[[TurnedCrops], Result], crops: TurnedCrops, device: torch.device) -> list[Result]:
    """Results of crops, for as many crops at a time as a network takes; on the CPU, threads share the crops.

    Torch's own threads would wait for one another in every operator (``one_torch_thread``). These threads meet only at
    the end.
    """
    on_cpu = device.type == "cpu"
    cores = get_num_threads() if on_cpu else 1
    step = min(_BATCH["cpu" if on_cpu else "cuda"], max(-(-len(crops) // cores), 1))
    parts = [crops[start : start + step] for start in range(0, len(crops), step)]
    results: list[list[Result]] = [[] for _ in parts]

    @one_torch_thread()
    @torch.no_grad()
    def share(some: slice) -> None:
        for index in range(len(parts))[some]:
            results[index].append(work(parts[index]))

    threads = max(min(cores, len(parts)), 1)
    if threads > 1:
        wp.load_module(crop_kernels, device="cpu")  # or each thread would build it
    run_slices(share, [slice(first, None, threads) for first in range(threads)])
    return [result for (result,) in results]


class _Pictures:
    """Pictures of one size at their full size and at halves of it, on one device.

    Args:
        pixels: Colours of the pictures, shape (N, H, W, 3), uint8.
    """

    def __init__(self, pixels: torch.Tensor) -> None:
        self.first = max(0, math.ceil(math.log2(max(pixels.shape[1:3]) / _LARGEST)))  # number of the finest level
        self._bytes = pixels.permute(0, 3, 1, 2)
        self._levels: list[torch.Tensor] = []
        self._lock = threading.Lock()  # several threads may ask for a level that isn't there yet

    @property
    def device(self) -> torch.device:
        return self._bytes.device

    @cached_property
    def _finest(self) -> torch.Tensor:
        """The finest level, from 0 to 1, shape (N, 3, h, w)."""
        if self.first == 0:
            return self._bytes.float() / 255
        strips = []
        for strip in self._bytes.split(_STRIP << self.first, dim=2):
            values = strip.float() / 255
            for _ in range(self.first):
                values = _halved(values)
            strips.append(values)
        return torch.cat(strips, dim=2)

    def level(self, number: int) -> torch.Tensor:
        """Level of the pictures, from the finest one on, shape (N, 3, h, w), channels last."""
        with self._lock:
            while len(self._levels) <= number - self.first:
                made = _halved(self._levels[-1]) if self._levels else self._finest
                self._levels.append(made.contiguous(memory_format=torch.channels_last))
        return self._levels[number - self.first]


class Pyramid:
    """Picture at its full size and at halves of it, from which crops are cut without aliasing.

    Args:
        picture: RGB, shape (H, W, 3), uint8.
        device: Device to hold it on.
    """

    def __init__(self, picture: np.ndarray, device: torch.device | str) -> None:
        self._place(_Pictures(tensor_over(picture)[None].to(device)), 0, picture)

    @classmethod
    def each(cls, pictures: Sequence[np.ndarray], device: torch.device | str) -> list[Pyramid]:
        """Pyramids of pictures. On CUDA, pictures of one size are copied in a batch, and share their levels."""
        if torch.device(device).type != "cuda":
            return [cls(picture, device) for picture in pictures]
        found: dict[int, Pyramid] = {}
        for shape in dict.fromkeys(picture.shape for picture in pictures):
            indices = [index for index, picture in enumerate(pictures) if picture.shape == shape]
            step = max(1, _UPLOAD // math.prod(shape))
            for some in (indices[start : start + step] for start in range(0, len(indices), step)):
                together = _Pictures(_uploaded([pictures[index] for index in some], device))
                for row, index in enumerate(some):
                    found[index] = cls.__new__(cls)
                    found[index]._place(together, row, pictures[index])
        return [found[index] for index in range(len(pictures))]

    def _place(self, pictures: _Pictures, row: int, picture: np.ndarray) -> None:
        self.size = picture.shape[0], picture.shape[1]
        self.device = pictures.device
        self._pictures, self._row = pictures, row

    def level(self, wanted: int) -> tuple[torch.Tensor, int]:
        """Level ``wanted``, whose pixels are 2**level wide in the picture, or the finest there is, and its number.

        Shape (1, 3, h, w); the colours of a pixel lie side by side in memory.
        """
        wanted = max(wanted, self._pictures.first)
        return self._pictures.level(wanted)[self._row : self._row + 1], wanted


def _uploaded(pictures: Sequence[np.ndarray], device: torch.device | str) -> torch.Tensor:
    """Pictures of one size on a CUDA device. Threads copy them to pinned memory, which the device reads by itself."""
    held = torch.empty(len(pictures), *pictures[0].shape, dtype=torch.uint8, pin_memory=True)
    there, rows = torch.empty(held.shape, dtype=held.dtype, device=device), held.numpy()

    def copy(part: slice) -> None:
        for row, picture in enumerate(pictures[part], part.start):
            rows[row] = picture

    threads = max(min(get_num_threads(), _UPLOADERS, len(pictures)), 1)
    run_slices(copy, [slice(len(pictures) * k // threads, len(pictures) * (k + 1) // threads) for k in range(threads)])
    return there.copy_(held, non_blocking=True)


def _halved(values: torch.Tensor) -> torch.Tensor:
    """Means of blocks of 2 x 2; an odd last row or column counts twice."""
    height, width = values.shape[-2:]
    if height % 2 or width % 2:
        values = F.pad(values, (0, width % 2, 0, height % 2), mode="replicate")
    return F.avg_pool2d(values, 2)


def cut_crops(
    pyramids: Sequence[Pyramid], crops: TurnedCrops, size: int | tuple[int, int], *, beyond: str = "zeros"
) -> torch.Tensor:
    """Crops as pictures.

    Each crop is read bilinearly from a halved picture. A pixel of the crop is at most 2.83 of its pixels wide.

    Args:
        pyramids: The pictures.
        crops: N crops of them.
        size: Height and width (H, W) of the results [px], or the side of a square.
        beyond: Filling beyond the picture: "zeros" is black, and "border" repeats the border.

    Returns:
        Colours from 0 to 1, shape (N, 3, H, W).
    """
    device = pyramids[0].device
    height, width = size if isinstance(size, tuple) else (size, size)
    if not len(crops):
        return torch.zeros(0, 3, height, width, device=device)
    coarsest = crops.sides * max(1 / height, crops.aspect / width)  # pixels of the picture in a pixel of a crop
    levels = np.floor(np.log2(np.maximum(coarsest, 2**_SHARPER)) - _SHARPER).astype(int)
    wanted = zip(crops.pictures.tolist(), levels.tolist(), strict=True)
    sources = [pyramids[picture].level(level) for picture, level in wanted]
    scales = 2.0 ** np.array([level for _, level in sources])
    centres = (np.array([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5]])) / (width, height)
    positions = crops.to_picture(np.broadcast_to(centres, (len(crops), 3, 2))) / scales[:, None, None]
    positions[:, 1:] -= positions[:, :1]
    pointers = torch.tensor([values.data_ptr() for values, _ in sources]).to(device)
    sizes = torch.tensor([values.shape[-2:] for values, _ in sources], dtype=torch.int32).to(device)
    steps = torch.from_numpy(positions.astype(np.float32)).to(device)
    cut = torch.empty(len(crops), 3, height, width, device=device)
    with on_torch_stream(device):
        arrays = [warp_array(pointers), warp_array(sizes), warp_array(steps, wp.vec2)]
        crop_kernels.launch_crops(arrays, beyond == "zeros", warp_array(cut))
    return cut
