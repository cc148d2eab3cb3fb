"""The demo in a browser: pages are served, keys, mouse and controls reach the window, and pictures come back."""

from __future__ import annotations

import asyncio
import gc
import io
import itertools
import json
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest
from conftest import HANG
from helpers import viewer
from helpers.viewer import make_state
from PIL import Image
from typer.testing import CliRunner

from warp_partdr import PART_NAMES, InputError
from warp_partdr.cli.main import app
from warp_partdr.viewer import web
from warp_partdr.viewer.targets import body_of
from warp_partdr.viewer.window import Window

SIZE = (640, 400)


open_window = viewer.open_window  # a fixture


@pytest.fixture
def window(open_window):
    pytest.importorskip("aiohttp", reason="the extra demo isn't installed")
    return open_window(make_state())


class Browser:
    """The page's scripts, as far as they matter here."""

    def __init__(self, session: Any, connection: Any, address: str, size: tuple[int, int]) -> None:
        self.address, self.controls = address, {}
        self._session, self._connection, self._numbers = session, connection, itertools.count(1)
        self._look = {"width": size[0], "height": size[1], "zoom": 1.0, "more": False}
        self._shown = {"number": 0, "quality": 0, "rate": 1e9}

    @classmethod
    @asynccontextmanager
    async def open(cls, address: str, size: tuple[int, int] = SIZE, *, more: bool = False) -> AsyncIterator[Browser]:
        import aiohttp

        async with (
            aiohttp.ClientSession(headers={"Origin": address}) as session,
            session.ws_connect(f"{address}/messages") as connection,
        ):
            browser = cls(session, connection, address, size)
            await browser.look(visible=True, more=more)
            yield browser

    async def look(self, *, visible: bool, more: bool = False) -> None:
        self._look["more"] = more
        await self.tell("look", visible=visible, more=more)

    async def send(self, do: str, **values: Any) -> int:
        """Send a message; the number that its answer will bear."""
        number = next(self._numbers)
        await self._connection.send_json({"do": do, "id": number} | values)
        return number

    async def tell(self, do: str, **values: Any) -> None:
        """Send a message and wait until it is done."""
        number = await self.send(do, **values)
        while (answer := await self.hear()).get("done") != number:
            assert "fault" not in answer, answer

    async def hear(self) -> dict[str, Any]:
        """The next message of the server, of which those about controls are kept."""
        told = await self._connection.receive_json(timeout=HANG)
        if "above" in told:
            self.controls = told
        return told

    async def press(self, key: str) -> None:
        await self.tell("press", key=key)

    def find(self, text: str) -> dict[str, Any]:
        """Place of the control with a text, as messages about it name it."""
        for row, entries in enumerate([*self.controls["above"], *self.controls["below"]]):
            for at, entry in enumerate(entries):
                if entry["text"] == text:
                    return {"more": self.controls["more"], "row": row, "at": at, "text": text}
        raise AssertionError(f"no {text} in {self.controls}")

    async def picture(self) -> np.ndarray:
        """The next one, asked for as the page does."""
        async with self._session.post(f"{self.address}/picture", json=self._shown | self._look) as answer:
            assert answer.status == 200, await answer.text()
            told = json.loads(answer.headers["X-Picture"])
            assert told["waited"] >= 0
            assert told["number"] > self._shown["number"] or told["quality"] > self._shown["quality"]
            self._shown |= told
            return np.asarray(Image.open(io.BytesIO(await answer.read())))

    async def mouse(self, kind: str, x: float, y: float) -> None:
        await self.tell("mouse", kind=kind, x=x, y=y, shift=False, **self._look)

    def break_off(self) -> None:
        """Be gone without a word, as when a page is closed while messages come."""
        self._connection.get_extra_info("socket").shutdown(socket.SHUT_RDWR)


def visit(window: Window, visitor: Callable[[Browser], Coroutine[Any, Any, None]]) -> None:
    """Serve a window while a browser is there."""

    async def both() -> None:
        opened: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        serving = asyncio.ensure_future(web.serve(window, "127.0.0.1", 0, opened.set_result))
        port = await asyncio.wait_for(opened, HANG)
        try:
            async with Browser.open(f"http://127.0.0.1:{port}") as browser:
                await visitor(browser)
        finally:
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)
        with socket.socket() as again:
            assert again.connect_ex(("127.0.0.1", port)) != 0  # nobody listens any more

    asyncio.run(both())


