"""Pictures that stand behind people, lie on their clothes and hide parts of them: a user's own, or others."""

from __future__ import annotations

import math
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image

from ...errors import InputError
from ...inputs.part_labels import read_photo
from ...inputs.photo_files import PHOTO_SUFFIXES, ending_of, is_hidden_name
from .rng import TorchRng
from .shading import noise_backgrounds

SIDE = 384  # [px], of the squares that are kept
_WIDE = 1.3  # ratio of width to height from which on a picture gives its left and right ends, too
_SAMPLES = ("brick.png", "chelsea.png", "coffee.png", "coins.png", "grass.png", "gravel.png", "motorcycle_left.png")
_NOISE, _NOISE_SEED = 32, 5_003  # number of pictures of noise, and their seed
_PART = (0.25, 1.0)  # side of the part that is cut out; small ones as often as large ones, as logarithms
_TILT = 0.3  # [rad], largest turn of it
_BRIGHTNESS = (0.5, 1.3)
_PLAIN = 0.2  # share of backgrounds that are one colour with soft spots:
_SPOTS = ((2, 0.5), (8, 0.25), (40, 0.15))  # cells a side, and how much they change a colour
_BLURRED, _BLUR = 0.4, 8  # share of backgrounds out of focus, and how much coarser these are


def load_backdrops(folder: str) -> torch.Tensor:
    """Read pictures as squares of ``SIDE`` pixels, shape (N, 3, 384, 384), uint8.

    Args:
        folder: Folder of pictures in which nobody is seen. If it is "", some of scikit-image's sample pictures are
            taken, or smooth noise and boxes if that library is not installed.

    Raises:
        InputError: If the folder is none, holds no pictures, or holds one that can't be read.
    """
    if folder:
        return _squares(_pictures_in(Path(folder)))
    samples = _sample_files()
    return _squares(samples) if samples else _noise()


def _pictures_in(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise InputError(f"data.backgrounds: {folder}; expected a folder of pictures")
    names = sorted(path for path in folder.iterdir() if ending_of(path.name) in PHOTO_SUFFIXES)
    found = [path for path in names if path.is_file() and not is_hidden_name(path.name)]
    if not found:
        raise InputError(f"data.backgrounds: {folder}: no pictures in it; expected some: {', '.join(PHOTO_SUFFIXES)}")
    return found


def _sample_files() -> list[Path]:
    """Sample pictures without people that are installed with scikit-image, which is not imported."""
    library = find_spec("skimage")
    if library is None or library.origin is None:
        return []
    paths = [Path(library.origin).parent / "data" / name for name in _SAMPLES]
    return [path for path in paths if path.is_file()]


def _squares(files: list[Path]) -> torch.Tensor:
    found = [square for path in files for square in _squares_of(read_photo(path))]
    return torch.from_numpy(np.stack(found)).permute(0, 3, 1, 2).contiguous()


def _squares_of(photo: np.ndarray) -> list[np.ndarray]:
    """Squares of a picture (H, W, 3): its middle, and both ends of a wide one."""
    height, width = photo.shape[:2]
    zoom = SIDE / min(height, width)
    size = max(round(width * zoom), SIDE), max(round(height * zoom), SIDE)
    small = np.asarray(Image.fromarray(photo).resize(size, Image.Resampling.BICUBIC))
    top, left = (small.shape[0] - SIDE) // 2, (small.shape[1] - SIDE) // 2
    found = [small[top : top + SIDE, left : left + SIDE]]
    if small.shape[1] > _WIDE * SIDE:
        found += [small[:SIDE, :SIDE], small[:SIDE, -SIDE:]]
    return found


@lru_cache(maxsize=1)
def _noise() -> torch.Tensor:
    pictures = noise_backgrounds(_NOISE, (SIDE, SIDE), TorchRng(_NOISE_SEED, "cpu"))
    return (pictures.clamp(0, 1) * 255).byte()


class Backdrops:
    """Pictures on a device, from which parts are cut out at random.

    Args:
        pictures: Pictures of ``load_backdrops``, shape (N, 3, H, W), uint8.
        rng: Source of chance, whose device they are moved to.
    """

    def __init__(self, pictures: torch.Tensor, rng: TorchRng) -> None:
        self._pictures, self._rng = pictures.to(rng.device), rng

    def some(self, count: int) -> torch.Tensor:
        """Random pictures as they are, from 0 to 1, shape (count, 3, H, W)."""
        return self._pictures[self._rng.integers(len(self._pictures), count)].float() / 255

    def parts(self, count: int, size: int) -> torch.Tensor:
        """Parts of random pictures, tilted, half of them mirrored, from 0 to 1, shape (count, 3, size, size)."""
        rng, pictures = self._rng, self.some(count)
        angle = rng.uniform(count, low=-_TILT, high=_TILT)
        side = log_uniform(rng, _PART, count)
        mirror = torch.where(rng.chance(0.5, count), 1.0, -1.0)
        shift = (1 - side)[:, None] * rng.uniform(count, 2, low=-1, high=1)
        across, down = side * torch.cos(angle), side * torch.sin(angle)
        first = torch.stack([mirror * across, -down, shift[:, 0]], dim=-1)
        second = torch.stack([mirror * down, across, shift[:, 1]], dim=-1)
        return sample_affinely(pictures, torch.stack([first, second], dim=1), size, padding="reflection")

    def behind(self, count: int, size: int) -> torch.Tensor:
        """Backgrounds, parts of pictures or plain, darker or brighter, some blurred, shape (count, 3, size, size)."""
        rng, photos = self._rng, self.parts(count, size)
        plain = rng.uniform(count, 3, 1, 1)
        for cells, strength in _SPOTS:
            spots = rng.uniform(count, 3, cells, cells, low=-strength, high=strength)
            plain = plain + F.interpolate(spots, size=(size, size), mode="bilinear")
        behind = torch.where(rng.chance(_PLAIN, count, 1, 1, 1), plain.clamp(0, 1), photos)
        behind = behind * rng.uniform(count, 1, 1, 1, low=_BRIGHTNESS[0], high=_BRIGHTNESS[1])
        return torch.where(rng.chance(_BLURRED, count, 1, 1, 1), coarser(behind, _BLUR), behind)


def sample_affinely(pictures: torch.Tensor, maps: torch.Tensor, size: int, *, padding: str = "zeros") -> torch.Tensor:
    """Squares of pictures (B, C, H, W), each sampled where its map (B, 2, 3) leads, shape (B, C, size, size)."""
    grid = F.affine_grid(maps, [len(maps), pictures.shape[1], size, size], align_corners=False)
    return F.grid_sample(pictures, grid, mode="bilinear", padding_mode=padding, align_corners=False)


def coarser(pictures: torch.Tensor, factor: int) -> torch.Tensor:
    """Pictures (B, C, S, S) as if they had a pixel for each ``factor`` x ``factor`` of theirs."""
    return F.interpolate(F.avg_pool2d(pictures, factor), size=pictures.shape[-2:], mode="bilinear")


def log_uniform(rng: TorchRng, between: tuple[float, float], *shape: int) -> torch.Tensor:
    """Random numbers in a range whose logarithms are uniform."""
    return rng.uniform(*shape, low=math.log(between[0]), high=math.log(between[1])).exp()
