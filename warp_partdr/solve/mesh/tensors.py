"""Dataclasses of tensors, whose values a captured graph copies from others of the same shapes."""

from __future__ import annotations

from dataclasses import replace
from typing import Self

import torch

from ...interop.movable import Movable


class NamedTensors(Movable):
    """Mixin for a dataclass whose fields are tensors, dataclasses with this mixin, or None."""

    def named(self) -> dict[str, torch.Tensor]:
        """Collect all tensors by their names; a name in an inner dataclass has that one's name and a dot before it."""
        found: dict[str, torch.Tensor] = {}
        for name, value in vars(self).items():
            if isinstance(value, NamedTensors):
                found |= {f"{name}.{own}": tensor for own, tensor in value.named().items()}
            elif value is not None:
                found[name] = value
        return found

    def tensors(self) -> list[torch.Tensor]:
        """List all tensors."""
        return list(self.named().values())

    def copied(self) -> Self:
        """Copy the dataclass with all its tensors."""
        copies: dict[str, torch.Tensor | NamedTensors] = {}
        for name, value in vars(self).items():
            if value is not None:
                copies[name] = value.copied() if isinstance(value, NamedTensors) else value.clone()
        return replace(self, **copies)
