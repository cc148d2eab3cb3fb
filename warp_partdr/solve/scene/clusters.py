"""Clusters of people who may hide one another. Only people whose boxes overlap in a picture can."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ...errors import InputError
from ...inputs.observation import CROP_MARGIN
from ...inputs.person import crop_boxes
from ...render.part_mesh import MAX_LABEL
from ..mesh.observed_body import ObservedBody

Clusters = tuple[tuple[int, ...], ...]  # indices of people; each person is in one cluster, and indices rise


def find_clusters(observed_bodies: Sequence[ObservedBody], num_people: int) -> Clusters:
    """Groups people who are drawn together.

    Two people are in one cluster if their boxes overlap in any picture, or if a chain of overlapping people connects
    them.
    """
    if num_people == 1:
        return ((0,),)
    near = np.eye(num_people, dtype=bool)
    by_picture: dict[tuple[int, int], list[ObservedBody]] = {}
    for observed in observed_bodies:
        by_picture.setdefault((observed.frame, observed.view), []).append(observed)
    for group in by_picture.values():
        people = np.array([observed.person for observed in group])
        boxes = np.stack([_box(observed) for observed in group])
        low = boxes[:, 0]
        high = boxes[:, 1]
        overlap = ((low < high[:, None]) & (high > low[:, None])).all(-1)
        near[np.ix_(people, people)] |= overlap
    for _ in range(num_people.bit_length()):  # each product doubles the number of people between two
        near = near @ near
    return tuple(dict.fromkeys(tuple(np.flatnonzero(row).tolist()) for row in near))


def fits_in_labels(people: int, groups: int) -> bool:
    """True if a label picture has enough ids for this many people with this many groups each."""
    return people * groups <= MAX_LABEL


def check_room(clusters: Clusters, groups: int) -> None:
    """Raises InputError if the people of a cluster need more labels than a picture can hold."""
    most = max(map(len, clusters))
    if not fits_in_labels(most, groups):
        raise InputError(
            f"observations: {most} people with {groups} groups each overlap; expected {MAX_LABEL} labels at most, "
            f"which are {MAX_LABEL // groups} people; fit them in several scenes, or one person of a film at a time "
            "(--person)"
        )


def of_several(clusters: Clusters) -> Clusters:
    """Clusters of more than one person."""
    return tuple(members for members in clusters if len(members) > 1)


def of_one(clusters: Clusters) -> Clusters:
    """Clusters of one person."""
    return tuple(members for members in clusters if len(members) == 1)


def slots_of(clusters: Clusters, num_people: int, device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """Numbers the people of K clusters, which have at most C people.

    Returns:
        Person in each slot of each cluster, shape (K, C), and cluster and slot of each person, shape (P, 2), both
        int32. They are -1 where there is none.
    """
    slots = np.full((len(clusters), max(map(len, clusters))), -1, dtype=np.int32)
    places = np.full((num_people, 2), -1, dtype=np.int32)
    for index, members in enumerate(clusters):
        slots[index, : len(members)] = members
        places[list(members)] = [(index, slot) for slot in range(len(members))]
    return torch.from_numpy(slots).to(device), torch.from_numpy(places).to(device)


def _box(observed: ObservedBody) -> np.ndarray:
    """Lowest and highest (x, y) in the picture [px] of the person with a margin, shape (2, 2)."""
    corners = np.concatenate(crop_boxes(*observed.evidence.extents(), CROP_MARGIN))
    found: np.ndarray = corners / observed.evidence.windows.zooms + observed.evidence.windows.starts
    return found
