"""PartBench as ``Sample`` records: the same people at every level, scored against the clean truth."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np

from ...body.labels import label_set
from ...cameras import Perspective
from ...errors import InputError
from ...inputs.keypoints import Keypoints2D
from ...inputs.part_labels import PartLabels
from ...inputs.sample import Sample
from ...synthetic.noise import HIDDEN_CONFIDENCE, LEVELS, noisy_keypoints, noisy_labels
from ...synthetic.partbench_people import COCO, NUM_PEOPLE, SEED, Person, Setting, make_person
from . import VERSION

LABELS = label_set("cdcl14")
# Levels of noise as "realistic", and people of ``make_person(setting=...)``.
NEAR, TILTED, CLOTHED = SETTINGS = ("near", "tilted", "clothed")
CROSSED = "crossed"  # level of ``crossed_samples``
PAIRS, GROUPS, CLIP, VIEWS = SCENES = ("pairs", "groups", "clip", "views")  # levels of ``partbench_scenes``
_OVERLAP = (0.1, 0.3)  # of the person's width that a stranger stands before


def source_name(level: str) -> str:
    """Name of a level's source, under which its figures are pooled."""
    return f"PartBench {VERSION}, {level}"


def partbench_samples(count: int = NUM_PEOPLE, levels: Sequence[str] = tuple(LEVELS)) -> list[Sample]:
    """The first ``count`` people at each level: those of noise, and ``SETTINGS``.

    Raises:
        InputError: If a level is unknown, or there are not so many people.
    """
    check_people(range(count))
    if unknown := [level for level in levels if level not in (*LEVELS, *SETTINGS)]:
        known = ", ".join((*LEVELS, *SETTINGS, CROSSED, *SCENES))
        raise InputError(f"level: {', '.join(unknown)}; expected {known}")
    return [make_sample(index, level) for level in levels for index in range(count)]


def check_people(indices: Sequence[int]) -> None:
    """Raise InputError unless there are people of these indices."""
    if not indices or min(indices) < 0 or max(indices) >= NUM_PEOPLE:
        raise InputError(f"people: {len(indices)}; expected 1 to {NUM_PEOPLE}")


def make_sample(index: int, name: str) -> Sample:
    """Person ``index`` at a level: seen with its noise, and the truth without.

    At "clothed", keypoints and noise are those of "realistic", so that only labels tell of clothes. The true labels
    show clothes, as annotators' do; joints and vertices are those of the body beneath.
    """
    setting: Setting = name if name in SETTINGS else "usual"  # type: ignore[assignment]
    person, level = make_person(index, setting), LEVELS["realistic" if name in SETTINGS else name]
    noise = "realistic" if name == CLOTHED else name
    rng = np.random.default_rng([SEED, index, zlib.crc32(noise.encode())])
    truth = LABELS.from_parts(person.parts)
    groups, hidden, others = truth, person.hidden, np.zeros((len(COCO), 3))
    if rng.random() < level.stranger:
        groups, hidden, others = _add_stranger(person, truth, make_person((index + 1) % NUM_PEOPLE, setting), rng)
    groups = noisy_labels(groups, LABELS, person.height, level, rng)
    keypoints = noisy_keypoints(
        person.keypoints, hidden, COCO.landmarks, person.height, truth.shape, level=level, rng=rng
    )
    return Sample(
        source=source_name(name),
        name=f"{person.name}, {person.kind}",
        # Labels of another outline may take more or fewer draws, after which the keypoints' would differ.
        keypoints=make_sample(index, noise).keypoints if name == CLOTHED else _keypoints(keypoints),
        parts=PartLabels(LABELS, groups),
        others=(_keypoints(others),) if np.count_nonzero(others[:, 2]) > 1 else (),
        target=truth,
        joints=person.joints,
        vertices=person.vertices,
        camera=person.camera if isinstance(person.camera, Perspective) else None,
    )


def _keypoints(values: np.ndarray) -> Keypoints2D:
    values = values.astype(np.float32)
    return Keypoints2D(COCO.name, values[:, :2], values[:, 2])


def _add_stranger(
    person: Person, truth: np.ndarray, stranger: Person, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Group ids with somebody before the person's one side, keypoints that are hidden now, and the other's, (17, 3)."""
    rows, columns = np.nonzero(stranger.parts)
    mine = np.nonzero(truth.any(0))[0]
    overlap = rng.uniform(*_OVERLAP) * np.ptp(mine)
    shift = round(mine[0] + overlap - columns.max() if rng.random() < 0.5 else mine[-1] - overlap - columns.min())
    height, width = truth.shape
    inside = (rows < height) & (columns + shift >= 0) & (columns + shift < width)
    rows, columns = rows[inside], columns[inside]
    seen, before = truth.copy(), np.zeros(truth.shape, dtype=bool)
    seen[rows, columns + shift] = LABELS.from_parts(stranger.parts)[rows, columns]
    before[rows, columns + shift] = True
    u, v = np.clip(person.keypoints.astype(int), 0, [width - 1, height - 1]).T
    points = stranger.keypoints + np.array([shift, 0.0])
    found = ((points >= 0) & (points <= [width, height])).all(axis=1, keepdims=True)
    values = np.column_stack([points, np.where(stranger.hidden, HIDDEN_CONFIDENCE, 1.0)])
    return seen, person.hidden | before[v, u], np.where(found, values, 0.0)
