"""Tables that are made once and kept on a device, such as indices: a captured graph keeps those that it reads.

A graph reads its tables at the same addresses at every replay. A cache of a limited size frees the table that was used
least recently, and the memory then holds other numbers. So what a cache returns while a graph is captured is kept for
as long as that graph.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache, wraps
from typing import Any, ParamSpec, TypeVar

import torch

_P = ParamSpec("_P")
_T = TypeVar("_T")

# Lists of the captures in progress. They belong to the process, because autograd calls functions in a thread of its
# own. What another thread asks for meanwhile is kept, too, which does no harm.
_captures: list[list[Any]] = []


def device_cache(maxsize: int | None, *, typed: bool = False) -> Callable[[Callable[_P, _T]], Callable[_P, _T]]:
    """Cache a function's values as ``lru_cache`` does, for functions that return tensors or arrays on a device.

    While ``torch.compile`` traces, the function itself is called: a trace would warn of the cache.

    Args:
        maxsize: Number of values that are kept; of more, the one that was used least recently is freed, unless a graph
            reads it. None: all.
        typed: True if arguments of different types are different, such as 1 and True.
    """

    def decorate(function: Callable[_P, _T]) -> Callable[_P, _T]:
        kept = lru_cache(maxsize, typed)(function)

        @wraps(function)
        def find(*args: _P.args, **kwargs: _P.kwargs) -> _T:
            if torch.compiler.is_compiling():
                return function(*args, **kwargs)
            value = kept(*args, **kwargs)  # type: ignore[arg-type]
            for capture in _captures:
                capture.append(value)
            return value

        return find

    return decorate


@contextmanager
def keeping_tables() -> Iterator[list[Any]]:
    """Collect what caches return within; a graph that is captured within must keep the list as long as itself."""
    found: list[Any] = []
    _captures.append(found)
    try:
        yield found
    finally:
        _captures[:] = [each for each in _captures if each is not found]
