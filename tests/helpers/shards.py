"""WebDataset's tar files that tests write: photos of the example with what lies beside them."""

from __future__ import annotations

import json
import tarfile
from io import BytesIO
from pathlib import Path

from PIL import Image

from helpers.datasets import photo
from helpers.example import example_photo
from helpers.files import EXAMPLE

SIDE = 160


def members(key: str, keypoints: bool = True, parts: bool = True, ending: str = "jpg") -> dict[str, bytes]:
    """Files of one sample by their names."""
    buffer = BytesIO()
    photo(SIDE).save(buffer, {"jpg": "jpeg"}.get(ending, ending))
    files = {f"{key}.{ending}": buffer.getvalue()}
    zoom, size = SIDE / len(example_photo()), photo(SIDE).size
    if keypoints:
        given = json.loads((EXAMPLE / "keypoints.json").read_text())
        given["keypoints"] = [[x * zoom, y * zoom, c] for x, y, c in given["keypoints"]]
        files[f"{key}.keypoints.json"] = json.dumps(given).encode()
    if parts:
        buffer = BytesIO()
        with Image.open(EXAMPLE / "parts.png") as labels:
            labels.resize(size, Image.Resampling.NEAREST).save(buffer, "png")
        files[f"{key}.parts.png"] = buffer.getvalue()
    return files


def write_tar(path: Path, files: dict[str, bytes]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with tarfile.open(path, "w") as tar:
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            tar.addfile(info, BytesIO(data))
    return path


def write_beside(folder: Path, files: dict[str, bytes]) -> None:
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
