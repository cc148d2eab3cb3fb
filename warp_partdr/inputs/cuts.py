"""Cuts of films: frames in which another shot begins, found while a film is read once.

Small pictures of two frames are compared block by block. Each block is compared with its neighbourhood in the other
frame, so that motion, slow pans and changes of light make no difference. The remaining difference is compared with that
of the frames just before and after: fast pans, shakes and low frame rates change every frame, but a cut changes one. A
slideshow changes every frame, too; whether a change in it is a cut is decided by the people in it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..errors import InputError
from .films import Frame

_SIDE, _BLOCK = 64, 8  # [px], longer side of the small pictures, and side of their blocks
_REACH = 4  # [px] of the small pictures that a block may move from one frame to the next
_BLANK = 4.0  # standard deviation of values, of 255, below which a picture shows nothing: black, or a white flash
_NOISE = 0.1  # standard deviation of a block's values, as a share of the picture's, that means nothing
_COLOUR = 0.1  # weight of a block's mean colour beside its pattern

# Unlikeness of two frames, 0 to 1. In real films, that of neighbours is 0 to 0.43, that across cuts to another camera
# 0.78 to 0.95, and that across cuts in one camera's recording 0.07 to 0.4.
_CUT, _TIMES_CUT = 0.6, 1.5  # least unlikeness of a new shot, and its least multiple of the usual unlikeness; below the
# multiple, a new shot begins if nobody clearly stayed
_JUMP, _TIMES_JUMP = 0.06, 3.0  # least unlikeness of a new shot, and its multiple, if nobody can be followed
_AROUND = 3  # frames before and after a frame, whose median is the usual unlikeness
_LATE = 1.5  # usual time steps, above which frames are missing
_KEPT = 64  # small pictures that are remembered
_FLASH = 0.11  # [s], longest flash or run of damaged frames, after which the film goes on as before, without a cut
_AHEAD = 8  # frames that are read ahead at most
_NAMED = 5  # cuts that a sentence lists


class Change(Enum):
    """Change from the frame before to a frame.

    ``JUMP`` is a cut if nobody can be followed through it. If nobody was visible, people may appear from here on, as at
    the end of a blank start. ``NEW`` means that nearly everything is new, but the same is true of the frames around, as
    in a slideshow or if a camera turns fast; it is a cut unless somebody clearly stayed. ``FLASH`` is a frame, blank or
    very different, after which the film goes on as before.
    """

    NONE = "none"
    FLASH = "flash"
    JUMP = "jump"
    NEW = "new"
    CUT = "cut"


def with_changes(frames: Iterable[Frame]) -> Iterator[tuple[Frame, Change]]:
    """Frames of a film in their order, each with the change that leads to it; a few frames are in memory at a time.

    Raises:
        InputError: If ``frames`` raises one. The frames before it are yielded first.
    """
    finder, iterator = _Finder(), iter(frames)
    held: deque[Frame] = deque()
    fault: InputError | None = None
    ended = False
    while True:
        while not ended and not _enough(held):
            try:
                frame = next(iterator)
            except StopIteration:
                ended = True
            except InputError as error:
                ended, fault = True, error
            else:
                held.append(frame)
                finder.add(frame)
        if not held:
            break
        yield held.popleft(), finder.next_change()
    if fault is not None:
        raise fault


def cuts_sentence(cuts: Sequence[int], times: Sequence[float] | np.ndarray) -> str:
    """Words about the cuts of a film, one or more.

    Args:
        cuts: First frames of all shots but the first.
        times: Times of these frames [s].
    """
    some = list(zip(cuts, times, strict=True))[:_NAMED]
    frames, seconds = ", ".join(f"{cut}" for cut, _ in some), ", ".join(f"{time:.2f}" for _, time in some)
    if len(cuts) == 1:
        return f"a cut at frame {frames} ({seconds} s): 2 shots"
    more = f" and {len(cuts) - _NAMED} more" if len(cuts) > _NAMED else ""
    return f"cuts at frames {frames} ({seconds} s){more}: {len(cuts) + 1} shots"


def _enough(held: Sequence[Frame]) -> bool:
    """True if enough frames are read to find the change of the first one."""
    if len(held) <= _AROUND:
        return False
    return len(held) > _AHEAD or held[-1].time - held[0].time > _FLASH


@dataclass
class _Small:
    """Small picture of a frame.

    Attributes:
        time: Time since the first frame [s].
        picture: Values with mean 0, and with standard deviation 1 unless the picture is blank, shape (h, w, 3),
            float32.
        blank: True if it shows nothing.
        step: Unlikeness to the last picture before it that is not blank; 0 if there is none.
    """

    time: float
    picture: np.ndarray
    blank: bool
    step: float = 0.0


class _Finder:
    """Changes of frames that were added, one after another."""

    def __init__(self) -> None:
        self._before: deque[_Small] = deque(maxlen=_KEPT)  # of this shot, without blank pictures and flashes
        self._ahead: deque[_Small] = deque()
        self._flash = 0  # frames that still belong to a flash
        self._blank_start = False

    def add(self, frame: Frame) -> None:
        """Take the film's next frame."""
        small = _small(frame)
        last = next((each for each in reversed(self._ahead) if not each.blank), None)
        if last is None and self._before:
            last = self._before[-1]
        if last is not None and not small.blank:
            small.step = unlikeness(last.picture, small.picture)
        self._ahead.append(small)

    def next_change(self) -> Change:
        """Return the change that leads to the first of the frames that have none yet."""
        small = self._ahead.popleft()
        if self._flash:
            self._flash -= 1
            return Change.FLASH
        if small.blank:
            self._blank_start |= not self._before
            return Change.FLASH if self._before else Change.NONE
        if not self._before:
            self._before.append(small)
            return Change.JUMP if self._blank_start else Change.NONE
        change = _change(small.step, self._usual_before())
        if change is not Change.NONE or small.step >= _CUT:
            if (stop := self._return(small)) is not None:
                self._flash = stop
                self._ahead[stop].step = unlikeness(self._before[-1].picture, self._ahead[stop].picture)
                return Change.FLASH
            change = _change(small.step, self._usual(small))
            if change is Change.NONE and small.step >= _CUT and not self._late(small):
                change = Change.NEW
        if change is Change.CUT:
            self._before.clear()
        self._before.append(small)
        return change

    def _usual(self, small: _Small) -> float:
        """Usual unlikeness around a frame: of frames as far apart in time as this frame and the one before it."""
        before = list(self._before)
        after = [each for each in self._ahead if not each.blank]
        usual = max(self._usual_before(), _middle([each.step for each in after[:_AROUND]]))
        if self._late(small):
            gap = small.time - before[-1].time
            start, stop = before[-1].time - gap, small.time + gap
            earlier = next((each for each in reversed(before) if each.time <= start), before[0])
            later = next((each for each in after if each.time >= stop), after[-1] if after else small)
            pairs = (earlier, before[-1]), (small, later)
            usual = max(usual, *(unlikeness(one.picture, other.picture) for one, other in pairs))
        return usual

    def _late(self, small: _Small) -> bool:
        """True if frames are missing between a frame and the one before."""
        before = list(self._before)
        after = [each for each in self._ahead if not each.blank]
        times = [each.time for each in (*before[-_AROUND - 1 :], small, *after[:_AROUND])]
        return small.time - before[-1].time > _LATE * float(np.median(np.diff(times)))

    def _usual_before(self) -> float:
        """Unlikeness of the last frames of this shot to those before them."""
        return _middle([each.step for each in list(self._before)[1:][-_AROUND:]])

    def _return(self, small: _Small) -> int | None:
        """Number of further frames after which the film goes on as it was before this frame; None if it does not."""
        last = self._before[-1]
        for count, each in enumerate(self._ahead):
            if each.time - small.time > _FLASH and (count or not self._alone(small)):
                break
            if not each.blank:
                back = unlikeness(last.picture, each.picture)
                if back < min(small.step / 2, unlikeness(small.picture, each.picture)):
                    return count
        return None

    def _alone(self, small: _Small) -> bool:
        """True if a single frame, after which the film returns, is far more unlike than all frames around it."""
        before = [each.step for each in list(self._before)[1:][-_AROUND:]]
        after = [each.step for each in list(self._ahead)[1:] if not each.blank][:_AROUND]
        usual = [_middle(steps) for steps in (before, after) if steps]
        return bool(usual) and small.step >= _TIMES_CUT * max(usual)


