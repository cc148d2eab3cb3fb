"""Warnings of people who can't be where, or as tall as, several cameras say."""

from __future__ import annotations

_STATURES = (0.5, 2.6)  # [m], of people
_FARTHEST = 100.0  # [m], of people from their cameras
ASKED = "are translations in metres, is each film of its camera, and do the films show the same moments?"


def impossible_people(statures: dict[int, float], distances: dict[int, float]) -> list[str]:
    """Warnings of people who are too small, too tall or too far away.

    Args:
        statures: Heights standing, by person [m].
        distances: From the farthest camera [m], by person.
    """
    found: list[str] = []
    for person, stature in statures.items():
        if not _STATURES[0] <= stature <= _STATURES[1]:
            least, most = _STATURES
            found.append(f"person{person} is {stature:.2f} m tall; expected {least:g} to {most:g} m: {ASKED}")
        elif not distances[person] <= _FARTHEST:
            far = f"person{person} is {distances[person]:.0f} m away from a camera"
            found.append(f"{far}; expected {_FARTHEST:g} m at most: {ASKED}")
    return found
