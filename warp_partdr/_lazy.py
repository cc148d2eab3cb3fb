"""Public names that are fetched from their modules when they are first used (PEP 562)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_names(face: str, exports: Mapping[str, str]) -> Callable[[str], object]:
    """Make the ``__getattr__`` of a public module.

    Args:
        face: Full name of the public module.
        exports: The module that defines each public name, relative to ``warp_partdr``.
    """

    def fetch(name: str) -> object:
        """Fetch a public name from its module, once."""
        if name not in exports:
            raise AttributeError(f"module {face!r} has no attribute {name!r}")
        begins = "warp" not in sys.modules
        value = getattr(import_module(f"{__package__}.{exports[name]}"), name)
        setattr(sys.modules[face], name, value)
        if begins and "warp" in sys.modules:  # a program that imports Warp itself decides what Warp tells
            import_module(f"{__package__}.kernels.messages").quieten()
        return value

    return fetch
