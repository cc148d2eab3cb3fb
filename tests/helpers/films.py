"""Films that tests write."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

av = pytest.importorskip("av", reason="needs PyAV, the extra film")


def write_film(
    path: Path,
    pictures: Iterable[np.ndarray],
    *,
    rate: int = 10,
    turned: int = 0,
    times: Iterable[int] = (),
    between: int = 0,
    **options: str,
) -> Path:
    """A film of pictures of even size.

    Args:
        path: The file.
        pictures: RGB, shape (H, W, 3), uint8.
        rate: Frames a second.
        turned: Degrees counter-clockwise by which players turn it.
        times: Of each frame, in frames of ``rate``; default: 0, 1, ...
        between: Frames in a row that are decoded after a later one (B-frames), at most.
        options: Of libav's writer.
    """
    pictures, times = list(pictures), list(times)
    with av.open(str(path), "w", options=options) as container:
        stream = container.add_stream("mpeg4", rate=rate)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt, stream.bit_rate = "yuv420p", 8_000_000
        stream.codec_context.max_b_frames = between
        if turned:
            stream.set_display_rotation(turned)
        for index, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts = times[index] if times else index
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path
