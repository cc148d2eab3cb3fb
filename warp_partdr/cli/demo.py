"""The command ``partdr demo``: play with a body and its refinement in a window, or record one without."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import InputError
from .register import LabelsOption

DEMO_HELP = """Play with a body in a window: change it, and watch it be refined toward a target, step by step.

Example: `partdr demo`, then the space bar. In a browser: `partdr demo --web`. As a file: `partdr demo --record out.gif`

Left, the body in 3D; right, its labels, the target's, what differs, where the loss pulls each part, and the loss.
Point at a button for what it does and its key. Bodies by name: t-pose, walking, crossed arms, sitting, random.

**A person of your own**: --keypoints and, for more than those, --parts with --labels, as `partdr fit` takes them.
"""


_OF_WEB = {"host": "--host", "port": "--port", "browser": "--no-browser"}


def demo(
    context: typer.Context,
    start: Annotated[
        str, typer.Option(help="Body to begin with; network: what the label network says.", metavar="NAME")
    ] = "t-pose",
    target: Annotated[str, typer.Option(help="Body to reach.", metavar="NAME")] = "walking",
    seed: Annotated[int, typer.Option(help="Of random bodies, also of those that buttons draw.", metavar="N")] = 0,
    body: Annotated[
        Path | None, typer.Option(help="Begin with a body.npz of `partdr fit` instead.", metavar="FILE.npz")
    ] = None,
    photo: Annotated[
        Path | None, typer.Option(help="Picture of the person to reach, to be shown.", metavar="FILE")
    ] = None,
    keypoints: Annotated[
        Path | None, typer.Option(help="2D keypoints of the person to reach, JSON.", metavar="FILE.json")
    ] = None,
    parts: Annotated[Path | None, typer.Option(help="Part labels of the person to reach.", metavar="FILE")] = None,
    labels: LabelsOption = None,
    supervision: Annotated[
        str, typer.Option(help="What is followed: keypoints; with them the silhouette, or the parts.", metavar="NAME")
    ] = "parts",
    depth_gradient: Annotated[bool, typer.Option(help="With PartDR's z gradient of parts, or without.")] = True,
    renderer: Annotated[str, typer.Option(help="exact, or the mesh of a level: E0 to E3.", metavar="NAME")] = "exact",
    gradient: Annotated[
        str, typer.Option(help="Of the exact renderer: partdr, coverage or edges.", metavar="NAME")
    ] = "partdr",
    size: Annotated[int, typer.Option(help="Pixels a side: 64, 128, 256 or 512.", metavar="N")] = 256,
    steps: Annotated[int, typer.Option(help="Iterations.", metavar="N")] = 100,
    record: Annotated[
        Path | None, typer.Option(help="Write the refinement, without a window: .gif, .mp4 or .html.", metavar="FILE")
    ] = None,
    profile: Annotated[
        bool, typer.Option("--profile", help="Print how long a change takes to be drawn, without a window.")
    ] = False,
    out: Annotated[Path, typer.Option(help="Where the window saves to.", metavar="FOLDER")] = Path("out"),
    web: Annotated[
        bool, typer.Option("--web", help="The same in a browser; drawn on this machine, which needs no screen.")
    ] = False,
    host: Annotated[
        str, typer.Option(help="With --web: address to listen at; 0.0.0.0 lets other machines in.", metavar="ADDRESS")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(help="With --web: port to listen at; 0 takes a free one.", metavar="N", min=0, max=65535)
    ] = 8080,
    browser: Annotated[bool, typer.Option(help="With --web: open the browser, if there is a screen.")] = True,
) -> None:
    """Play; see ``DEMO_HELP``."""
    if sum((web, record is not None, profile)) > 1:
        raise InputError("--web, --record, --profile: more than one; expected one of them, or none for a window")
    for name, option in _OF_WEB.items():
        if not web and (source := context.get_parameter_source(name)) and source.name == "COMMANDLINE":
            raise InputError(f"{option}: without --web; expected both, or neither")
    if web:
        import_module("..viewer.web", __package__).check_backend()
    elif record is None and not profile and not _has_display():
        raise InputError(
            "demo: no display (DISPLAY is not set); expected one, or --web for a browser, or --record out.gif or "
            "out.html, which need none"
        )
    import torch
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    torch.set_num_threads(1)  # the tensors are small
    # By name: the demo stands above the package, which imports nothing of it until it is asked for.
    targets, state, recording = (
        import_module(f"..viewer.{name}", __package__) for name in ("targets", "state", "record")
    )
    if record is not None:
        recording.check_format(record)
    settings = state.Settings(supervision, depth_gradient, renderer, gradient, size, steps)
    if keypoints is not None:
        aim = targets.read_target(photo, keypoints, parts, labels)
    elif photo is not None or parts is not None:
        raise InputError("--keypoints: none with --photo or --parts; expected the person's 2D keypoints, FILE.json")
    else:
        aim = targets.target_of(targets.body_of(target, seed + 1))  # another than a random start
    if body is not None:
        first = targets.read_body(body)
    else:
        first = targets.network_body(aim) if start == targets.NETWORK else targets.body_of(start, seed)
    shown = state.DemoState(first, aim, settings)
    if record is not None:
        _record(shown, recording, record, steps)
        return
    window = import_module("..viewer.window", __package__).Window(shown, out, off_screen=profile or web, seed=seed + 1)
    if profile:
        for what, took in window.profile().items():
            typer.echo(f"{what}: {took:.1f} ms from the change to its drawn picture, at {size}x{size}")
        return
    if web:
        _serve(window, host, port, browser and _has_display())
    else:
        window.show()
    if told := window.finish():
        typer.echo(told)


def _has_display() -> bool:
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _serve(window: Any, host: str, port: int, open_browser: bool) -> None:
    import asyncio
    import contextlib
    import webbrowser

    web = import_module("..viewer.web", __package__)

    def ready(taken: int) -> None:
        address = web.page_address(host, taken)
        typer.echo(f"{address} shows the demo in a browser; Ctrl+C ends it")
        if open_browser:
            webbrowser.open(address)

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(web.serve(window, host, port, ready))


def _record(shown: Any, recording: Any, path: Path, steps: int) -> None:
    from .progress import FitProgress

    scene = import_module("..viewer.scene", __package__).Scene(shown)
    try:
        with FitProgress() as progress:
            pictures = []
            for picture in recording.frames(scene, steps):
                pictures.append(picture)
                progress("recording", len(shown.history), steps)
            recording.write(pictures, path)
    finally:
        scene.close()
    typer.echo(f"{path}: {len(pictures)} pictures, {path.stat().st_size / 1e6:.1f} MB")
