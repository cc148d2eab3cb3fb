"""Random numbers on a device, all of one generator: a seed says what comes, whatever precision training uses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import torch

from ...interop.precision import matmul_precision


class TorchRng:
    """A generator on a device and the distributions that training needs; nothing waits for the device."""

    def __init__(self, seed: int, device: torch.device | str) -> None:
        self.device = torch.device(device)
        self.generator = torch.Generator(self.device).manual_seed(seed)

    def uniform(self, *shape: int, low: float = 0.0, high: float = 1.0) -> torch.Tensor:
        """Random numbers between ``low`` and ``high``, float32."""
        numbers = torch.rand(shape, generator=self.generator, device=self.device)
        return numbers if (low, high) == (0.0, 1.0) else numbers.mul_(high - low).add_(low)

    def normal(self, *shape: int) -> torch.Tensor:
        """Random numbers of a normal distribution with mean 0 and standard deviation 1, float32."""
        return torch.randn(shape, generator=self.generator, device=self.device)

    def chance(self, probability: float | torch.Tensor, *shape: int) -> torch.Tensor:
        """True with a probability, one for all or a tensor that broadcasts to ``shape``; bool."""
        return self.uniform(*shape) < probability

    def integers(self, below: int, *shape: int) -> torch.Tensor:
        """0 to ``below`` - 1, int64."""
        return torch.randint(below, shape, generator=self.generator, device=self.device)

    def choice(self, weights: Sequence[float] | torch.Tensor, *shape: int) -> torch.Tensor:
        """Indices, each as often as its weight says, int64."""
        shares = torch.as_tensor(weights, dtype=torch.float32, device=self.device).cumsum(0)
        return torch.searchsorted(shares, shares[-1] * self.uniform(*shape), right=True).clamp(max=len(shares) - 1)


@contextmanager
def exact_float32(device: torch.device) -> Iterator[None]:
    """Float32 throughout: under TF32 or bfloat16, vertices move by millimetres, and other poses are accepted."""
    with matmul_precision("highest"), torch.autocast(device.type, enabled=False):
        yield
