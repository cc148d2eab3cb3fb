"""Items that are made ahead."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
import torch

from warp_partdr.interop.ahead import made_ahead


def test_items_keep_their_order() -> None:
    assert list(made_ahead(range(20))) == list(range(20))
    assert list(made_ahead([])) == []
    assert list(made_ahead([None, 0, False])) == [None, 0, False]


def test_items_are_made_on_another_thread_and_few_wait() -> None:
    made: list[int] = []
    threads: set[int] = set()

    def numbers() -> Iterator[int]:
        for number in range(20):
            threads.add(threading.get_ident())
            assert torch.get_num_threads() == 1
            made.append(number)
            yield number

    for number in made_ahead(numbers()):
        assert len(made) <= number + 4  # this one, two that wait, and one in work
    assert made == list(range(20))
    assert threads - {threading.get_ident()}
    assert len(threads) == 1


def test_faults_come_where_they_are() -> None:
    def numbers() -> Iterator[int]:
        yield 1
        raise ValueError("broken")

    items = made_ahead(numbers())
    assert next(items) == 1
    with pytest.raises(ValueError, match="broken"):
        next(items)


def test_whoever_stops_early_ends_the_work() -> None:
    closed = threading.Event()

    def numbers() -> Iterator[int]:
        try:
            yield from range(1000)
        finally:
            closed.set()

    items = made_ahead(numbers())
    assert next(items) == 0
    items.close()  # type: ignore[attr-defined]
    del items
    assert closed.is_set()
    assert all(not thread.name.startswith("ahead") for thread in threading.enumerate())
