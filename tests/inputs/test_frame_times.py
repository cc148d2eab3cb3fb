"""Times of frames rise whatever a file states, and tell how even a film is."""

from __future__ import annotations

import numpy as np
import pytest

from warp_partdr.inputs.frame_times import is_even, rising_times, time_warnings, usual_rate


def risen(stated: list[float | None]) -> tuple[list[float], list[int]]:
    """Times of frames 0.1 s apart for the most part, and which are guesses."""
    found = list(rising_times(enumerate(stated), 0.1))
    assert [item for item, _, _ in found] == list(range(len(stated)))
    return [time for _, time, _ in found], [item for item, _, guessed in found if guessed]


@pytest.mark.parametrize(
    ("stated", "times", "guessed"),
    [
        ([5.0, 5.1, 5.5], [0.0, 0.1, 0.5], []),
        ([-0.2, -0.1, 0.0], [0.0, 0.1, 0.2], []),
        ([0.0, 0.1, 0.1, 0.3], [0.0, 0.1, 0.2, 0.3], [2]),  # twice
        ([0.0, 0.1, 0.1, 0.1, 0.4], [0.0, 0.1, 0.2, 0.3, 0.4], [2, 3]),
        ([0.0, 0.1, 0.05, 0.3], [0.0, 0.1, 0.2, 0.3], [2]),  # a little back
        ([0.0, None, 0.4, None], [0.0, 0.2, 0.4, 0.5], [1, 3]),
        ([None, None, 7.0, 7.3], [0.0, 0.1, 0.2, 0.5], [0, 1]),
        ([0.0, 0.1, 0.2, 0.3, 0.0, 0.2, 0.3], [0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 0.7], [4]),  # anew
        ([0.0, 0.1, 0.1, 0.9, 0.0, 0.1], [0.0, 0.1, 0.5, 0.9, 1.0, 1.1], [2, 4]),
        ([None] * 30, list(np.arange(30) / 10), list(range(30))),
        ([3.0] * 30, list(np.arange(30) / 10), list(range(1, 30))),
        ([], [], []),
    ],
)
def test_stated_times_become_rising_times(stated: list[float | None], times: list[float], guessed: list[int]) -> None:
    found, guesses = risen(stated)
    assert found == pytest.approx(times)
    assert guesses == guessed


@pytest.mark.parametrize(
    ("times", "stated", "rate"),
    [
        (np.arange(50) / 29.97, 29.97, 29.97),
        ((1000 * np.arange(50) / 30).round() / 1000, 30.0, 30.0),  # as Matroska rounds them
        (np.arange(50) / 25, 30.0, 25.0),  # what the file states is wrong
        (np.arange(50) / 25, 0.0, 25.0),
        (np.array([0.0, 1, 2, 3, 4, 8, 9, 10, 13]) / 24, 12.0, 24.0),  # frames are missing
        (np.array([0.0, 1, 2, 3, 4, 8, 9, 10, 13]) / 24, 24.01, 24.01),
        (np.zeros(1), 0.0, 30.0),
        (np.zeros(1), 12.0, 12.0),
        (np.zeros(0), 0.0, 30.0),
    ],
)
def test_the_usual_rate_is_that_of_the_times_where_the_file_is_wrong(
    times: np.ndarray, stated: float, rate: float
) -> None:
    assert usual_rate(times, stated) == pytest.approx(rate, rel=1e-6)


def test_times_are_even_where_each_is_near_its_place() -> None:
    even = np.arange(200) / 30
    assert is_even(even, 30)
    assert is_even(even + 7, 30)
    assert is_even((1000 * even).round() / 1000, 30)
    assert not is_even(even, 30.1)
    late = even.copy()
    late[100:] += 0.002
    assert not is_even(late, 30)
    assert not is_even(np.arange(10) / 1000 + 0.0005 * (np.arange(10) > 4), 1000)  # a half of a step


def test_missing_frames_and_guessed_times_are_warnings() -> None:
    even, sure = np.arange(20) / 20, [False] * 20
    assert time_warnings("a.mp4", even, sure, 20) == ()
    gone = np.delete(even, [5, 6, 12])
    (told,) = time_warnings("a.mp4", gone, sure[:17], 20)
    assert told.startswith(
        "a.mp4: frames missing after 0.20 s, and after 1 more (steps of up to 0.15 s, 0.050 s is usual)"
    )
    (told,) = time_warnings("a.mp4", np.delete(even, [9, 10]), sure[:18], 20)
    assert told.startswith("a.mp4: frames missing after 0.40 s (steps of up to 0.15 s")
    (told,) = time_warnings("a.mp4", even, [index in (3, 4) for index in range(20)], 20)
    assert told.startswith("a.mp4: 2 of 20 frames have no time of their own, the first of them at 0.15 s; ")
    assert time_warnings("a.mp4", even, [True] * 20, 20) == ("a.mp4: states no times; taken for 20 frames a second",)
    uneven = np.cumsum([0.0, *[0.05] * 10, *[0.07] * 10])  # a phone in the dusk
    assert time_warnings("a.mp4", uneven, [False] * 21, 20) == ()
    assert time_warnings("a.mp4", [], [], 30) == ()


def test_a_rate_that_changes_is_no_loss():
    """Half a second at 60 frames a second, then 24, as a phone films in a darker room."""
    times = [*(np.arange(30) / 60), *(0.5 + np.arange(12) / 24)]
    (told,) = time_warnings("a.mp4", times, [False] * 42, 60.0)
    assert told.startswith("a.mp4: another rate after 0.50 s (steps of up to 0.04 s, 0.017 s is usual)")
    gap = [*times, times[-1] + 0.2, times[-1] + 0.2 + 1 / 24]
    (told,) = time_warnings("a.mp4", gap, [False] * 44, 60.0)
    assert told.startswith("a.mp4: frames missing after 0.96 s (steps of up to 0.20 s, ")
