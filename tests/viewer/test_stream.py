"""Pictures for pages: as good as the line allows, the newest, and a better one when nothing changes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from functools import wraps
from typing import Any

import pytest

from warp_partdr.viewer.stream import JpegPicture, PictureStream


class Drawn:
    """A window whose picture is the count of those drawn so far."""

    count = 0

    @property
    def img_cols_rows(self) -> tuple[int, int, int]:
        self.count += 1
        return self.count, 0, 0


def encode(image: int, columns: int, rows: int, quality: int) -> tuple[bytes]:
    """It has as many bytes as the quality says."""
    return (bytes([image]) * quality,)


@pytest.fixture
def made():
    return PictureStream(Drawn(), encode)


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
    picture = await made.after(0, 0, rate)
    assert picture == (1, quality, b"\1" * quality)


@asynchronous
async def test_changes_that_nobody_saw_are_not_drawn(made):
    first = await made.after(0, 0, 1e9)
    waiting = asyncio.ensure_future(made.after(first.number, first.quality, 1e9))
    assert await waits(waiting)
    for _ in range(10):
        made.schedule_render()
    picture = await waiting
    assert picture.number == first.number + 10
    assert made.rca.count == 2


@asynchronous
async def test_a_rough_picture_is_followed_by_a_better_one_when_it_is_quiet(made):
    rough = await made.after(0, 0, 80)
    assert rough.quality == 30
    better = await made.after(rough.number, rough.quality, 80)  # 0.8 s of the line
    assert better == (rough.number, 55, b"\1" * 55)
    waiting = asyncio.ensure_future(made.after(better.number, better.quality, 80))
    assert await waits(waiting)  # the line carries no better one
    made.schedule_render()
    assert await waiting == (rough.number + 1, 30, b"\2" * 30)


@asynchronous
async def test_two_pages_share_what_is_drawn(made):
    both = await asyncio.gather(made.after(0, 0, 0), made.after(0, 0, 1e9))
    assert [picture.quality for picture in both] == [20, 85]
    assert made.rca.count == 1


@asynchronous
async def test_nobody_waits_for_one_that_is_closed(made):
    picture = await made.after(0, 0, 1e9)
    waiting = asyncio.ensure_future(made.after(picture.number, picture.quality, 1e9))
    assert await waits(waiting)
    await made.close()
    await waiting
    assert made.closed
