"""Data sets of people whose rows are made up, so that every number in them is known."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import LandmarkGather, pose
from warp_partdr.body.skeletons import skeleton
from warp_partdr.bulk.rows import PeopleRows, Row, columns, people_table
from warp_partdr.bulk.shards import Shards
from warp_partdr.cameras import Perspective, WeakPerspective
from warp_partdr.results.body_file import BODY_ARRAYS
from warp_partdr.results.save import body_file

SIZE = 120, 100  # (H, W) of the pictures


def body_row(picture: str, distance: float | None = None, **changes: Any) -> Row:
    """A row of the mean body in the middle of its picture, so far from the camera [m]; None: of weak perspective."""
    parameters = BodyParameters.mean(1)
    camera: WeakPerspective | Perspective = WeakPerspective(torch.tensor([50.0]), torch.tensor([[50.0, 60.0]]))
    if distance is not None:
        camera = Perspective(torch.tensor([[50.0 * distance] * 2]), torch.tensor([[50.0, 60.0]]))
    saved = body_file(parameters, camera, SIZE, None if distance is None else torch.tensor([0.0, 0.0, distance]))
    posed = pose(*(torch.from_numpy(getattr(saved, name))[None] for name in BODY_ARRAYS))
    points = camera.project(LandmarkGather(skeleton("coco17").marks, "cpu")(posed))[0, :, :2].numpy()
    seen = camera.project(posed.joints)[0, :, :2].numpy()
    return {
        "picture": picture,
        "person": 0,
        "people": 1,
        "height": SIZE[0],
        "width": SIZE[1],
        "score": 0.9,
        "box": np.array([*seen.min(0), *seen.max(0)]),
        "keypoints": np.column_stack([points, np.ones(len(points))]),
        "keypoint_error": 0.01,
        "energy": 2.0,
        "warnings": [],
        **{name: getattr(saved, name) for name in (*BODY_ARRAYS, "camera_translation")},
        "camera_scale": float(saved.camera_scale),
        "camera_perspective": distance is not None,
        "joints": posed.joints[0].numpy(),
        "joints_2d": seen,
        "joint_spreads": np.full(20, 0.05),
        "confidence": 0.8,
        **changes,
    }


def write_shards(folder: Path, shards: Sequence[Sequence[Row]], **changes: dict[int, Any]) -> None:
    """Shards of these rows; ``changes`` are of what single shards state, by name and number of the shard."""
    names = [sorted({row["picture"] for row in rows}) for rows in shards]
    size = max(map(len, names))
    padded = [name for own in names for name in (*own, *[""] * (size - len(own)))]
    made = Shards(folder, padded, size, {"quality": "fast", "model": None}, {"skeleton": "coco17", "device": "cpu"})
    for index, rows in enumerate(shards):
        about = made.describe(index) | {"pictures": len(names[index]), "seconds": 0.5}
        about |= {name: each[index] for name, each in changes.items() if index in each}
        made.write(index, people_table(PeopleRows.of(rows), columns("coco17"), about))
