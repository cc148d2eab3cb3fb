"""Frames of films, one after another, upright and with their times; PyAV reads them, the extra "film"."""

from __future__ import annotations

import math
import os
import threading
from collections import OrderedDict, deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError, cause, install_command
from ..files.disk import check_regular
from .film_sizes import stated_bytes
from .frame_times import USUAL_RATE, rising_times, usual_rate
from .part_labels import LARGEST_PICTURE, read_photo
from .photo_files import PHOTO_SUFFIXES, ending_of

if TYPE_CHECKING:
    from av import Packet, VideoFrame
    from av.container import InputContainer
    from av.video.stream import VideoStream

FILM_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mpg", ".mpeg", ".mts", ".wmv")
_NEAR = 32  # frames ahead that a film is read on to instead of being opened anew, and frames kept for other threads
_FASTEST = 480.0  # frames a second; a file that states more often means the unit of its times
_FIRST = 256  # packets from which the rate of such a film is found


@dataclass(frozen=True)
class Frame:
    """One frame of a film.

    Attributes:
        index: Index of the frame, 0 for the first.
        time: Time since the first frame [s]; it rises from frame to frame.
        picture: Picture, RGB, shape (H, W, 3), uint8, upright, with square pixels; all frames have one size.
        guessed: True if the file does not state the time.
    """

    index: int
    time: float
    picture: np.ndarray
    guessed: bool = False


@dataclass(frozen=True)
class FilmPicture:
    """Picture of a film, by its index, 0 for the first."""

    film: Path
    index: int

    def read(self) -> np.ndarray:
        """Return the picture, RGB, shape (H, W, 3), uint8; raise InputError if it can't be read."""
        return FilmFrames(self.film).read(self.index)


@dataclass(frozen=True)
class FilmFacts:
    """Facts that a film's file states about itself.

    Attributes:
        rate: Frames a second on average; 0 if unknown.
        frames: Number of frames, which may be off by a few; 0 if unknown.
    """

    rate: float
    frames: int


def is_film(path: str | Path) -> bool:
    """True if a file's name ends like that of a film."""
    return ending_of(str(path)) in FILM_SUFFIXES


def check_pyav(path: str | Path) -> None:
    """Raise an InputError, about a film, if PyAV is not installed."""
    if find_spec("av") is None:
        raise InputError(f"{path}: a film, without PyAV; expected it: {install_command('film')}")


def film_facts(path: str | Path) -> FilmFacts:
    """Find the rate and number of a film's frames, without decoding them.

    Raises:
        InputError: If PyAV is not installed, or the file can't be read as a film.
    """
    with _opened(path) as (container, stream):
        rate = _stated_rate(stream)
        seconds = (container.duration or 0) / 1_000_000  # libav's own unit of time
        if not 0 < rate <= _FASTEST:
            first = islice((packet.pts for packet in container.demux(stream) if packet.pts is not None), _FIRST)
            times = np.unique(np.array(list(first), dtype=np.float64)) * float(stream.time_base or 0)
            rate = usual_rate(times) if len(times) > 1 else 0.0
        return FilmFacts(rate, stream.frames or max(round(seconds * rate), 0))


def read_frames(path: str | Path, *, size: tuple[int, int] | None = None) -> Iterator[Frame]:
    """Frames of a film in their order, of which one at a time is in memory.

    Args:
        path: File of the film, or of a photo.
        size: Size (H, W) of the pictures [px], to which libav scales while it converts colours; None: the film's size.

    Raises:
        InputError: If PyAV is not installed, the file can't be read as a film, it has no frame, it has fewer frames
            than it states, or one is damaged. Frames before the fault are yielded first.
    """
    if is_photo(path):
        photo = read_photo(path)
        yield Frame(0, 0.0, photo if size is None else scaled(photo, size))
        return
    square = (0, 0)
    with _opened(path) as (container, stream):
        stream.thread_type = "AUTO"
        rate, packets = _stated_rate(stream), _Packets(path, container, stream)
        frames = ((frame, packets.time(frame)) for packet in packets for frame in packet.decode())
        step = 1 / (rate if 0 < rate <= _FASTEST else USUAL_RATE)
        for index, (frame, time, guessed) in enumerate(rising_times(frames, step)):
            if not index:
                square = _square_size(path, stream, frame)
                if size is not None:
                    square = size if _quarters(frame) % 2 else (size[1], size[0])
            # Some films change their size, but tracking needs pictures of one size.
            yield Frame(index, time, _upright(frame, square), guessed)
    if not square[0]:
        raise InputError(f"{path}: no frames; expected a film")
    if packets.fault:
        raise InputError(packets.fault)


