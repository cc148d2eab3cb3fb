"""The demo in a browser: pictures are drawn here and sent there; mouse and keys come back to the same window."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import socket
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any
from urllib.parse import urlsplit

from ..errors import InputError
from .controlled import ControlledWindow
from .stream import PictureStream
from .style import ACCENT, PAPER

_ALL_ADDRESSES = ("0.0.0.0", "::")  # hosts that mean each of this machine's addresses
_LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")
AREA = "demo"  # what messages about the picture are addressed to
_REST = 0.015  # [s] between a picture and the next step, in which messages come and go
_PIXELS = 1_500_000  # of a picture, at most; screens have more
_LOGS = ("asyncio", "aiohttp.server", "wslink.protocol")  # that say at length that a page is gone
_CONDITIONS = ("If-Match", "If-None-Match", "If-Modified-Since", "If-Unmodified-Since", "Range")
_MOVES = 50  # [ms] between places of the mouse
BROWSER_NAMES = {  # of keys, where browsers call them otherwise than VTK does
    "space": " ",
    "BackSpace": "Backspace",
    "bracketleft": "[",
    "bracketright": "]",
    "comma": ",",
    "period": ".",
}
_STYLE = """
html, body { margin: 0; background: PAPER; }
.picture { position: absolute; inset: 0; width: 100%; height: 100%; pointer-events: none; }
.busy, .idle { position: fixed; top: 45%; left: 20%; padding: 0.5em 1em; pointer-events: none; }
.busy, .idle { font: 16px sans-serif; color: white; background: ACCENT; border-radius: 6px; }
.busy { opacity: 1; transition: opacity 0.1s 0.5s; }  /* what takes less shows by itself */
.idle { opacity: 0; }
"""
_PLACE = "position: absolute; inset: 0; min-width: 1200px; min-height: 750px"  # what words and buttons take
_SCRIPT = """
const keys = KEYS;
document.addEventListener("keydown", event => {
  if (event.ctrlKey || event.altKey || event.metaKey || !(event.key in keys)) return;
  event.preventDefault();  // F5 loads no page anew
  if (!event.repeat) window.trame.trigger("press", [keys[event.key]]);
});
document.addEventListener("pointerdown", () => setTimeout(() => window.trame.trigger("answer"), 100), true);
const watch = async () => {
  let shown = {number: 0, quality: 0, rate: 0};
  for (;;) try {
    await new Promise(requestAnimationFrame);  // the last one is on the screen; a hidden page asks for none
    const asked = performance.now();
    const answer = await fetch("picture", {method: "POST", body: JSON.stringify(shown)}), file = await answer.blob();
    const seconds = (performance.now() - asked) / 1000, told = JSON.parse(answer.headers.get("X-Picture"));
    const picture = document.querySelector(".picture"), address = URL.createObjectURL(file);
    picture.src = address;
    await picture.decode().finally(() => URL.revokeObjectURL(address));
    shown = {number: told.number, quality: told.quality, rate: file.size / Math.max(seconds - told.waited, 0.001)};
  } catch { await new Promise(done => setTimeout(done, 1000)); }
};
watch();
"""


def check_backend() -> None:
    """Raise InputError where PyVista's web backend isn't installed."""
    if find_spec("trame_pyvista") is None:
        raise InputError(
            "--web: without trame-pyvista; expected it (pip install trame-pyvista), or --record out.html, a page that "
            "needs nothing more"
        )


async def serve(window: ControlledWindow, host: str, port: int, ready: Callable[[int], None]) -> None:
    """Show an off-screen window as a page, and play, until cancelled; all who open it see and move the same body.

    ``ready`` is called with the port when the page can be opened; port 0 takes a free one. An InputError says why it
    can't listen there.
    """
    for name in _LOGS:
        logging.getLogger(name).addFilter(_is_of_open_page)
    server, pictures = _make_page(window)

    def bind(wslink: Any) -> None:
        wslink.app.middlewares.append(_make_guard(host))
        wslink.app.router.add_post("/picture", partial(_answer, pictures))

    server.controller.on_server_bind.add(bind)
    server.controller.on_server_ready.add(lambda **_: ready(server.port))
    # thread: signals are asyncio's matter; timeout: the server stays when nobody looks
    started = server.start(
        port=port,
        host=host,
        exec_mode="coroutine",
        thread=True,
        timeout=0,
        open_browser=False,
        show_connection_info=False,
    )
    serving = asyncio.ensure_future(started)
    playing = asyncio.ensure_future(_play(window))
    try:
        done, _ = await asyncio.wait({serving, playing}, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    except OSError as error:
        reason = error.strerror if isinstance(error, socket.gaierror) else os.strerror(error.errno or 0)
        raise InputError(
            f"--web: {host}:{port}: {reason}; expected this machine's address and a free port (--set port=0 takes any)"
        ) from error
    finally:
        playing.cancel()
        await pictures.close()
        if not serving.done():
            await server.stop()


def _make_page(window: ControlledWindow) -> tuple[Any, PictureStream]:
    names = ("app", "ui.html", "widgets.html", "widgets.client", "widgets.rca")
    trame, layouts, html, client, areas = (import_module(f"trame.{name}") for name in names)
    rca, encoders = import_module("trame_rca.utils"), import_module("trame_rca.encoders")
    server = trame.get_server(f"partdr {id(window)}", client_type="vue3")
    server.state.trame__title = "partdr demo"
    server.trigger("answer")(lambda: None)  # until it comes, the page says that it waits
    server.trigger("press")(lambda key: window.press(key) if key in window.keys else None)
    plotter = window.scene.plotter
    plotter.iren.initialize()  # else VTK's widgets are deaf
    window.scene.screenshot()  # else PyVista takes none later
    plotter.suppress_rendering = True  # drawn when it is sent, and once is enough
    pictures = PictureStream(rca.VtkWindow(plotter.render_window), encoders.RcaImageEncoder.JPEG.encode)
    # Not for each event: VTK and PyVista say when there is something to draw.
    area = rca.RcaViewAdapter(pictures.rca, AREA, scheduler=pictures, do_schedule_render_on_interaction=False)
    area.max_pixel_count = _PIXELS
    plotter.iren.interactor.AddObserver("RenderEvent", lambda *_: pictures.schedule_render())
    plotter.add_on_render_callback(lambda _: pictures.schedule_render())
    keys = {BROWSER_NAMES.get(key, key): key for key in window.keys}
    with layouts.DivLayout(server, style=_PLACE):
        client.Style(_STYLE.replace("PAPER", PAPER).replace("ACCENT", ACCENT))
        client.Script(_SCRIPT.replace("KEYS", json.dumps(keys)))
        with areas.RemoteControlledArea(name=AREA, send_mouse_move=True, event_throttle_ms=_MOVES) as view:
            html.Img(classes="picture")
        view.add_view_handler(area)
        html.Div("working ...", classes=("trame__busy ? 'busy' : 'idle'",))  # for no picture comes meanwhile
    return server, pictures


async def _answer(pictures: PictureStream, request: Any) -> Any:
    """Answer a page that shows a picture and asks for the next."""
    web, clock = import_module("aiohttp.web"), asyncio.get_running_loop().time
    if pictures.closed:
        raise web.HTTPServiceUnavailable
    asked = clock()
    try:
        shown = await request.json()
        number, quality, rate = int(shown["number"]), int(shown["quality"]), float(shown["rate"])
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise web.HTTPBadRequest(text=f"{error}; expected number, quality and rate") from error
    picture = await pictures.after(number, quality, rate)
    told = {"number": picture.number, "quality": picture.quality, "waited": clock() - asked}
    headers = {"X-Picture": json.dumps(told), "Cache-Control": "no-store"}
    return web.Response(body=picture.content, content_type="image/jpeg", headers=headers)


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
        if isinstance(response, web.FileResponse) and not any(name in request.headers for name in _CONDITIONS):
            response.enable_compression()  # to half; aiohttp would also put bytes behind a "304 Not Modified"
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
