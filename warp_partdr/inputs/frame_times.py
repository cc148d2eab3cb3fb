"""Times of a film's frames. They always rise, whatever the file states, and they show if the rate is constant."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import TypeVar

import numpy as np

Item = TypeVar("Item")

USUAL_RATE = 30.0  # frames a second of a film that states no rate
_ROUNDED = 1.5e-3  # [s], largest error of times at a constant rate, because containers round them
_MISSING = 1.5  # usual steps, above which frames are missing
_BESIDE = 4  # steps on either side with which a step is compared
_BACK = 2.0  # usual steps; times that go back by more start again
_HELD = 8  # frames without a time of their own that wait for the next frame with one


def rising_times(stated: Iterable[tuple[Item, float | None]], step: float) -> Iterator[tuple[Item, float, bool]]:
    """Items with their times since the first one [s], which rise, and True if the time is a guess.

    A file may state a time twice, or none: such an item gets a time between those of its neighbours. If times start
    again, as in films that were joined, they go on a usual step later.

    Args:
        stated: Items in order, with the times that the file states [s].
        step: Usual time between two items [s].
    """
    waiting: list[Item] = []
    last = -step  # time of the last item that was yielded
    offset = math.nan  # added to stated times
    for item, time in stated:
        anew = time is not None and not time + offset >= last - _BACK * step
        guess = anew and not math.isnan(offset)
        if anew or len(waiting) == _HELD:
            for each in waiting:
                last += step
                yield each, last, True
            waiting.clear()
        if time is not None and anew:
            offset = last + step - time
        now = last if time is None else time + offset
        if now - last < 1e-6 * step:
            waiting.append(item)
            continue
        between = (now - last) / (len(waiting) + 1)
        for count, each in enumerate(waiting, start=1):
            yield each, last + count * between, True
        waiting.clear()
        last = now
        yield item, now, guess
    for each in waiting:
        last += step
        yield each, last, True


def usual_rate(times: Sequence[float] | np.ndarray, stated: float = 0.0) -> float:
    """Frames a second in most of a film: one over the usual time step.

    Args:
        times: Times of the frames [s], rising, shape (F,).
        stated: Frames a second as the file states them. They count if they agree with the times. 0: unknown.
    """
    at = np.asarray(times, dtype=np.float64)
    if len(at) < 2:
        return stated or USUAL_RATE
    if stated and is_even(at, stated):
        return stated
    mean = (len(at) - 1) / float(at[-1] - at[0])
    if is_even(at, mean):
        return mean
    steps = np.diff(at)
    middle = float(np.median(steps))
    usual = steps[(steps < _MISSING * middle) & (_MISSING * steps > middle)]
    found = 1 / float(usual.mean())
    return stated if abs(found - stated) < 1e-3 * found else found


def is_even(times: np.ndarray, rate: float) -> bool:
    """True if times, shape (F,) [s], have a constant rate, except for the rounding of a container."""
    off = times - times[:1] - np.arange(len(times)) / rate
    return bool((np.abs(off) <= min(_ROUNDED, 0.25 / rate)).all())


def time_warnings(name: str, times: Sequence[float], guessed: Sequence[bool], rate: float) -> tuple[str, ...]:
    """Warnings about frames that are missing, and about times that are guesses.

    Args:
        name: Name of the film.
        times: Times of its frames [s], shape (F,).
        guessed: True for each time that is a guess, as ``rising_times`` says.
        rate: Frames a second in most of the film.
    """
    warnings: list[str] = []
    at = np.asarray(times)
    if len(at) > 1 and all(guessed):
        warnings.append(f"{name}: states no times; taken for {rate:g} frames a second")
    elif any(guessed):
        first = float(at[list(guessed).index(True)])
        few = f"{sum(guessed)} of {len(at)} frames have no time of their own, the first of them at {first:.2f} s"
        warnings.append(f"{name}: {few}; taken to lie between their neighbours")
    steps = np.diff(at)
    long = np.flatnonzero(steps > _MISSING / rate)
    if len(long) and not is_even(at, rate):
        alone = [step for step in long.tolist() if _stands_out(steps, step)]
        first_long = alone[0] if alone else int(long[0])
        reason = "frames missing" if alone else "another rate"
        several = f", and after {len(alone) - 1} more" if len(alone) > 1 else ""
        size = f"steps of up to {steps.max():.2f} s, {1 / rate:.3f} s is usual"
        warnings.append(
            f"{name}: {reason} after {at[first_long]:.2f} s{several} ({size}); bodies are at the true times"
        )
    return tuple(warnings)


def _stands_out(steps: np.ndarray, index: int) -> bool:
    """True if a step is longer than those on both sides of it. If the rate changed, it is as long as those after it."""
    before, after = steps[max(index - _BESIDE, 0) : index], steps[index + 1 : index + 1 + _BESIDE]
    usual = [float(np.median(each)) for each in (before, after) if len(each)]
    return float(steps[index]) > _MISSING * max(usual, default=0.0)
