"""Mixin for objects that hold arrays: it copies them to another device."""

from __future__ import annotations

from dataclasses import Field, fields, replace
from typing import Any, ClassVar, Self


class Movable:
    """Mixin for a dataclass with tensors, Warp arrays and other movable objects, alone or in a dictionary."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def to(self, device: Any) -> Self:
        """Copy to a device, such as "cpu" or "cuda:0". Arrays that are on it already are shared, not copied."""
        given = {field.name: getattr(self, field.name) for field in fields(self) if field.init}
        copied = {name: _copied(value, str(device)) for name, value in given.items()}
        return self if all(copied[name] is value for name, value in given.items()) else replace(self, **copied)


def _copied(value: Any, device: str) -> Any:
    if isinstance(value, dict):
        copied = {name: _copied(each, device) for name, each in value.items()}
        return value if all(copied[name] is each for name, each in value.items()) else copied
    return value.to(device) if hasattr(value, "to") else value
