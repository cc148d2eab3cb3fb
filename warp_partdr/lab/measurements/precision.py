"""Distance of people who are found in float16, as on CUDA in data sets, from those who are found in float32.

For each person: mean and largest distance of the sure keypoints, as a share of the box's height, scores in both, and
pixels of 256 x 256 of the mask that change sides.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import numpy as np

from ...inputs.part_labels import read_photo
from ...networks.detection import people as finding
from ...networks.detection.asset import PeopleNetworks, packaged_people_networks
from ...networks.detection.person import FoundPerson
from ..options import Device
from ..tables import Cell, FigureTable

_EXAMPLES = Path(__file__).resolve().parents[2] / "assets" / "example"
_COLUMNS = {
    "picture": "",
    "height [px]": ".0f",
    "keypoints off [%]": ".2f",
    "at most": ".2f",
    "score in float32": ".3f",
    "in float16": ".3f",
    "pixels of the mask": "d",
}


def measure_precision(*pictures: Path, device: Device = "cpu") -> Iterator[FigureTable | str]:
    """Find people in both precisions.

    Args:
        pictures: Photos; by default the packaged ones.
        device: Device of the networks.
    """
    files = pictures or [_EXAMPLES / name for name in ("photo.png", "astronaut.jpg")]
    photos = [read_photo(file) for file in files]
    exact = finding.find_people_in(photos, device=device)

    def halved(device: str, **_: object) -> PeopleNetworks:
        return packaged_people_networks(device, half=True)

    with patch.object(finding, "packaged_people_networks", halved):
        found = finding.find_people_in(photos, device=device)
    means, table = [], FigureTable("People in float16 against float32", _COLUMNS)
    for file, some, others in zip(files, exact, found, strict=True):
        yield f"{file.name}: {len(some)} people in float32, {len(others)} in float16"
        for person, other in zip(some, others, strict=False):
            shares = _distances(person, other)
            means.append(shares.mean())
            table.add(file.name, *_cells(person, other, shares))
    yield table
    yield f"Mean of {len(means)} people: {100 * np.mean(means):.2f} % of the height"


def _distances(person: FoundPerson, other: FoundPerson) -> np.ndarray:
    """Distances of sure keypoints as shares of the box's height."""
    confident = person.keypoints.confident
    return np.linalg.norm(person.keypoints.points - other.keypoints.points, axis=1)[confident] / _height(person)


def _height(person: FoundPerson) -> float:
    return float(person.box[3] - person.box[1])


def _cells(person: FoundPerson, other: FoundPerson, shares: np.ndarray) -> list[Cell]:
    changed = int(((person.mask > 0.5) != (other.mask > 0.5)).sum())
    off = 100 * float(shares.mean()), 100 * float(shares.max())
    return [_height(person), *off, float(person.score), float(other.score), changed]
