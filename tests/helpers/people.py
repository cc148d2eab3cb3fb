"""Photos composed of the example's person."""

from __future__ import annotations

import numpy as np
from PIL import Image

from helpers.example import example_mask, example_photo

_BOX = (95, 20, 300, 500)  # of the person in the example's photo [px]


def cut_out(height: int) -> tuple[Image.Image, Image.Image]:
    """The person and their mask, so high [px]."""
    size = round(height * (_BOX[2] - _BOX[0]) / (_BOX[3] - _BOX[1])), height
    photo, mask = (Image.fromarray(each) for each in (example_photo(), 255 * example_mask().astype(np.uint8)))
    return photo.crop(_BOX).resize(size), mask.crop(_BOX).resize(size)


def crowd(count: int, height: int = 225) -> tuple[np.ndarray, np.ndarray]:
    """A photo of so many people in rows of twelve, every other one mirrored; and their places (count, 2) [px]."""
    person, mask = cut_out(height)
    across, down, rng = person.width + 50, height + 30, np.random.default_rng(0)
    shade = np.linspace(200, 150, -(-count // 12) * down + 90)[:, None, None]
    picture = Image.fromarray(np.tile(shade, (1, 12 * across + 60, 3)).astype(np.uint8))
    places = []
    for index in range(count):
        x = index % 12 * across + int(rng.integers(0, 30))
        y = index // 12 * down + 30 + int(rng.integers(0, 20))
        turned = [each.transpose(Image.Transpose.FLIP_LEFT_RIGHT) if index % 2 else each for each in (person, mask)]
        picture.paste(turned[0], (x, y), turned[1])
        box = turned[1].getbbox()
        assert box is not None
        places.append((x + (box[0] + box[2]) / 2, y + (box[1] + box[3]) / 2))
    return np.asarray(picture), np.array(places)
