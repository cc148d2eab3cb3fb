"""Shards of a data set: each a Parquet file that appears whole or not at all, and says what it was made of.

``part-00003-of-00010.parquet`` holds the people of the fourth N pictures. Its schema's metadata has the SHA-256 of
these pictures' names and of the options, so that a later run knows what is there, and needs no other file. It also
numbers the pictures that a passing fault, such as of the disk, kept from being read: a later run reads these again.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, cause, printable
from ..files.disk import sync
from ..results.result_sets import scratch_folder
from .rows import FORMAT, METADATA, UNREAD
from .sources import COUNTED

if TYPE_CHECKING:
    import pyarrow as pa

TALLIED = ["picture", "error", "warnings", "camera_scale"]  # columns that a tally counts

_DIGITS = 5


@dataclass
class Tally:
    """Numbers of what a run wrote, and of what failed.

    Attributes:
        shards: Number of shards that were made, or made whole.
        pictures: Number of pictures that the run tried.
        people: Number of bodies in their rows.
        errors: Number of their rows with an error.
        unread: Number of pictures that another run reads again.
        rows: Number of rows in the whole shards, also of pictures that an earlier run read.
        failures: Number of these rows with an error.
        first_error: Error of the first row that has one, with its picture's name.
        annotations: Number of rows with a warning about their annotations.
        first_annotation: First such warning, with its picture's name.
    """

    shards: int = 0
    pictures: int = 0
    people: int = 0
    errors: int = 0
    unread: int = 0
    rows: int = 0
    failures: int = 0
    first_error: str = ""
    annotations: int = 0
    first_annotation: str = ""

    @property
    def failed(self) -> bool:
        """True if more than half of the shards' rows have an error."""
        return 2 * self.failures > self.rows

    def add(self, pictures: int, table: pa.Table, unread: int, whole: pa.Table) -> None:
        """Count a shard.

        Args:
            pictures: Number of pictures that were read.
            table: Rows of these pictures, with the columns ``TALLIED``.
            unread: Number of pictures that another run is to read again.
            whole: Rows of the whole shard.
        """
        faults = table.filter(table["error"].is_valid())
        self.shards += 1
        self.pictures += pictures
        self.people += table.num_rows - table["camera_scale"].null_count
        self.errors += faults.num_rows
        self.unread += unread
        self.rows += whole.num_rows
        self.failures += whole.num_rows - whole["error"].null_count
        if faults.num_rows:
            name, error = (faults[column][0].as_py() for column in ("picture", "error"))
            self.first_error = self.first_error or (error if error.startswith(name) else f"{name}: {error}")
        for row, warnings in enumerate(table["warnings"].to_pylist()):
            counted = [warning for warning in warnings or () if warning.startswith(COUNTED)]
            self.annotations += bool(counted)
            if counted and not self.first_annotation:
                self.first_annotation = f"{table['picture'][row].as_py()}: {counted[0]}"


@dataclass(frozen=True)
class Shards:
    """Shards of a data set in a folder.

    Attributes:
        folder: Folder of the data set. It is made when the first shard is written.
        names: Names of all pictures, in order.
        size: Number of pictures in a shard. The last may have fewer.
        options: Options that rows depend on, in addition to the pictures, as values that JSON takes.
        about: Further facts to be stated, such as versions.

    Examples:
        >>> from pathlib import Path
        >>> from warp_partdr import Shards
        >>> names = [f"{number}.jpg" for number in range(250)]
        >>> shards = Shards(Path("people"), names, size=100, options={"quality": "fast"})
        >>> shards.count, shards.pictures(2)[-1]
        (3, '249.jpg')
        >>> shards.path(0).name, shards.done()
        ('part-00000-of-00003.parquet', set())
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

    def left(self, index: int) -> Sequence[str]:
        """Names of a shard's pictures that are to be read yet: all, or those that could not be read before.

        Raises:
            InputError: If the shard is there, but of other pictures or options, or can't be read.
        """
        if not self.path(index).exists():
            return self.pictures(index)
        unread = set(self._unread(self.path(index), index))
        return [name for number, name in enumerate(self.pictures(index)) if number in unread]

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

    def there(self) -> dict[int, int]:
        """Shards that are there, each with the number of its pictures that are to be read again.

        Raises:
            InputError: If some are there of other pictures or options, or can't be read.
        """
        mine = {self.path(index).name: index for index in range(self.count)}
        found = sorted(self.folder.glob("part-*.parquet"))
        for path in found:
            if path.name not in mine:
                expected = f"{self.count} shards of {self.size} pictures"
                raise InputError(f"{path}: of another data set; expected {expected} there, or another folder for them")
        return {mine[path.name]: len(self._unread(path, mine[path.name])) for path in found}

    def done(self) -> set[int]:
        """Shards that are there and need no other run; raises as ``there``."""
        return {index for index, unread in self.there().items() if not unread}

    def _unread(self, path: Path, index: int) -> list[int]:
        """Numbers of a shard's pictures that are to be read again; checks that it is of this data set."""
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
        return list(known.get(UNREAD, ()))

    def write(self, index: int, table: pa.Table) -> None:
        """Write a shard's file, which is then on the disk and whole.

        Raises:
            InputError: If it can't be written; nothing of it is left, and an earlier file stays.
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
            reason = os.strerror(error.errno) if error.errno else cause(error)
            room = f"room for shard {index} of {self.count}: the same command goes on there"
            raise InputError(f"{self.folder}: {reason}; expected {room}") from error

    def completed(self, index: int, table: pa.Table, read: Sequence[str]) -> pa.Table:
        """Rows of a shard after some of its pictures were read, and those of the other pictures in its file.

        Raises:
            InputError: If its file can't be read.
        """
        if len(read) == len(self.pictures(index)):
            return table
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = self.path(index)
        places = {printable(name): number for number, name in enumerate(self.pictures(index))}
        again = {printable(name) for name in read}
        try:
            old = pq.read_table(path)
        except (OSError, pa.ArrowException) as error:
            raise InputError(f"{path}: {cause(error)}; expected a whole shard") from error
        kept = old.filter(pa.array([name not in again for name in old["picture"].to_pylist()], pa.bool_()))
        rows = pa.concat_tables([kept.replace_schema_metadata(table.schema.metadata), table])
        order = sorted(range(rows.num_rows), key=[places[name] for name in rows["picture"].to_pylist()].__getitem__)
        return rows.take(pa.array(order, pa.int64()))

    def seconds(self, index: int) -> float:
        """Seconds that former runs took for a shard."""
        path = self.path(index)
        return float(read_about(path).get("seconds", 0.0)) if path.exists() else 0.0

    def count_rows(self, index: int) -> Tally:
        """Numbers of a shard that is there."""
        import pyarrow.parquet as pq

        tally = Tally()
        table = pq.read_table(self.path(index), columns=TALLIED)
        tally.add(len(self.pictures(index)), table, len(self._unread(self.path(index), index)), table)
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
