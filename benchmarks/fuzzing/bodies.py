"""Posed bodies, cameras, rotations and the pose prior."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import torch

from fuzzing.case import Case
from fuzzing.render import camera
from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.body.posing import pose
from warp_partdr.body.rotations import rotation_from_6d, rotation_from_axis_angle, rotation_to_axis_angle
from warp_partdr.cameras import Crop, WeakPerspective


@lru_cache
def prior(device: str) -> PosePrior:
    return PosePrior().to(device)


def try_prior(case: Case) -> Any:
    batch = case.one([0, 1, 3])
    vectors, up = case.maybe(case.tensor(batch, 20, 3)), case.maybe(case.tensor(batch, 3))
    return prior(case.device)(vectors, up), prior(case.device).joint_limits(vectors)


def try_pose(case: Case) -> Any:
    batch, dtype = case.one([0, 1, 2]), case.one([torch.float32, torch.float64])
    posed = pose(
        *(case.maybe(values.to(dtype)) for values in (case.turns(batch), case.tensor(batch, 3), case.turns(batch, 20))),
        lengths=case.maybe(case.tensor(batch, 12, scale=0.1, shift=0.4).to(dtype)),
        thicknesses=case.maybe(case.tensor(batch, 15, scale=0.05, shift=0.2).to(dtype)),
    )
    return posed, posed.vertices(case.number(case.one(range(4)), 4, 1000))


def try_ellipbody(case: Case) -> Any:
    batch = case.one([0, 1, 2])
    body = EllipBody.from_numpy(
        global_orient=case.array(np.tile(np.eye(3), (batch, 1, 1))),
        translation=case.array(case.rng.normal(size=(batch, 3))),
        rotations=case.array(np.tile(np.eye(3), (batch, 20, 1, 1))),
        lengths=case.array(case.rng.uniform(0.1, 1, (batch, 12))),
        thicknesses=case.array(case.rng.uniform(0.1, 1, (batch, 15))),
        device=case.device,
    )
    measured = body.measure(case.number(0, -1, 5)) if batch else {}
    return body.pose(subdivisions=case.number(1, 0, 3, 4)).torch(), measured


def try_cameras(case: Case) -> Any:
    batch = case.one([0, 1, 3])
    seen = camera(case, batch, perspective=case.happens(5))
    points = case.maybe(case.tensor(batch, 5, 3, shift=2.0))
    crop = Crop(*(case.number(value) for value in (-3.0, 4.0, 1.5)), (8, 8))
    inside = seen.in_crop(crop)
    results = [seen.project(points), inside.intrinsics, inside.in_full(crop).intrinsics]
    if not isinstance(seen, WeakPerspective):
        return [*results, seen.to_weak(case.maybe(case.tensor(batch, 3, shift=3.0)))]
    hmr = WeakPerspective.from_hmr(case.maybe(case.tensor(batch, 3)), 8)
    perspective = seen.to_perspective(case.maybe(case.tensor(batch).abs() + 1), case.tensor(batch, 2))
    return [*results, seen.to_hmr(case.number(8, 256)), hmr, *perspective]


def try_rotations(case: Case) -> Any:
    shape = case.one([(), (2,), (0,), (2, 3)])
    vectors = case.maybe(case.tensor(*shape, 3, scale=float(10.0 ** case.rng.uniform(-8, 3))))
    turns = rotation_from_axis_angle(vectors)
    columns = case.maybe(case.tensor(*shape, 6, scale=float(10.0 ** case.rng.uniform(-30, 30))))
    return turns, rotation_to_axis_angle(turns), rotation_from_6d(columns)
