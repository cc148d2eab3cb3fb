"""Dataclasses of settings from TOML, JSON and ``--set``, with errors that name the key and what is expected."""

from __future__ import annotations

import tomllib
import types
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from ..errors import InputError, shown
from .disk import check_regular

Section = TypeVar("Section")


def read_toml(path: Path | Traversable, name: str, expected: str) -> dict[str, Any]:
    """Read the tables of a TOML file; messages have its name and what is expected.

    Raises:
        InputError: If it can't be read, or is no TOML.
    """
    try:
        if isinstance(path, Path):
            check_regular(path)
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(f"{name}: {error.strerror or error}; expected {expected}") from error
    except (ValueError, RecursionError) as error:  # TOMLDecodeError and UnicodeDecodeError are ValueErrors
        raise InputError(f"{name}: {error}; expected TOML") from error


def set_value(values: dict[str, Any], override: str) -> str:
    """Set one value in nested tables, in place, and return its key; tables that are missing are made.

    The value of ``key=value`` is as in TOML, a text without quotes too; ``table.key`` reaches into a table.

    Raises:
        InputError: If it is no ``key=value``, or reaches into what is no table.
    """
    key, equals, text = override.partition("=")
    *tables, last = (name.strip() for name in key.split("."))
    if not equals or not last:
        raise InputError(f"--set: {override}; expected key=value")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError):
        value = text.strip()
    for name in tables:
        table = values.setdefault(name, {})
        if not isinstance(table, dict):
            raise InputError(f"--set: {override}: {name} is no table; expected one of the config's keys")
        values = table
    values[last] = value
    return key.strip()


def read_section(kind: type[Section], values: object, where: str = "", base: Section | None = None) -> Section:
    """Make a dataclass from a mapping; keys left out keep their values in ``base``, or their defaults.

    Args:
        kind: A dataclass. Its fields are bool, int, float, str, Path, Literal, Any, dataclasses, or tuples, dicts and
            unions of these.
        values: Value that was parsed from TOML or JSON.
        where: Key that holds the value, for messages.
        base: Dataclass to change. Tables change the dataclasses within it. If it is None, a new one is made.

    Raises:
        InputError: If a key is unknown or missing, or its value of another type or out of range.
    """
    if not isinstance(values, Mapping):
        raise InputError(f"{where or 'config'}: {shown(values)}; expected a table")
    known = {field.name: field for field in fields(kind) if field.init}  # type: ignore[arg-type]
    check_keys(values, known, where)
    for name, field in known.items():
        if base is None and name not in values and field.default is MISSING and field.default_factory is MISSING:
            raise InputError(f"{_join(where, name)}: missing; expected a value")
    hints, read = get_type_hints(kind), {}
    for key, value in values.items():
        now, place = getattr(base, key, None), _join(where, key)
        inside = is_dataclass(now) and isinstance(value, Mapping)
        read[key] = read_section(type(now), value, place, now) if inside else _read(hints[key], value, place)
    try:
        return kind(**read) if base is None else replace(base, **read)  # type: ignore[type-var]
    except InputError:
        raise
    except ValueError as error:  # of the dataclass's own check
        raise InputError(_join(where, error)) from error


def check_keys(values: Mapping[str, Any], known: Iterable[str], where: str = "") -> None:
    """Raise an InputError that names the first unknown key, and the known ones."""
    for key in values:
        if key not in known:
            raise InputError(f"{_join(where, key)}: unknown; expected one of {', '.join(known) or 'no keys'}")


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
    texts = str in kinds or Path in kinds  # of which "none" may be one
    if type(None) in kinds and (value is None or (value == "none" and not texts)):  # TOML has no null
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
