"""Torch's threads: for small tensors, threads that wait for one another cost far more than they save.

On two busy cores, with one thread and with two: a fit 0.5 and 0.7 s, a registration 6 and 43 to 83 s, 32 bodies of the
label network 2 and 6 s.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import torch

_lock = threading.Lock()
_users = 0
_before = 0  # torch's threads when the first of the users came
_own = threading.local()


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Let torch's CPU operations take one thread within; as a decorator, during a call.

    Torch keeps a count for each thread of Python, and a new one takes over what was set last. So each sets and restores
    its own, and a 1 that it finds while others are within is theirs.
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
    """Let torch take as many threads as before, inside of ``one_torch_thread``: for large networks of others."""
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
