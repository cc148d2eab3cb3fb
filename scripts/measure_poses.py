"""Measure how near the poses that networks learn from come to those of real people, and how fast they are made.

    python scripts/measure_poses.py MOCAP REAL

MOCAP is a folder of clips, or a file of ``pack_poses``; REAL holds ``sights.npz`` and ``p2s_joints.npz``. A pose is
where elbows, wrists, knees and ankles are in the trunk's frame, of limbs as long as the mean body's, from hips and
shoulders that are where the mean body has them: neither sizes nor data sets' hips count. The distance of a real pose is
that to the nearest of 20,000 drawn ones, mean over the eight joints and a few draws [mm]. Equal rows are counted once.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
import warp as wp

from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.template import JOINT_NAMES, LENGTH_NAMES, template
from warp_partdr.lab.synthetic.pose_sampler import PoseBank, PoseSampler
from warp_partdr.lab.synthetic.poses import mean_body

POSES, DRAWS, SEED, POOL = 20_000, 6, 1, 4096
LIMBS = (
    ("left_shoulder", "left_elbow", "left_wrist", "upper arm", "forearm"),
    ("right_shoulder", "right_elbow", "right_wrist", "upper arm", "forearm"),
    ("left_hip", "left_knee", "left_ankle", "upper leg", "lower leg"),
    ("right_hip", "right_knee", "right_ankle", "upper leg", "lower leg"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("mocap", type=Path)
    parser.add_argument("real", type=Path)
    arguments = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    bank = PoseBank.read(arguments.mocap)
    PoseSampler(bank, pool=64, seed=SEED)
    start = time.process_time()
    sampler = PoseSampler(bank, pool=POOL, seed=SEED)
    print(f"{POOL / (time.process_time() - start):.0f} poses a second of a CPU core, {len(bank.ups)} captured")

    real, distances = real_poses(arguments.real), []
    for _ in range(DRAWS):
        rotations, _ = sampler.draw(POSES)
        joints = mean_body(rotation_from_axis_angle(rotations)).joints
        drawn = limb_joints({name: joints[:, index] for index, name in enumerate(JOINT_NAMES)})
        distances.append([(poses[:, None] - drawn).norm(dim=-1).mean(-1).amin(1) for poses in real.values()])
    for name, *each in zip(real, *distances, strict=True):
        nearest = 1000 * torch.stack(each).mean(0)
        print(f"{name:24} {len(nearest):4} poses: {nearest.mean():5.1f} mm, worst {nearest.max():5.1f}")


def real_poses(folder: Path) -> dict[str, torch.Tensor]:
    """Places of limb joints in each set, shape (N, 8, 3)."""
    with np.load(folder / "sights.npz", allow_pickle=False) as file:
        sights = dict(file)
    sets = {name: sights["joints_world"][sights["set"] == name] for name in np.unique(sights["set"]).tolist()}
    found = {name: limb_joints(of_names(values, sights["joint_names"])) for name, values in sets.items()}
    with np.load(folder / "p2s_joints.npz", allow_pickle=False) as file:
        found["pose2sim"] = limb_joints(of_names(file["joints_world"], file["joint_names"]))
    return {name: values.mul(1000).round().unique(dim=0) / 1000 for name, values in found.items()}


def of_names(joints: np.ndarray, names: np.ndarray) -> dict[str, torch.Tensor]:
    return {str(name): torch.from_numpy(joints[:, index]).float() for index, name in enumerate(names)}


def limb_joints(joints: dict[str, torch.Tensor]) -> torch.Tensor:
    """Elbows, wrists, knees and ankles in the trunk's frame, retargeted to the mean body [m], shape (N, 8, 3)."""
    unit = torch.nn.functional.normalize
    hips, shoulders = (0.5 * (joints[f"left_{name}"] + joints[f"right_{name}"]) for name in ("hip", "shoulder"))
    up = unit(shoulders - hips, dim=-1)
    across = sum(joints[f"left_{name}"] - joints[f"right_{name}"] for name in ("hip", "shoulder"))
    left = unit(across - (across * up).sum(-1, keepdim=True) * up, dim=-1)
    frame = torch.stack([left, up, torch.linalg.cross(left, up)], dim=1)  # (N, 3, 3), of rows
    lengths = dict(zip(LENGTH_NAMES, template().mean_lengths.tolist(), strict=True))
    places = []
    for root, middle, end, first, second in LIMBS:
        upper = lengths[first] * (frame @ unit(joints[middle] - joints[root], dim=-1)[..., None])[..., 0]
        lower = lengths[second] * (frame @ unit(joints[end] - joints[middle], dim=-1)[..., None])[..., 0]
        places += [upper, upper + lower]
    return torch.stack(places, dim=1)


if __name__ == "__main__":
    main()
