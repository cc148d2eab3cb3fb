"""The demo in a browser: the page is served, keys and mouse reach the window, and pictures come back."""

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
    pytest.importorskip("trame_pyvista", reason="the extra demo isn't installed")
    return open_window(make_state())


class Browser:
    """The page's scripts, as far as they matter here."""

    def __init__(self, session: Any, connection: Any, address: str) -> None:
        from wslink.chunking import UnChunker

        self.address = address
        self._session, self._connection, self._numbers, self._join = session, connection, itertools.count(), UnChunker()
        self._join.set_max_message_size(2**24)
        self._shown = {"number": 0, "quality": 0, "rate": 1e9}

    @classmethod
    @asynccontextmanager
    async def open(cls, address: str) -> AsyncIterator[Browser]:
        import aiohttp

        async with (
            aiohttp.ClientSession(headers={"Origin": address}) as session,
            session.ws_connect(f"{address}/ws") as connection,
        ):
            browser = cls(session, connection, address)
            await browser.call("wslink.hello", {"secret": "wslink-secret"})
            await browser.call("trame.rca.size", web.AREA, "browser", {"w": SIZE[0], "h": SIZE[1], "p": 1})
            yield browser

    async def send(self, method: str, *args: Any) -> str:
        """Send a message; the number that its answer will bear."""
        import msgpack
        from wslink.chunking import generate_chunks

        number = f"{'system' if method == 'wslink.hello' else 'rpc'}:browser:{next(self._numbers)}"
        message = {"wslink": "1.0", "id": number, "method": method, "args": list(args), "kwargs": {}}
        for chunk in generate_chunks(msgpack.packb(message), 0):
            await self._connection.send_bytes(chunk)
        return number

    async def call(self, method: str, *args: Any) -> Any:
        """Send a message and wait for its answer."""
        number = await self.send(method, *args)
        while (answer := await self._receive()).get("id") != number:
            pass
        assert "error" not in answer, answer
        return answer.get("result")

    async def press(self, key: str) -> None:
        await self.call("trame.trigger", "press", [key], {})

    async def picture(self) -> np.ndarray:
        """The next one, asked for as the page does."""
        async with self._session.post(f"{self.address}/picture", json=self._shown) as answer:
            assert answer.status == 200
            told = json.loads(answer.headers["X-Picture"])
            assert told["waited"] >= 0
            assert told["number"] > self._shown["number"] or told["quality"] > self._shown["quality"]
            self._shown |= told
            return np.asarray(Image.open(io.BytesIO(await answer.read())))

    async def mouse(self, kind: str, x: float, y: float) -> None:
        event = {"x": round(x), "y": round(y), "w": SIZE[0], "h": SIZE[1]}
        keys = dict.fromkeys(("shiftKey", "altKey", "ctrlKey", "metaKey"), 0)
        await self.call("trame.rca.event", web.AREA, "browser", {"type": kind, **event, **keys})

    def break_off(self) -> None:
        """Be gone without a word, as when a page is closed while messages come."""
        self._connection.get_extra_info("socket").shutdown(socket.SHUT_RDWR)

    async def _receive(self) -> dict:
        while True:
            message = self._join.process_chunk((await self._connection.receive(timeout=HANG)).data)
            if message is not None:
                return message


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
        renderer = window.scene.plotter.renderers[0]
        renderer.SetWorldPoint(*window.scene.parts[PART_NAMES.index("right_forearm")].center, 1)
        renderer.WorldToDisplay()
        x, y, _ = renderer.GetDisplayPoint()
        for kind in ("MouseMove", "LeftButtonPress", "LeftButtonRelease"):
            await browser.mouse(kind, x, y)
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
        body = b'{"number": 0, "quality": 0, "rate": 1e9}'
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
                    await gone.send("trame.trigger", "answer", [], {})
                gone.break_off()
                steps = len(window.state.history)
                await until(lambda: len(window.state.history) > steps + 2)  # noqa: B023
                asking.cancel()
        await browser.picture()
        gc.collect()  # faults of tasks that nobody asks for are told then
        await asyncio.sleep(0)
        assert caplog.records == []
        monkeypatch.setattr(window, "press", lambda key: 1 / 0)
        await browser.send("trame.trigger", "press", ["n"], {})
        await until(lambda: "ZeroDivisionError" in caplog.text)

    visit(window, visitor)


def test_requests_of_pages_are_answered_and_those_of_others_refused(window):
    """The page is sent once. What is malformed is told. Pictures are as rough as the line is slow."""

    async def visitor(browser: Browser) -> None:
        import aiohttp

        address = browser.address
        async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=1)) as session:
            for _ in range(2):
                async with session.get(address) as page:
                    assert page.status == 200
                    assert page.headers["X-Frame-Options"] == "DENY"
                    assert page.headers["Content-Encoding"] in ("gzip", "deflate")
                    assert "<script" in await page.text()
                async with session.get(address, headers={"If-None-Match": page.headers["ETag"]}) as same:
                    assert same.status == 304
                    assert await same.read() == b""
            for body in (b"", b"[]", b"{}", b'{"number": "x", "quality": 0, "rate": 0}'):
                async with session.post(f"{address}/picture", data=body) as answer:
                    assert answer.status == 400
                    assert "expected number, quality and rate" in await answer.text()
            for rate, quality in ((0, 20), (1e9, 85)):  # what a slow line and a fast one carry
                shown = {"number": 0, "quality": 0, "rate": rate}
                async with session.post(f"{address}/picture", json=shown) as answer:
                    assert json.loads(answer.headers["X-Picture"])["quality"] == quality
            # a page whose name has come to mean this machine, too
            renamed = f"another.page:{address.rpartition(':')[2]}"
            for headers in ({"Origin": "http://another.page"}, {"Origin": f"http://{renamed}", "Host": renamed}):
                with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                    await session.ws_connect(f"{address}/ws", headers=headers)
                async with session.post(f"{address}/picture", headers=headers, data=b"{}") as answer:
                    assert answer.status == 403

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
    pytest.importorskip("trame_pyvista", reason="the extra demo isn't installed")
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
    assert str(done.exception).startswith("--web: without trame-pyvista; expected it (pip install trame-pyvista), or")
