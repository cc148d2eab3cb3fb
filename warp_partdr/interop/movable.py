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
        return replace(self, **{name: _moved(value, str(device)) for name, value in given.items()})


def _moved(value: Any, device: str) -> Any:
    if isinstance(value, dict):
        return {name: _moved(each, device) for name, each in value.items()}
    return value.to(device) if hasattr(value, "to") else value
