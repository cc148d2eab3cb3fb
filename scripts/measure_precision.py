"""Measure and print how far people who are found in float16, as on CUDA in data sets, are from those in float32.

    python scripts/measure_precision.py [--device cuda] PICTURE...

Without pictures, the packaged ones. Of each person: mean and largest distance of the sure keypoints, as a share of the
box's height, scores in both, and pixels of 256 x 256 of the mask that change sides.
"""

from __future__ import annotations

import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np
import warp as wp

from warp_partdr.inputs.part_labels import read_photo
from warp_partdr.networks.detection import people as finding
from warp_partdr.networks.detection.asset import PeopleNetworks, packaged_people_networks
from warp_partdr.networks.detection.person import FoundPerson

EXAMPLES = Path(__file__).resolve().parents[1] / "warp_partdr" / "assets" / "example"


def main(device: str, *files: str) -> None:
    wp.config.log_level = wp.LOG_WARNING
    names = files or [str(EXAMPLES / name) for name in ("photo.png", "astronaut.jpg")]
    pictures = [read_photo(Path(name)) for name in names]
    exact = finding.find_people_in(pictures, device=device)

    def halved(device: str, **_: object) -> PeopleNetworks:
        return packaged_people_networks(device, half=True)

    with patch.object(finding, "packaged_people_networks", halved):
        found = finding.find_people_in(pictures, device=device)
    means = []
    for name, some, others in zip(names, exact, found, strict=True):
        print(f"{Path(name).name}: {len(some)} people in float32, {len(others)} in float16")
        for person, other in zip(some, others, strict=False):
            means.append(compare(person, other))
    print(f"mean of {len(means)} people: {100 * np.mean(means):.2f} % of the height")


def compare(person: FoundPerson, other: FoundPerson) -> float:
    """Print one person's; the mean distance."""
    height = person.box[3] - person.box[1]
    sure = person.keypoints.confident
    shares = np.linalg.norm(person.keypoints.points - other.keypoints.points, axis=1)[sure] / height
    changed = int(((person.mask > 0.5) != (other.mask > 0.5)).sum())
    print(
        f"  {height:.0f} px high: {100 * shares.mean():.2f} % on average, {100 * shares.max():.2f} % at most; "
        f"score {person.score:.3f}, {other.score:.3f}; {changed} pixels of the mask"
    )
    return float(shares.mean())


if __name__ == "__main__":
    words = sys.argv[1:]
    main(*(words[1:] if words[:1] == ["--device"] else ["cpu", *words]))
