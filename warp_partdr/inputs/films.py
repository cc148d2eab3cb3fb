"""Frames of films, one after another, upright and with their times; PyAV reads them, the extra "film"."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError, cause
from .part_labels import LARGEST_PICTURE

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

FILM_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mpg", ".mpeg", ".mts", ".wmv")


@dataclass(frozen=True)
class Frame:
    """One frame of a film.

    Attributes:
        index: 0 for the first.
        time: Since the first frame [s].
        picture: RGB, shape (H, W, 3), uint8, upright, with square pixels; all frames have one size.
    """

    index: int
    time: float
    picture: np.ndarray


@dataclass(frozen=True)
class FilmFacts:
    """Facts that a film's file states about itself.

    Attributes:
        rate: Frames a second on average; 0 if unknown.
        frames: Their number, which may be off by a few; 0 if unknown.
    """

    rate: float
    frames: int


def is_film(path: str | Path) -> bool:
    """True if a file's name ends like that of a film."""
    return Path(path).suffix.lower() in FILM_SUFFIXES


def check_pyav(path: str | Path) -> None:
    """Raise an InputError, about a film, if PyAV is not installed."""
    if find_spec("av") is None:
        raise InputError(f"{path}: a film, without PyAV; expected it: pip install 'warp-partdr[film]'")


def film_facts(path: str | Path) -> FilmFacts:
    """Rate and number of a film's frames, without decoding them.

    Raises:
        InputError: If PyAV is not installed, or the file can't be read as a film.
    """
    with _opened(path) as (container, stream):
        rate = float(stream.average_rate or stream.guessed_rate or 0)
        seconds = (container.duration or 0) / 1_000_000  # libav's own unit of time
        return FilmFacts(rate, stream.frames or max(round(seconds * rate), 0))


def read_frames(path: str | Path, *, first: int = 0, times: Sequence[float] = ()) -> Iterator[Frame]:
    """Frames of a film in their order, of which one at a time is in memory.

    Args:
        path: The film.
        first: Of the frames; those before are left out.
        times: Of all the film's frames since its first [s]; with them it begins near ``first`` at once.

    Raises:
        InputError: If PyAV is not installed, the file can't be read as a film, it has no frame, or one is damaged;
            frames before a damaged one are given.
    """
    size = (0, 0)
    with _opened(path) as (container, stream):
        stream.thread_type = "AUTO"
        rate = float(stream.average_rate or stream.guessed_rate or 0)
        start, decoded = _decoded(container, stream, first, times)
        for index, frame in decoded:
            if index < first:
                continue
            if size == (0, 0):
                wide = float(stream.sample_aspect_ratio or 1)  # of a pixel
                size = max(round(frame.width * wide), 1), frame.height
                _check_pixels(path, size)
            # Films of several sizes exist; what follows people wants one.
            pixels = frame.to_ndarray(format="rgb24", width=size[0], height=size[1])
            upright = np.ascontiguousarray(np.rot90(pixels, round(frame.rotation / 90)))
            time = index / rate if frame.time is None and rate else (frame.time or 0.0) - start
            yield Frame(index, time, upright)
    if size == (0, 0):
        raise InputError(f"{path}: no frames{f' from {first} on' if first else ''}; expected a film")


def _decoded(
    container: InputContainer, stream: VideoStream, first: int, times: Sequence[float]
) -> tuple[float, Iterator[tuple[int, VideoFrame]]]:
    """Time of the film's first frame [s], and frames with their indices, from the first or a later one on."""
    frames = container.decode(stream)
    opening = next(frames, None)
    if opening is None:
        return 0.0, iter(())
    start = opening.time or 0.0
    if first and len(times) > first and opening.pts is not None and stream.time_base:
        places = [opening.pts + int(times[first] / stream.time_base), opening.pts]
        for place in places:  # where a file finds no frame that comes before, from the start
            container.seek(place, stream=stream)
            frames = container.decode(stream)
            near = next(frames, None)
            if near is not None and near.time is not None:
                index = int(np.abs(np.asarray(times) - (near.time - start)).argmin())
                if index <= first:
                    return start, zip(count(index), chain([near], frames), strict=False)
    return start, zip(count(), chain([opening], frames), strict=False)


@contextmanager
def _opened(path: str | Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    """The file and its first film; whatever is wrong with it becomes an InputError."""
    check_pyav(path)
    import av

    if not Path(path).is_file():  # libav would take addresses, too
        raise InputError(f"{path}: No such file; expected a film")
    try:
        with av.open(str(Path(path).resolve())) as container:
            if not container.streams.video:
                raise InputError(f"{path}: no pictures in it; expected a film")
            yield container, container.streams.video[0]
    except (av.error.FFmpegError, OSError, ValueError, MemoryError) as error:
        if isinstance(error, InputError):
            raise
        text = "no frames" if isinstance(error, av.error.EOFError) else cause(error)
        raise InputError(f"{path}: {text}; expected a film") from error


def _check_pixels(path: str | Path, size: tuple[int, int]) -> None:
    if size[0] * size[1] > LARGEST_PICTURE:
        raise InputError(f"{path}: frames of {size[0]}x{size[1]}; expected smaller ones")
