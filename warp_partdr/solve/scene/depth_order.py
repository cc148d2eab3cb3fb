"""Depth order of people who hide one another, decided by the labels where they overlap.

A body that grows while it moves away from the camera keeps its picture. Only the order in which people hide one another
changes. So a wrong order costs nothing at keypoints and outlines, and gradient steps cannot correct it. Instead, pairs
of people are exchanged in depth, drawn, and compared with the labels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import torch

from ...cameras import ScreenCamera
from ...render.mesh import mesh_label_loss
from ...render.part_mesh import PartMesh
from ..mesh.observed_body import ObservedBody
from ..mesh.starts import Starts, Unknowns
from .clusters import of_several
from .plan import ScenePlan
from .start import gather_scene

_APART = 1.08  # ratio of the distances of two people after their exchange
LEAST_GAIN = 0.003  # share of the loss that an exchange must save, because rounding alone moves a few pixels
_MOST_EXCHANGES = 3  # exchanges for each person of the picture


def order_people(plan: ScenePlan, observed_bodies: Sequence[ObservedBody]) -> tuple[Starts, list[ObservedBody]]:
    """Exchanges pairs of people in depth where the labels ask for it.

    Returns:
        The starts and the observed bodies after the exchanges.
    """
    observed_bodies = list(observed_bodies)
    scene = plan.scene
    people = gather_scene(plan, observed_bodies)
    if not _labels_tell_order(plan, people):
        return people, observed_bodies
    bodies = _drawn(plan, people, people.at_rest())
    for frame in range(scene.num_frames):
        for _ in range(_MOST_EXCHANGES * scene.num_people):
            factors = _best_exchanges(plan, people, bodies, frame)
            if factors is None:
                break
            observed_bodies = _exchanged(observed_bodies, {frame: factors})
            people = gather_scene(plan, observed_bodies)
            bodies = _drawn(plan, people, people.at_rest())
    return people, observed_bodies


def exchange(
    plan: ScenePlan,
    people: Starts,
    unknowns: Unknowns,
    observed_bodies: Sequence[ObservedBody],
    least_gain: float = LEAST_GAIN,
) -> list[ObservedBody] | None:
    """Exchanges two people in depth in each frame, where that saves most.

    Args:
        plan: Plan of the scene's fit.
        people: Starts of the bodies.
        unknowns: State of the fit, in which exchanges are compared.
        observed_bodies: Observed bodies from which ``people`` start.
        least_gain: Share of the label loss that an exchange must save.

    Returns:
        The observed bodies after the exchanges, or None if no exchange saves enough.
    """
    if not _labels_tell_order(plan, people):
        return None
    bodies = _drawn(plan, people, unknowns)
    tried = {frame: _best_exchanges(plan, people, bodies, frame, least_gain) for frame in range(bodies.shape[1])}
    found = {frame: factors for frame, factors in tried.items() if factors is not None}
    return _exchanged(observed_bodies, found) if found else None


def _labels_tell_order(plan: ScenePlan, people: Starts) -> bool:
    """True if labels decide who stands in front. With several views or known sizes, the depth is known already."""
    drawn = plan.energy.cluster_mesh is not None and people.overlapping is not None
    return drawn and people.num_views == 1 and bool(people.unknown.any())


def _drawn(plan: ScenePlan, people: Starts, unknowns: Unknowns) -> torch.Tensor:
    """Vertices in the pictures of K clusters with C slots: u [px], v [px], z [m], shape (K, T, C, n, 3)."""
    pictures = people.overlapping
    assert pictures is not None
    assert pictures.slots is not None
    clusters, slots = pictures.slots.slots.shape
    drawn, _ = plan.energy.place(people, unknowns).pictured(pictures)
    return drawn.unflatten(1, (slots, -1)).unflatten(0, (clusters, -1))


def _exchanged(
    observed_bodies: Sequence[ObservedBody], factors: Mapping[int, Mapping[int, float]]
) -> list[ObservedBody]:
    """Resizes bodies by factors, by frame and person."""
    return [grown(observed, factors.get(observed.frame, {}).get(observed.person, 1.0)) for observed in observed_bodies]


def _best_exchanges(
    plan: ScenePlan, people: Starts, drawn: torch.Tensor, frame: int, least_gain: float = LEAST_GAIN
) -> dict[int, float] | None:
    """Finds the best exchange of two people in each cluster in a frame.

    Returns:
        Factor by which each exchanged person grows, or None if no exchange helps.
    """
    assert people.overlapping is not None
    assert people.views is not None
    assert plan.energy.cluster_mesh is not None
    targets = people.overlapping.target.unflatten(0, drawn.shape[:2])
    visible = people.by_person(people.views.observed)[:, frame, 0]
    found: dict[int, float] = {}
    for cluster, members in enumerate(of_several(plan.clusters)):
        shown = visible[list(members)].tolist()
        target = targets[cluster, frame]
        factors = _best_exchange(plan.energy.cluster_mesh, drawn[cluster, frame], shown, target, least_gain)
        found |= {members[slot]: factor for slot, factor in factors.items()}
    return found or None


def _best_exchange(
    mesh: PartMesh, bodies: torch.Tensor, shown: Sequence[bool], target: torch.Tensor, least_gain: float
) -> dict[int, float]:
    """Finds the best exchange of two people in one picture.

    Returns:
        Factor by which each exchanged person grows, by slot. It is empty if no exchange helps.
    """
    distances = bodies[..., 2].mean(1).tolist()
    boxes = [(points.amin(0), points.amax(0)) for points in bodies[..., :2]]
    tries: list[dict[int, float]] = [{}]
    for one, other in combinations(range(len(shown)), 2):
        low, high = boxes[one]
        other_low, other_high = boxes[other]
        overlap = bool((torch.minimum(high, other_high) > torch.maximum(low, other_low)).all())
        if shown[one] and shown[other] and overlap:
            front, back = sorted((one, other), key=distances.__getitem__)
            factor = math.sqrt(_APART * distances[back] / distances[front])
            tries.append({front: factor, back: 1 / factor})
    if len(tries) == 1:
        return {}
    factors = bodies.new_tensor([[each.get(slot, 1.0) for slot in range(len(bodies))] for each in tries])
    # A body grows about the camera, so only depths change.
    positions = bodies[..., :2].expand(len(tries), -1, -1, -1)
    depths = bodies[..., 2:] * factors[..., None, None]
    tried = torch.cat([positions, depths], dim=-1)
    loss, _ = mesh_label_loss(tried.flatten(1, 2), mesh, ScreenCamera(perspective=True), target[None])
    best = 1 + int(loss[1:].argmin())
    return tries[best] if float(loss[best]) < (1 - least_gain) * float(loss[0]) else {}


def grown(observed: ObservedBody, factor: float) -> ObservedBody:
    """Returns a copy whose body is larger and farther away by a factor."""
    return replace(observed, body=observed.body.resized(torch.full_like(observed.body.log_scale, factor)))
