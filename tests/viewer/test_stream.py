"""Pictures for pages: as good as the line allows, the newest, and a better one when nothing changes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from functools import wraps
from typing import Any

import numpy as np
import pytest

from warp_partdr.viewer.plotted import Look
from warp_partdr.viewer.stream import JpegPicture, PictureStream

SMALL, LARGE = Look((320, 200)), Look((640, 400), more=True)


class Drawn:
    """A window whose picture is the count of those drawn so far."""

    count = 0

    def draw(self, look: Look) -> np.ndarray:
        self.count += 1
        return np.array([self.count])


def encode(image: np.ndarray, quality: int) -> bytes:
    """It has as many bytes as the quality says."""
    return bytes(image.tolist()) * quality


@pytest.fixture
def window():
    return Drawn()


@pytest.fixture
def made(window):
    return PictureStream(window.draw, encode)


def asynchronous(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Test that runs in an event loop of its own."""

    @wraps(test)
    def run(**arguments: Any) -> None:
        asyncio.run(asyncio.wait_for(test(**arguments), 60))

    return run


async def waits(task: asyncio.Future[JpegPicture]) -> bool:
    """True if a task stands still though nothing else is to be done."""
    await asyncio.sleep(0.7)
    return not task.done()


@pytest.mark.parametrize(("rate", "quality"), [(0, 20), (25, 20), (100, 40), (200, 70), (1e9, 85)])
@asynchronous
async def test_quality_is_what_a_line_carries_in_04_s(made, rate, quality):
    picture = await made.after(SMALL, 0, 0, rate)
    assert picture == (1, quality, b"\1" * quality)


@asynchronous
async def test_changes_that_nobody_saw_are_not_drawn(made, window):
    first = await made.after(SMALL, 0, 0, 1e9)
    waiting = asyncio.ensure_future(made.after(SMALL, first.number, first.quality, 1e9))
    assert await waits(waiting)
    for _ in range(10):
        made.change()
    picture = await waiting
    assert picture.number == first.number + 10
    assert window.count == 2


@asynchronous
async def test_a_rough_picture_is_followed_by_a_better_one_when_it_is_quiet(made):
    rough = await made.after(SMALL, 0, 0, 80)
    assert rough.quality == 30
    better = await made.after(SMALL, rough.number, rough.quality, 80)  # 0.8 s of the line
    assert better == (rough.number, 55, b"\1" * 55)
    waiting = asyncio.ensure_future(made.after(SMALL, better.number, better.quality, 80))
    assert await waits(waiting)  # the line carries no better one
    made.change()
    assert await waiting == (rough.number + 1, 30, b"\2" * 30)


@asynchronous
async def test_two_pages_share_what_is_drawn(made, window):
    both = await asyncio.gather(made.after(SMALL, 0, 0, 0), made.after(SMALL, 0, 0, 1e9))
    assert [picture.quality for picture in both] == [20, 85]
    assert window.count == 1


@asynchronous
async def test_pages_of_two_sizes_have_a_picture_each_of_every_change(made, window):
    for number in (1, 2):
        both = await asyncio.gather(*(made.after(look, number - 1, 0, 1e9) for look in (SMALL, LARGE)))
        assert [picture.number for picture in both] == [number, number]
        assert both[0].content != both[1].content
        assert window.count == 2 * number
        made.change()


@asynchronous
async def test_nobody_waits_for_one_that_is_closed(made):
    picture = await made.after(SMALL, 0, 0, 1e9)
    waiting = asyncio.ensure_future(made.after(SMALL, picture.number, picture.quality, 1e9))
    assert await waits(waiting)
    made.close()
    await waiting
    assert made.closed
