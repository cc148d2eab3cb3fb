"""Survey of a data set of people, shard by shard, column by column: what can be counted before rows are trusted.

Memory doesn't grow with the rows: distributions are histograms, errors and warnings are counted by kind, and of the
worst people only their addresses are kept.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..body.labels import label_set
from ..body.template import PART_NAMES
from ..errors import InputError
from ..inputs.body_lines import LIMBS
from .histograms import Histogram
from .reading import Address, PeopleFiles
from .rows import UNREAD

if TYPE_CHECKING:
    import pyarrow as pa

_BODY = "camera_scale"  # a small column that all bodies have, and nothing else
_COUNTED = ("picture", "person", "error", "warnings", _BODY)
_OF_ONE_SHARD = ("shard", "pictures", "pictures_sha256", "seconds", UNREAD)
_MOST_KINDS = 300
_NAMES = sorted({*PART_NAMES, *label_set("body14").group_names, *label_set("lsp6").group_names, *LIMBS}, key=len)
_NAME = "|".join(name.replace("_", "[_ ]") for name in reversed(_NAMES))
_LIST = re.compile(rf"\b(?:{_NAME})\b(?:(?:, | and )(?:{_NAME})\b)*")


@dataclass(frozen=True)
class PersonScore:
    """A number of each person.

    Attributes:
        name: Name of the score, as ``--by`` takes it.
        title: Title of the score, to be shown.
        unit: Unit, which is written after the number.
        columns: Columns from which it is computed.
        values: Function from rows to the score of each, NaN where there is none.
        factor: Factor from the row's unit to the one that is shown.
        worst: End at which people are worst. It is None where neither is.
    """

    name: str
    title: str
    unit: str
    columns: tuple[str, ...]
    values: Callable[[pa.RecordBatch], np.ndarray]
    factor: float = 1.0
    worst: str | None = "high"


def _plain(name: str) -> Callable[[pa.RecordBatch], np.ndarray]:
    return lambda batch: _numbers(batch[name])


def _numbers(column: pa.Array) -> np.ndarray:
    return column.to_numpy(zero_copy_only=False).astype(np.float64)


def _lists(batch: pa.RecordBatch, name: str) -> np.ndarray:
    """Rows of a column's numbers (N, K), NaN where there are none."""
    column, size = batch[name], math.prod(json.loads(batch.schema.field(name).metadata[b"shape"]))
    values = np.full((len(column), size), np.nan)
    known = column.is_valid().to_numpy(zero_copy_only=False)
    values[known] = column.drop_null().flatten().to_numpy(zero_copy_only=False).reshape(-1, size)
    return values


def _spread(batch: pa.RecordBatch) -> np.ndarray:
    return _lists(batch, "joint_spreads").mean(axis=1)


def _box_height(batch: pa.RecordBatch) -> np.ndarray:
    box = _lists(batch, "box")
    return box[:, 3] - box[:, 1]


def _distance(batch: pa.RecordBatch) -> np.ndarray:
    known = batch["camera_perspective"].fill_null(False).to_numpy(zero_copy_only=False)
    return np.where(known, _lists(batch, "translation")[:, 2], np.nan)


SCORES = (
    PersonScore(
        "keypoint_error", "Distance of keypoints from the body", "% of height", ("keypoint_error",),
        _plain("keypoint_error"), 100.0,
    ),
    PersonScore("confidence", "Confidence in the body", "%", ("confidence",), _plain("confidence"), 100.0, "low"),
    PersonScore("energy", "Energy of the last stage", "", ("energy",), _plain("energy")),
    PersonScore("score", "Confidence that there is a person", "%", ("score",), _plain("score"), 100.0, "low"),
    PersonScore("depth", "Uncertainty of depths, mean of joints", "cm", ("joint_spreads",), _spread, 100.0),
    PersonScore("size", "Height of the person's box", "px", ("box",), _box_height, worst="low"),
    PersonScore("stature", "Stature, standing", "cm", ("stature",), _plain("stature"), 100.0, None),
    PersonScore(
        "distance", "Distance from the camera", "m", ("camera_perspective", "translation"), _distance, worst=None
    ),
)  # fmt: skip
RANKED = tuple(score.name for score in SCORES if score.worst)
_USUAL = ("confidence", "keypoint_error")  # by which people are worst unless something else is asked for