class _Packets:
    """Packets of a film in the order of the file. After the last one, ``fault`` says if the film is cut off."""

    def __init__(self, path: str | Path, container: InputContainer, stream: VideoStream) -> None:
        self.fault = ""
        self._path, self._container, self._stream = path, container, stream
        self._count, self._listed = 0, len(stream.index_entries)
        # AVI states when frames are decoded. From these times, libav guesses when frames are shown. It guesses wrong if
        # the two orders differ.
        self.guesses = container.format.name == "avi" and stream.codec_context.has_b_frames
        self._decoded: deque[int] = deque()  # times of the packets whose frames are not shown yet, where it guesses

    def __iter__(self) -> Iterator[Packet]:
        for packet in self._container.demux(self._stream):
            if packet.size or packet.dts is not None:  # an empty packet only asks for the last frames
                self._count += 1
                if self.guesses and packet.dts is not None:
                    self._decoded.append(packet.dts)
            yield packet
        self.fault = self._cut_off()

    def time(self, frame: VideoFrame) -> float | None:
        """Time at which a frame is shown, as the file states it [s]; None if it states none.

        Call it once for each frame, in order.
        """
        ticks = frame.pts
        if self.guesses:  # the n-th frame that is shown has the time of the n-th frame that is decoded
            ticks = self._decoded.popleft() if self._decoded else None
        return None if ticks is None or frame.time_base is None else float(ticks * frame.time_base)

    def _cut_off(self) -> str:
        """Describe what is missing from a film whose last packet was read; empty if it is whole."""
        size, stated = os.stat(self._path).st_size, stated_bytes(self._path)
        frames, listed = self._stream.frames, self._listed
        if self._container.format.name == "avi":
            # A whole file may list fewer frames than its header counts: the recorder dropped the others.
            frames = listed if size + 1 >= stated > 0 else frames
        elif stated > size:
            return f"{self._path}: {size} of {stated} bytes in it; expected a whole film"
        elif frames:  # without those that an edit list leaves out
            frames = listed or frames
        if self._count < frames:
            return f"{self._path}: {self._count} of {frames} frames in it; expected a whole film"
        return ""


