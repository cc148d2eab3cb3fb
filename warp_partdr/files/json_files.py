"""JSON files: those of users are read so that nothing in them is lost silently, and numbers are rounded for others."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from .disk import check_regular

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def read_json(path: str | Path, expected: str) -> Any:
    """Read a JSON file; ``expected`` says in messages what it should be.

    Raises:
        InputError: If it can't be read, or as ``parse_json``.
    """
    try:
        check_regular(path)
        text = Path(path).read_text(encoding="utf-8-sig")  # some programs of Windows begin with a byte order mark
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; expected {expected}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not JSON ({error}); expected {expected}") from error
    return parse_json(text, str(path), expected)


def parse_json(text: str, where: str, expected: str) -> Any:
    """Parse JSON text, refusing keys that stand twice. Messages name the text and what is expected.

    Raises:
        InputError: If it is no JSON, is nested too deeply, or an object in it has a key twice.
    """

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise InputError(f"{where}: key {twice!r} twice in one object; expected {expected}")
        return found

    try:
        return json.loads(text, object_pairs_hook=unique)
    except InputError:
        raise
    except RecursionError:
        raise InputError(f"{where}: not JSON (nested too deeply); expected {expected}") from None
    except ValueError as error:
        raise InputError(f"{where}: not JSON ({error}); expected {expected}") from error


def rounded(values: ArrayLike, digits: int) -> Any:
    """Round numbers for a JSON file, and return them as lists of floats, or one number as a float.

    Numbers of float32 are made float64 first, or 0.1 would be written as 0.10000000149011612.
    """
    return np.asarray(values, dtype=np.float64).round(digits).tolist()
