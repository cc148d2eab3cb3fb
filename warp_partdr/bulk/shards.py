"""Shards of a data set: each a Parquet file that appears whole or not at all, and says what it was made of.

``part-00003-of-00010.parquet`` holds the people of the fourth N pictures. Its schema's metadata has the SHA-256 of
these pictures' names and of the options, so that a later run knows what is there, and needs no other file.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, cause
from ..files.disk import sync
from ..results.result_sets import scratch_folder
from .rows import FORMAT, METADATA
from .sources import COUNTED

if TYPE_CHECKING:
    import pyarrow as pa

TALLIED = ["picture", "error", "warnings", "camera_scale"]  # columns that a tally counts

_DIGITS = 5


@dataclass
class Tally:
    """Numbers of what a run wrote, of what failed, and of rows with a warning about their annotations."""

    shards: int = 0
    pictures: int = 0
    people: int = 0
    errors: int = 0
    first_error: str = ""
    annotations: int = 0
    first_annotation: str = ""

    def add(self, pictures: int, table: pa.Table) -> None:
        """Count a shard of so many pictures, by its columns ``TALLIED``."""
        faults = table.filter(table["error"].is_valid())
        self.shards += 1
        self.pictures += pictures
        self.people += table.num_rows - table["camera_scale"].null_count
        self.errors += faults.num_rows
        if faults.num_rows:
            name, error = (faults[column][0].as_py() for column in ("picture", "error"))
            self.first_error = self.first_error or (error if error.startswith(name) else f"{name}: {error}")
        for row, warnings in enumerate(table["warnings"].to_pylist()):
            told = [warning for warning in warnings or () if warning.startswith(COUNTED)]
            self.annotations += bool(told)
            if told and not self.first_annotation:
                self.first_annotation = f"{table['picture'][row].as_py()}: {told[0]}"


@dataclass(frozen=True)
class Shards:
    """Shards of a data set in a folder.

    Attributes:
        folder: Made when the first shard is written.
        names: Of all pictures, in order.
        size: Pictures of a shard; the last may have fewer.
        options: All that rows depend on beside the pictures, of what JSON takes.
        about: More to be stated, such as versions.
    """

    folder: Path
    names: Sequence[str]
    size: int
    options: Mapping[str, Any]
    about: Mapping[str, Any] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of shards."""
        return -(-len(self.names) // self.size)

    def pictures(self, index: int) -> Sequence[str]:
        """Names of a shard's pictures."""
        return self.names[index * self.size : (index + 1) * self.size]

    def path(self, index: int) -> Path:
        """A shard's file."""
        return self.folder / f"part-{index:0{_DIGITS}d}-of-{self.count:0{_DIGITS}d}.parquet"

    def describe(self, index: int) -> dict[str, Any]:
        """Metadata of a shard."""
        return {
            "format": FORMAT,
            **self.about,
            "options": dict(self.options),
            "options_sha256": digest(self.options),
            "shard": index,
            "shards": self.count,
            "pictures": len(self.pictures(index)),
            "pictures_sha256": digest(list(self.pictures(index))),
        }

    def done(self) -> set[int]:
        """Shards that are there.

        Raises:
            InputError: If some are there of other pictures or options, or can't be read.
        """
        mine = {self.path(index).name: index for index in range(self.count)}
        found = sorted(self.folder.glob("part-*.parquet"))
        for path in found:
            if path.name not in mine:
                told = f"{self.count} shards of {self.size} pictures"
                raise InputError(f"{path}: of another data set; expected {told} there, or another folder for them")
            self._check(path, mine[path.name])
        return {mine[path.name] for path in found}

    def _check(self, path: Path, index: int) -> None:
        known = read_about(path)
        own = self.describe(index)
        if known.get("options_sha256") != own["options_sha256"]:
            was, now = known.get("options") or {}, dict(self.options)
            name = next((each for each in (*now, *was) if was.get(each) != now.get(each)), "format")
            raise InputError(
                f"{path}: made with {name} {was.get(name)}, not {now.get(name)}; expected the same options, "
                "or another folder"
            )
        if known.get("pictures_sha256") != own["pictures_sha256"]:
            raise InputError(f"{path}: of other pictures; expected those of this run, or another folder")

    def write(self, index: int, table: pa.Table) -> None:
        """Write a shard's file, which is then on the disk and whole.

        Raises:
            InputError: If it can't be written; nothing of it is left.
        """
        import pyarrow.parquet as pq

        path = self.path(index)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with scratch_folder(self.folder) as scratch:
                new = scratch / path.name
                pq.write_table(table, new, compression="zstd")
                sync(new)
                new.replace(path)
            if os.name == "posix":  # elsewhere folders can't be opened
                sync(self.folder)
        except OSError as error:
            told = os.strerror(error.errno) if error.errno else cause(error)
            room = f"room for shard {index} of {self.count}: the same command goes on there"
            raise InputError(f"{self.folder}: {told}; expected {room}") from error

    def count_rows(self, index: int) -> Tally:
        """Numbers of a shard that is there."""
        import pyarrow.parquet as pq

        tally = Tally()
        table = pq.read_table(self.path(index), columns=TALLIED)
        tally.add(len(self.pictures(index)), table)
        return tally


def read_about(path: Path) -> dict[str, Any]:
    """Facts that a shard's file states about itself.

    Raises:
        InputError: If it is no such file.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        known = json.loads((pq.read_metadata(path).metadata or {})[METADATA])
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        raise InputError(f"{path}: no shard of partdr dataset; expected one, or another folder") from error
    return known if isinstance(known, dict) else {}


def digest(value: Any) -> str:
    """SHA-256 of what JSON takes, whatever the order of keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
