"""Arguments of one case, some of which are wrong in one way or another."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hypothesis import strategies as st

from warp_partdr.body.rotations import rotation_from_axis_angle

SIZES = [(8, 8), (1, 1), (5, 12), (24, 16)]
_BAD_SIZES = [(0, 8), (8,), None, 8, (-1, 4), (2.0, 8), (2**20, 2**20), (2**14, 2**14), "ab", (8, 8, 8)]
_DTYPES = [torch.float64, torch.float16, torch.bfloat16, torch.int32, torch.int64, torch.uint8]
_DTYPES += [torch.bool, torch.complex64]
_VALUES = [math.nan, math.inf, -math.inf, 0.0, -1.0, 1e-45, 1e-20, 1e9, 1e20, 3e38, 1e300]
_ODDITIES = [None, "a", [1.0], np.zeros(3)]
_JSON = [None, True, -1, 0, 1e400, 10**400, "x", [], {}, [[]], math.nan, "left_foot", 7.5, [1, 2, 3]]


class Case:
    """Source of one case's arguments; Hypothesis shrinks them towards the first of every choice, which is right.

    Args:
        draw: Function of Hypothesis that draws values.
        folder: Folder for the case's files.
        device: Device of its tensors.
    """

    def __init__(self, draw: Callable[[st.SearchStrategy], Any], folder: Path, device: str) -> None:
        self.draw, self.folder, self.device = draw, folder, device
        self.rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))  # of what need not shrink: normal numbers
        self.extreme = False  # if some tensor holds no number, 0, or what is near the end of float32
        # Most cases spoil something; where all is spoilt, only the first check is tested.
        self.spoilt_tenths = self.one([0, 1, 2, 4])

    def one(self, choices: Sequence[Any]) -> Any:
        return self.draw(st.sampled_from(choices))

    def happens(self, tenths: int) -> bool:
        return self.draw(st.integers(1, 10)) > 10 - tenths

    def spoils(self) -> bool:
        return self.happens(self.spoilt_tenths)

    def either(self, value: Any, *others: Any) -> Any:
        return self.one(others) if self.spoils() else value

    def tensor(self, *shape: int, scale: float = 1.0, shift: float = 0.0) -> torch.Tensor:
        """Normal numbers."""
        return torch.from_numpy(self.rng.normal(shift, scale, shape)).float().to(self.device)

    def turns(self, *shape: int) -> torch.Tensor:
        """Rotation matrices."""
        return rotation_from_axis_angle(self.tensor(*shape, 3))

    def maybe(self, tensor: torch.Tensor) -> Any:
        """The tensor, or something made of it that may be wrong in any way."""
        if self.happens(2):
            tensor = tensor.clone().requires_grad_(tensor.is_floating_point())
        if not self.spoils():
            return tensor
        ways: list[Callable[[torch.Tensor], Any]] = [
            *[self._overwritten] * 4,
            *[self._reshaped] * 2,
            lambda known: known * float(10.0 ** self.rng.uniform(-12, 12)),
            lambda known: known.to(self.one(_DTYPES)),
            lambda known: known.to("meta"),
            lambda known: known.transpose(0, -1).contiguous().transpose(0, -1) if known.dim() else known,
            lambda known: known.to_sparse() if self.device == "cpu" else known,
            lambda known: self.one(_ODDITIES),
        ]
        spoilt = self.one(ways)(tensor.detach())
        if isinstance(spoilt, torch.Tensor) and spoilt.layout == torch.strided and not spoilt.is_meta:
            sizes = spoilt.abs() if spoilt.is_floating_point() or spoilt.is_complex() else torch.ones(())
            # What is divided by next to nothing leaves float32, too.
            self.extreme |= not bool(((sizes > 1e-18) & (sizes < 1e18)).all())
        return spoilt

    def _overwritten(self, tensor: torch.Tensor) -> torch.Tensor:
        """A few numbers replaced."""
        if not tensor.numel():
            return tensor
        values = tensor.clone().flatten()
        places = self.draw(st.lists(st.integers(0, len(values) - 1), min_size=1, max_size=3))
        value = self.one(_VALUES)
        if not values.is_floating_point():
            value = int(np.clip(np.nan_to_num(value), 0, 255))
        elif 1e38 < abs(value) < math.inf:
            values = values.double()
        values[places] = value
        return values.view(tensor.shape)

    def _reshaped(self, tensor: torch.Tensor) -> torch.Tensor:
        if not tensor.numel() or not tensor.dim():
            return tensor.new_zeros(())
        axis = self.one(range(tensor.dim()))
        ways: list[Callable[[], torch.Tensor]] = [
            lambda: tensor.select(axis, 0),
            lambda: tensor.unsqueeze(axis),
            lambda: tensor.narrow(axis, 0, 0),
            lambda: tensor.narrow(axis, 0, tensor.shape[axis] - 1),
            lambda: torch.cat([tensor, tensor], axis),
            lambda: tensor.flatten(),
            lambda: tensor.transpose(0, -1),
            lambda: tensor.new_zeros(()),
        ]
        return self.one(ways)()

    def array(self, values: np.ndarray) -> Any:
        """Array that ``maybe`` may have changed, or one of ``_ODDITIES``."""
        tensor = self.maybe(torch.from_numpy(np.array(values)))
        if not isinstance(tensor, torch.Tensor) or tensor.is_meta or tensor.layout != torch.strided:
            return self.one(_ODDITIES)
        return (tensor.float() if tensor.dtype == torch.bfloat16 else tensor).detach().numpy()

    def number(self, value: Any, *others: Any) -> Any:
        """The number, or another one."""
        number = self.either(value, *others, math.nan, math.inf, -math.inf, 0, -1, 1e30, None, "a", 2.5)
        self.extreme |= number == 1e30  # two of them multiplied leave float32
        return number

    def size(self) -> Any:
        """A picture's size."""
        return self.one(_BAD_SIZES if self.spoils() else SIZES)

    def file(self, name: str, data: bytes) -> Path:
        """A file with these bytes, or damaged ones."""
        path = self.folder / name
        if self.spoils() and self.happens(1):
            return self.one([self.folder, self.folder / "missing" / name, path.with_suffix("")])
        path.write_bytes(self.damaged(data) if self.happens(6) else data)
        return path

    def damaged(self, data: bytes) -> bytes:
        """Damage bytes in up to three places: replace, cut out, cut off, repeat or put in some."""
        for _ in range(self.one([1, 2, 3])):
            length = min(len(data), self.one([256, len(data)]))  # in the beginning are headers
            at = self.draw(st.integers(0, length))
            end = at + self.one([1, 1, 0, 64, len(data)])
            put_in = self.one([self.rng.bytes(end - at), b"", data[at : at + 256], self.rng.bytes(20)])
            data = data[:at] + put_in + data[end:]
        return data

    def json(self, data: Any) -> Any:
        """Data with up to two things in it replaced, renamed or left out, wherever they are."""
        root = [copy.deepcopy(data)]
        for _ in range(self.one([0, 1, 2]) if self.spoilt_tenths else 0):
            holder: Any = root
            key: Any = 0
            while isinstance(holder[key], dict | list) and holder[key] and not self.happens(2):
                holder = holder[key]
                key = self.one(list(holder) if isinstance(holder, dict) else range(len(holder)))
            if holder is not root and self.happens(2):
                del holder[key]
            elif isinstance(holder, dict) and self.happens(2):
                holder[self.one(["", "format", "x"])] = holder.pop(key)
            else:
                holder[key] = copy.deepcopy(self.one(_JSON))
        return root[0]