def usual_score(files: PeopleFiles) -> str:
    """Name of the score by which people are worst by default.

    It is the confidence. Data sets of older versions lack it; theirs is the distance of the keypoints.
    """
    known = all(_USUAL[0] in files.columns(shard) for shard in files.paths)
    return _USUAL[0] if known else _USUAL[1]


@dataclass
class Kinds:
    """Counts of sentences by their kind: numbers and names of parts in them don't matter.

    Attributes:
        counts: Count of each kind, with the first sentence of it and where that was.
        others: Count of kinds beyond the first ones.
    """

    counts: dict[str, tuple[int, str, Address]] = field(default_factory=dict)
    others: int = 0

    def add(self, sentence: str, count: int, where: Address, kind: str | None = None) -> None:
        """Count a sentence ``count`` times. By default, its kind is the one that ``kind_of`` returns."""
        kind = kind_of(sentence) if kind is None else kind
        if kind in self.counts:
            before, first, place = self.counts[kind]
            self.counts[kind] = before + count, first, min(place, where)
        elif len(self.counts) < _MOST_KINDS:
            self.counts[kind] = count, sentence, where
        else:
            self.others += count

    def sorted(self) -> list[tuple[int, str, Address]]:
        """Counts, the most frequent first."""
        return sorted(self.counts.values(), key=lambda each: (-each[0], each[2]))


def kind_of(sentence: str) -> str:
    """A sentence without numbers, quoted values and lists of parts."""
    return re.sub(r"-?\d[\d.,]*(?:e[-+]?\d+)?", "0", _LIST.sub("parts", re.sub(r"'[^']*'", "''", sentence)))


@dataclass
class Worst:
    """People with the worst values of a score, worst first.

    Attributes:
        score: Score among ``RANKED``.
        count: Greatest number of people.
        values: Value of the score for each person, shape (N,).
        places: Shard and row of each person, shape (N, 2).
    """

    score: PersonScore
    count: int
    values: np.ndarray = field(default_factory=lambda: np.zeros(0))
    places: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))

    @classmethod
    def by(cls, name: str, count: int) -> Worst:
        """Make an empty list of the worst people by the score of this name."""
        return cls(next(score for score in SCORES if score.name == name), count)

    def add(self, values: np.ndarray, shard: int, rows: np.ndarray) -> None:
        """Take finite values of a shard's rows, if they are among the worst."""
        addresses = np.column_stack([np.full(len(rows), shard), rows])
        values, addresses = np.concatenate([self.values, values]), np.concatenate([self.places, addresses])
        order = np.argsort(-values if self.score.worst == "high" else values, kind="stable")[: self.count]
        self.values, self.places = values[order], addresses[order]

    @property
    def addresses(self) -> list[Address]:
        """Addresses of the people, the worst first."""
        return [Address(*shard_and_row) for shard_and_row in self.places.tolist()]


@dataclass
class Survey:
    """Numbers of a data set.

    Attributes:
        worst: The worst people.
        rows: Number of all rows.
        people: Number of rows with a person.
        bodies: Number of rows with a body.
        pictures: Number of pictures that rows belong to. ``stated`` is the number from which shards say they were made.
        nobody: Number of pictures in which nobody was found.
        warned: Number of rows with a warning.
        seconds: Duration of the work, as far as shards say [s]. ``timed`` is the number of their bodies.
        distributions: Distributions of bodies' scores, by name.
        made: Versions, options and so on that shards state, by name.
        errors, warnings: Counts of errors and warnings, by kind.
        faults: Shards that do not agree with what they state, a sentence each.
    """

    worst: Worst
    rows: int = 0
    people: int = 0
    bodies: int = 0
    pictures: int = 0
    stated: int = 0
    nobody: int = 0
    warned: int = 0
    seconds: float = 0.0
    timed: int = 0
    distributions: dict[str, Histogram] = field(default_factory=dict)
    made: dict[str, Kinds] = field(default_factory=dict)
    errors: Kinds = field(default_factory=Kinds)
    warnings: Kinds = field(default_factory=Kinds)
    faults: Kinds = field(default_factory=Kinds)

    @property
    def rows_at_fault(self) -> int:
        """Rows with an error."""
        return sum(count for count, _, _ in self.errors.counts.values()) + self.errors.others

    @property
    def rate(self) -> float | None:
        """Bodies a second of one process; None if no shard says how long it took."""
        return self.timed / self.seconds if self.seconds else None

    @property
    def differing(self) -> list[str]:
        """Names of what is not the same in all shards."""
        return [name for name, values in self.made.items() if len(values.counts) > 1]


