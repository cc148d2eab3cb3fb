"""The error that a user's input raises, and how values are shown in it."""

from __future__ import annotations

import reprlib


class InputError(ValueError):
    """A file or an option that can't be used: one line that names it, what it was and what was expected.

    The command line prints it without a traceback and exits with code 2.
    """


_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = 60


def shown(value: object) -> str:
    """A value for a message: short, however long or deeply nested it is."""
    return " ".join(_REPR.repr(value).split())
