"""Posed bodies, cameras and rotations."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from fuzzing.chance import Chance
from fuzzing.render import camera
from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.posing import pose
from warp_partdr.body.rotations import rotation_from_6d, rotation_from_axis_angle, rotation_to_axis_angle
from warp_partdr.cameras import Crop, WeakPerspective


def try_pose(chance: Chance) -> Any:
    batch = chance.one([0, 1, 2])
    values = {
        "global_orient": chance.turns(batch),
        "translation": chance.tensor(batch, 3),
        "rotations": chance.turns(batch, 20),
        "lengths": chance.tensor(batch, 12, scale=0.1, shift=0.4),
        "thicknesses": chance.tensor(batch, 15, scale=0.05, shift=0.2),
    }
    dtype = chance.one([torch.float32, torch.float64])
    posed = pose(**{name: chance.maybe(value.to(dtype)) for name, value in values.items()})
    vertices = posed.vertices(chance.number(int(chance.rng.integers(4)), 4, 1000))
    return posed, vertices


def try_ellipbody(chance: Chance) -> Any:
    batch = chance.one([0, 1, 2])
    body = EllipBody.from_numpy(
        global_orient=chance.array(np.tile(np.eye(3), (batch, 1, 1))),
        translation=chance.array(chance.rng.normal(size=(batch, 3))),
        rotations=chance.array(np.tile(np.eye(3), (batch, 20, 1, 1))),
        lengths=chance.array(chance.rng.uniform(0.1, 1, (batch, 12))),
        thicknesses=chance.array(chance.rng.uniform(0.1, 1, (batch, 15))),
        device=chance.device,
    )
    measured = body.measure(chance.number(0, -1, 5)) if batch else {}
    return body.pose(subdivisions=chance.number(1, 0, 3, 4)).torch(), measured


def try_cameras(chance: Chance) -> Any:
    batch = chance.one([0, 1, 3])
    perspective = bool(chance.rng.random() < 0.5)
    seen = camera(chance, batch, perspective)
    points = chance.maybe(chance.tensor(batch, 5, 3, shift=2.0))
    crop = Crop(*(chance.number(value) for value in (-3.0, 4.0, 1.5)), (8, 8))
    inside = seen.in_crop(crop)
    results: list[Any] = [seen.project(points), inside.intrinsics, inside.in_full(crop).intrinsics]
    if isinstance(seen, WeakPerspective):
        results += [
            seen.to_hmr(chance.number(8, 256)),
            WeakPerspective.from_hmr(chance.maybe(chance.tensor(batch, 3)), 8),
        ]
        results += list(seen.to_perspective(chance.maybe(chance.tensor(batch).abs() + 1), chance.tensor(batch, 2)))
    else:
        results.append(seen.to_weak(chance.maybe(chance.tensor(batch, 3, shift=3.0))))
    return results


def try_rotations(chance: Chance) -> Any:
    shape = chance.one([(), (2,), (0,), (2, 3)])
    vectors = chance.maybe(chance.tensor(*shape, 3, scale=float(10.0 ** chance.rng.uniform(-8, 3))))
    turns = rotation_from_axis_angle(vectors)
    columns = chance.maybe(chance.tensor(*shape, 6, scale=float(10.0 ** chance.rng.uniform(-30, 30))))
    return turns, rotation_to_axis_angle(turns), rotation_from_6d(columns)
