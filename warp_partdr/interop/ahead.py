"""Items that are made ahead of time, on a thread of their own."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

from .torch_threads import one_torch_thread

_AHEAD = 2  # items that wait, at most

Item = TypeVar("Item")


def made_ahead(items: Iterable[Item]) -> Iterator[Item]:
    """Items in their order; the next ones are made while the caller works on one. Their errors are raised here."""
    iterator = iter(items)

    def following() -> list[Item]:
        with one_torch_thread():
            return list(islice(iterator, 1))

    with ThreadPoolExecutor(1, thread_name_prefix="ahead") as pool:
        coming: deque[Future[list[Item]]] = deque(pool.submit(following) for _ in range(_AHEAD))
        while item := coming.popleft().result():
            coming.append(pool.submit(following))
            yield item[0]
