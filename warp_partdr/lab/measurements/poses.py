"""Distance of the poses that networks learn from to those of real people, and the speed of making them.

REAL holds `sights.npz` and `p2s_joints.npz`. A pose is where elbows, wrists, knees and ankles are in the trunk's frame,
of limbs as long as the mean body's, from hips and shoulders that are where the mean body has them: neither sizes nor
data sets' hips count. The distance of a real pose is that to the nearest of 20,000 drawn ones, mean over the eight
joints and a few draws. Equal rows are counted once.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from ...body.rotations import rotation_from_axis_angle
from ...body.template import JOINT_NAMES, LENGTH_NAMES, template
from ..options import Mocap
from ..synthetic.pose_sampler import PoseBank, PoseSampler
from ..synthetic.poses import mean_body
from ..tables import FigureTable

_POSES, _DRAWS, _SEED, _POOL = 20_000, 6, 1, 4096
_LIMBS = (
    ("left_shoulder", "left_elbow", "left_wrist", "upper arm", "forearm"),
    ("right_shoulder", "right_elbow", "right_wrist", "upper arm", "forearm"),
    ("left_hip", "left_knee", "left_ankle", "upper leg", "lower leg"),
    ("right_hip", "right_knee", "right_ankle", "upper leg", "lower leg"),
)


def measure_poses(mocap: Mocap, real: Path, /) -> Iterator[FigureTable | str]:
    """Draw poses, and look for the nearest to each real one.

    Args:
        mocap: Poses that are drawn from.
        real: Folder of real poses.
    """
    bank = PoseBank.read(mocap)
    PoseSampler(bank, pool=64, seed=_SEED)
    start = time.process_time()
    sampler = PoseSampler(bank, pool=_POOL, seed=_SEED)
    speed = _POOL / (time.process_time() - start)
    yield f"{speed:.0f} poses a second of a CPU core, {len(bank.ups)} captured"

    poses_of, distances = _real_poses(real), []
    for _ in range(_DRAWS):
        rotations, _ = sampler.draw(_POSES)
        joints = mean_body(rotation_from_axis_angle(rotations)).joints
        drawn = _limb_joints({name: joints[:, index] for index, name in enumerate(JOINT_NAMES)})
        distances.append([(poses[:, None] - drawn).norm(dim=-1).mean(-1).amin(1) for poses in poses_of.values()])
    table = FigureTable("Nearest poses", {"set": "", "poses": "d", "mean [mm]": ".1f", "worst [mm]": ".1f"})
    for name, *each in zip(poses_of, *distances, strict=True):
        nearest = 1000 * torch.stack(each).mean(0)
        table.add(name, len(nearest), float(nearest.mean()), float(nearest.max()))
    yield table


def _real_poses(folder: Path) -> dict[str, torch.Tensor]:
    """Places of limb joints in each set, shape (N, 8, 3)."""
    with np.load(folder / "sights.npz", allow_pickle=False) as file:
        sights = dict(file)
    sets = {name: sights["joints_world"][sights["set"] == name] for name in np.unique(sights["set"]).tolist()}
    found = {name: _limb_joints(_by_name(values, sights["joint_names"])) for name, values in sets.items()}
    with np.load(folder / "p2s_joints.npz", allow_pickle=False) as file:
        found["pose2sim"] = _limb_joints(_by_name(file["joints_world"], file["joint_names"]))
    return {name: values.mul(1000).round().unique(dim=0) / 1000 for name, values in found.items()}


def _by_name(joints: np.ndarray, names: np.ndarray) -> dict[str, torch.Tensor]:
    return {str(name): torch.from_numpy(joints[:, index]).float() for index, name in enumerate(names)}


def _limb_joints(joints: dict[str, torch.Tensor]) -> torch.Tensor:
    """Elbows, wrists, knees and ankles in the trunk's frame, retargeted to the mean body [m], shape (N, 8, 3)."""
    unit = torch.nn.functional.normalize
    hips, shoulders = (0.5 * (joints[f"left_{name}"] + joints[f"right_{name}"]) for name in ("hip", "shoulder"))
    up = unit(shoulders - hips, dim=-1)
    across = torch.stack([joints[f"left_{name}"] - joints[f"right_{name}"] for name in ("hip", "shoulder")]).sum(0)
    left = unit(across - (across * up).sum(-1, keepdim=True) * up, dim=-1)
    frame = torch.stack([left, up, torch.linalg.cross(left, up)], dim=1)  # (N, 3, 3), of rows
    lengths = dict(zip(LENGTH_NAMES, template().mean_lengths.tolist(), strict=True))
    positions = []
    for root, middle, end, first, second in _LIMBS:
        upper = lengths[first] * (frame @ unit(joints[middle] - joints[root], dim=-1)[..., None])[..., 0]
        lower = lengths[second] * (frame @ unit(joints[end] - joints[middle], dim=-1)[..., None])[..., 0]
        positions += [upper, upper + lower]
    return torch.stack(positions, dim=1)
