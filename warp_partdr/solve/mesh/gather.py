"""Starts of the mesh stage from fits of ellipsoids, and what its gathering shares with that of scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch

from ...body.landmarks import landmark_points
from ...body.parameters import BodyParameters
from ...body.pose_prior import FREE_PARTS
from ...body.template import JOINT_NAMES
from ...inputs.observation import Observation, resize_nearest
from ...models.clothes import CLOTHED
from ...models.model import DetailedModel
from ...models.pose import free_joints, pose_from_ellipbody
from ...models.registration import shape_from_lengths
from ...networks.regression.uncertainty import Uncertainty
from ..ellipsoids.energy import landmark_weights
from .drawn_model import DrawnModel
from .energy import MeshEnergy
from .given_poses import GivenPoses
from .landmark_costs import LandmarkAims
from .observed_body import ObservedBody
from .starts import LabelPictures, Starts

# Where no network said how sure it is, and of joints that it says nothing of: depth [m] and turns [rad].
_DEPTH_SPREAD, _TURN_SPREAD, _LOCKED_SPREAD = 0.1, 0.3, 0.05
_ROW = 32  # keypoints: people have so many, or a multiple, so that few sizes of captured graphs serve all


def gather_starts(
    energy: MeshEnergy, model: DetailedModel, people: Sequence[ObservedBody], given: GivenPoses | None = None
) -> Starts:
    """Starts of people, each alone in one frame of one view; all have a camera, or none.

    Args:
        energy: Energy of people with labels of their set.
        model: The whole model.
        people: The people.
        given: Bodies to start from instead, where the people's crops see theirs.
    """
    start = BodyParameters.joined([each.body for each in people])
    if given is None:
        posed = start.posed()
        shape = shape_from_lengths(model, posed)
        whole, translation = pose_from_ellipbody(model, posed, shape, trunk_along=True)
        rotations = whole[:, energy.drawn.turning]
    else:
        shape, rotations, translation = given.shape, given.turning_rotations(), given.translation
    observations, said = [each.observation for each in people], [each.uncertainty for each in people]
    aims = gather_aims(energy.drawn, observations, said, shape.new_zeros(len(shape), len(JOINT_NAMES) - 1))
    alone = lens = None
    if energy.drawn.mesh is not None:
        labels = torch.stack([each.labels for each in observations if each.labels is not None])
        alone = LabelPictures.of(resize_nearest(labels, energy.options.size))
    if observations[0].lens is not None:
        lens = torch.stack([each.lens for each in observations if each.lens is not None])
    starts = Starts(
        rotations=rotations,
        translation=translation,
        shape=shape,
        clothes=shape.new_zeros(len(shape), len(CLOTHED)),
        unknown=shape.new_ones(len(shape), 1),
        log_scale=start.log_scale,
        shift=start.shift,
        lens=lens,
        turn_variances=gather_turn_spreads(energy.drawn, said, shape).square()[..., None],
        aims=aims,
        alone=alone,
    )
    landmarks = energy.drawn.landmarks(energy.drawn.pose(starts, starts.at_rest()))
    return replace(starts, aims=replace(aims, depths=energy.drawn.depths(landmarks).detach()))


def gather_aims(
    drawn: DrawnModel, observations: Sequence[Observation], said: Sequence[Uncertainty | None], depths: torch.Tensor
) -> LandmarkAims:
    """Aims of landmarks in M pictures of bodies.

    Args:
        drawn: Model that is drawn.
        observations: What was observed in each picture.
        said: How sure the network was of each body, if one was asked.
        depths: Depths of ``JOINT_NAMES`` but the pelvis, relative to it [m], shape (M, 20).
    """
    places, points, votes = _gather_keypoints(drawn.model, observations)
    unsaid = depths.new_full((1, len(JOINT_NAMES) - 1), _DEPTH_SPREAD)
    spreads = torch.cat([unsaid if each is None else each.depths for each in said])
    return LandmarkAims(places, points, votes, drawn.ends, depths, spreads.pow(-2))


def gather_turn_spreads(drawn: DrawnModel, said: Sequence[Uncertainty | None], like: torch.Tensor) -> torch.Tensor:
    """Spreads of the turns of free joints [rad], shape (M, F), of the dtype and on the device of ``like``."""
    count = 1 + len(FREE_PARTS)
    unsaid = like.new_full((1, count), _TURN_SPREAD)
    turns = torch.cat([unsaid if each is None else each.turns for each in said])
    others = like.new_tensor([[_TURN_SPREAD if each is None else _LOCKED_SPREAD] for each in said])
    turns = torch.cat([turns, others], dim=1)
    # The orientation is the root's, then come free parts; of other joints nothing is said.
    stated = {0: 0} | {drawn.model.part_joints[part]: 1 + index for index, part in enumerate(FREE_PARTS)}
    columns = [stated.get(joint, count) for joint in free_joints(drawn.model)]
    return turns[:, columns]


def _gather_keypoints(
    model: DetailedModel, seen: Sequence[Observation]
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """``places``, ``points`` and ``votes`` of ``LandmarkAims``."""
    device, columns = seen[0].points.device, -(-max(len(each.landmarks) for each in seen) // _ROW) * _ROW
    rows = [_keypoint_table(model, each.landmarks, each.body_points, columns) for each in seen]
    places, parts, known = torch.from_numpy(np.stack(rows, axis=1)).to(device)

    there = np.arange(columns) < np.array([[len(each.landmarks)] for each in seen])
    person, column = (torch.from_numpy(each).to(device) for each in there.nonzero())

    def padded(tensors: list[torch.Tensor]) -> torch.Tensor:
        given = torch.cat(tensors)
        found = given.new_zeros(len(seen), columns, *given.shape[1:])
        found[person, column] = given
        return found

    return (
        places,
        padded([each.points for each in seen]),
        known * landmark_weights(padded([each.confidence for each in seen]), parts),
    )


@lru_cache(maxsize=1024)
def _keypoint_table(
    model: DetailedModel, landmarks: tuple[str, ...], marks: tuple[str, ...], columns: int
) -> np.ndarray:
    """Landmark of the model, part, and 1 of each keypoint, 0 of one that the model has not, and 0: (3, columns)."""
    index = {name: place for place, name in enumerate(model.landmark_names)}
    found = [
        next((index[name] for name in names if name in index), None) for names in zip(marks, landmarks, strict=True)
    ]
    known = [place is not None for place in found]
    table = np.array([[place or 0 for place in found], landmark_points(landmarks).parts[:, 0], known], dtype=np.int64)
    return np.pad(table, ((0, 0), (0, columns - len(landmarks))))
