"""Detailed models with few joints: those that nothing turns, of fingers, toes and face, move as the joint above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from .model import DetailedModel


def merge_joints(model: DetailedModel, kept: Sequence[int]) -> DetailedModel:
    """Merge joints with the next one above that is kept; the same body wherever those have no turn of their own.

    Landmarks stay: where one lies at a joint that goes, a vertex without a face stands for it, behind the others.

    Args:
        model: Model with J joints.
        kept: Indices of the joints to keep, in order. The root and all joints that carry parts must be among them.

    Raises:
        ValueError: If one of those is missing.
    """
    if missing := {0, *model.part_joints} - set(kept):
        raise ValueError(f"kept: without joints {sorted(missing)}; expected the root and all that carry parts")
    above: list[int] = []  # the kept joint that each one moves with
    for joint, parent in enumerate(model.parents):
        above.append(kept.index(joint) if joint in kept else above[parent])
    moving = torch.nn.functional.one_hot(torch.tensor(above, device=model.faces.device), len(kept))
    moving = moving.to(model.skin_weights)
    by_vertex, by_joint = model.landmark_weights.split([model.num_vertices, model.num_joints], dim=1)
    gone = [joint for joint in range(model.num_joints) if joint not in kept and by_joint[:, joint].any()]
    few = list(kept)
    bends = model.pose_directions
    if bends is not None:
        rows = bends.unflatten(0, (-1, 9))[[joint - 1 for joint in few[1:]]].flatten(0, 1)
        bends = torch.nn.functional.pad(rows, (0, 3 * len(gone)))
    return replace(
        model,
        joint_names=tuple(model.joint_names[joint] for joint in few),
        parents=tuple(-1 if joint == 0 else above[model.parents[joint]] for joint in few),
        part_joints=tuple(few.index(joint) for joint in model.part_joints),
        rest_vertices=torch.cat([model.rest_vertices, model.rest_joints[gone]]),
        shape_directions=torch.cat([model.shape_directions, model.joint_directions[:, gone]], dim=1),
        rest_joints=model.rest_joints[few],
        joint_directions=model.joint_directions[:, few],
        skin_weights=torch.cat([model.skin_weights @ moving, moving[gone]]),
        landmark_weights=torch.cat([by_vertex, by_joint[:, gone], by_joint[:, few]], dim=1),
        pose_directions=bends,
    )
