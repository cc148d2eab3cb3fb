"""Dataclasses of tensors that a captured graph takes anew."""

from __future__ import annotations

from dataclasses import replace
from typing import Self

import torch

from ...interop.movable import Movable


class NamedTensors(Movable):
    """Mixin for a dataclass of tensors, others of these, or None: starts, which a captured graph copies from others."""

    def named(self) -> dict[str, torch.Tensor]:
        """All that are there, by their names."""
        found: dict[str, torch.Tensor] = {}
        for name, value in vars(self).items():
            if isinstance(value, NamedTensors):
                found |= {f"{name}.{own}": tensor for own, tensor in value.named().items()}
            elif value is not None:
                found[name] = value
        return found

    def tensors(self) -> list[torch.Tensor]:
        """All that are there."""
        return list(self.named().values())

    def copied(self) -> Self:
        """Copies of all tensors."""
        copies: dict[str, torch.Tensor | NamedTensors] = {}
        for name, value in vars(self).items():
            if value is not None:
                copies[name] = value.copied() if isinstance(value, NamedTensors) else value.clone()
        return replace(self, **copies)
