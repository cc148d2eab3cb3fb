"""The demo in a browser: pictures are drawn here and sent there; mouse, keys and controls come back to the window."""

from __future__ import annotations

import asyncio
import io
import json
import logging
import os
import socket
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from PIL import Image

from ..errors import InputError
from .buttons import Button, Entry, Rows, Slider
from .controlled import ControlledWindow
from .plotted import Look
from .stream import PictureStream
from .web_page import demo_page

_ALL_ADDRESSES = ("0.0.0.0", "::")  # hosts that mean each of this machine's addresses
_LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")
_REST = 0.015  # [s] between a picture and the next step, in which messages come and go
_PIXELS, _SIDE = 1_500_000, (160, 4096)  # of a picture, at most; and the shortest and longest side
_LOGS = ("asyncio", "aiohttp.server")  # that say at length that a page is gone
_BEAT = 20.0  # [s] after which a page that says nothing is asked if it is there
_SOON = 0.05  # [s] between two descriptions of the controls
BROWSER_NAMES = {  # of keys, where browsers call them otherwise than VTK does
    "space": " ",
    "BackSpace": "Backspace",
    "bracketleft": "[",
    "bracketright": "]",
    "comma": ",",
    "period": ".",
    "Left": "ArrowLeft",
    "Right": "ArrowRight",
}
_MOUSE = {
    name: f"{name}Event"
    for name in ("LeftButtonPress", "LeftButtonRelease", "MouseMove", "MouseWheelForward", "MouseWheelBackward")
}


def check_backend() -> None:
    """Raise InputError where the web server isn't installed."""
    if find_spec("aiohttp") is None:
        raise InputError(
            "--web: without aiohttp; expected it (pip install aiohttp), or --record out.html, a page that needs "
            "nothing more"
        )


async def serve(window: ControlledWindow, host: str, port: int, ready: Callable[[int], None]) -> None:
    """Show an off-screen window as a page, and play, until cancelled; all who open it see and move the same body.

    ``ready`` is called with the port when the page can be opened; port 0 takes a free one. An InputError says why it
    can't listen there.
    """
    web = import_module("aiohttp.web")
    for name in _LOGS:
        logging.getLogger(name).addFilter(_is_of_open_page)
    pages = _Pages(window)
    app = web.Application(middlewares=[_make_guard(host)])
    app.router.add_get("/", pages.show)
    app.router.add_post("/picture", pages.picture)
    app.router.add_get("/messages", pages.talk)
    runner = web.AppRunner(app, access_log=None, shutdown_timeout=1.0)
    await runner.setup()
    try:
        site = web.TCPSite(runner, host, port)
        try:
            await site.start()
        except OSError as error:
            reason = error.strerror if isinstance(error, socket.gaierror) else os.strerror(error.errno or 0)
            raise InputError(
                f"--web: {host}:{port}: {reason}; expected this machine's address and a free port (--set port=0 takes "
                "any)"
            ) from error
        ready(runner.addresses[0][1])
        await _play(window)
    finally:
        await pages.close()
        await runner.cleanup()


class _Page:
    """A page that is open: whether somebody sees it, and whether it shows everything."""

    def __init__(self, connection: Any) -> None:
        self.connection = connection
        self.visible, self.more = True, False