def survey_people(
    files: PeopleFiles, by: str | None = None, count: int = 100, progress: Callable[[str], None] | None = None
) -> Survey:
    """Count everything in a data set, and find the worst people.

    Args:
        files: Files of the data set.
        by: Score by which people are worst, one of ``RANKED``. None: ``usual_score``.
        count: Number of worst people to find.
        progress: Function that is called with each shard's name.

    Raises:
        InputError: If a shard can't be read.
    """
    survey = Survey(Worst.by(by or usual_score(files), count))
    for shard, path in files.paths.items():
        about = files.about(shard)
        _count_shard(survey, files, shard, about)
        for name, value in flat_facts(about):
            survey.made.setdefault(name, Kinds()).add(value, 1, Address(shard, 0), kind=value)
        if progress is not None:
            progress(path.name)
    return survey


def worst_people(
    files: PeopleFiles, by: str | None, count: int, progress: Callable[[str], None] | None = None
) -> Worst:
    """Find the worst people by a score. The arguments are those of ``survey_people``."""
    worst = Worst.by(by or usual_score(files), count)
    for shard, path in files.paths.items():
        for first, batch in files.batches(shard, (*worst.score.columns, _BODY)):
            _take_worst(worst, shard, first, batch)
        if progress is not None:
            progress(path.name)
    return worst


def flat_facts(about: Mapping[str, Any]) -> Iterable[tuple[str, str]]:
    """Metadata that all shards of a data set share, by name; tables give each of their entries."""
    for name, value in about.items():
        if name in _OF_ONE_SHARD:
            continue
        if isinstance(value, Mapping):
            yield from ((f"{name}: {key}", _told(each)) for key, each in value.items())
        else:
            yield name, _told(value)


def _told(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _count_shard(survey: Survey, files: PeopleFiles, shard: int, about: Mapping[str, Any]) -> None:
    columns = {column for score in SCORES for column in score.columns}
    pictures, last, bodies = 0, None, survey.bodies
    for first, batch in files.batches(shard, (*_COUNTED, *sorted(columns))):
        names = batch["picture"].to_pylist()
        pictures += sum(name != before for name, before in zip(names, [last, *names[:-1]], strict=True))
        last = names[-1]
        _count_rows(survey, shard, first, batch)
    seconds = about.get("seconds")
    if seconds:
        survey.seconds += float(seconds)
        survey.timed += survey.bodies - bodies
    stated = int(about.get("pictures", pictures))
    survey.pictures += pictures
    survey.stated += stated
    if pictures != stated:
        survey.faults.add(f"Rows of {pictures} pictures, but made of {stated}", 1, Address(shard, 0))


def _count_rows(survey: Survey, shard: int, first: int, batch: pa.RecordBatch) -> None:
    bodies, people = _there(batch, _BODY), _there(batch, "person")
    survey.rows += batch.num_rows
    survey.people += int(people.sum())
    survey.bodies += int(bodies.sum())
    survey.nobody += int((~people & ~_there(batch, "error")).sum())
    for score in _scores_in(batch):
        values = score.values(batch)
        survey.distributions.setdefault(score.name, Histogram()).add(
            values[bodies & np.isfinite(values)] * score.factor
        )
    _take_worst(survey.worst, shard, first, batch)
    for row in np.flatnonzero(_there(batch, "error")).tolist():
        picture, error = (batch[name][row].as_py() for name in ("picture", "error"))
        kind = kind_of(error.replace(picture, ""))
        survey.errors.add(error, 1, Address(shard, first + row), kind)
    for row, sentences in enumerate(batch["warnings"].to_pylist()):
        survey.warned += bool(sentences)
        for sentence in sentences or ():
            survey.warnings.add(sentence, 1, Address(shard, first + row))


def _take_worst(worst: Worst, shard: int, first: int, batch: pa.RecordBatch) -> None:
    if worst.score not in _scores_in(batch):
        raise InputError(f"--by: {worst.score.name}; expected a score that these rows have")
    values = worst.score.values(batch)
    rows = np.flatnonzero(_there(batch, _BODY) & np.isfinite(values))
    worst.add(values[rows] * worst.score.factor, shard, first + rows)


def _scores_in(batch: pa.RecordBatch) -> list[PersonScore]:
    names = set(batch.schema.names)
    return [score for score in SCORES if names.issuperset(score.columns)]


def _there(batch: pa.RecordBatch, name: str) -> np.ndarray:
    return np.asarray(batch[name].is_valid().to_numpy(zero_copy_only=False))