def test_keys_and_clicks_reach_the_window_and_pictures_show_it(window):
    async def visitor(browser: Browser) -> None:
        before = await browser.picture()
        assert before.shape == (SIZE[1], SIZE[0], 3)
        assert len(np.unique(before.reshape(-1, 3), axis=0)) > 100
        renderer = window.scene.body_view
        renderer.SetWorldPoint(*window.scene.parts[PART_NAMES.index("right_forearm")].center, 1)
        renderer.WorldToDisplay()
        x, y, _ = renderer.GetDisplayPoint()
        for kind in ("MouseMove", "LeftButtonPress", "LeftButtonRelease"):
            await browser.mouse(kind, x / SIZE[0], 1 - y / SIZE[1])
        assert window.controls.part == "right_forearm"
        await browser.press("n")
        assert len(window.state.history) == 1
        await browser.press("no key")
        await browser.press("F4")
        for _ in range(10):  # those before it may be on their way
            after = await browser.picture()
            if (np.abs(after.astype(int) - before).max(-1) > 50).mean() > 0.01:
                return
        raise AssertionError("the picture didn't change")

    visit(window, visitor)
    assert not np.array_equal(window.state.body.rotations.detach(), body_of("t-pose").rotations)


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(120):  # only what hangs takes as long
        while not condition():
            await asyncio.sleep(0.01)


def test_a_page_that_stands_still_holds_up_nobody(window):
    drawn = []
    window.scene.plotter.render_window.AddObserver("EndEvent", lambda *_: drawn.append(len(window.state.history)))

    async def visitor(browser: Browser) -> None:
        still = await asyncio.open_connection(*browser.address.removeprefix("http://").split(":"), limit=1000)
        shown = {"number": 0, "quality": 0, "rate": 1e9, "width": 640, "height": 400, "zoom": 1, "more": False}
        body = json.dumps(shown).encode()
        head = f"POST /picture HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: {len(body)}\r\n\r\n"
        still[1].write(head.encode() + body)
        assert await still[0].readexactly(15) == b"HTTP/1.1 200 OK"  # and reads no more of it
        await browser.press("space")
        before = len(drawn)
        await until(lambda: len(window.state.history) > 10)
        assert len(drawn) == before  # it asks for no other one, so none is drawn, and none waits
        for count in range(3):
            await browser.picture()
            assert len(drawn) == before + count + 1
            assert drawn[-1] >= 10 + count
            await until(lambda: len(window.state.history) > drawn[-1])
        still[1].transport.abort()

    visit(window, visitor)


def test_pages_come_and_go_while_it_plays_without_a_word(window, caplog, monkeypatch):
    async def visitor(browser: Browser) -> None:
        await browser.press("space")
        for _ in range(3):
            async with Browser.open(browser.address) as gone:
                await gone.picture()
                asking = asyncio.ensure_future(gone.picture())
                for _ in range(30):
                    await gone.send("press", key="no key")
                gone.break_off()
                steps = len(window.state.history)
                await until(lambda: len(window.state.history) > steps + 2)  # noqa: B023
                asking.cancel()
        await browser.picture()
        gc.collect()  # faults of tasks that nobody asks for are told then
        await asyncio.sleep(0)
        assert caplog.records == []
        monkeypatch.setattr(window, "press", lambda key: 1 / 0)
        await browser.send("press", key="n")
        await until(lambda: "ZeroDivisionError" in caplog.text)

    visit(window, visitor)


def test_requests_of_pages_are_answered_and_those_of_others_refused(window):
    """Malformed requests are told. Pictures are as rough as the line is slow."""

    async def visitor(browser: Browser) -> None:
        import aiohttp

        address = browser.address
        async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=1)) as session:
            async with session.get(address) as page:
                assert page.status == 200
                assert page.headers["X-Frame-Options"] == "DENY"
                assert page.headers["Content-Encoding"] in ("gzip", "deflate")
                assert "<script" in await page.text()
            size = {"width": 640, "height": 400, "zoom": 1, "more": False}
            for body in (b"", b"[]", b"{}", b'{"number": "x", "quality": 0, "rate": 0}'):
                async with session.post(f"{address}/picture", data=body) as answer:
                    assert answer.status == 400
                    assert "expected number, quality, rate, width" in await answer.text()
            for side in (0, -3, 1e9, "wide", None):
                shown = {"number": 0, "quality": 0, "rate": 0} | size | {"width": side}
                async with session.post(f"{address}/picture", data=json.dumps(shown)) as answer:
                    assert answer.status == 400, side
            for rate, quality in ((0, 20), (1e9, 85)):  # what a slow line and a fast one carry
                shown = {"number": 0, "quality": 0, "rate": rate} | size
                async with session.post(f"{address}/picture", json=shown) as answer:
                    assert json.loads(answer.headers["X-Picture"])["quality"] == quality
            # a page whose name has come to mean this machine, too
            renamed = f"another.page:{address.rpartition(':')[2]}"
            for headers in ({"Origin": "http://another.page"}, {"Origin": f"http://{renamed}", "Host": renamed}):
                with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                    await session.ws_connect(f"{address}/messages", headers=headers)
                async with session.post(f"{address}/picture", headers=headers, data=b"{}") as answer:
                    assert answer.status == 403

    visit(window, visitor)


