"""Photos of shaded people in hard situations: a crowd, a stranger, a table, the picture's border, a poor picture."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
import torch
from PIL import Image

from .partbench_people import COCO, SEED, Person, make_person
from .people import anny_mesh
from .rng import TorchRng
from .shading import shade_people

KINDS = ("plain", "table", "cut", "stranger", "crowd", "poor")
_LOOKS, _PHOTO = 77, 78  # of the seeds of a person's colours and of a photo
_OTHERS = 100_000  # index of the first person who stands beside another
_ALSO = {"table": 0.1, "poor": 0.2}  # chances that a photo of another kind has this, too
_FRONT = 0.6  # chance that a further person stands before the others
_TABLE = 99  # owner of pixels that show a thing
_NEAR = (-3, 0, 3)  # [px], where a keypoint's person may show
_SMALLEST = 40  # [px], least side of what the border leaves


@dataclass(frozen=True)
class PhotographedPerson:
    """Person in a photo, with the truth.

    Attributes:
        keypoints: Keypoints of COCO in the picture [px], shape (17, 2).
        seen: Flags of keypoints that are in the picture and not behind another person or a thing, shape (17,), bool.
        joints: LSP's 14 joints in the frame of a camera [m], shape (14, 3).
        stature: Height [m].
        height: Height of the person standing, in the picture [px].
    """

    keypoints: np.ndarray
    seen: np.ndarray
    joints: np.ndarray
    stature: float
    height: float


@dataclass(frozen=True)
class CrowdedPhoto:
    """Photo of a kind of ``KINDS``: RGB pixels, shape (H, W, 3), uint8, and its people."""

    kind: str
    pixels: np.ndarray
    people: tuple[PhotographedPerson, ...]


class _Canvas:
    """Picture that grows: its pixels, the owner of each, counted from 1 on, and keypoints of the people."""

    def __init__(self, person: Person, pixels: np.ndarray) -> None:
        self.pixels = pixels.copy()
        self.owners = (person.parts > 0).astype(np.int64)
        self.people = [person]
        self.keypoints = [person.keypoints(COCO)]

    def add_person(self, person: Person, pixels: np.ndarray, rng: np.random.Generator) -> None:
        """Add a person who stands about where the others do, before them or behind them."""
        rows, columns = np.nonzero(person.parts)
        across = np.flatnonzero((self.owners > 0).any(0))
        lowest = int(np.flatnonzero((self.owners > 0).any(1))[-1])
        half = int(np.ptp(columns)) // 2
        down = lowest - int(rows.max()) + int(rng.integers(-10, 25))
        right = int(rng.integers(across[0] - half, across[-1] - half + 1)) - int(columns.min())
        height, width = self.owners.shape
        inside = (rows + down >= 0) & (rows + down < height) & (columns + right >= 0) & (columns + right < width)
        rows, columns = rows[inside], columns[inside]
        if rng.random() >= _FRONT:
            free = self.owners[rows + down, columns + right] == 0
            rows, columns = rows[free], columns[free]
        self.people.append(person)
        self.pixels[rows + down, columns + right] = pixels[rows, columns]
        self.owners[rows + down, columns + right] = len(self.people)
        self.keypoints.append(person.keypoints(COCO) + np.array([right, down]))

    def add_table(self, rng: np.random.Generator) -> None:
        """Add a thing with one colour before the people."""
        height, width = self.owners.shape
        top = int(np.quantile(np.nonzero(self.owners)[0], rng.uniform(0.3, 0.8)))
        left, right = (0, width) if rng.random() < 0.5 else np.sort(rng.integers(0, width, 2)).tolist()
        bottom = height if rng.random() < 0.6 else min(height, top + int(rng.uniform(0.1, 0.5) * height))
        shades = rng.normal(0, 8, (bottom - top, right - left, 1)) + np.linspace(0, 30, right - left)[None, :, None]
        self.pixels[top:bottom, left:right] = (rng.uniform(0, 255, 3) + shades).clip(0, 255)
        self.owners[top:bottom, left:right] = _TABLE

    def seen(self, index: int) -> np.ndarray:
        """Flags of a person's keypoints that are in the picture and near pixels of the person, shape (17,)."""
        height, width = self.owners.shape
        found = np.zeros(len(COCO), dtype=bool)
        places = np.rint(self.keypoints[index]).astype(int)
        inside = ((places >= 0) & (places < [width, height])).all(axis=1)
        for down in _NEAR:
            for right in _NEAR:
                u, v = np.clip(places + np.array([right, down]), 0, [width - 1, height - 1]).T
                found |= self.owners[v, u] == index + 1
        return found & inside


