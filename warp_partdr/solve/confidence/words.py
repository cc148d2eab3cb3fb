"""Words for the confidence in a body."""

from __future__ import annotations

_WORDS = ((0.25, "likely wrong"), (0.5, "more likely wrong than right"), (0.75, "more likely right than wrong"))


def confidence_in_words(probability: float) -> str:
    """Say how likely a body is right, by a number and in words, such as "confidence 0.12: likely wrong"."""
    words = next((words for limit, words in _WORDS if probability < limit), "likely right")
    return f"confidence {probability:.2f}: {words}"
