"""Files of PartBench's people, for data sets that measurements write."""

from __future__ import annotations

import json
import tarfile
from collections import defaultdict
from io import BytesIO
from pathlib import Path

from PIL import Image

from ..errors import InputError
from .synthetic.partbench_people import make_person


def kept_people(folder: Path, count: int) -> list[dict[str, bytes]]:
    """Files of people by their endings, drawn unless they are kept in the folder's people.tar.

    Raises:
        InputError: If fewer people are kept there.
    """
    path, kept = folder / "people.tar", defaultdict[str, dict[str, bytes]](dict)
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        with tarfile.open(path, "w") as tar:
            for index in range(count):
                for ending, data in _person_files(index).items():
                    add_file(tar, f"{index:03}.{ending}", data)
    with tarfile.open(path) as tar:
        for member in tar:
            number, _, ending = member.name.partition(".")
            kept[number][ending] = tar.extractfile(member).read()  # type: ignore[union-attr]  # a file
    if len(kept) < count:
        raise InputError(f"{path}: {len(kept)} people; expected {count}, or no such file")
    return [kept[number] for number in sorted(kept)[:count]]


def add_file(tar: tarfile.TarFile, name: str, data: bytes) -> None:
    """Add a file to an archive."""
    info = tarfile.TarInfo(name)
    info.size = len(data)
    tar.addfile(info, BytesIO(data))


def _person_files(index: int) -> dict[str, bytes]:
    """Files of a person by their endings; the picture shows the labels."""
    person = make_person(index)
    points = [[float(x), float(y), 1.0] for x, y in person.keypoints()]
    files = {"keypoints.json": json.dumps({"format": "coco17", "keypoints": points}).encode()}
    for ending, image in (("png", Image.fromarray(person.parts * 12)), ("parts.png", Image.fromarray(person.parts))):
        buffer = BytesIO()
        image.save(buffer, "png")
        files[ending] = buffer.getvalue()
    return files
