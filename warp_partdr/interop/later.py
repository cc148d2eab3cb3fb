"""Images that are drawn when they are first read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import Field
from typing import Any, ClassVar


class DrawnLater:
    """Mixin for a frozen dataclass of images: all of them are drawn when one is first read.

    Args:
        draw: Gives the fields by name.
    """

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def __init__(self, draw: Callable[[], Mapping[str, Any]]) -> None:
        self.__dict__["_draw"] = draw

    def __getattr__(self, name: str) -> Any:  # Python asks here for what it has not found
        if name not in self.__dataclass_fields__:
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        self.__dict__.update(self._draw())
        return self.__dict__[name]
