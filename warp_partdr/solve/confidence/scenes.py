"""Confidence in the bodies of a scene: each view judges the bodies that it shows, and their words are combined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ...inputs.observation import Observation
from ...inputs.observations import Observations, batch_observations
from ...networks.regression.uncertainty import Uncertainty
from ..mesh.observed_body import ObservedBody
from ..scene.fitting import SceneFit
from .limbs import LIMBS
from .measures import body_rows, measure_points
from .model import packaged_model
from .sights import LIMB_LANDMARKS, NO_SIGHT, limb_sights, limbs_outside, seen_limbs


@dataclass(frozen=True)
class SceneConfidence:
    """Confidence in the bodies of a scene with P people in T frames.

    Attributes:
        bodies: Logarithm of the odds that each body is right (``BodyConfidence``), NaN in frames in which no view shows
            the person, shape (P, T). With several views, it is the mean over those that show the person.
        limbs: Logarithm of the odds that each limb of ``LIMBS`` is right, NaN likewise, shape (P, T, 5). With several
            views, it is that of the view that is surest.
        sights: Index in ``SIGHTS`` of each limb, ``NO_SIGHT`` where ``bodies`` is NaN, shape (P, T, 5), uint8. A
            limb is seen if any view shows it.
    """

    bodies: np.ndarray
    limbs: np.ndarray
    sights: np.ndarray


@torch.no_grad()
def judge_scene(
    fit: SceneFit, observed_bodies: Sequence[ObservedBody], sizes: Sequence[tuple[int, int]]
) -> SceneConfidence:
    """Judge the bodies of a scene by their meshes' joints, the keypoints, and the label network's uncertainty.

    A view in which no joint of trunk or limbs has a keypoint can't judge a body. It counts as if it did not show the
    person.

    Views of one body make the same mistakes, so they are no independent witnesses: the mean of their log-odds is taken,
    not the sum.

    Args:
        fit: Fit of the scene.
        observed_bodies: Bodies that the label network predicted for the scene's observations.
        sizes: Size (H, W) of each view's pictures [px].
    """
    model = fit.bodies.model
    marks = (mark for each in observed_bodies for mark in each.observation.body_points)
    names = tuple(name for name in dict.fromkeys((*LIMB_LANDMARKS, *marks)) if name in model.landmark_names)
    landmarks = fit.landmarks(names).cpu()
    shape = len(fit.scene.views), fit.scene.num_people, fit.scene.num_frames
    bodies = np.full(shape, np.nan)
    limbs = np.full((*shape, len(LIMBS)), np.nan)
    sights = np.full((*shape, len(LIMBS)), NO_SIGHT, dtype=np.uint8)
    for own, batch in _batches(observed_bodies):
        rows, view = body_rows(batch.landmarks), own[0].view
        if not rows:
            continue
        at = view, [each.person for each in own], [each.frame for each in own]
        seen_from = fit.scene.views[view]
        pixels = seen_from.camera.project(seen_from.to_camera(landmarks[at[1:]]))[..., :2]
        columns = [names.index(batch.marks[row] if batch.marks[row] in names else batch.landmarks[row]) for row in rows]
        points = _in_crops(pixels[:, columns], own).to(batch.points)
        stated = [each.uncertainty for each in own if each.uncertainty is not None]
        measures = measure_points(points, batch, Uncertainty.joined(stated) if stated else None)
        bodies[at], limbs[at] = packaged_model().log_odds(measures, {})
        seen = seen_limbs(batch.landmarks, batch.confidence.cpu().numpy())
        sights[at] = limb_sights(seen, limbs_outside(names, pixels.numpy(), sizes[view]))
    shown = np.isfinite(bodies)
    total = np.where(shown, bodies, 0.0).sum(axis=0)
    mean = np.where(shown.any(axis=0), total / shown.sum(axis=0).clip(1), np.nan)
    return SceneConfidence(mean, np.fmax.reduce(limbs, axis=0), sights.min(axis=0))


def _batches(observed_bodies: Sequence[ObservedBody]) -> list[tuple[list[ObservedBody], Observations]]:
    """Batches of observations of one view, all with a stated uncertainty or all without one."""
    groups: dict[tuple[int, bool], list[ObservedBody]] = {}
    for each in observed_bodies:
        groups.setdefault((each.view, each.uncertainty is None), []).append(each)
    return [
        ([own[row] for row in rows], batch)
        for own in groups.values()
        for rows, batch in batch_observations([_without_picture(each.observation) for each in own])
    ]


def _without_picture(observation: Observation) -> Observation:
    """Copy of an observation without labels and probabilities, which are large and not measured."""
    return replace(observation, labels=None, maps=None, known=None)


def _in_crops(pixels: torch.Tensor, observed_bodies: Sequence[ObservedBody]) -> torch.Tensor:
    """Points (N, M, 2) [px] of the pictures in the people's crops of side 2."""
    crops = [each.crop for each in observed_bodies]
    corners = pixels.new_tensor([[each.left, each.top] for each in crops])
    scales = pixels.new_tensor([2 * each.zoom / each.size[0] for each in crops])
    return (pixels - corners[:, None]) * scales[:, None, None] - 1
