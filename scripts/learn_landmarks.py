"""Learn where a data set's joints lie from EllipBody's landmarks, for ``CONVENTIONS`` of ``body/landmarks.py``.

    python scripts/learn_landmarks.py VIEWS.npz SET [SET ...]

VIEWS.npz holds people with true 3D joints, as `partdr evaluate real` reads them (docs/how_to/evaluate.md).
EllipBody's skeleton is put on the joints of all frames of these sets together: each frame has a pose, held by the pose
prior and the joint limits, and each person has a size and bone lengths near the mean adult's. One offset per joint is
shared by all frames and both sides. Limbs have none: from joints alone, an offset of a knee is no other than a turn or
a length.

Printed are rows of the table, millimetres of the mean adult, and each offset's standard error: the jackknife over
people. Offsets along a bone and up and forward at the hips are known least, for lengths and the pose explain as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from warp_partdr.body.landmarks import without_side
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import packaged_prior
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.body.rotations import rotation_to_6d
from warp_partdr.body.template import PART_NAMES
from warp_partdr.files.array_files import read_npz
from warp_partdr.lab.harness import run_script

# The part that each joint is fixed to; "pelvis" is both hips.
CARRIERS = {
    "mid_hip": "pelvis",
    "hip": "pelvis",
    "spine": "abdomen",
    "neck": "chest",
    "shoulder": "chest",
    "head": "head",
    "head_top": "head",
    "nose": "head",
    "eye": "head",
    "ear": "head",
}
STEPS, RATE = 1200, 0.02
RESIDUAL, OFFSET = 0.008, 0.04  # standard deviations of what is left of a joint, and of an offset's components [m]
SIZE, LENGTH = 0.1, 0.04  # of the logarithms of a person's size and bone lengths
LIMITS = 20.0  # weight of the squared excess over joint limits


@dataclass(frozen=True)
class Frames:
    """Moments of people.

    Attributes:
        names: Landmarks of J joints.
        joints: Shape (F, J, 3) [m], NaN where unknown.
        people: Index of each moment's person, shape (F,), int64.
    """

    names: tuple[str, ...]
    joints: torch.Tensor
    people: torch.Tensor

    def without(self, person: int) -> Frames:
        """The moments of everybody else."""
        kept = self.people != person
        _, people = self.people[kept].unique(return_inverse=True)
        return Frames(self.names, self.joints[kept], people)


def read_frames(path: Path, sets: Sequence[str]) -> Frames:
    """Moments of sets in a file of views, each once however many cameras saw it."""
    names = ("set", "person", "frame", "joints_world", "joint_names")
    data = read_npz(path, names, expected="a file of views (docs/how_to/evaluate.md)")
    keys = [f"{data['set'][row]} {data['person'][row]}" for row in range(len(data["set"]))]
    rows: dict[tuple[str, int], int] = {}
    for row, key in enumerate(keys):
        if str(data["set"][row]) in sets:
            rows.setdefault((key, int(data["frame"][row])), row)
    if not rows:
        raise SystemExit(f"{path}: no views of {', '.join(sets)}; expected some of {sorted(set(data['set'].tolist()))}")
    people = sorted({key for key, _ in rows})
    joints = torch.from_numpy(data["joints_world"][list(rows.values())]).float()
    indices = torch.tensor([people.index(key) for key, _ in rows])
    return Frames(tuple(data["joint_names"].tolist()), joints, indices)


def learn(frames: Frames) -> dict[str, np.ndarray]:
    """Offsets of the joints of ``CARRIERS`` by name without side, left, up and forward [m] of the mean adult."""
    known = ~frames.joints.isnan().any(2)
    used = [column for column in range(len(frames.names)) if known[:, column].any()]
    names = [frames.names[column] for column in used]
    true, known = frames.joints[:, used].nan_to_num(), known[:, used]
    free = sorted({without_side(name) for name in names} & CARRIERS.keys())
    carriers = [CARRIERS.get(without_side(name), "pelvis").replace("pelvis", "left_hip") for name in names]
    parts = torch.tensor([PART_NAMES.index(part) for part in carriers])
    signs = torch.ones(len(names), 3)
    signs[[name.startswith("right_") for name in names], 0] = -1.0
    rows = torch.tensor([free.index(without_side(name)) if without_side(name) in free else len(free) for name in names])
    sideways = torch.ones(len(free) + 1, 3)
    sideways[[i for i, name in enumerate(free) if f"left_{name}" not in names], 0] = 0.0  # middles have none
    sideways[-1] = 0.0

    count, prior = len(true), packaged_prior("cpu")
    mean = BodyParameters.mean(count)
    orientation = rotation_to_6d(_trunk_frames(names, true))
    place = true[:, [names.index("left_hip"), names.index("right_hip")]].mean(1)
    pose = prior.mean_pose.expand(count, -1, 3).clone()
    persons = int(frames.people.max()) + 1
    leaves = [orientation, place, pose, torch.zeros(persons), torch.zeros(persons, mean.lengths.shape[1])]
    leaves.append(torch.zeros(len(free) + 1, 3))
    leaves = [each.detach().clone().requires_grad_() for each in leaves]
    orientation, place, pose, size, lengths, offsets = leaves
    gather, up = LandmarkGather(names, "cpu"), torch.tensor([0.0, 1.0, 0.0]).expand(count, 3)
    adam = torch.optim.Adam(leaves, lr=RATE)
    for step in range(STEPS):
        growth = size[frames.people].exp()[:, None]
        grown = growth * mean.lengths * lengths[frames.people].exp()
        bodies = BodyParameters(orientation, pose, grown, growth * mean.thicknesses, mean.log_scale, mean.shift)
        posed = bodies.posed()
        moved = (sideways * offsets)[rows] * signs * growth[..., None]
        points = gather(posed) + (posed.rotations[:, parts] @ moved[..., None])[..., 0] + place[:, None]
        costs = [
            ((points - true) * known[..., None] / RESIDUAL).square().sum() / 2,
            prior(bodies.free_rotations(), up).sum(),
            LIMITS * prior.joint_limits(bodies.free_rotations()).sum(),
            (size / SIZE).square().sum() / 2 + (lengths / LENGTH).square().sum() / 2,
            (offsets / OFFSET).square().sum() / 2,
        ]
        adam.param_groups[0]["lr"] = RATE * (1 - step / STEPS)
        adam.zero_grad()
        sum(costs).backward()
        adam.step()
    found = (sideways * offsets).detach().numpy()
    return {name: found[row] for row, name in enumerate(free)}


def _trunk_frames(names: Sequence[str], joints: torch.Tensor) -> torch.Tensor:
    """Frames of trunks, left, up and forward as columns, shape (F, 3, 3)."""
    left_hip, right_hip, neck = (joints[:, names.index(name)] for name in ("left_hip", "right_hip", "neck"))
    left = torch.nn.functional.normalize(left_hip - right_hip, dim=1)
    upward = neck - (left_hip + right_hip) / 2
    forward = torch.nn.functional.normalize(torch.linalg.cross(left, upward), dim=1)
    return torch.stack([left, torch.linalg.cross(forward, left), forward], dim=2)


def main(views: Path, /, *sets: str) -> None:
    """Learn from everybody, and from everybody but one in turn.

    Args:
        views: File of people with true joints.
        sets: Names of data sets in it.
    """
    frames = read_frames(views, sets)
    persons = int(frames.people.max()) + 1
    print(f"{len(frames.joints)} moments of {persons} people")
    found = learn(frames)
    others = [learn(frames.without(person)) for person in range(persons)] if persons > 1 else []
    for name, offset in found.items():
        row = ", ".join(f"{1000 * value:.1f}" for value in offset)
        line = f'        "{name}": ("{CARRIERS[name]}", ({row})),'
        if others:
            left_out = np.stack([each[name] for each in others])
            error = np.sqrt((persons - 1) / persons * ((left_out - left_out.mean(0)) ** 2).sum(0))
            line += "  # standard error " + ", ".join(f"{1000 * value:.0f}" for value in error)
        print(line)


if __name__ == "__main__":
    run_script(main)
