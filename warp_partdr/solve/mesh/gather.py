"""Starts of the mesh stage from fits of ellipsoids, and the functions that starts of scenes use, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch

from ...body.landmarks import landmark_points
from ...body.parameters import BodyParameters
from ...body.pose_prior import FREE_PARTS
from ...body.posing import Posed
from ...body.template import JOINT_NAMES
from ...inputs.observation import Observation, resize_nearest
from ...interop.captured_call import call_as_graph
from ...interop.layouts import Tensors
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

# Uncertainty of depths [m] and turns [rad] if no network was asked, and of turns that the network does not predict
# [rad].
_DEPTH_UNCERTAINTY = 0.1
_TURN_UNCERTAINTY = 0.3
_LOCKED_UNCERTAINTY = 0.05
_ROW = 32  # tables of keypoints have a multiple of this number of columns, so that few captured graphs serve all people


def gather_starts(
    energy: MeshEnergy, model: DetailedModel, people: Sequence[ObservedBody], given: GivenPoses | None = None
) -> Starts:
    """Collect the starts and observations of a batch of people; each is alone in one frame of one view.

    Args:
        energy: Energy of people with labels of the same set.
        model: Whole detailed model.
        people: People with their bodies. Either all have a lens or none has.
        given: Bodies to start from instead; they have the positions of the people's bodies.
    """
    start = BodyParameters.joined([each.body for each in people])
    if given is None:
        posed = start.posed()
        shape = shape_from_lengths(model, posed)
        whole, translation = call_as_graph(_start_pose, (model,), (shape, *vars(posed).values()))
        rotations = whole[:, energy.drawn.turning]
    else:
        shape = given.shape
        rotations = given.turning_rotations()
        translation = given.translation
    observations = [each.observation for each in people]
    uncertainties = [each.uncertainty for each in people]
    # The depths follow from the landmarks of the starts, below.
    aims = gather_aims(energy.drawn, observations, uncertainties, shape.new_zeros(len(shape), len(JOINT_NAMES) - 1))
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
        turn_variances=gather_turn_uncertainties(energy.drawn, uncertainties, shape).square()[..., None],
        aims=aims,
        alone=alone,
    )
    landmarks = energy.drawn.landmarks(energy.drawn.pose(starts, starts.at_rest()))
    return replace(starts, aims=replace(aims, depths=energy.drawn.depths(landmarks).detach()))


def _start_pose(model: DetailedModel, shape: torch.Tensor, *posed: torch.Tensor) -> Tensors:
    """Local rotations and translations of bodies with the pose of EllipBodies, from the tensors of ``Posed``."""
    return pose_from_ellipbody(model, Posed(*posed), shape, trunk_along=True)


def gather_aims(
    drawn: DrawnModel,
    observations: Sequence[Observation],
    uncertainties: Sequence[Uncertainty | None],
    depths: torch.Tensor,
) -> LandmarkAims:
    """Collect the aims of landmarks in M pictures of bodies.

    Args:
        drawn: Model that is drawn.
        observations: Observation in each picture.
        uncertainties: Uncertainty of the network about each body; None for bodies without a network.
        depths: Expected depths of ``JOINT_NAMES`` relative to the pelvis [m], shape (M, 20).
    """
    indices, points, weights = _gather_keypoints(drawn.model, observations)
    usual = depths.new_full((1, len(JOINT_NAMES) - 1), _DEPTH_UNCERTAINTY)
    depth_uncertainty = torch.cat([usual if each is None else each.depths for each in uncertainties])
    return LandmarkAims(indices, points, weights, drawn.ends, depths, depth_uncertainty.pow(-2))


def gather_turn_uncertainties(
    drawn: DrawnModel, uncertainties: Sequence[Uncertainty | None], like: torch.Tensor
) -> torch.Tensor:
    """Collect the uncertainty of the turns of free joints [rad], shape (M, F).

    Args:
        drawn: Model that is drawn.
        uncertainties: Uncertainty of the network about each body; None for bodies without a network.
        like: Tensor with the dtype and device of the result.
    """
    count = 1 + len(FREE_PARTS)
    usual = like.new_full((1, count), _TURN_UNCERTAINTY)
    turns = torch.cat([usual if each is None else each.turns for each in uncertainties])
    others = like.new_tensor([[_TURN_UNCERTAINTY if each is None else _LOCKED_UNCERTAINTY] for each in uncertainties])
    turns = torch.cat([turns, others], dim=1)
    # The first column is the orientation of the root, then follow the free parts. The last one is for all other joints.
    predicted = {0: 0} | {drawn.model.part_joints[part]: 1 + index for index, part in enumerate(FREE_PARTS)}
    columns = [predicted.get(joint, count) for joint in free_joints(drawn.model)]
    return turns[:, columns]


def _gather_keypoints(
    model: DetailedModel, observations: Sequence[Observation]
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Collect ``landmark_indices``, ``points`` and ``weights`` of ``LandmarkAims``."""
    device = observations[0].points.device
    columns = -(-max(len(each.landmarks) for each in observations) // _ROW) * _ROW
    tables = [_keypoint_table(model, each.landmarks, each.body_points, columns) for each in observations]
    indices, parts, known = torch.from_numpy(np.stack(tables, axis=1)).to(device)

    filled = np.arange(columns) < np.array([[len(each.landmarks)] for each in observations])
    filled_rows, filled_columns = filled.nonzero()
    person = torch.from_numpy(filled_rows).to(device)
    column = torch.from_numpy(filled_columns).to(device)

    def padded(tensors: list[torch.Tensor]) -> torch.Tensor:
        given = torch.cat(tensors)
        found = given.new_zeros(len(observations), columns, *given.shape[1:])
        found[person, column] = given
        return found

    points = padded([each.points for each in observations])
    confidence = padded([each.confidence for each in observations])
    return indices, points, known * landmark_weights(confidence, parts)


@lru_cache(maxsize=1024)
def _keypoint_table(
    model: DetailedModel, landmarks: tuple[str, ...], marks: tuple[str, ...], columns: int
) -> np.ndarray:
    """Make the table of a person's keypoints.

    Returns:
        Three rows: the index of the model's landmark, the part of the body, and 1 if the model has the landmark, else
        0; shape (3, columns). Columns without a keypoint are 0.
    """
    index_of = {name: index for index, name in enumerate(model.landmark_names)}
    found = [
        next((index_of[name] for name in names if name in index_of), None)
        for names in zip(marks, landmarks, strict=True)
    ]
    known = [index is not None for index in found]
    table = np.array([[index or 0 for index in found], landmark_points(landmarks).parts[:, 0], known], dtype=np.int64)
    return np.pad(table, ((0, 0), (0, columns - len(landmarks))))
