"""Errors that wrong input raises, how values are shown in them, and checks that need neither torch nor Warp."""

from __future__ import annotations

import math
import operator
import re
import reprlib
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import UnionType
from typing import SupportsIndex, get_args

# Products of three such numbers, an area in pixels times a depth, stay within float32.
LARGEST = 1e12


class InputError(ValueError):
    """A file or an option that can't be used: one line that names it, what it was and what was expected.

    The command line prints it without a traceback and exits with code 2.

    Examples:
        >>> from warp_partdr import InputError, read_keypoints
        >>> try:
        ...     read_keypoints("missing.json")
        ... except InputError as error:
        ...     print(error)
        missing.json: No such file or directory; expected keypoints in JSON
    """


_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = 60


def shown(value: object) -> str:
    """A value for a message: short, however long or deeply nested it is."""
    return " ".join(_REPR.repr(value).split())


def cause(error: Exception) -> str:
    """An error's own message for another one: a line of at most 200 characters; of a file, what the system says."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(text.split())[:200]


def install_command(extra: str) -> str:
    """Command that installs the packages of one of this package's extras.

    It names these packages themselves, because warp-partdr is on no package index: ``pip install 'warp-partdr[film]'``
    would fail.

    Args:
        extra: Name in pyproject.toml, such as "film".

    Returns:
        A line for a shell, such as ``pip install 'av>=18'``.
    """
    from importlib.metadata import PackageNotFoundError, requires  # slow to import

    wanted = f"extra == '{extra}'"
    try:
        stated = requires("warp-partdr") or []
    except PackageNotFoundError:
        stated = []
    packages = [line.partition(";")[0].strip() for line in stated if line.replace('"', "'").endswith(wanted)]
    if not packages:  # it runs from its folder, without an installation of this version
        return f"pip install '.[{extra}]' in the folder of warp-partdr"
    return f"pip install {' '.join(map(shlex.quote, packages))}"


# Control characters, line separators and halves of characters, which are no text. Python reads a byte of a file's name
# that is not UTF-8 as one of U+DC80 to U+DCFF.
_UNPRINTABLE = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")


def printable(text: str) -> str:
    r"""A text, such as a file's name, in one line of valid Unicode: other characters become ``\xff`` or ``\u2028``."""
    return _UNPRINTABLE.sub(_escaped, text)


def _escaped(found: re.Match[str]) -> str:
    code = ord(found[0])
    if 0xDC80 <= code <= 0xDCFF:
        code -= 0xDC00
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"


@contextmanager
def told_as(name: str, file: object) -> Iterator[None]:
    """Let an InputError about an argument name the file that the argument was read from."""
    try:
        yield
    except InputError as error:
        if not str(error).startswith(f"{name}: "):
            raise
        raise InputError(f"{file}{str(error).removeprefix(name)}") from error


@contextmanager
def told_of(file: object) -> Iterator[None]:
    """Let every InputError name the file whose contents are looked at, once."""
    try:
        yield
    except InputError as error:
        if str(error).startswith(f"{file}: "):
            raise
        raise InputError(f"{file}: {error}") from error


def check_type(name: str, value: object, kind: type | UnionType, hint: str) -> None:
    """Raise TypeError unless an argument is of a type.

    Args:
        name: The argument's name.
        value: Value that the caller passed.
        kind: A class, or a union of classes and None.
        hint: Hint at where such a value comes from, such as "of read_parts".
    """
    if not isinstance(value, kind):
        names = " or ".join(getattr(each, "__name__", str(each)) for each in get_args(kind) or (kind,))
        raise TypeError(f"{name}: {type(value).__name__}; expected {names.replace('NoneType', 'None')}, {hint}")


def check_each(name: str, values: object, kind: type, hint: str) -> None:
    """Raise TypeError unless an argument is a list or another sequence, and each item is of a type.

    The arguments are those of ``check_type``; an item's error names its index.
    """
    if not isinstance(values, Sequence) or isinstance(values, str | bytes):
        raise TypeError(f"{name}: {type(values).__name__}; expected a sequence of {kind.__name__}, {hint}")
    for index, value in enumerate(values):
        check_type(f"{name}[{index}]", value, kind, hint)


def check_whole(name: str, value: SupportsIndex, low: int, high: float = math.inf) -> int:
    """An integer of any type, such as ``numpy.int64``, as an ``int``; True and False are none.

    Args:
        name: The argument's name, for the message.
        value: Value that the caller passed.
        low: Least that it may be.
        high: Most that it may be.

    Raises:
        ValueError: If it is no integer, or out of range.
    """
    try:
        number = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = None
    if number is None or not low <= number <= high:
        expected = f"an integer from {low} to {high}" if high < math.inf else f"an integer of {low} or more"
        raise ValueError(f"{name}: {value!r}; expected {expected}")
    return number
