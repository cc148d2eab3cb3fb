"""The error that a user's input raises."""

from __future__ import annotations


class InputError(ValueError):
    """A file or an option that can't be used: one line that names it, what it was and what was expected.

    The command line prints it without a traceback and exits with code 2.
    """
