"""Order in depth of people who hide one another, decided by whose labels are seen where they overlap.

A body that grows as it goes away from the camera looks as before; only who hides whom changes. So a wrong order costs
neither keypoints nor outlines, and no small step mends it: pairs are exchanged, drawn, and compared.
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

_APART = 1.08  # ratio of the distances of two people who were exchanged
LEAST_GAIN = 0.003  # of the loss, that an exchange must save; rounding alone moves a few pixels
_MOST_EXCHANGES = 3  # a person of the picture


def order_people(plan: ScenePlan, looks: Sequence[ObservedBody]) -> tuple[Starts, list[ObservedBody]]:
    """Starts with pairs exchanged where the labels of their picture say so, and their sights."""
    looks, scene = list(looks), plan.scene
    people = gather_scene(plan, looks)
    if not _tells_order(plan, people):
        return people, looks
    bodies = _drawn(plan, people, people.at_rest())
    for frame in range(scene.num_frames):
        for _ in range(_MOST_EXCHANGES * scene.num_people):
            factors = _best_exchanges(plan, people, bodies, frame)
            if factors is None:
                break
            looks = _exchanged(looks, {frame: factors})
            people = gather_scene(plan, looks)
            bodies = _drawn(plan, people, people.at_rest())
    return people, looks


def exchange(
    plan: ScenePlan,
    people: Starts,
    unknowns: Unknowns,
    looks: Sequence[ObservedBody],
    least_gain: float = LEAST_GAIN,
) -> list[ObservedBody] | None:
    """Sights after the best exchange of two people in each frame, as bodies are now; None if none gains so much."""
    if not _tells_order(plan, people):
        return None
    bodies = _drawn(plan, people, unknowns)
    tried = {frame: _best_exchanges(plan, people, bodies, frame, least_gain) for frame in range(bodies.shape[1])}
    found = {frame: factors for frame, factors in tried.items() if factors is not None}
    return _exchanged(looks, found) if found else None


def _tells_order(plan: ScenePlan, people: Starts) -> bool:
    """True if labels can say who stands in front; several views, or known sizes, tell the depth."""
    drawn = plan.energy.together is not None and people.together is not None
    return drawn and people.num_views == 1 and bool(people.unknown.any())


def _drawn(plan: ScenePlan, people: Starts, unknowns: Unknowns) -> torch.Tensor:
    """Vertices in pictures of those who overlap, u [px], v [px], z [m], of K clusters with C slots, (K, T, C, n, 3)."""
    pictures = people.together
    assert pictures is not None
    assert pictures.slots is not None
    clusters, slots = pictures.slots.slots.shape
    drawn, _ = plan.energy.place(people, unknowns).pictured(pictures)
    return drawn.unflatten(1, (slots, -1)).unflatten(0, (clusters, -1))


def _exchanged(looks: Sequence[ObservedBody], factors: Mapping[int, Mapping[int, float]]) -> list[ObservedBody]:
    """Sights whose bodies grow by factors, by frame and person."""
    return [grown(look, factors.get(look.sight.frame, {}).get(look.sight.person, 1.0)) for look in looks]


def _best_exchanges(
    plan: ScenePlan, people: Starts, drawn: torch.Tensor, frame: int, least_gain: float = LEAST_GAIN
) -> dict[int, float] | None:
    """Factors by which two people of each cluster grow as they are exchanged in a frame; None if that helps nowhere."""
    assert people.together is not None
    assert people.views is not None
    assert plan.energy.together is not None
    targets = people.together.target.unflatten(0, drawn.shape[:2])
    shown = people.by_person(people.views.observed)[:, frame, 0]
    found: dict[int, float] = {}
    for cluster, members in enumerate(of_several(plan.clusters)):
        seen = shown[list(members)].tolist()
        factors = _best_exchange(plan.energy.together, drawn[cluster, frame], seen, targets[cluster, frame], least_gain)
        found |= {members[slot]: factor for slot, factor in factors.items()}
    return found or None


def _best_exchange(
    mesh: PartMesh, bodies: torch.Tensor, shown: Sequence[bool], target: torch.Tensor, least_gain: float
) -> dict[int, float]:
    """Factors by which two people of a picture grow as they are exchanged, by slot; none if no exchange helps."""
    distances = bodies[..., 2].mean(1).tolist()
    boxes = [(points.amin(0), points.amax(0)) for points in bodies[..., :2]]
    tries: list[dict[int, float]] = [{}]
    for one, other in combinations(range(len(shown)), 2):
        (low, high), (from_, to) = boxes[one], boxes[other]
        if shown[one] and shown[other] and bool((torch.minimum(high, to) > torch.maximum(low, from_)).all()):
            front, back = sorted((one, other), key=distances.__getitem__)
            factor = math.sqrt(_APART * distances[back] / distances[front])
            tries.append({front: factor, back: 1 / factor})
    if len(tries) == 1:
        return {}
    factors = bodies.new_tensor([[each.get(slot, 1.0) for slot in range(len(bodies))] for each in tries])
    # About the camera: only depths change.
    places, depths = bodies[..., :2].expand(len(tries), -1, -1, -1), bodies[..., 2:] * factors[..., None, None]
    tried = torch.cat([places, depths], dim=-1)
    loss, _ = mesh_label_loss(tried.flatten(1, 2), mesh, ScreenCamera(perspective=True), target[None])
    best = 1 + int(loss[1:].argmin())
    return tries[best] if float(loss[best]) < (1 - least_gain) * float(loss[0]) else {}


def grown(look: ObservedBody, factor: float) -> ObservedBody:
    """A sight whose body is so much larger and farther away."""
    return replace(look, body=look.body.resized(torch.full_like(look.body.log_scale, factor)))
