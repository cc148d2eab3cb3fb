"""Torch's threads. For small tensors, threads that wait for one another cost far more than they save.

On two busy cores:

| | one thread | two threads |
|---|---|---|
| a fit | 0.5 s | 0.7 s |
| a registration | 6 s | 43 to 83 s |
| 32 bodies of the label network | 2 s | 6 s |
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import torch

_lock = threading.Lock()
_users = 0
_before = 0  # number of torch's threads when the first user entered
_own = threading.local()


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Let torch's CPU operations take one thread within; as a decorator, during a call.

    Torch keeps a number for each thread of Python, and a new thread takes the number that was set last. So each thread
    sets and restores its own number. If it finds 1 while other threads are within, that 1 is theirs.
    """
    global _users, _before
    if getattr(_own, "within", False):
        yield
        return
    with _lock:
        count = torch.get_num_threads()
        if _users == 0:
            _before = count
        elif count == 1:
            count = _before
        _users += 1
        torch.set_num_threads(1)
    _own.within = True
    try:
        yield
    finally:
        _own.within = False
        with _lock:
            _users -= 1
            torch.set_num_threads(count)


@contextmanager
def all_torch_threads() -> Iterator[None]:
    """Let torch take as many threads as before, inside of ``one_torch_thread``: for other projects' large networks."""
    if not getattr(_own, "within", False):
        yield
        return
    _own.within = False
    with _lock:
        torch.set_num_threads(_before)
    try:
        yield
    finally:
        _own.within = True
        with _lock:
            torch.set_num_threads(1)