class _Pages:
    """All pages that are open."""

    def __init__(self, window: ControlledWindow) -> None:
        self._window, self._open = window, set[_Page]()
        plotter = window.scene.plotter
        plotter.iren.initialize()
        window.scene.screenshot()  # else PyVista takes none later
        plotter.suppress_rendering = True  # drawn when it is sent, and once is enough
        self._pictures = PictureStream(self._draw, _encode)
        window.changed = self._pictures.change

    async def close(self) -> None:
        """Let all pages go."""
        self._pictures.close()
        for each in list(self._open):
            await each.connection.close()

    def _draw(self, look: Look) -> np.ndarray:
        self._window.arrange(look)
        return self._window.scene.screenshot()

    async def show(self, request: Any) -> Any:
        """Answer with the page itself."""
        web = import_module("aiohttp.web")
        keys = {BROWSER_NAMES.get(key, key): key for key in self._window.keys}
        answer = web.Response(
            text=demo_page(keys, self._window.tall), content_type="text/html", headers={"Cache-Control": "no-cache"}
        )
        answer.enable_compression()
        return answer

    async def picture(self, request: Any) -> Any:
        """Answer a page that shows a picture and asks for the next."""
        web, clock = import_module("aiohttp.web"), asyncio.get_running_loop().time
        if self._pictures.closed:
            raise web.HTTPServiceUnavailable
        asked = clock()
        try:
            shown = await request.json()
            number, quality, rate = int(shown["number"]), int(shown["quality"]), float(shown["rate"])
            look = _look(shown)
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise web.HTTPBadRequest(
                text=f"{error}; expected number, quality, rate, width, height, zoom and more"
            ) from error
        picture = await self._pictures.after(look, number, quality, rate)
        told = {"number": picture.number, "quality": picture.quality, "waited": clock() - asked}
        headers = {"X-Picture": json.dumps(told), "Cache-Control": "no-store"}
        return web.Response(body=picture.content, content_type="image/jpeg", headers=headers)

    async def talk(self, request: Any) -> Any:
        """Take a page's messages, and tell it of its controls, until it is closed."""
        web = import_module("aiohttp.web")
        connection = web.WebSocketResponse(heartbeat=_BEAT, max_msg_size=2**16)
        await connection.prepare(request)
        opened = _Page(connection)
        self._open.add(opened)
        telling = asyncio.ensure_future(self._tell(opened))
        try:
            async for message in connection:
                try:
                    told = json.loads(message.data)
                    self._take(opened, told)
                    answer = {"done": told.get("id")}
                except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError) as error:
                    answer = {"fault": f"{type(error).__name__}: {error}"}
                await connection.send_json(answer)
        except ConnectionError:
            pass
        finally:
            telling.cancel()
            self._open.discard(opened)
            self._watch()
        return connection

    async def _tell(self, opened: _Page) -> None:
        """Tell a page of its controls, each time that they have changed."""
        last = ""
        try:
            while not opened.connection.closed:
                now = json.dumps(self._described(opened.more))
                if now != last:
                    last = now
                    await opened.connection.send_str(now)
                    await asyncio.sleep(_SOON)
                    continue
                await self._pictures.changed()
        except ConnectionError:
            pass

    def _take(self, opened: _Page, told: dict[str, Any]) -> None:
        """Do what a page says."""
        window, kind = self._window, told["do"]
        if kind == "look":
            opened.visible, opened.more = bool(told["visible"]), bool(told["more"])
            self._watch()
            self._pictures.change()
        elif kind == "press":
            if told["key"] in window.keys:
                window.press(told["key"])
        elif kind in ("click", "slide"):
            above, below = window.rows(bool(told["more"]))
            entry = [*above, *below][int(told["row"])][int(told["at"])]
            if kind == "click" and isinstance(entry, Button) and entry.text == told["text"]:
                window.click(entry)
            elif kind == "slide" and isinstance(entry, Slider) and entry.title == told["text"]:
                window.pull(entry, float(told["value"]))
        elif kind == "mouse":
            self._point(told)

    def _point(self, told: dict[str, Any]) -> None:
        """Do what the mouse or a finger does at a place, shares of the picture's width and height."""
        look = _look(told)
        x, y = float(told["x"]) * look.size[0], (1 - float(told["y"])) * look.size[1]
        self._window.arrange(look)
        interactor = self._window.scene.plotter.iren.interactor
        interactor.SetEventInformation(round(x), round(y), 0, int(bool(told["shift"])), "\0", 0, None)
        interactor.InvokeEvent(_MOUSE[told["kind"]])
        self._pictures.change()

    def _watch(self) -> None:
        """Pause where nobody looks: no page is open, or none is to be seen."""
        if not any(each.visible for each in self._open):
            self._window.pause()

    def _described(self, more: bool) -> dict[str, Any]:
        """The controls above and below the picture."""
        above, below = self._window.rows(more)
        return {"more": more, "above": _rows_described(above), "below": _rows_described(below)}


def _rows_described(rows: Rows) -> list[list[dict[str, Any]]]:
    return [[_described(entry) for entry in row] for row in rows]


def _described(entry: Entry) -> dict[str, Any]:
    if isinstance(entry, str):
        return {"kind": "text", "text": entry}
    if isinstance(entry, Slider):
        told = {"text": entry.title, "low": entry.low, "high": entry.high, "value": entry.value, "shown": entry.shown}
        return {"kind": "slider"} | told
    return {"kind": "button", "text": entry.text, "hint": entry.hint, "key": entry.key} | {
        "colour": entry.colour if entry.is_on() else ""
    }


def _look(told: dict[str, Any]) -> Look:
    """The picture that a page shows; a ValueError says that its size can't be drawn."""
    width, height = float(told["width"]), float(told["height"])
    if not (0 < width < 1e5 and 0 < height < 1e5):
        raise ValueError(f"size: {width:g} x {height:g}")
    shrink = min(1.0, (_PIXELS / (width * height)) ** 0.5)
    size = (int(min(max(side * shrink, _SIDE[0]), _SIDE[1])) for side in (width, height))
    zoom = min(max(float(told["zoom"]), 0.5), 4.0) * shrink
    return Look((next(size), next(size)), bool(told["more"]), zoom=zoom)


def _encode(image: np.ndarray, quality: int) -> bytes:
    Image.fromarray(image).save(file := io.BytesIO(), "JPEG", quality=quality)
    return file.getvalue()


def _make_guard(host: str) -> Any:
    """Guard that turns down messages from other pages that are open in the user's browser.

    Neither may they pass as its own page under another name for this machine (DNS rebinding), nor lie over it.
    """
    web = import_module("aiohttp.web")
    names = {host.lower(), *_LOCAL_NAMES}

    async def guard(request: Any, handler: Callable[[Any], Any]) -> Any:
        if host not in _ALL_ADDRESSES and urlsplit(f"//{request.host}").hostname not in names:
            raise web.HTTPForbidden(text=f"the demo answers to {', '.join(sorted(names))}")
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != request.host:
            raise web.HTTPForbidden(text="the demo takes messages from its own page only")
        response = await handler(request)
        if not response.prepared:
            response.headers["X-Frame-Options"] = "DENY"
        return response

    return web.middleware(guard)


def _is_of_open_page(record: logging.LogRecord) -> bool:
    """False for a record of a page that was closed while something was on its way to it."""
    return not isinstance((record.exc_info or sys.exc_info())[1], ConnectionError)


async def _play(window: ControlledWindow) -> None:
    while True:
        window.tick()
        await asyncio.sleep(_REST)


def page_address(host: str, port: int) -> str:
    """Address of the page that ``serve`` shows."""
    name = socket.gethostname() if host in _ALL_ADDRESSES else host
    return f"http://[{name}]:{port}/" if ":" in name else f"http://{name}:{port}/"
