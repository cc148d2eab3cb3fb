"""Mixin for all objects that hold arrays: copies on another device."""

from __future__ import annotations

from dataclasses import Field, fields, replace
from typing import Any, ClassVar, Self


class Movable:
    """Mixin for a dataclass of tensors, Warp arrays and other movable objects, alone or in a dictionary."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def to(self, device: Any) -> Self:
        """Copy to another device, such as "cpu" or "cuda:0"; what is there already is shared, not copied."""
        given = {field.name: getattr(self, field.name) for field in fields(self) if field.init}
        moved = {name: _moved(value, str(device)) for name, value in given.items()}
        return self if all(moved[name] is value for name, value in given.items()) else replace(self, **moved)


def _moved(value: Any, device: str) -> Any:
    if isinstance(value, dict):
        moved = {name: _moved(each, device) for name, each in value.items()}
        return value if all(moved[name] is each for name, each in value.items()) else moved
    return value.to(device) if hasattr(value, "to") else value