def test_a_second_page_is_served_as_well_as_the_first(window):
    """Each has pictures of its own size and its own screen, and both see and move the same body."""

    async def visitor(browser: Browser) -> None:
        async with Browser.open(browser.address, (390, 500), more=True) as second:
            for _ in range(2):
                first, other = await asyncio.gather(browser.picture(), second.picture())
                assert (first.shape, other.shape) == ((400, 640, 3), (500, 390, 3))
                await second.press("n")
            assert len(window.state.history) == 2
            while not (second.controls and browser.controls):
                await asyncio.gather(browser.press("no key"), second.press("no key"))
            assert second.find("E2")
            with pytest.raises(AssertionError, match="no E2"):
                browser.find("E2")
            await second.tell("click", **second.find("E2"))
            assert window.state.settings.renderer == "E2"
            await browser.tell("slide", **browser.find("how tall [%]"), value=105.0)
            assert window.state.share("lengths") == pytest.approx(1.05)
            stale = second.find("E0") | {"text": "another"}
            await second.tell("click", **stale)  # the controls were others meanwhile
            assert window.state.settings.renderer == "E2"

    visit(window, visitor)


def test_it_pauses_when_nobody_looks_and_says_so(window):
    async def visitor(browser: Browser) -> None:
        async with Browser.open(browser.address) as second:
            await browser.press("space")
            await browser.look(visible=False)
            assert window.controls.playing  # the second page is still seen
            await second.look(visible=False)
            assert not window.controls.playing
            assert window.scene.message == "Paused, because nobody looks. Press play to go on."
            count = len(window.state.history)
            await second.look(visible=True)
            assert len(window.state.history) == count
            await browser.press("space")
            await until(lambda: len(window.state.history) > count + 1)
            await browser.look(visible=False)
        await until(lambda: not window.controls.playing)  # the second page is closed

    visit(window, visitor)


def test_messages_that_are_malformed_are_told(window):
    async def visitor(browser: Browser) -> None:
        for values in ({"do": "click"}, {"do": "slide", "more": False, "row": 99, "at": 0, "text": "", "value": 0}, {}):
            await browser._connection.send_json(values)
            while "fault" not in (told := await browser.hear()):
                assert "done" not in told
        await browser._connection.send_str("no JSON")
        while "fault" not in await browser.hear():
            pass
        await browser.press("n")
        assert len(window.state.history) == 1

    visit(window, visitor)


def test_keys_have_names_in_a_browser(window):
    """Letters and function keys are called alike everywhere; others are in the table."""
    names = [web.BROWSER_NAMES.get(key, key) for key in window.keys]
    assert len(set(names)) == len(names)
    assert all(len(name) == 1 or name[0] == "F" or name in web.BROWSER_NAMES.values() for name in names)


def test_the_page_has_an_address_for_any_host():
    assert web.page_address("127.0.0.1", 80) == "http://127.0.0.1:80/"
    assert web.page_address("::1", 80) == "http://[::1]:80/"
    assert socket.gethostname() in web.page_address("::", 80)


def test_a_taken_port_is_one_line(window):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=rf"^--web: 127.0.0.1:{port}: Address .* in use; expected .*port=0"):
            asyncio.run(web.serve(window, "127.0.0.1", port, print))


def test_the_command_says_where_and_ends_with_ctrl_c(can_draw):
    pytest.importorskip("aiohttp", reason="the extra demo isn't installed")
    settings = ("--set", "port=0", "--set", "browser=false", "--set", "size=64")
    command = [sys.executable, "-m", "warp_partdr", "demo", "--web", *settings]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        while "shows the demo" not in (said := running.stdout.readline()):
            assert said, running.communicate()
        assert urllib.request.urlopen(said.split()[0], timeout=HANG).status == 200
        running.send_signal(signal.SIGINT)
        _, faults = running.communicate(timeout=HANG)
    assert "Traceback" not in faults
    assert running.returncode == 0


def test_a_missing_backend_is_an_error_that_names_it(monkeypatch):
    monkeypatch.setattr(web, "find_spec", lambda name: None)
    done = CliRunner().invoke(app, ["demo", "--web"])
    assert isinstance(done.exception, InputError)
    assert str(done.exception).startswith("--web: without aiohttp; expected it (pip install aiohttp), or")
