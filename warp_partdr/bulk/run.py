"""A run over a data set: while a shard's last people are fitted, the next one's pictures are read, and rows written."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

from ..errors import printable
from .batches import group_rows, people_pool
from .cutting import Held, Read, read_picture
from .people import PeopleFitter
from .processes import needed_memory, read_in_processes, shared_memory
from .rows import UNREAD, Column, PeopleRows, metadata, people_table
from .rows import columns as people_columns
from .shards import Shards, Tally
from .sources import PictureSource

_AHEAD = 4  # pictures a thread that are decoded before they are asked for


def make_dataset(
    source: PictureSource,
    shards: Shards,
    fitter: PeopleFitter,
    columns: Sequence[Column] | None = None,
    *,
    todo: Sequence[int] | None = None,
    threads: int = 2,
    processes: int = 0,
    told: Callable[[str], None] | None = None,
    written: Callable[[int, Tally], None] | None = None,
) -> Tally:
    """Make shards of a data set.

    Killed at any time, it leaves whole shards alone; what was in work is made again by a later call.

    Args:
        source: Source of the pictures, such as ``open_source`` finds.
        shards: Shards of ``source.names``, in a folder.
        fitter: Object that finds and fits the people.
        columns: Columns of the rows, with keypoints in the format of ``fitter.cutter``. By default, they are all that
            the fitter makes, with keypoints in the format of ``source``.
        todo: Indices of the shards to make. By default, they are all that are not whole in the folder. Pictures that
            could not be read before are read again.
        threads: Number of threads that decode pictures while people are fitted.
        processes: Number of processes that decode pictures instead, and cut out the people who are known.
        told: Function that is called with each picture's name.
        written: Function that is called after each shard with its index and the numbers so far.

    Raises:
        InputError: If a shard can't be written.

    Examples:
        >>> from pathlib import Path
        >>> from warp_partdr import FitOptions, PeopleFitter, Shards, load_label_network, make_dataset, open_source
        >>> source = open_source(Path("pictures"))
        >>> shards = Shards(Path("dataset"), source.names, size=100, options={"quality": "fast"})
        >>> tally = make_dataset(source, shards, PeopleFitter(FitOptions.at("fast"), load_label_network()))
        >>> tally.people, shards.path(0).name
        (1, 'part-00000-of-00001.parquet')
    """
    if columns is None:
        fitter = replace(fitter, cutter=replace(fitter.cutter, skeleton=source.skeleton))
        columns = people_columns(source.skeleton, fitter.model)
    if todo is None:
        whole = {index for index, unread in shards.there().items() if not unread}
        todo = [index for index in range(shards.count) if index not in whole]
    tally = Tally()
    pool = ThreadPoolExecutor(threads, thread_name_prefix="decode")
    writer = ThreadPoolExecutor(1, thread_name_prefix="write")
    left = {index: shards.left(index) for index in todo}
    writing: deque[tuple[int, Future[None]]] = deque()
    began = time.perf_counter()

    def settle() -> None:
        """Wait for the shard that is being written."""
        while writing:
            index, work = writing.popleft()
            work.result()
            if written is not None:
                written(index, tally)

    try:
        if processes:
            taken = read_in_processes(source, fitter.cutter, [left[index] for index in todo], processes)
        else:
            pictures = _read_ahead(source, (name for index in todo for name in left[index]), pool, threads)
            taken = (islice(pictures, len(left[index])) for index in todo)
        with people_pool(fitter) as workers:
            for index, rows in zip(todo, group_rows(fitter, workers, taken, told), strict=True):
                before, began = began, time.perf_counter()
                settle()
                shard = _Shard(shards, index, left[index], columns, round(began - before, 3))
                writing.append((index, writer.submit(shard.write, rows, tally)))
        settle()
    finally:
        for threads_of in (pool, writer):
            threads_of.shutdown(cancel_futures=True)
    return tally


@dataclass(frozen=True)
class _Shard:
    """A shard to be written: the names of the pictures that were read for it, and the seconds that this took."""

    shards: Shards
    index: int
    read: Sequence[str]
    columns: Sequence[Column]
    seconds: float

    def write(self, rows: PeopleRows, tally: Tally) -> None:
        """Write the rows, with those that are there, and count them."""
        table = people_table(rows, self.columns, {})
        again = {table["picture"][row].as_py() for row in rows.unread()}
        indices = [index for index, name in enumerate(self.shards.pictures(self.index)) if printable(name) in again]
        about = self.shards.describe(self.index) | {"seconds": self.seconds + self.shards.seconds(self.index)}
        if indices:
            about[UNREAD] = indices
        table = table.replace_schema_metadata(metadata(about))
        whole = self.shards.completed(self.index, table, self.read)
        self.shards.write(self.index, whole)
        tally.add(len(self.read), table, len(indices), whole)


class Readers(NamedTuple):
    """Numbers of threads and of processes that read pictures."""

    threads: int
    processes: int


def source_readers(source: PictureSource, fitter: PeopleFitter, cores: int) -> Readers:
    """Threads and processes of ``make_dataset`` on so many cores.

    A GPU waits for pictures: where people are known, processes cut them out. Pictures in which they have to be found
    stay in one process, for they are large; all do where little memory may be shared, as in containers by default.
    """
    needed = needed_memory(cores, fitter.batch, fitter.cutter.label_size)
    apart = fitter.device != "cpu" and source.digest is not None and shared_memory() >= needed
    return Readers(cores, cores if apart else 0)


def _read_ahead(source: PictureSource, names: Iterator[str], pool: ThreadPoolExecutor, threads: int) -> Iterator[Held]:
    """Pictures in order, a few of them decoded ahead."""
    waiting: deque[tuple[str, Future[Read]]] = deque()
    while True:
        for name in islice(names, _AHEAD * threads - len(waiting)):
            waiting.append((name, pool.submit(read_picture, source, name)))
        if not waiting:
            return
        name, picture = waiting.popleft()
        yield name, picture.result()
