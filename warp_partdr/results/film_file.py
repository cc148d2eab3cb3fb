"""Films as files, made from pictures. PyAV writes them, which the extra "film" installs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from ..inputs.films import check_pyav

_CODECS = ("libx264", "libopenh264", "mpeg4")  # the codec that most players know comes first
_TICK = Fraction(1, 60_000)  # [s], unit of times; MPEG-4 has no finer one than 1/65535


def write_film(
    path: Path, pictures: Iterable[np.ndarray], rate: float, times: Sequence[float] | np.ndarray | None = None
) -> None:
    """Write pictures as a film.

    Args:
        path: Path of the .mp4.
        pictures: Pictures, RGB, shape (H, W, 3), uint8, all of one size. If a side is odd, its last row or column is
            left out.
        rate: Pictures a second.
        times: Times of the pictures [s], rising, at least as many as pictures; None: they have a constant rate.

    Raises:
        InputError: If PyAV is not installed.
    """
    check_pyav(path)
    import av
    from av.video.stream import VideoStream

    known = next(name for name in _CODECS if name in av.codecs_available)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(known, rate=Fraction(rate).limit_denominator(1001))
        assert isinstance(stream, VideoStream)
        stream.pix_fmt = "yuv420p"
        if times is not None:
            stream.time_base = stream.codec_context.time_base = _TICK
        if known == "libx264":
            stream.options = {"preset": "veryfast"}  # a third of the usual preset's time, about as large
        for number, picture in enumerate(pictures):
            height = picture.shape[0] - picture.shape[0] % 2
            width = picture.shape[1] - picture.shape[1] % 2
            if not number:
                stream.width, stream.height = width, height
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture[:height, :width]), format="rgb24")
            if times is not None:
                frame.pts, frame.time_base = round(float(times[number]) / _TICK), _TICK
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
