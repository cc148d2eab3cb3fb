"""The errors that wrong input raises, and how values are shown in them."""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from types import UnionType
from typing import get_args


class InputError(ValueError):
    """A file or an option that can't be used: one line that names it, what it was and what was expected.

    The command line prints it without a traceback and exits with code 2.
    """


_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = 60


def shown(value: object) -> str:
    """A value for a message: short, however long or deeply nested it is."""
    return " ".join(_REPR.repr(value).split())


def check_type(name: str, value: object, kind: type | UnionType, hint: str) -> None:
    """Raise TypeError unless an argument is of a type.

    Args:
        name: The argument's name.
        value: What the caller passed.
        kind: A class, or a union of classes and None.
        hint: Where one comes from, such as "of read_parts".
    """
    if not isinstance(value, kind):
        names = " or ".join(getattr(each, "__name__", str(each)) for each in get_args(kind) or (kind,))
        raise TypeError(f"{name}: {type(value).__name__}; expected {names.replace('NoneType', 'None')}, {hint}")


def check_each(name: str, values: object, kind: type, hint: str) -> None:
    """The same of each in a list or another sequence."""
    if not isinstance(values, Sequence) or isinstance(values, str | bytes):
        raise TypeError(f"{name}: {type(values).__name__}; expected a sequence of {kind.__name__}, {hint}")
    for index, value in enumerate(values):
        check_type(f"{name}[{index}]", value, kind, hint)