def make_crowded_photo(index: int) -> CrowdedPhoto:
    """Photo ``index``, with a seed of its own; its first person is ``make_person(index)``."""
    rng = np.random.default_rng([SEED, index, _PHOTO])
    kind = KINDS[int(rng.integers(len(KINDS)))]
    canvas = _Canvas(*_shaded(index))
    for number in range({"stranger": 1, "crowd": 3}.get(kind, 0)):
        canvas.add_person(*_shaded(_OTHERS + 4 * index + number), rng)
    if kind == "table" or rng.random() < _ALSO["table"]:
        canvas.add_table(rng)
    left, top, right, bottom = (
        _cut_box(canvas.owners == 1, rng) if kind == "cut" else (0, 0, *canvas.owners.shape[::-1])
    )
    seen = [canvas.seen(row) for row in range(len(canvas.people))]
    keypoints = [each - [left, top] for each in canvas.keypoints]
    pixels, zoom = canvas.pixels[top:bottom, left:right], 1.0
    within = [((each >= 0) & (each < [right - left, bottom - top])).all(axis=1) for each in keypoints]
    if kind == "poor" or rng.random() < _ALSO["poor"]:
        pixels, zoom = _worsen(pixels, rng)
    people = [
        PhotographedPerson(points * zoom, shown & there, person.joints, person.stature, person.height * zoom)
        for person, points, shown, there in zip(canvas.people, keypoints, seen, within, strict=True)
    ]
    return CrowdedPhoto(kind, np.ascontiguousarray(pixels), tuple(people))


def _shaded(index: int) -> tuple[Person, np.ndarray]:
    """Person ``index``, and a photo of them alone."""
    person = make_person(index)
    seed = int(np.random.default_rng([SEED, index, _LOOKS]).integers(2**62))
    vertices = torch.from_numpy(person.vertices)[None]
    return person, shade_people(vertices, anny_mesh(), person.camera, person.parts.shape, TorchRng(seed, "cpu"))[0][0]


def _cut_box(shown: np.ndarray, rng: np.random.Generator) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of a part of the picture that cuts off some of the person."""
    rows, columns = np.nonzero(shown)
    height, width = shown.shape
    side, share = int(rng.integers(4)), float(rng.uniform(0.15, 0.6))
    if not len(rows):
        return 0, 0, width, height
    tall, wide = float(np.ptp(rows)), float(np.ptp(columns))
    box = [
        (0, 0, width, int(rows.max() - share * tall)),
        (0, int(rows.min() + 0.5 * share * tall), width, height),
        (int(columns.min() + share * wide), 0, width, height),
        (0, 0, int(columns.max() - share * wide), height),
    ][side]
    large = min(box[2] - box[0], box[3] - box[1]) > _SMALLEST
    return box if large else (0, 0, width, height)


def _worsen(pixels: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Make a picture smaller, paler, noisier and a JPEG; and the factor of its size."""
    zoom = float(np.exp(rng.uniform(np.log(0.2), 0.0)))
    height, width = max(int(pixels.shape[0] * zoom), 24), max(int(pixels.shape[1] * zoom), 24)
    small = np.asarray(Image.fromarray(pixels).resize((width, height), Image.Resampling.BOX)).astype(np.float64)
    contrast, brightness = rng.uniform(0.3, 1.1), rng.uniform(-50, 50)
    values = (small - 128) * contrast + 128 + brightness + rng.normal(0, rng.uniform(0, 14), small.shape)
    buffer = io.BytesIO()
    Image.fromarray(values.clip(0, 255).astype(np.uint8)).save(buffer, "JPEG", quality=int(rng.integers(20, 95)))
    return np.asarray(Image.open(buffer).convert("RGB")), width / pixels.shape[1]
