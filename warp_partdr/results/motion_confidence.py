"""Confidence in the bodies of a film's people, as files hold it."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from ..errors import InputError
from ..solve.confidence.limbs import LIMBS
from ..solve.confidence.motions import MotionConfidence
from ..solve.confidence.sights import NO_SIGHT, SIGHTS

CONFIDENCE_ARRAYS = "confidence", "limb_confidence", "limb_sights"  # of personN.npz


def confidence_arrays(confidence: MotionConfidence) -> dict[str, np.ndarray]:
    """Arrays of T frames for a person's file, by their names.

    They are ``CONFIDENCE_ARRAYS`` of shapes (T,), (T, 5) and (T, 5), as in ``MotionConfidence``, and the names of the
    five limbs.
    """
    return {
        "confidence": confidence.bodies.astype(np.float32),
        "limb_confidence": confidence.limbs.astype(np.float32),
        "limb_sights": confidence.sights,
        "limb_names": np.array([limb.name for limb in LIMBS]),
    }


def read_confidence(arrays: Mapping[str, np.ndarray], count: int, where: str) -> MotionConfidence | None:
    """Confidence from the arrays of a person's file; None if it has none of them, as files of older versions.

    Args:
        arrays: Arrays by their names, with some or none of ``CONFIDENCE_ARRAYS``.
        count: Number of frames, T.
        where: Name of the file, for messages.

    Raises:
        InputError: If only some of the arrays are there, or if one has a wrong shape or numbers that are impossible.
    """
    given = [name for name in CONFIDENCE_ARRAYS if name in arrays]
    if not given:
        return None
    if len(given) < len(CONFIDENCE_ARRAYS):
        missing = ", ".join(name for name in CONFIDENCE_ARRAYS if name not in arrays)
        raise InputError(f"{where}: no array {missing}; expected it beside {', '.join(given)}")
    for name, shape in zip(CONFIDENCE_ARRAYS, ((count,), (count, len(LIMBS)), (count, len(LIMBS))), strict=True):
        values = arrays[name]
        sights = name == "limb_sights"
        most = NO_SIGHT if sights else 1
        valid = values.shape == shape and values.dtype.kind == ("u" if sights else "f")
        if not valid or ((values < 0) | (values > most)).any():
            raise InputError(f"{where}: {name}: {values.dtype} {values.shape}; expected numbers {shape}, 0 to {most}")
    return MotionConfidence(
        arrays["confidence"].astype(np.float64),
        arrays["limb_confidence"].astype(np.float64),
        arrays["limb_sights"].astype(np.uint8),
    )


def motion_confidence_record(frames: np.ndarray, confidence: MotionConfidence) -> dict[str, Any]:
    """Numbers about the confidence in a person's bodies for JSON.

    Args:
        frames: Indices of T frames in the film, rising, shape (T,).
        confidence: Confidence in these frames.

    Returns:
        Entries ``mean_confidence``, None if no frame has a confidence; ``confidence`` of each frame from the first to
        the last one, null where the person was not found; and ``guessed``, first and last frame of each run of frames
        in which a limb is guessed, by the name of the limb.
    """
    known = confidence.known
    every: list[float | None] = [None] * int(frames[-1] - frames[0] + 1)
    for frame, probability in zip(frames[known].tolist(), confidence.bodies[known].tolist(), strict=True):
        every[frame - int(frames[0])] = round(probability, 3)
    guessed = {}
    for column, limb in enumerate(LIMBS):
        sights = confidence.sights[:, column]
        own = frames[(sights != SIGHTS.index("seen")) & (sights != NO_SIGHT)]
        if len(own):
            guessed[limb.name.replace(" ", "_")] = _runs(own)
    return {
        "mean_confidence": round(float(confidence.bodies[known].mean()), 3) if known.any() else None,
        "confidence": every,
        "guessed": guessed,
    }


def _runs(frames: np.ndarray) -> list[list[int]]:
    """First and last frame of each run of frames that follow one another."""
    starts = [0, *(np.flatnonzero(np.diff(frames) > 1) + 1).tolist(), len(frames)]
    return [[int(frames[first]), int(frames[stop - 1])] for first, stop in pairwise(starts)]
