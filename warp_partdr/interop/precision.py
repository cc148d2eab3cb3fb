"""Rounding of float32 products and convolutions on CUDA, and devices on which bfloat16 is fast."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

import torch

_CPU_CHECKS = ("_is_avx512_bf16_supported", "_is_amx_tile_supported")


@contextmanager
def matmul_precision(precision: Literal["highest", "high", "medium"]) -> Iterator[None]:
    """Let products of float32 matrices be rounded to TF32 ("high"), bfloat16 ("medium") or not at all ("highest")."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(precision)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


@contextmanager
def exact_convolutions() -> Iterator[None]:
    """Keep convolutions of float32 exact within; by default, torch rounds them to TF32."""
    before = torch.backends.cudnn.allow_tf32
    torch.backends.cudnn.allow_tf32 = False
    try:
        yield
    finally:
        torch.backends.cudnn.allow_tf32 = before


def multiplies_bfloat16(device: str) -> bool:
    """True if a device multiplies bfloat16 in hardware: CUDA from capability 8.0 on, CPUs with AVX512-BF16 or AMX.

    On other devices it is emulated, and slower than float32. Torch has no public function that tells it about a CPU.
    """
    if device == "cpu":
        return any(getattr(torch.cpu, name, bool)() for name in _CPU_CHECKS)
    return torch.version.cuda is not None and torch.cuda.get_device_capability(device) >= (8, 0)