class FilmFrames:
    """Frames of a film by their index, in any thread. If they are read in about their order, each is decoded once.

    Attributes:
        path: File of the film.
        fault: Reason why there are fewer frames than the file states; None if none is missing.
    """

    def __init__(self, path: str | Path) -> None:
        """Count the frames, without decoding them.

        Raises:
            InputError: If PyAV is not installed, or the file can't be read as a film.
        """
        self.path = path
        times: list[int | None] = []
        last, rises = -math.inf, True
        with _opened(path) as (container, stream):
            packets = _Packets(path, container, stream)
            for packet in packets:
                if packet.size and not packet.is_discard:
                    times.append(packet.pts)
                    rises = rises and (packet.dts is None or packet.dts > last)
                    last = last if packet.dts is None else packet.dts
        self.fault = packets.fault or (None if times else f"{path}: no frames; expected a film")
        known = [time for time in times if time is not None]
        self._count = len(times)
        # If times are missing or not unique, frames can only be counted from the first one on.
        trusted = rises and not packets.guesses and len(set(known)) == len(times)
        self._times = sorted(known) if trusted else None
        self._lock = threading.Lock()
        self._ahead: OrderedDict[int, np.ndarray] = OrderedDict()
        self._decoded: Iterator[tuple[int, np.ndarray]] = iter(())
        self._next = math.inf  # index of the next frame of ``_decoded``

    def __len__(self) -> int:
        """Number of frames."""
        return self._count

    def read(self, index: int) -> np.ndarray:
        """Read a frame by its index, 0 for the first: RGB, shape (H, W, 3), uint8, upright, with square pixels.

        Raises:
            InputError: If there is no such frame, or it is damaged.
        """
        if not 0 <= index < self._count:
            raise InputError(f"{self.path}: frame {index}; expected 0 to {self._count - 1}")
        with self._lock:
            if (picture := self._ahead.pop(index, None)) is not None:
                return picture
            if not self._next <= index <= self._next + _NEAR:
                self._decoded = self._decode(index)
            self._next = math.inf  # after a fault
            for number, picture in self._decoded:
                if number >= index:
                    self._next = number + 1
                    if number == index:
                        return picture
                self._ahead[number] = picture
                if len(self._ahead) > _NEAR:
                    self._ahead.popitem(last=False)
                if number > index:
                    break
            raise InputError(f"{self.path}: frame {index}: damaged; expected a whole film")

    def _decode(self, first: int) -> Iterator[tuple[int, np.ndarray]]:
        """Indices and pictures of frames, from index ``first`` on."""
        if is_photo(self.path):
            yield 0, read_photo(self.path)
            return
        indices = None if self._times is None else {time: index for index, time in enumerate(self._times)}
        with _opened(self.path) as (container, stream):
            stream.thread_type = "AUTO"
            if first and self._times is not None:
                container.seek(self._times[first], stream=stream)  # to the last key frame before
            for count, frame in enumerate(container.decode(stream)):
                number = count if indices is None or frame.pts is None else indices.get(frame.pts)
                if number is not None and number >= first:
                    yield number, _upright(frame, _square_size(self.path, stream, frame))


def scaled(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Scale a picture, RGB, uint8, to a size (H, W) [px]; return it unchanged if it has that size already."""
    if picture.shape[:2] == size:
        return picture
    from PIL import Image

    return np.asarray(Image.fromarray(picture).resize((size[1], size[0]), Image.Resampling.BILINEAR))


def is_photo(path: str | Path) -> bool:
    """True for a photo's file. Libav could read it, too, but does not mirror it if its EXIF data say so."""
    return ending_of(str(path)) in PHOTO_SUFFIXES


@contextmanager
def _opened(path: str | Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    """Open a file and its first film stream; any fault becomes an InputError."""
    check_pyav(path)
    import av

    try:
        check_regular(path)  # libav would take addresses, too
        with av.open(str(Path(path).resolve())) as container:
            if not container.streams.video:
                raise InputError(f"{path}: no pictures in it; expected a film")
            yield container, container.streams.video[0]
    except (av.error.FFmpegError, OSError, ValueError, MemoryError) as error:
        if isinstance(error, InputError):
            raise
        text = "no frames" if isinstance(error, av.error.EOFError) else cause(error)
        raise InputError(f"{path}: {text}; expected a film") from error


def _stated_rate(stream: VideoStream) -> float:
    """Frames a second on average, as the file states them; 0 if it does not."""
    return float(stream.average_rate or stream.guessed_rate or 0)


def _square_size(path: str | Path, stream: VideoStream, frame: VideoFrame) -> tuple[int, int]:
    """Width and height of a frame with square pixels."""
    size = max(round(frame.width * float(stream.sample_aspect_ratio or 1)), 1), frame.height
    if size[0] * size[1] > LARGEST_PICTURE:
        raise InputError(f"{path}: frames of {size[0]}x{size[1]}; expected smaller ones")
    return size


def _upright(frame: VideoFrame, size: tuple[int, int]) -> np.ndarray:
    """Pixels of a frame, turned upright; ``size`` is the width and height before that."""
    pixels = frame.to_ndarray(format="rgb24", width=size[0], height=size[1])
    return np.ascontiguousarray(np.rot90(pixels, _quarters(frame)))


def _quarters(frame: VideoFrame) -> int:
    """Quarter turns, counterclockwise, that make a frame upright."""
    return round(frame.rotation / 90)
