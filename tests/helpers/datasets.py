"""Small data sets of pictures: a folder with all that may be in one, and COCO's annotations of a person."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from PIL import Image

from helpers.example import example_photo
from helpers.files import EXAMPLE


def photo(side: int = 256) -> Image.Image:
    image = Image.fromarray(example_photo())
    return image.resize((image.width * side // image.height, side))


def rows(folder: Path | str) -> list[dict[str, Any]]:
    """All rows of a data set that was written."""
    import pyarrow.parquet as pq

    found: list[dict[str, Any]] = pq.read_table(folder).to_pylist()
    return found


def write_folder(folder: Path) -> None:
    """A person, two people, nobody, and what is no picture; one lies in a folder, and something else beside them."""
    (folder / "more").mkdir(parents=True)
    photo().save(folder / "b_one.png")
    large, small = photo(320), photo(240)
    wide = Image.new("RGB", (large.width + small.width + 20, 320), large.getpixel((3, 3)))
    wide.paste(large, (0, 0))
    wide.paste(small, (large.width + 10, 60))
    wide.save(folder / "more" / "two.png")
    Image.new("RGB", (160, 120), (90, 120, 90)).save(folder / "a_empty.png")
    (folder / "c_broken.jpg").write_bytes((folder / "b_one.png").read_bytes()[:400])
    (folder / "notes.md").write_text("no picture")


def write_coco(folder: Path, count: int = 5, side: int = 128, **changes: Any) -> Path:
    """COCO's annotations of so many pictures of the example, moved a little each; ``changes`` are of each."""
    folder.mkdir(parents=True, exist_ok=True)
    given = json.loads((EXAMPLE / "keypoints.json").read_text())["keypoints"]
    images, annotations = [], []
    zoom = side / len(example_photo())
    for index in range(count):
        picture = Image.new("RGB", (photo(side).width + count, side), (120, 120, 120))
        picture.paste(photo(side), (index, 0))
        picture.save(folder / f"{index:03}.jpg")
        numbers = [[x * zoom + index, y * zoom, 2 if c > 0 else 0] for x, y, c in given]
        xs, ys = ([row[axis] for row in numbers if row[2]] for axis in (0, 1))
        box = [min(xs), min(ys), max(xs) - min(xs), max(ys) - min(ys)]
        left, top, width, height = box
        outline = [left, top, left + width, top, left + width, top + height, left, top + height]
        images.append({"id": 10 + index, "file_name": f"{index:03}.jpg"})
        annotations.append(
            {
                "id": 100 + index,
                "image_id": 10 + index,
                "category_id": 1,
                "keypoints": [number for row in numbers for number in row],
                "bbox": box,
                "segmentation": [outline],
                **changes,
            }
        )
    path = folder / "people.json"
    path.write_text(json.dumps({"images": images, "annotations": annotations}))
    return path
