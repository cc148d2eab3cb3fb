"""Photos of shaded people in hard situations: crowds, tables, skirts, riders, near cameras, children beside adults."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
import torch
from PIL import Image

from .partbench_people import AS_DRAWN, COCO, SEED, Person, PersonRequest, make_person
from .photo_things import Paint, Thing, bench_thing, chair_thing, mount_thing
from .rng import TorchRng
from .shading import shade_people

# What each kind asks of its first person.
_REQUESTS = {
    "plain": AS_DRAWN,
    "table": AS_DRAWN,
    "cut": AS_DRAWN,
    "stranger": AS_DRAWN,
    "crowd": AS_DRAWN,
    "poor": AS_DRAWN,
    "half body": PersonRequest(pose="standing at ease"),
    "skirt": PersonRequest(tube=True),
    "near": PersonRequest(distance=(0.8, 1.6)),
    "child": AS_DRAWN,
    "overlap": AS_DRAWN,
    "wheelchair": PersonRequest(pose="sitting"),
    "rider": PersonRequest(pose="riding"),
    "on one leg": PersonRequest(pose="on one leg"),
}
KINDS = tuple(_REQUESTS)
_CHILD = PersonRequest(age=(0.0, 0.06))
_OTHERS_BESIDE = {"stranger": 1, "crowd": 3}
_LOOKS, _PHOTO = 77, 78  # of the seeds of a person's colours and of a photo
_OTHERS = 100_000  # index of the first person who stands beside another
_ALSO = {"table": 0.1, "poor": 0.2}  # chances that a photo of another kind has this, too
_FRONT = 0.6  # chance that a further person stands before the others
_OVERLAP = 0.35  # of their widths, largest distance between the middles of people who overlap
_LARGEST_CHANGE = 8.0  # of a picture's size, where a child is made as large as it is beside an adult
_THING = 99  # owner of pixels that show a thing
_NEAR = (-3, 0, 3)  # [px], where a keypoint's person may show
_SMALLEST = 40  # [px], least side of what the border leaves
_HIPS = [COCO.landmarks.index(f"{side}_hip") for side in ("left", "right")]
_SHOULDERS = [COCO.landmarks.index(f"{side}_shoulder") for side in ("left", "right")]


@dataclass(frozen=True)
class PhotographedPerson:
    """Person in a photo, with the truth.

    Attributes:
        keypoints: Keypoints of COCO in the picture [px], shape (17, 2).
        seen: Flags of keypoints that are in the picture and not behind another person or a thing, shape (17,), bool.
        joints: LSP's 14 joints in the frame of a camera [m], shape (14, 3).
        stature: Height [m].
        height: Height of the person standing, in the picture [px].
        shape: Anny's shape values, shape (1, 20).
    """

    keypoints: np.ndarray
    seen: np.ndarray
    joints: np.ndarray
    stature: float
    height: float
    shape: torch.Tensor


@dataclass(frozen=True)
class HardPhoto:
    """Photo of a kind of ``KINDS``: RGB pixels, shape (H, W, 3), uint8, and its people."""

    kind: str
    pixels: np.ndarray
    people: tuple[PhotographedPerson, ...]


class _Canvas:
    """Picture that grows: its pixels, the owner of each, counted from 1 on, and keypoints and heights of the people."""

    def __init__(self, person: Person, pixels: np.ndarray) -> None:
        self.pixels = pixels.copy()
        self.owners = (person.parts > 0).astype(np.int64)
        self.people = [person]
        self.keypoints = [person.keypoints(COCO)]
        self.heights = [person.height]

    def add_person(
        self,
        person: Person,
        pixels: np.ndarray,
        rng: np.random.Generator,
        *,
        zoom: float = 1.0,
        overlap: bool = False,
    ) -> None:
        """Add a person who stands about where the others do, before them or behind them.

        Args:
            person: Person, whose picture is ``pixels``.
            pixels: RGB, shape (H, W, 3), uint8.
            rng: Source of chance.
            zoom: Factor of the picture's size.
            overlap: True places the person right before or behind the first one.
        """
        shown = person.parts > 0
        if zoom != 1.0:
            size = (max(round(shown.shape[1] * zoom), 1), max(round(shown.shape[0] * zoom), 1))
            pixels = np.asarray(Image.fromarray(pixels).resize(size, Image.Resampling.BOX))
            shown = np.asarray(Image.fromarray(shown).resize(size, Image.Resampling.NEAREST))
        rows, columns = np.nonzero(shown)
        if not len(rows):
            return
        across = np.flatnonzero((self.owners > 0).any(0))
        lowest = int(np.flatnonzero((self.owners > 0).any(1))[-1])
        half = int(np.ptp(columns)) // 2
        first, last = int(across[0]) - half, int(across[-1]) - half
        if overlap:
            middle, reach = (first + last) // 2, round(_OVERLAP * (half + (last - first) / 2))
            first, last = middle - reach, middle + reach
        down = lowest - int(rows.max()) + int(rng.integers(-10, 25))
        right = int(rng.integers(first, last + 1)) - int(columns.min())
        height, width = self.owners.shape
        inside = (rows + down >= 0) & (rows + down < height) & (columns + right >= 0) & (columns + right < width)
        rows, columns = rows[inside], columns[inside]
        if rng.random() >= _FRONT:
            free = self.owners[rows + down, columns + right] == 0
            rows, columns = rows[free], columns[free]
        self.people.append(person)
        self.pixels[rows + down, columns + right] = pixels[rows, columns]
        self.owners[rows + down, columns + right] = len(self.people)
        self.keypoints.append(zoom * person.keypoints(COCO) + np.array([right, down]))
        self.heights.append(zoom * person.height)

    def add_thing(self, thing: Thing) -> None:
        """Add a thing before the people."""
        self.pixels[thing.mask] = thing.colours[thing.mask]
        self.owners[thing.mask] = _THING

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


def make_hard_photo(index: int, kind: str | None = None) -> HardPhoto:
    """Photo ``index``, with a seed of its own.

    Args:
        index: Index of the photo, and of its first person.
        kind: Kind of ``KINDS``. If it is None, the index decides.
    """
    rng = np.random.default_rng([SEED, index, _PHOTO])
    drawn = KINDS[int(rng.integers(len(KINDS)))]
    kind = kind or drawn
    person, pixels = _shaded(index, _REQUESTS[kind])
    canvas = _Canvas(person, pixels)
    _add_others(canvas, kind, index, rng)
    paint = Paint(canvas.owners.shape, rng)
    if kind == "table" or rng.random() < _ALSO["table"]:
        canvas.add_thing(bench_thing(paint, canvas.owners > 0))
    if kind == "wheelchair":
        canvas.add_thing(chair_thing(paint, person))
    if kind == "rider":
        canvas.add_thing(mount_thing(paint, person))
    left, top, right, bottom = _kept_box(canvas, kind, rng)
    seen = [canvas.seen(row) for row in range(len(canvas.people))]
    keypoints = [each - [left, top] for each in canvas.keypoints]
    pixels, zoom = canvas.pixels[top:bottom, left:right], 1.0
    within = [((each >= 0) & (each < [right - left, bottom - top])).all(axis=1) for each in keypoints]
    if kind == "poor" or rng.random() < _ALSO["poor"]:
        pixels, zoom = _worsen(pixels, rng)
    people = []
    for row, each in enumerate(canvas.people):
        people.append(
            PhotographedPerson(
                keypoints[row] * zoom,
                seen[row] & within[row],
                each.joints,
                each.stature,
                canvas.heights[row] * zoom,
                each.shape,
            )
        )
    return HardPhoto(kind, np.ascontiguousarray(pixels), tuple(people))


def _add_others(canvas: _Canvas, kind: str, index: int, rng: np.random.Generator) -> None:
    """Add the further people of a kind."""
    first = _OTHERS + 4 * index
    for number in range(_OTHERS_BESIDE.get(kind, 0)):
        canvas.add_person(*_shaded(first + number), rng)
    if kind == "overlap":
        canvas.add_person(*_shaded(first), rng, overlap=True)
    if kind == "child":
        child, pixels = _shaded(first, _CHILD)
        adult = canvas.people[0]
        zoom = (adult.height / adult.stature) / (child.height / child.stature)  # pixels a metre
        canvas.add_person(child, pixels, rng, zoom=float(np.clip(zoom, 1 / _LARGEST_CHANGE, _LARGEST_CHANGE)))


def _shaded(index: int, request: PersonRequest = AS_DRAWN) -> tuple[Person, np.ndarray]:
    """Person ``index``, and a photo of them alone."""
    person = make_person(index, request=request)
    seed = int(np.random.default_rng([SEED, index, _LOOKS]).integers(2**62))
    vertices, mesh = person.shown
    points = torch.from_numpy(vertices)[None]
    return person, shade_people(points, mesh, person.camera, person.parts.shape, TorchRng(seed, "cpu"))[0][0]


def _kept_box(canvas: _Canvas, kind: str, rng: np.random.Generator) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of the part of the picture that is kept."""
    height, width = canvas.owners.shape
    box = 0, 0, width, height
    if kind == "cut":
        box = _cut_box(canvas.owners == 1, rng)
    elif kind == "half body":
        rows = canvas.keypoints[0][:, 1]
        hips, shoulders = rows[_HIPS].mean(), rows[_SHOULDERS].mean()
        box = 0, 0, width, int(hips + rng.uniform(-0.35, 0.5) * (hips - shoulders))
    large = min(box[2] - box[0], box[3] - box[1]) > _SMALLEST
    return (box[0], box[1], box[2], min(box[3], height)) if large else (0, 0, width, height)


def _cut_box(shown: np.ndarray, rng: np.random.Generator) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of a part of the picture that cuts off some of the person."""
    rows, columns = np.nonzero(shown)
    height, width = shown.shape
    side, share = int(rng.integers(4)), float(rng.uniform(0.15, 0.6))
    if not len(rows):
        return 0, 0, width, height
    tall, wide = float(np.ptp(rows)), float(np.ptp(columns))
    return [
        (0, 0, width, int(rows.max() - share * tall)),
        (0, int(rows.min() + 0.5 * share * tall), width, height),
        (int(columns.min() + share * wide), 0, width, height),
        (0, 0, int(columns.max() - share * wide), height),
    ][side]


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
