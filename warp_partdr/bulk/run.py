"""A run over a data set: pictures are decoded ahead, their people fitted, and shards written one after the other."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice

from ..errors import InputError
from .people import PeopleFitter, Read
from .rows import Column, people_table
from .shards import Shards, Tally
from .sources import PictureSource

_AHEAD = 4  # pictures a thread that are decoded before they are asked for


def make_dataset(
    source: PictureSource,
    shards: Shards,
    fitter: PeopleFitter,
    columns: Sequence[Column],
    *,
    todo: Sequence[int],
    threads: int = 2,
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
        told: Called with each picture's name.
        written: Called after each shard with its index and the numbers so far.

    Raises:
        InputError: If a shard can't be written.
    """
    tally = Tally()
    pool = ThreadPoolExecutor(threads, thread_name_prefix="decode")
    try:
        pictures = _read_ahead(source, (name for index in todo for name in shards.pictures(index)), pool, threads)
        for index in todo:
            count = len(shards.pictures(index))
            started = time.perf_counter()
            rows = fitter.rows(islice(pictures, count), told)
            about = shards.describe(index) | {"seconds": round(time.perf_counter() - started, 3)}
            table = people_table(rows, columns, about)
            shards.write(index, table)
            tally.add(count, table)
            if written is not None:
                written(index, tally)
    finally:
        pool.shutdown(cancel_futures=True)
    return tally


def _read_ahead(
    source: PictureSource, names: Iterator[str], pool: ThreadPoolExecutor, threads: int
) -> Iterator[tuple[str, Read]]:
    """Pictures in order, a few of them decoded ahead."""
    waiting: deque[tuple[str, Future[Read]]] = deque()
    while True:
        for name in islice(names, _AHEAD * threads - len(waiting)):
            waiting.append((name, pool.submit(_read, source, name)))
        if not waiting:
            return
        name, picture = waiting.popleft()
        yield name, picture.result()


def _read(source: PictureSource, name: str) -> Read:
    try:
        return source.read(name)
    except (InputError, OSError, ValueError, MemoryError) as error:
        return error