def _change(step: float, usual: float) -> Change:
    """Change that belongs to an unlikeness, beside the usual one."""
    if step >= max(_CUT, _TIMES_CUT * usual):
        return Change.CUT
    return Change.JUMP if step >= max(_JUMP, _TIMES_JUMP * usual) else Change.NONE


def _middle(steps: Sequence[float]) -> float:
    return float(np.median(steps)) if steps else 0.0


def _small(frame: Frame) -> _Small:
    from PIL import Image

    height, width = frame.picture.shape[:2]
    zoom = _SIDE / _BLOCK / max(height, width)
    size = max(round(width * zoom), 1) * _BLOCK, max(round(height * zoom), 1) * _BLOCK
    values = np.asarray(Image.fromarray(frame.picture).resize(size, Image.Resampling.BOX), np.float32)
    deviation = float(np.sqrt(values.var((0, 1)).mean()))
    return _Small(frame.time, (values - values.mean()) / max(deviation, _BLANK), deviation < _BLANK)


def unlikeness(one: np.ndarray, other: np.ndarray) -> float:
    """Share of a small picture's blocks that another picture does not show near by, 0 to 1.

    A block's share is the least, over all offsets, of ``(var a + var b - 2 cov + 0.1 (mean a - mean b)^2) / (max(var a,
    var b) + noise)``, at most 1. Variances, covariance and squared means are sums over the colours.

    Args:
        one: The picture of one frame, shape (h, w, 3), sides multiples of 8.
        other: The picture of another frame, of the same shape.
    """
    rows, columns = other.shape[0] // _BLOCK, other.shape[1] // _BLOCK
    blocks = other.reshape(rows, _BLOCK, columns, _BLOCK, 3).transpose(0, 2, 4, 1, 3)
    means = blocks.mean((-1, -2))[..., None, None]
    variances = blocks.var((-1, -2)).sum(-1)[..., None, None]
    wide = np.pad(one, ((_REACH, _REACH), (_REACH, _REACH), (0, 0)), mode="edge")
    box_means = _box_means(wide)
    box_variances = (_box_means(np.square(wide)) - np.square(box_means)).sum(-1)
    offsets = (2 * _REACH + 1, 2 * _REACH + 1)

    def around(values: np.ndarray) -> np.ndarray:
        """Values at all offsets from each block, shape (rows, columns, ..., *offsets)."""
        return sliding_window_view(values, offsets, axis=(0, 1))[::_BLOCK, ::_BLOCK]

    found_means, found_variances = around(box_means), around(box_variances)
    patches = around(sliding_window_view(wide, (_BLOCK, _BLOCK), axis=(0, 1)))
    both = np.einsum("rckij,rckijst->rcst", blocks - means, patches) / _BLOCK**2
    unlike = found_variances + variances - 2 * both + _COLOUR * np.square(found_means - means).sum(2)
    shares = unlike / (np.maximum(found_variances, variances) + 3 * _NOISE**2)
    return float(np.minimum(shares, 1.0).min((-1, -2)).mean())


def _box_means(values: np.ndarray) -> np.ndarray:
    """Means of all boxes of a block's size in a picture (H, W, 3), shape (H - 7, W - 7, 3)."""
    sums = np.cumsum(np.cumsum(np.pad(values, ((1, 0), (1, 0), (0, 0))), axis=0, dtype=np.float64), axis=1)
    rows = sums[_BLOCK:] - sums[:-_BLOCK]
    return ((rows[:, _BLOCK:] - rows[:, :-_BLOCK]) / _BLOCK**2).astype(np.float32)
