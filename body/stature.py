"""Stature: the height of a person standing, which an EllipBody has by the lengths of its bones."""

from __future__ import annotations

import numpy as np
import torch

from ..errors import InputError
from ..interop.device_cache import device_cache
from .template import LENGTH_NAMES

# Of the bones between sole and crown, how much of each length counts: learned by scripts/learn_stature.py.
SHARES = {"abdomen": 0.99, "chest": 1.2, "neck": 1.71, "head": 0.81, "upper leg": 1.02, "lower leg": 0.86}
LEAST_STATURE, MOST_STATURE = 0.4, 2.8  # [m]
# One man in a thousand of ANSUR II (US Army, 2012) is taller than 1.97 m, and some peoples are some centimetres taller.
_TALL = 2.05  # [m]


def bone_statures(lengths: torch.Tensor) -> torch.Tensor:
    """Statures [m] of bodies with ``LENGTH_NAMES`` (B, 12) [m], shape (B,); of Annys 0.2 % off on average."""
    return lengths @ _shares(lengths.device, lengths.dtype)


@device_cache(8)
def _shares(device: torch.device, dtype: torch.dtype) -> torch.Tensor:
    with torch.inference_mode(False):  # kept for calls outside of it, too
        return torch.tensor([SHARES.get(name, 0.0) for name in LENGTH_NAMES], device=device, dtype=dtype)


def tall_warning(person: str, stature: float) -> tuple[str, ...]:
    """Warn of a height that was guessed from one picture or film, and that hardly anybody has.

    Args:
        person: Name of the person, for the sentence.
        stature: Height of the person standing [m].

    Returns:
        One sentence, or none if people of this height are common. Small people may be children: they are not told.
    """
    if stature <= _TALL:
        return ()
    return (
        f"{person} is {stature:.2f} m tall, and hardly anybody is taller than {_TALL} m. One camera does not show how "
        "tall somebody is: size and distance may both be too large. Please give the height if you know it, for example "
        "--set stature=1.8",
    )


def check_stature(stature: float | None) -> float | None:
    """Check that a known stature, if there is one, is somebody's; returns it as a plain number.

    Raises:
        InputError: If it is no number of metres that a person can have.
    """
    if stature is None:
        return None
    number = isinstance(stature, int | float | np.number) and not isinstance(stature, bool)
    if not (number and LEAST_STATURE <= stature <= MOST_STATURE):
        raise InputError(f"stature: {stature!r}; expected metres, {LEAST_STATURE} to {MOST_STATURE}")
    return float(stature)
