"""People cut out of pictures: their evidence is weighed, and their labels are drawn in crops, as a batch on a device.

Each result is the same, to the bit, as that of ``weigh_evidence`` and ``crop_evidence`` for the person alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ..body.labels import LabelSet
from ..body.skeletons import Skeleton
from ..errors import InputError
from ..interop.streams import on_torch_stream
from ..interop.torch_threads import one_torch_thread
from .cut_people import CutPerson
from .evidence import (
    MASK_LABELS,
    PicturePerson,
    check_points,
    exchanged_groups,
    exchanged_warning,
    keypoint_warnings,
    weigh_people,
)
from .keypoints import LARGEST_COORDINATE
from .observation import (
    LABEL_SIZE,
    WeighedPerson,
    boxes_in_picture,
    crop_squares,
    observe_batch,
    with_probabilities,
)
from .own_pixels import Mask, Windows, extents, no_label_along_bones
from .part_labels import PartLabels
from .person import person_labels

_PIXELS = {"cpu": 2**25, "cuda": 2**26}  # most pixels of the pictures in one batch

Found = dict[int, CutPerson | InputError]


@one_torch_thread()
def cut_out_people(
    people: Sequence[PicturePerson],
    device: torch.device | str,
    label_size: int = LABEL_SIZE,
    *,
    probabilities: bool = False,
) -> list[CutPerson | InputError]:
    """Cut people out of pictures with part labels, with masks, or with keypoints alone.

    The evidence does not hold the picture's labels. If labels and keypoints disagree on left and right, the keypoints
    are believed. A person whose mask shows nothing is cut out by keypoints alone.

    Args:
        people: People, who may share pictures.
        device: Device of the observations.
        label_size: Side of the labels' crops [px], of which ``LABEL_SIZE`` is an odd multiple.
        probabilities: True: observations also have the probabilities of the labels, if the picture has them.

    Returns:
        Each person, or the error that ``weigh_evidence`` raises for this person.
    """
    device = torch.empty(0, device=device).device  # with its number, which Warp asks for
    found: Found = dict(_unusable(people))
    batches: list[tuple[tuple[str | Skeleton, LabelSet | None], list[int]]] = []  # label sets can't be keys
    usable: dict[int, PicturePerson] = {}
    for index, person in enumerate(people):
        if index in found:
            continue
        try:
            usable[index] = _with_own_labels(person)
        except InputError as error:
            found[index] = error
            continue
        key = person.keypoints.skeleton, _label_set(person)
        indices = next((own for each, own in batches if each == key), None)
        if indices is None:
            batches.append((key, indices := []))
        indices.append(index)
    for (_, labels), indices in batches:
        if labels is None:
            found |= zip(indices, _cut_keypoints([usable[index] for index in indices], device), strict=True)
            continue
        for some in _shares(indices, usable, _PIXELS[device.type]):
            cut = _cut_labels([usable[index] for index in some], device, label_size, probabilities)
            found |= zip(some, cut, strict=True)
    return [found[index] for index in range(len(people))]


def _unusable(people: Sequence[PicturePerson]) -> Found:
    """Errors of people whose keypoints can't be used, by index.

    All people are checked at once; ``check_points``, which is slower, only makes the errors.
    """
    found: Found = {}
    forms: dict[str | Skeleton, list[int]] = {}
    for index, person in enumerate(people):
        forms.setdefault(person.keypoints.skeleton, []).append(index)
    for indices in forms.values():
        points = np.stack([people[index].keypoints.points for index in indices])
        visible = np.stack([people[index].keypoints.confidence for index in indices]) > 0
        first = np.take_along_axis(points, visible.argmax(axis=1)[:, None, None], axis=1)
        differ = (visible & (points != first).any(axis=2)).any(axis=1)
        known = ((np.abs(points) <= LARGEST_COORDINATE).all(axis=2) | ~visible).all(axis=1)
        for row in np.flatnonzero(~(differ & known)).tolist():
            try:
                check_points(people[indices[row]].keypoints)
            except InputError as error:
                found[indices[row]] = error
    return found


def _label_set(person: PicturePerson) -> LabelSet | None:
    """Label set of a person's picture; None without labels and masks."""
    if person.pixels is None:
        return None
    return MASK_LABELS if isinstance(person.pixels, Mask) else person.pixels.label_set


