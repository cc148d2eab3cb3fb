"""People of a scene who may hide one another, which only those can whose boxes overlap in a picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ...errors import InputError
from ...inputs.observation import CROP_MARGIN
from ...inputs.person import crop_boxes
from ...render.part_mesh import MAX_LABEL
from ..mesh.observed_body import ObservedBody

Clusters = tuple[tuple[int, ...], ...]  # each person in one, ascending


def find_clusters(looks: Sequence[ObservedBody], num_people: int) -> Clusters:
    """People who are drawn together: whose boxes overlap in any picture, and whoever overlaps these, and so on."""
    if num_people == 1:
        return ((0,),)
    near = np.eye(num_people, dtype=bool)
    of_picture: dict[tuple[int, int], list[ObservedBody]] = {}
    for look in looks:
        of_picture.setdefault((look.sight.frame, look.sight.view), []).append(look)
    for group in of_picture.values():
        people = np.array([look.sight.person for look in group])
        low, high = np.stack([_box(look) for look in group], axis=1)
        overlap = ((low < high[:, None]) & (high > low[:, None])).all(-1)
        near[np.ix_(people, people)] |= overlap
    for _ in range(num_people.bit_length()):  # each time through twice as many others
        near = near @ near
    return tuple(dict.fromkeys(tuple(np.flatnonzero(row).tolist()) for row in near))


def fits_in_labels(people: int, groups: int) -> bool:
    """True if a picture holds the labels of so many people of so many groups."""
    return people * groups <= MAX_LABEL


def check_room(clusters: Clusters, groups: int) -> None:
    """Raise InputError if people drawn together had more labels than a picture holds."""
    most = max(map(len, clusters))
    if not fits_in_labels(most, groups):
        raise InputError(
            f"sights: {most} people of {groups} groups overlap; expected {MAX_LABEL} labels at most, as of "
            f"{MAX_LABEL // groups} people; fit them in several scenes, of a film one person each (--person)"
        )


def of_several(clusters: Clusters) -> Clusters:
    """Clusters of more than one person."""
    return tuple(members for members in clusters if len(members) > 1)


def of_one(clusters: Clusters) -> Clusters:
    """Clusters of one person."""
    return tuple(members for members in clusters if len(members) == 1)


def slots_of(clusters: Clusters, num_people: int, device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """``slots`` and ``places`` of ``PictureViews``, shapes (K, C) and (P, 2)."""
    slots = np.full((len(clusters), max(map(len, clusters))), -1, dtype=np.int32)
    places = np.full((num_people, 2), -1, dtype=np.int32)
    for number, members in enumerate(clusters):
        slots[number, : len(members)] = members
        places[list(members)] = [(number, slot) for slot in range(len(members))]
    return torch.from_numpy(slots).to(device), torch.from_numpy(places).to(device)


def _box(look: ObservedBody) -> np.ndarray:
    """Lowest and highest (x, y) in the picture [px] of the person with a margin, shape (2, 2)."""
    corners = np.concatenate(crop_boxes(*look.evidence.extents(), CROP_MARGIN))
    found: np.ndarray = corners / look.evidence.windows.zooms + look.evidence.windows.starts
    return found
