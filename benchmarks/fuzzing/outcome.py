"""The outcome of a case: a result of finite numbers, an error on purpose, or a fault."""

from __future__ import annotations

import sys
import traceback
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

PACKAGE = {
    Path(sys.modules[name].__file__ or "").resolve().parent
    for name in ("warp_partdr", *(f"warp_partdr.{part}" for part in ("body.template", "kernels.launch")))
}
REFUSALS = (ValueError, TypeError, OSError)


class UnfitError(AssertionError):
    """A result that is none."""


@dataclass(frozen=True)
class Outcome:
    """Of one case: "right", "refused" or what failed, and the trace of that."""

    target: str
    kind: str
    trace: str = field(default="", compare=False)

    @property
    def passed(self) -> bool:
        """True if it is right, or refused on purpose."""
        return self.kind in ("right", "refused")


def check_finite(value: Any, name: str = "result") -> None:
    """Raise UnfitError where a result holds NaN, or infinity that is not the background's depth or a near plane."""
    if isinstance(value, torch.Tensor):
        if value.is_meta:  # it has none
            return
        value = value.detach().cpu().float().numpy() if value.dtype == torch.bfloat16 else value.detach().cpu().numpy()
    if isinstance(value, float | np.ndarray | np.generic):
        numbers = np.asarray(value)
        if numbers.dtype.kind in "fc":
            bad = np.isnan(numbers) if name.endswith(("depth", "maps", "near")) else ~np.isfinite(numbers)
            if bad.any():
                raise UnfitError(f"{name}: {numbers[bad][0]}")
    elif is_dataclass(value) and not isinstance(value, type):
        for each in fields(value):
            check_finite(getattr(value, each.name), f"{name}.{each.name}")
    elif isinstance(value, dict):
        for key, each in value.items():
            check_finite(each, f"{name}.{key}")
    elif isinstance(value, list | tuple):
        for index, each in enumerate(value):
            check_finite(each, f"{name}[{index}]")


def on_purpose(error: BaseException) -> bool:
    """True if a line of this package raised it, or Python because of an argument's type."""
    if isinstance(error, TypeError):
        return True
    if not isinstance(error, REFUSALS) or not str(error):
        return False
    last = traceback.extract_tb(error.__traceback__)[-1]
    return not PACKAGE.isdisjoint(Path(last.filename).resolve().parents)
