"""Random arguments, some of which are wrong in one way or another."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from warp_partdr.body.rotations import rotation_from_axis_angle

SIZES = [(8, 8), (1, 1), (5, 12), (24, 16)]

_DTYPES = [
    *(torch.float64, torch.float16, torch.bfloat16),
    *(torch.int32, torch.int64, torch.uint8, torch.bool, torch.complex64),
]
_VALUES = [math.nan, math.inf, -math.inf, 0.0, -1.0, 1e-45, 1e-20, 1e9, 1e20, 3e38, 1e300]
_ODDITIES = [None, "a", [1.0], np.zeros(3)]
_JSON = [None, True, -1, 0, 1e400, 10**400, "x", [], {}, [[]], math.nan, "left_foot", 7.5, [1, 2, 3]]


class Chance:
    """Source of one case's arguments, on one device.

    Args:
        rng: The case's own.
        folder: For its files.
        device: Of its tensors.
    """

    def __init__(self, rng: np.random.Generator, folder: Path, device: str) -> None:
        self.rng, self.folder, self.device = rng, folder, device
        self.extreme = False  # if some tensor holds no number, 0, or what is near the end of float32
        # Most cases spoil something; where all is spoilt, only the first check is tested.
        self.rate = float(rng.choice([0.0, 0.1, 0.3]))

    def one(self, choices: Any) -> Any:
        """One of a sequence."""
        return choices[int(self.rng.integers(len(choices)))]

    def spoils(self) -> bool:
        """True if this argument is spoilt."""
        return bool(self.rng.random() < self.rate)

    def either(self, value: Any, *others: Any) -> Any:
        """The value, or one of the others."""
        return self.one(others) if self.spoils() else value

    def tensor(self, *shape: int, scale: float = 1.0, shift: float = 0.0) -> torch.Tensor:
        """Normal numbers."""
        return torch.from_numpy(self.rng.normal(shift, scale, shape)).float().to(self.device)

    def turns(self, *shape: int) -> torch.Tensor:
        """Rotation matrices."""
        return rotation_from_axis_angle(self.tensor(*shape, 3))

    def maybe(self, tensor: torch.Tensor) -> Any:
        """The tensor, or something made of it that may be wrong in any way."""
        if self.rng.random() < 0.2:
            tensor = tensor.clone().requires_grad_(tensor.is_floating_point())
        if not self.spoils():
            return tensor
        kind = self.rng.integers(12)
        if kind <= 3 and tensor.numel():
            values = tensor.detach().clone().flatten()
            count = min(int(self.rng.integers(1, 4)), values.numel())
            spots = torch.from_numpy(self.rng.integers(0, values.numel(), count)).to(values.device)
            value = self.one(_VALUES)
            self.extreme |= not 1e-18 < abs(value) < 1e18  # what is divided by next to nothing leaves float32, too
            if not values.is_floating_point():
                value = int(np.clip(np.nan_to_num(value), 0, 255))
            elif abs(value) > 1e38 and math.isfinite(value):
                values = values.double()
            values[spots] = value
            return values.view(tensor.shape)
        if kind == 4:
            scaled = tensor.detach() * float(10.0 ** self.rng.uniform(-12, 12))
            self.extreme |= not bool((scaled.abs() < 1e18).all())
            return scaled
        if kind == 5:
            cast = tensor.detach().to(self.one(_DTYPES))
            self.extreme |= not bool(torch.isfinite(cast).all())
            return cast
        if kind in (6, 7):
            return self._reshaped(tensor.detach())
        if kind == 8:
            return tensor.detach().to("meta")
        if kind == 9:
            return tensor.detach().transpose(0, -1).contiguous().transpose(0, -1) if tensor.dim() else tensor
        if kind == 10:
            return tensor.detach().to_sparse() if self.device == "cpu" else tensor
        return self.one(_ODDITIES)

    def _reshaped(self, tensor: torch.Tensor) -> torch.Tensor:
        if not tensor.dim() or not tensor.numel():
            return tensor.new_zeros(())
        axis = int(self.rng.integers(tensor.dim()))
        ways: list[Callable[[], torch.Tensor]] = [
            lambda: tensor.select(axis, 0),
            lambda: tensor.unsqueeze(axis),
            lambda: tensor.narrow(axis, 0, 0),
            lambda: tensor.narrow(axis, 0, max(tensor.shape[axis] - 1, 0)),
            lambda: torch.cat([tensor, tensor], axis),
            lambda: tensor.flatten(),
            lambda: tensor.transpose(0, -1),
            lambda: tensor.new_zeros(()),
        ]
        return self.one(ways)()

    def array(self, values: np.ndarray) -> Any:
        """The same for arrays."""
        tensor = self.maybe(torch.from_numpy(np.array(values)))
        if not isinstance(tensor, torch.Tensor) or tensor.is_meta or tensor.layout != torch.strided:
            return self.one(_ODDITIES)
        return tensor.detach().numpy() if tensor.dtype != torch.bfloat16 else tensor.detach().float().numpy()

    def number(self, value: Any, *others: Any) -> Any:
        """The number, or another one."""
        number = self.either(value, *others, math.nan, math.inf, -math.inf, 0, -1, 1e30, None, "a", 2.5)
        self.extreme |= number == 1e30  # two of them multiplied leave float32
        return number

    def size(self) -> Any:
        """A picture's size."""
        bad = [(0, 8), (8,), None, 8, (-1, 4), (2.0, 8), (2**20, 2**20), (2**14, 2**14), "ab", (8, 8, 8)]
        return self.one(bad) if self.spoils() else self.one(SIZES)

    def file(self, name: str, data: bytes) -> Path:
        """A file with these bytes, or damaged ones."""
        path = self.folder / name
        if self.spoils() and self.rng.random() < 0.1:
            return self.one([self.folder, self.folder / "missing" / name, path.with_suffix("")])
        path.write_bytes(self.damaged(data) if self.rng.random() < 0.6 else data)
        return path

    def damaged(self, data: bytes) -> bytes:
        """Bytes flipped, cut, repeated or made up."""
        values = bytearray(data)
        for _ in range(int(self.rng.integers(1, 4))):
            at = int(self.rng.integers(max(len(values), 1)))
            kind = int(self.rng.integers(6))
            if kind == 0:
                del values[at:]
            elif kind == 1:
                del values[at : at + int(self.rng.integers(1, 64))]
            elif kind == 2:
                values[at:at] = self.rng.integers(0, 256, int(self.rng.integers(1, 64))).astype(np.uint8).tobytes()
            elif kind == 3:
                values[at:at] = values[at : at + int(self.rng.integers(1, 256))]
            elif values:
                # In the beginning are headers.
                at = min(at, int(self.rng.integers(1, 256))) % len(values) if kind == 4 else at % len(values)
                values[at] = int(self.rng.integers(256))
        return bytes(values)

    def json(self, data: Any) -> Any:
        """Data with something in it replaced, wherever it is."""
        if self.rng.random() < 0.05 * self.rate:
            return self.one(_JSON)
        if isinstance(data, dict):
            return {
                self.one(["", "format", "x"]) if self.rng.random() < 0.03 else k: self.json(v) for k, v in data.items()
            }
        if isinstance(data, list):
            kept = [self.json(value) for value in data]
            return kept[: int(self.rng.integers(len(kept) + 1))] if self.rng.random() < 0.03 else kept
        return data
