"""Data sets of people read back: their shards, rows by address, and the bodies in rows as fits have them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch

from ..body.posing import Posed, pose
from ..body.skeletons import Skeleton
from ..errors import InputError, cause, shown
from ..inputs.keypoints import Keypoints2D
from ..interop.checks import rotation_fault
from ..models.model import DetailedModel
from ..models.registration import Registered, ungrown
from ..results.body_file import BODY_ARRAYS, BodyFile
from .rows import FORMAT, Row
from .shards import read_about

if TYPE_CHECKING:
    import pyarrow as pa

_NAME = re.compile(r"part-(\d+)-of-(\d+)\.parquet")
_BATCH = 4096  # rows that are read at a time


class Address(NamedTuple):
    """Place of a row: number of its shard, and of the row in it, both from 0 on; written 3/17."""

    shard: int
    row: int

    def __str__(self) -> str:
        return f"{self.shard}/{self.row}"


def by_shard(addresses: Iterable[Address]) -> dict[int, list[int]]:
    """Rows in each shard, both in ascending order."""
    chosen: dict[int, list[int]] = {}
    for shard, row in sorted(addresses):
        chosen.setdefault(shard, []).append(row)
    return chosen


@dataclass(frozen=True)
class PeopleFiles:
    """Shards of a data set that are there.

    Attributes:
        folder: Folder of the data set.
        paths: Files by the number of the shard, in order.
        expected: Number of shards of the whole data set.
    """

    folder: Path
    paths: Mapping[int, Path]
    expected: int

    @classmethod
    def open(cls, folder: Path) -> PeopleFiles:
        """Shards in a folder.

        Raises:
            InputError: If there are none, or some of two data sets.
        """
        found = sorted((match, path) for path in folder.glob("part-*") if (match := _parts(path)))
        if not found:
            fault = "no shards in it" if folder.is_dir() else "No such folder"
            raise InputError(f"{folder}: {fault}; expected a data set of partdr dataset")
        counts = sorted({match[1] for match, _ in found})
        if len(counts) > 1:
            raise InputError(f"{folder}: shards of {counts[0]} and of {counts[1]}; expected those of one data set")
        return cls(folder, {match[0]: path for match, path in found}, counts[0])

    def path(self, shard: int) -> Path:
        """The file of a shard.

        Raises:
            InputError: If it is not there.
        """
        if shard not in self.paths:
            raise InputError(f"{self.folder}: no shard {shard}; expected one of the {len(self.paths)} that are there")
        return self.paths[shard]

    def about(self, shard: int) -> dict[str, Any]:
        """Facts that a shard states about itself.

        Raises:
            InputError: If it is none of this format.
        """
        known = read_about(self.path(shard))
        if known.get("format") != FORMAT:
            stated = shown(known.get("format"))
            raise InputError(f"{self.path(shard)}: format {stated}; expected {FORMAT!r}: make the data set again")
        return known

    def count(self, shard: int) -> int:
        """Rows of a shard."""
        import pyarrow.parquet as pq

        return int(pq.read_metadata(self.path(shard)).num_rows)

    def columns(self, shard: int) -> list[str]:
        """Names of a shard's columns.

        Raises:
            InputError: If it is none of this format.
        """
        import pyarrow.parquet as pq

        self.about(shard)
        return list(pq.read_schema(self.path(shard)).names)

    @cached_property
    def total(self) -> int:
        """Rows of all shards that are there."""
        return sum(map(self.count, self.paths))

    def batches(self, shard: int, columns: Sequence[str] | None = None) -> Iterator[tuple[int, pa.RecordBatch]]:
        """Rows of a shard, some at a time, with the number of the first; columns that are not there are left out."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        first, path = 0, self.path(shard)
        try:
            with pq.ParquetFile(path) as file:
                names = set(file.schema_arrow.names)
                taken = None if columns is None else [name for name in columns if name in names]
                for batch in file.iter_batches(_BATCH, columns=taken):
                    yield first, batch
                    first += batch.num_rows
        except (OSError, pa.ArrowException) as error:
            raise InputError(f"{path}: {cause(error)}; expected a whole shard") from error

    def rows(self, shard: int, indices: Sequence[int]) -> Iterator[tuple[Address, Row]]:
        """Rows of a shard by their numbers, in ascending order."""
        indices = sorted(set(indices))
        for first, batch in self.batches(shard):
            chosen = [index for index in indices if first <= index < first + batch.num_rows]
            for index in chosen:
                yield Address(shard, index), read_row(batch, index - first)

    def select(self, text: str) -> dict[int, list[int]]:
        """Rows that a text names: 3/17 (shard/row), 0:100 (all shards' rows, counted through), with commas between.

        Raises:
            InputError: If it is something else, or names a row that is not there.
        """
        chosen: dict[int, set[int]] = {}
        for part in text.split(","):
            if match := re.fullmatch(r"(\d+)/(\d+)", part.strip()):
                shard, row = map(int, match.groups())
                if row >= (count := self.count(shard)):
                    raise InputError(f"--rows: {part}; expected rows 0 to {count - 1} of shard {shard}")
                chosen.setdefault(shard, set()).add(row)
            elif match := re.fullmatch(r"(\d*):(\d*)", part.strip()):
                low, high = int(match[1] or 0), int(match[2]) if match[2] else self.total
                if not low < min(high, self.total):
                    raise InputError(f"--rows: {part}; expected some of rows 0:{self.total}")
                for shard, rows in self._counted(low, high):
                    chosen.setdefault(shard, set()).update(rows)
            else:
                raise InputError(f"--rows: {shown(part)}; expected such as 3/17 (shard/row) or 0:100, with commas")
        return {shard: sorted(rows) for shard, rows in sorted(chosen.items())}

    def _counted(self, low: int, high: int) -> Iterator[tuple[int, range]]:
        """Shards, and their rows, that are rows ``low`` to ``high`` of all."""
        first = 0
        for shard in self.paths:
            count = self.count(shard)
            rows = range(max(low - first, 0), min(high - first, count))
            if rows:
                yield shard, rows
            first += count
            if first >= high:
                return


