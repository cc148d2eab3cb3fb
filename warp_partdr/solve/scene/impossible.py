"""Warnings about people whose heights or distances are impossible, which shows that cameras are wrong."""

from __future__ import annotations

_STATURES = (0.5, 2.6)  # [m], least and largest height of a person
_FARTHEST = 100.0  # [m], largest distance of a person from a camera
ASKED = "are translations in metres, is each film of its camera, and do the films show the same moments?"


def impossible_people(statures: dict[int, float], distances: dict[int, float]) -> list[str]:
    """Warnings about people who are too small, too tall or too far away.

    Args:
        statures: Heights of people standing [m], by the index of the person.
        distances: Distances from the farthest camera [m], by the index of the person.
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
