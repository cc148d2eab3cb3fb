"""Confidence in a person's bodies through a film, frame by frame, and the stretches of time in which it is low."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .limbs import LIMBS
from .model import packaged_model
from .sights import SIGHTS, Sight, describe_guessed

_APART = 0.5  # [s], largest time between two frames of low confidence that belong to one stretch
_NAMED = 3  # stretches whose times a warning names; the others are counted
_SEEN = SIGHTS.index("seen")


@dataclass(frozen=True)
class MotionConfidence:
    """Confidence in a person's bodies in T frames. Frames in which the person was not found have none.

    Attributes:
        bodies: Probability that each body is right (``BodyConfidence``), NaN in frames without the person, shape (T,).
        limbs: Probability that each limb of ``LIMBS`` is right, NaN likewise, shape (T, 5).
        sights: Index in ``SIGHTS`` of each limb, ``NO_SIGHT`` in frames without the person, shape (T, 5), uint8. A limb
            that is not seen is guessed.
    """

    bodies: np.ndarray
    limbs: np.ndarray
    sights: np.ndarray

    @property
    def known(self) -> np.ndarray:
        """Flags of the frames in which the person was found, shape (T,), bool."""
        return np.isfinite(self.bodies)

    def guessed(self, row: int) -> tuple[str, ...]:
        """Names of the limbs that no keypoint shows in a frame; all of them where the person was not found."""
        return tuple(limb.name for limb, sight in zip(LIMBS, self.sights[row], strict=True) if sight != _SEEN)


def unsure_stretches(confidence: MotionConfidence, times: np.ndarray) -> list[slice]:
    """Rows of the stretches of time in which the confidence is below the limit, in order.

    Frames of low confidence that follow one another are one stretch, and so are those that are at most 0.5 s apart.

    Args:
        confidence: Confidence in T frames.
        times: Times of the frames [s], shape (T,).
    """
    low = np.flatnonzero(confidence.bodies < packaged_model().least)
    if not len(low):
        return []
    apart = (np.diff(low) > 1) & (np.diff(times[low]) > _APART)
    return [slice(int(some[0]), int(some[-1]) + 1) for some in np.split(low, np.flatnonzero(apart) + 1)]


def motion_warning(name: str, confidence: MotionConfidence, times: np.ndarray) -> str | None:
    """Sentence about the stretches of time in which a person's bodies are likely wrong; None if there are none.

    It says when, names the limbs that are guessed in most of these frames, and says what to look at.

    Args:
        name: Name of the person.
        confidence: Confidence in T frames.
        times: Times of the frames [s], shape (T,).
    """
    stretches = unsure_stretches(confidence, times)
    if not stretches:
        return None
    least = packaged_model().least
    longest = sorted(stretches, key=lambda rows: times[rows][0] - times[rows][-1])[:_NAMED]
    when = ", ".join(_when(times[rows]) for rows in stretches if rows in longest)
    if others := len(stretches) - len(longest):
        when += f" and in {others} shorter stretch{'es' if others > 1 else ''}"
    low = np.flatnonzero(confidence.bodies < least)
    reason = describe_guessed(_usual_sights(confidence.sights[low]))
    reason = f" ({reason})" if reason else ""
    return (
        f"{name}: confidence below {least:.2f} {when}{reason}; expected {least:.2f} or more; compare overlay.mp4 with "
        "the film"
    )


def _when(times: np.ndarray) -> str:
    """Words for the first and the last one of these times [s]."""
    first, last = f"{times[0]:.1f}", f"{times[-1]:.1f}"
    return f"at {first} s" if first == last else f"from {first} to {last} s"


def _usual_sights(sights: np.ndarray) -> dict[str, Sight]:
    """Sight of each limb in frames with sights (N, 5): the more frequent reason if it is guessed in most of them."""
    found: dict[str, Sight] = {}
    for limb, own in zip(LIMBS, sights.T, strict=True):
        counts = {sight: np.count_nonzero(own == index) for index, sight in enumerate(SIGHTS)}
        reason: Sight = "hidden" if counts["hidden"] >= counts["outside"] else "outside"
        found[limb.name] = reason if counts["seen"] < counts["hidden"] + counts["outside"] else "seen"
    return found
