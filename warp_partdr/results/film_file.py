"""Films as files, of pictures one after another; PyAV writes them, the extra "film"."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from ..inputs.films import check_pyav

_CODECS = ("libx264", "libopenh264", "mpeg4")  # what players know best comes first
_TICK = Fraction(1, 60_000)  # [s], the unit of times; MPEG-4 has no finer one than 1/65535


def write_film(
    path: Path, pictures: Iterable[np.ndarray], rate: float, times: Sequence[float] | np.ndarray | None = None
) -> None:
    """Write pictures as a film.

    Args:
        path: Of an .mp4.
        pictures: RGB, shape (H, W, 3), uint8, all of one size, of which an odd row or column is left out.
        rate: Pictures a second.
        times: Of the pictures [s], rising, at least as many; None: they come evenly.

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
            height, width = (side - side % 2 for side in picture.shape[:2])
            if not number:
                stream.width, stream.height = width, height
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture[:height, :width]), format="rgb24")
            if times is not None:
                frame.pts, frame.time_base = round(float(times[number]) / _TICK), _TICK
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
