"""Pictures of people in rows: what was seen, and the body over it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..body.skeletons import Skeleton, skeleton
from ..models.model import DetailedModel
from ..results.overlays import body_over, clothes_over, draw_keypoints, gray_picture, skin_over
from ..results.person_pictures import cut_window, jpeg_file, person_window
from .reading import Address, PeopleFiles, PersonRow, by_shard
from .survey import Worst

if TYPE_CHECKING:
    from PIL.Image import Image

SIDE = 280  # [px], longer side of a panel


@dataclass(frozen=True)
class DrawnPerson:
    """A person who was drawn.

    Attributes:
        address: Address of the row.
        value: Value of the score that chose the person.
        picture: Name of the picture.
        person: Number of the person in the picture.
        warnings: Warnings of the row.
        confidence: Probability that the body is right. It is None if the row does not state it.
        on_photo: True if the photo could be read.
        jpeg: Bytes of the drawing, a JPEG file.
    """

    address: Address
    value: float
    picture: str
    person: int
    warnings: Sequence[str]
    confidence: float | None
    on_photo: bool
    jpeg: bytes


def draw_worst(
    files: PeopleFiles,
    worst: Worst,
    read: Callable[[str], np.ndarray] | None,
    model: DetailedModel | None,
    *,
    bare: bool = False,
) -> Iterator[DrawnPerson]:
    """Draw the worst people, shard by shard.

    Args:
        files: Files of the data set.
        worst: Worst people of the data set.
        read: Function that reads a picture by its name. If it fails, or the picture has another size by now, the body
            is drawn alone. If it is None, there are no pictures.
        model: Detailed model, as in ``draw_person``.
        bare: True draws the skin alone.
    """
    values = dict(zip(worst.addresses, worst.values.tolist(), strict=True))
    for shard, rows in by_shard(worst.addresses).items():
        form = skeleton(files.about(shard)["skeleton"])
        for address, row in files.rows(shard, rows):
            person = PersonRow.of(address, row, str(files.path(shard)))
            assert person is not None
            photo = None if read is None else _photo(read, person)
            yield DrawnPerson(
                address,
                values[address],
                picture=row["picture"],
                person=row["person"],
                warnings=row["warnings"] or (),
                confidence=row.get("confidence"),
                on_photo=photo is not None,
                jpeg=jpeg_file(np.asarray(draw_person(person, form, photo, model, bare=bare))),
            )


def _photo(read: Callable[[str], np.ndarray], person: PersonRow) -> np.ndarray | None:
    try:
        photo = read(person.row["picture"])
    except (OSError, LookupError, ValueError, MemoryError):
        return None
    return photo if photo.shape[:2] == tuple(person.saved.image_size.tolist()) else None


def draw_person(
    person: PersonRow,
    form: str | Skeleton,
    photo: np.ndarray | None,
    model: DetailedModel | None,
    *,
    bare: bool = False,
) -> Image:
    """A person's part of the photo with the keypoints, and beside it the body; without a photo both on gray.

    Args:
        person: Row with the body.
        form: Format of the keypoints.
        photo: Picture, shape (H, W, 3), uint8. If it is None, it can't be read.
        model: Model of the detailed body, which is drawn if the row has one. If it is None, ellipsoids are drawn.
        bare: True draws the skin alone. By default the body wears a plain T-shirt and shorts.
    """
    from PIL import Image

    crop = person_window(person.row["box"], person.row["joints_2d"], SIDE)
    camera = person.saved.camera().in_crop(crop)
    below = gray_picture(crop.size) if photo is None else cut_window(photo, crop)
    if model is not None and person.detailed:
        body = person.registered(model)
        drawn = skin_over(below, body.detailed.vertices, model, camera, bare=bare)
        over = Image.fromarray(clothes_over(drawn, body, person.clothes, camera))
    else:
        over = Image.fromarray(body_over(below, person.posed, camera))
    seen = over if photo is None else Image.fromarray(below)
    keypoints = person.keypoints(form)
    moved = (keypoints.points - np.array([crop.left, crop.top], dtype=np.float32)) * np.float32(crop.zoom)
    draw_keypoints(seen, replace(keypoints, points=moved))
    if photo is None:
        return over
    both = Image.new("RGB", (seen.width + over.width + 2, seen.height), "white")
    both.paste(seen, (0, 0))
    both.paste(over, (seen.width + 2, 0))
    return both