def _parts(path: Path) -> tuple[int, int] | None:
    match = _NAME.fullmatch(path.name)
    return None if match is None else (int(match[1]), int(match[2]))


def read_row(batch: pa.RecordBatch, index: int) -> Row:
    """A row: numbers, texts, lists of texts, and float32 arrays of the shapes that the fields' metadata state."""
    row: Row = {}
    for field in batch.schema:
        value = batch[field.name][index]
        stated = (field.metadata or {}).get(b"shape")
        if stated is None or not value.is_valid:
            row[field.name] = value.as_py()
        else:
            row[field.name] = value.values.to_numpy().reshape(json.loads(stated))
    return row


@dataclass(frozen=True)
class PersonRow:
    """A body in a row, as the fit had it.

    Attributes:
        address: Address of the row.
        row: Values of all its columns.
        saved: EllipBody and camera.
    """

    address: Address
    row: Row
    saved: BodyFile

    @classmethod
    def of(cls, address: Address, row: Row, where: str) -> PersonRow | None:
        """The body of a row; None if it holds none.

        Raises:
            InputError: If numbers in it make no body.
        """
        if row["joints"] is None:
            return None
        size, perspective = np.array([row["height"], row["width"]]), np.array(int(row["camera_perspective"]))
        numbers = {name: np.asarray(row[name]) for name in (*BODY_ARRAYS, "camera_scale", "camera_translation")}
        data = {**numbers, "image_size": size, "camera_perspective": perspective}
        return cls(address, row, BodyFile.read(data, f"{where}, row {address}"))

    @property
    def posed(self) -> Posed:
        """EllipBody in the camera frame."""
        return pose(*(torch.from_numpy(getattr(self.saved, name))[None] for name in BODY_ARRAYS))

    def keypoints(self, form: str | Skeleton) -> Keypoints2D:
        """Keypoints of the person, of the data set's format."""
        numbers = self.row["keypoints"]
        return Keypoints2D(form, numbers[:, :2].copy(), numbers[:, 2].copy())

    @property
    def detailed(self) -> bool:
        """True if the row holds a detailed body, too."""
        return self.row.get("mesh_shape") is not None

    def registered(self, model: DetailedModel) -> Registered:
        """The detailed body in the camera frame.

        Raises:
            InputError: If it is of another model.
        """
        sizes = {
            "mesh_shape": (model.num_shapes,),
            "mesh_rotations": (model.num_joints, 3, 3),
            "mesh_translation": (3,),
        }
        tensors: list[torch.Tensor] = []
        for name, size in sizes.items():
            values = torch.from_numpy(self.row[name].copy())
            if values.shape != size:
                told = f"{tuple(values.shape)}; expected {size}, as {model.name}"
                raise InputError(f"row {self.address}: {name}: {told}: name the data set's model with --model")
            if name == "mesh_rotations" and (fault := rotation_fault(values)):
                raise InputError(f"row {self.address}: {name}: {fault}")
            tensors.append(values[None])
        shape, rotations, translation = tensors
        return ungrown(model, shape, rotations, translation, {})

    @property
    def clothes(self) -> torch.Tensor:
        """Thicknesses of clothes and hair of the detailed body [m], shape (1, 8)."""
        return torch.from_numpy(self.row["clothes"].copy())[None]