def _with_own_labels(person: PicturePerson) -> PicturePerson:
    """Person with only the person's own labels, if the picture's labels are given for each person."""
    if person.pixels is None or isinstance(person.pixels, Mask) or person.pixels.instances is None:
        return person
    return person._replace(pixels=person_labels(person.pixels, person.keypoints), others=())


def _shares(indices: Sequence[int], people: dict[int, PicturePerson], most: int) -> list[list[int]]:
    """Indices of people in parts, whose pictures have at most ``most`` pixels; one person is never split."""
    parts: list[list[int]] = []
    held: set[int] = set()
    size = 0
    for index in indices:
        pixels = people[index].pixels
        assert pixels is not None
        image = pixels.owners if isinstance(pixels, Mask) else pixels.groups
        own = image.shape[0] * image.shape[1]
        more = own if id(image) in held else 2 * own
        if not parts or size + more > most:
            parts.append([])
            held, size, more = set(), 0, 2 * own
        parts[-1].append(index)
        held.add(id(image))
        size += more
    return parts


def _cut_keypoints(people: Sequence[PicturePerson], device: torch.device) -> list[CutPerson]:
    """Cut out people with one skeleton by their keypoints alone."""
    count = len(people)
    points = np.stack([person.keypoints.points for person in people])
    confidence = np.stack([person.keypoints.confidence for person in people])
    windows = Windows.at(
        people[0].keypoints.skeleton,
        points,
        confidence,
        np.zeros((count, 2)),
        np.ones(count),
        np.ones((count, 2), dtype=np.int64),
    )
    nowhere = np.full((count, 2), np.inf)
    middles, halves = crop_squares(*extents(windows.points, confidence, nowhere, -nowhere))
    weighed = [
        WeighedPerson(
            person.keypoints,
            windows.points[n, confidence[n] > 0],
            windows.crop(n),
            None,
            None,
            keypoint_warnings(person.keypoints),
            person.camera,
        )
        for n, person in enumerate(people)
    ]
    return [CutPerson(*each) for each in observe_batch(weighed, middles, halves, device)]


def _cut_labels(
    people: Sequence[PicturePerson], device: torch.device, label_size: int, probabilities: bool
) -> list[CutPerson | InputError]:
    """Cut out people with one skeleton, from pictures with one label set or with masks, as one batch."""
    labels = _label_set(people[0])
    assert labels is not None
    with on_torch_stream(device):
        weighed = weigh_people(people, device)
        windows, along = weighed.pixels.windows, weighed.pixels.along
        middles, halves = crop_squares(
            *extents(windows.points, windows.confidence, weighed.measures.low, weighed.measures.high)
        )
        boxes = boxes_in_picture(windows, middles, halves)
        size = LABEL_SIZE, LABEL_SIZE
        targets = weighed.pixels.targets(*boxes, size, every=LABEL_SIZE // label_size).unbind()
    cut: list[WeighedPerson] = []
    maps: dict[int, np.ndarray] = {}
    for n, (person, target) in enumerate(zip(people, targets, strict=True)):
        warnings = weighed.warnings[n]
        if limbs := weighed.swapped[n]:
            whole = weighed.whole[n]
            table = torch.from_numpy(exchanged_groups(labels, limbs, whole=whole)).to(device)
            target = table[target.long()]
            warnings = (*warnings, exchanged_warning(limbs, whole=whole))
        points = windows.points[n, windows.confidence[n] > 0]
        cut.append(WeighedPerson(person.keypoints, points, windows.crop(n), target, labels, warnings, person.camera))
        if probabilities and isinstance(person.pixels, PartLabels) and person.pixels.maps is not None:
            every = person.pixels.maps
            maps[n] = every[exchanged_groups(labels, limbs, whole=weighed.whole[n])[: len(every)]] if limbs else every
    labelled = np.flatnonzero(along)
    found: list[CutPerson | InputError] = [no_label_along_bones()] * len(people)
    own = (
        observe_batch([cut[n] for n in labelled], middles[labelled], halves[labelled], device) if labelled.size else []
    )
    for n, each in zip(labelled.tolist(), own, strict=True):
        evidence, observation, crop = each
        if n in maps:
            box = (*boxes[0][n].tolist(), *boxes[1][n].tolist())
            observation = with_probabilities(observation, maps[n], box)
        found[n] = CutPerson(evidence, observation, crop)
    hidden = [n for n in np.flatnonzero(~along).tolist() if isinstance(people[n].pixels, Mask)]
    if hidden:
        for n, alone in zip(hidden, _cut_keypoints([people[n] for n in hidden], device), strict=True):
            found[n] = alone
    return found
