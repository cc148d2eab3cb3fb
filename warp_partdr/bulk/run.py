"""A run over a data set: while a shard's last people are fitted, the next one's pictures are read, and rows written."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TYPE_CHECKING, Any

from .cutting import Held, Read, read_picture
from .people import PeopleFitter
from .processes import needed_memory, read_in_processes, shared_memory
from .rows import Column, PeopleRows, people_table
from .shards import Shards, Tally
from .sources import PictureSource

if TYPE_CHECKING:
    import pyarrow as pa

_AHEAD = 4  # pictures a thread that are decoded before they are asked for


def make_dataset(
    source: PictureSource,
    shards: Shards,
    fitter: PeopleFitter,
    columns: Sequence[Column],
    *,
    todo: Sequence[int],
    threads: int = 2,
    processes: int = 0,
    told: Callable[[str], None] | None = None,
    written: Callable[[int, Tally], None] | None = None,
) -> Tally:
    """Make shards of a data set.

    Killed at any time, it leaves whole shards alone; what was in work is made again by a later call.

    Args:
        source: Of the pictures.
        shards: Of ``source.names``.
        fitter: Of the people.
        columns: Of the rows.
        todo: The shards to make, such as all but ``shards.done()``.
        threads: Threads that decode pictures while people are fitted.
        processes: Instead, so many processes that cut out those who are known, too.
        told: Called with each picture's name.
        written: Called after each shard with its index and the numbers so far.

    Raises:
        InputError: If a shard can't be written.
    """
    tally = Tally()
    pool = ThreadPoolExecutor(threads, thread_name_prefix="decode")
    workers = ThreadPoolExecutor(fitter.workers, thread_name_prefix="people")
    writer = ThreadPoolExecutor(1, thread_name_prefix="write")
    fitting: deque[tuple[int, Callable[[], PeopleRows]]] = deque()
    writing: deque[tuple[int, Future[pa.Table]]] = deque()
    began = time.perf_counter()

    def settle() -> None:
        """Wait for the shard that is being written."""
        while writing:
            index, work = writing.popleft()
            tally.add(len(shards.pictures(index)), work.result())
            if written is not None:
                written(index, tally)

    def collect(ahead: int) -> None:
        """Write shards, but for so many that may still be fitted."""
        nonlocal began
        while len(fitting) > ahead:
            index, finish = fitting.popleft()
            rows, before, began = finish(), began, time.perf_counter()
            about = shards.describe(index) | {"seconds": round(began - before, 3)}
            settle()
            writing.append((index, writer.submit(_write, shards, index, rows, columns, about)))

    try:
        if processes:
            taken = read_in_processes(source, fitter.cutter, [shards.pictures(index) for index in todo], processes)
        else:
            pictures = _read_ahead(source, (name for index in todo for name in shards.pictures(index)), pool, threads)
            taken = (islice(pictures, len(shards.pictures(index))) for index in todo)
        for index, each in zip(todo, taken, strict=True):
            fitting.append((index, fitter.begin(workers, each, told)))
            collect(1)
        collect(0)
        settle()
    finally:
        for threads_of in (pool, workers, writer):
            threads_of.shutdown(cancel_futures=True)
    return tally


def _write(
    shards: Shards, index: int, rows: PeopleRows, columns: Sequence[Column], about: Mapping[str, Any]
) -> pa.Table:
    table = people_table(rows, columns, about)
    shards.write(index, table)
    return table


def source_readers(source: PictureSource, fitter: PeopleFitter, cores: int) -> dict[str, int]:
    """Threads and processes of ``make_dataset`` on so many cores.

    A GPU waits for pictures: where people are known, processes cut them out. Pictures in which they have to be found
    stay in one process, for they are large; all do where little memory may be shared, as in containers by default.
    """
    needed = needed_memory(cores, fitter.batch, fitter.cutter.label_size)
    apart = fitter.device != "cpu" and source.digest is not None and shared_memory() >= needed
    return {"threads": cores, "processes": cores if apart else 0}


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
