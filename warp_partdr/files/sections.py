"""Dataclasses of numbers from TOML or JSON, with errors that name the key and what is expected."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from ..errors import InputError, shown

Section = TypeVar("Section")


def read_section(kind: type[Section], values: object, where: str = "") -> Section:
    """A dataclass from a mapping; keys left out keep their defaults.

    Args:
        kind: A dataclass. Its fields are bool, int, float, str, Path, Literal, Any, dataclasses, or tuples, dicts and
            unions of these.
        values: What TOML or JSON gave.
        where: The key that holds it, for messages.

    Raises:
        InputError: If a key is unknown, missing or of another type.
    """
    if not isinstance(values, Mapping):
        raise InputError(f"{where or 'config'}: {shown(values)}; expected a table")
    known = {field.name: field for field in fields(kind) if field.init}  # type: ignore[arg-type]
    for key in values:
        if key not in known:
            raise InputError(f"{_join(where, key)}: unknown; expected one of {', '.join(known) or 'no keys'}")
    for name, field in known.items():
        if name not in values and field.default is MISSING and field.default_factory is MISSING:
            raise InputError(f"{_join(where, name)}: missing; expected a value")
    hints = get_type_hints(kind)
    return kind(**{key: _read(hints[key], value, _join(where, key)) for key, value in values.items()})


def _read(kind: Any, value: Any, where: str) -> Any:
    origin, inner = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin in (Union, types.UnionType):
        return _read_union(inner, value, where)
    if is_dataclass(kind):
        return read_section(kind, value, where)  # type: ignore[arg-type]  # mypy takes it for an instance
    if origin is tuple and isinstance(value, list | tuple):
        if len(inner) == 2 and inner[1] is Ellipsis:
            inner = (inner[0],) * len(value)
        if len(inner) == len(value):
            return tuple(_read(*each, f"{where}[{index}]") for index, each in enumerate(zip(inner, value, strict=True)))
    elif origin is dict and isinstance(value, Mapping):
        return {key: _read(inner[1], each, _join(where, key)) for key, each in value.items()}
    elif origin is Literal and value in inner:
        return value
    elif kind is Path and isinstance(value, str | Path):
        return Path(value)
    elif kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    elif isinstance(kind, type) and type(value) is kind:
        return value
    raise InputError(f"{where}: {shown(value)}; expected {_name(kind)}")


def _read_union(kinds: tuple[Any, ...], value: Any, where: str) -> Any:
    if value is None and type(None) in kinds:
        return None
    *others, last = [kind for kind in kinds if kind is not type(None)]
    for kind in others:
        try:
            return _read(kind, value, where)
        except InputError:
            continue
    return _read(last, value, where)


def _join(where: str, key: object) -> str:
    return f"{where}.{key}" if where else str(key)


def _name(kind: Any) -> str:
    inner = get_args(kind)
    if get_origin(kind) is Literal:
        return " or ".join(map(repr, inner))
    if get_origin(kind) is tuple:
        return f"a list of {_name(inner[0])}" if inner[-1] is Ellipsis else f"[{', '.join(map(_name, inner))}]"
    names = {bool: "true or false", int: "a whole number", float: "a number", str: "a text", Path: "a path"}
    return names.get(kind, "a table" if get_origin(kind) is dict else str(kind))
