"""The demo in a browser: pictures are drawn here and sent there; mouse and keys come back to the same window."""

from __future__ import annotations

import asyncio
import json
import os
import socket
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any
from urllib.parse import urlsplit

from ..errors import InputError
from .window import Window

_ALL_ADDRESSES = ("0.0.0.0", "::")  # hosts that mean each of this machine's addresses
_LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")
AREA = "demo"  # what messages about the picture are addressed to
_REST = 0.015  # [s] between a picture and the next step, in which messages come and go
_QUALITY = 85  # of JPEG; one for all, or each change would be drawn twice
_PICTURES = 30  # a second, at most
_PIXELS = 1_500_000  # of a picture, at most; screens have more
_MOVES = 50  # [ms] between places of the mouse
_BROWSER_NAMES = {  # of keys, where browsers call them otherwise than VTK does
    "space": " ",
    "BackSpace": "Backspace",
    "bracketleft": "[",
    "bracketright": "]",
    "comma": ",",
    "period": ".",
}
_STYLE = """
html, body { margin: 0; background: #fafafa; }
.busy, .idle { position: fixed; top: 45%; left: 20%; padding: 0.5em 1em; pointer-events: none; }
.busy, .idle { font: 16px sans-serif; color: white; background: #14468c; border-radius: 6px; }
.busy { opacity: 1; transition: opacity 0.1s 0.5s; }  /* what takes less shows by itself */
.idle { opacity: 0; }
"""
_PLACE = "position: absolute; inset: 0; min-width: 1200px; min-height: 750px"  # what words and buttons take
_LISTEN = """
const keys = KEYS;
document.addEventListener("keydown", event => {
  if (event.ctrlKey || event.altKey || event.metaKey || !(event.key in keys)) return;
  event.preventDefault();  // F5 loads no page anew
  if (!event.repeat) window.trame.trigger("press", [keys[event.key]]);
});
document.addEventListener("pointerdown", () => setTimeout(() => window.trame.trigger("answer"), 100), true);
"""


def check_backend() -> None:
    """Raise InputError where PyVista's web backend isn't installed."""
    if find_spec("trame_pyvista") is None:
        raise InputError(
            "--web: without trame-pyvista; expected it (pip install trame-pyvista), or --record out.html, a page that "
            "needs nothing more"
        )


async def serve(window: Window, host: str, port: int, ready: Callable[[int], None]) -> None:
    """Show a window as a page, and play, until cancelled; all who open the page see and move the same body.

    Args:
        window: Made off-screen.
        host: Address of this machine to listen at.
        port: 0 takes a free one.
        ready: Called with the port when the page can be opened.

    Raises:
        InputError: If PyVista's web backend isn't installed, or it can't listen there.
    """
    check_backend()
    asyncio.get_running_loop().set_exception_handler(_pass_over_closed_pages)
    server = _make_page(window)
    server.controller.on_server_bind.add(lambda wslink: wslink.app.middlewares.append(_make_guard(host)))
    server.controller.on_server_ready.add(lambda **_: ready(server.port))
    # thread: signals are asyncio's matter; timeout: the server stays when nobody looks
    options = {"thread": True, "timeout": 0, "open_browser": False, "show_connection_info": False}
    serving = asyncio.ensure_future(server.start(port=port, host=host, exec_mode="coroutine", **options))
    playing = asyncio.ensure_future(_play(window))
    try:
        done, _ = await asyncio.wait({serving, playing}, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    except OSError as error:
        reason = error.strerror if isinstance(error, socket.gaierror) else os.strerror(error.errno or 0)
        raise InputError(
            f"--web: {host}:{port}: {reason}; expected an address of this machine and a free port (--port 0 takes any)"
        ) from error
    finally:
        playing.cancel()
        if not serving.done():
            await server.stop()


def _make_page(window: Window) -> Any:
    trame, layouts, html, client, views = (
        import_module(name)
        for name in (
            "trame.app",
            "trame.ui.html",
            "trame.widgets.html",
            "trame.widgets.client",
            "trame_pyvista.rca_view",
        )
    )
    server = trame.get_server(f"partdr {id(window)}", client_type="vue3")
    server.state.trame__title = "partdr demo"
    server.trigger("answer")(lambda: None)  # until it comes, the page says that it waits
    server.trigger("press")(lambda key: window.press(key) if key in window.keys else None)
    plotter = window.scene.plotter
    plotter.iren.initialize()  # else VTK's widgets are deaf
    window.scene.screenshot()  # else PyVista takes none later
    plotter.suppress_rendering = True  # drawn when it is sent, and once is enough
    with layouts.DivLayout(server, style=_PLACE):
        client.Style(_STYLE)
        client.Script(_LISTEN.replace("KEYS", json.dumps({browser_name(key): key for key in window.keys})))
        view = views.PyVistaRCAView(
            plotter, name=AREA, target_fps=_PICTURES, send_mouse_move=True, event_throttle_ms=_MOVES
        )
        html.Div("working ...", classes=("trame__busy ? 'busy' : 'idle'",))  # for no picture comes meanwhile
    view.handler.max_pixel_count = _PIXELS
    view.handler.update_quality(_QUALITY, _QUALITY)
    plotter.add_on_render_callback(lambda _: view.render())
    return server


def _make_guard(host: str) -> Any:
    """What turns down messages from other pages that are open in the user's browser.

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
        response.headers["X-Frame-Options"] = "DENY"
        return response

    return web.middleware(guard)


def _pass_over_closed_pages(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """A page that is closed while a picture is on its way is no fault."""
    if not isinstance(context.get("exception"), ConnectionResetError):
        loop.default_exception_handler(context)


async def _play(window: Window) -> None:
    while True:
        window.tick()
        await asyncio.sleep(_REST)


def page_address(host: str, port: int) -> str:
    """Where the page is that ``serve`` shows."""
    name = socket.gethostname() if host in _ALL_ADDRESSES else host
    return f"http://[{name}]:{port}/" if ":" in name else f"http://{name}:{port}/"


def browser_name(key: str) -> str:
    """What a browser's ``KeyboardEvent.key`` is for a key of VTK."""
    return _BROWSER_NAMES.get(key, key)
