"""Command ``partdr demo``: play with a body and its refinement in a window, or record it without a window."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, fields
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from ..errors import InputError, told_as
from ..files.sections import check_keys, read_section
from ..inputs.films import is_film
from ..inputs.part_labels import read_photo
from .options import OutOption, PersonFiles, SettingOptions, take_whole

_START, _EXAMPLE = "t-pose", "photo"  # the first body, and the target: the packaged photo
DEMO_HELP = """Watch how a body is fitted to the person in a photo, step by step, in a window or a browser.

Examples: `partdr demo`, then press play; `partdr demo --web` for a browser; `partdr demo --record out.gif` for a file

The first screen shows a photo of a person, and a body before it. Press play, and the body moves until it stands on the
person; it stops by itself. Three sliders change the body and the side that you see it from. The button "more" opens all
other controls: starts and targets, renderers, gradients, sizes, the labels that are compared, the pull on each part,
and the energy. Point at a button to see what it does and its key. `--target NAME` takes a body as the target: t-pose,
walking, crossed arms, sitting, random.

**A person of your own**: `partdr demo photo.jpg` takes the largest person, or the one of --person N. Or give
--keypoints and, if you have them, --parts with --labels, as for `partdr fit`.

**A film that was fitted**: `partdr demo FOLDER`, where FOLDER is the --out of `partdr fit film.mp4`. It shows all
people in the world, a slider through time, and the picture of each camera. Its settings are `film=FILE` (for several
films, their folder) if the film was moved; `speed=1`; `model=anny`.

**Settings** for --set and --config, with their defaults: `supervision=parts` (or silhouette, keypoints),
`renderer=exact` (or the meshes E0 to E3), `gradient=partdr` (or coverage, edges), `depth_gradient=true`, `size=256`
(or 64, 128, 512 px), `steps=100`, `learning_rate=0.06`, and `seed=0` for random bodies; for --web, `host=127.0.0.1`
(0.0.0.0 lets other machines in), `port=8080` (0 takes a free one), and `browser=true` (it is opened).
"""


@dataclass(frozen=True)
class WebAddress:
    """Settings of the page that --web shows."""

    host: str = "127.0.0.1"
    port: int = 8080
    browser: bool = True  # True: open the page in a browser, if there is a screen

    def __post_init__(self) -> None:
        if not 0 <= self.port < 2**16:
            raise InputError(f"port: {self.port}; expected 0 to {2**16 - 1}")


@dataclass(frozen=True, kw_only=True)
class DemoRequest:
    """Arguments and options of ``partdr demo``.

    Raises:
        InputError: If one is wrong or excludes another, or the file of settings can't be read.
    """

    files: PersonFiles
    photo: Annotated[
        Path | None,
        Argument(help="Picture of a person, the target; or the folder of a fitted film.", metavar="[PHOTO|FOLDER]"),
    ] = None
    start: Annotated[
        str,
        Option(
            help="First body: its name, network (the label network's prediction), or a body.npz of `partdr fit`.",
            metavar="NAME",
        ),
    ] = _START
    target: Annotated[
        str, Option(help="Target: the name of a body, or photo, the packaged photo of a person.", metavar="NAME")
    ] = _EXAMPLE
    record: Annotated[
        Path | None, Option(help="Write the demo to a file, without a window: .gif, .mp4 or .html.", metavar="FILE")
    ] = None
    web: Annotated[
        bool, Option("--web", help="Show the demo in a browser. This machine draws it and needs no screen.")
    ] = False
    profile: Annotated[
        bool, Option("--profile", help="Print how long it takes to draw a change, without a window.")
    ] = False
    out: OutOption = Path("out")
    settings: SettingOptions

    def __post_init__(self) -> None:
        if sum((self.web, self.record is not None, self.profile)) > 1:
            raise InputError("--web, --record, --profile: more than one; expected one of them, or none for a window")
        _ = self.address

    @cached_property
    def values(self) -> dict[str, Any]:
        """Settings in nested tables, which are read once."""
        return self.settings.read()

    @cached_property
    def address(self) -> WebAddress | None:
        """Address of the page that --web shows."""
        given = {name: value for name, value in self.values.items() if name in _ADDRESS_KEYS}
        if given and not self.web:
            raise InputError(f"{next(iter(given))}: without --web; expected both, or neither")
        return read_section(WebAddress, given) if self.web else None

    @property
    def demo_settings(self) -> dict[str, Any]:
        """Settings of the demo, without those of the page."""
        return {name: value for name, value in self.values.items() if name not in _ADDRESS_KEYS}

    @property
    def off_screen(self) -> bool:
        """True if no window is opened on a screen."""
        return self.web or self.profile


def demo(request: DemoRequest) -> None:
    """Play; see ``DEMO_HELP``."""
    if request.web:
        _viewer("web").check_backend()
    elif request.record is None and not request.profile and not _has_display():
        raise InputError(
            "demo: no display (DISPLAY is not set); expected one, or --web for a browser, or --record out.gif or "
            "out.html, which need none"
        )
    import torch

    from ..interop.devices import choose_device

    choose_device("cpu")
    torch.set_num_threads(1)  # the tensors are small
    if request.record is not None:
        _viewer("recording").check_format(request.record)
    if request.photo is not None and request.photo.is_dir():
        _show_film(request, request.photo)
    else:
        _show_body(request)


def _show_body(request: DemoRequest) -> None:
    """Show a body and its refinement, in a window or as a page, or record them."""
    values = request.demo_settings
    seed, settings = take_whole(values, "seed"), _viewer("settings").Settings
    check_keys(values, [*(field.name for field in fields(settings)), "seed", *_ADDRESS_KEYS])
    chosen = read_section(settings, values)
    first, goal = _bodies(request, seed)
    state = _viewer("state").DemoState(first, goal, chosen)
    if request.record is not None:
        _record(state, request.record, chosen.steps)
        return
    detailed = goal.photo is not None and not request.profile
    window = _viewer("window").Window(
        state, request.out, off_screen=request.off_screen, seed=seed + 1, detailed=detailed
    )
    _show(window, request, f", at {chosen.size}x{chosen.size}")


def _show_film(request: DemoRequest, folder: Path) -> None:
    """Show the results of ``partdr fit FILM`` in a folder, in a window or as a page, or record them."""
    _check_folder(request, folder)
    opening, values = _viewer("motion_state"), request.demo_settings
    check_keys(values, [*(field.name for field in fields(opening.MotionSettings)), *_ADDRESS_KEYS])
    state, films = opening.open_motion(folder, read_section(opening.MotionSettings, values))
    if request.record is None:
        window = _viewer("motion_window").MotionWindow(state, films, request.out, off_screen=request.off_screen)
        _show(window, request, "")
        return
    from .progress import FitProgress

    scene = _viewer("motion_scene").PlottedMotion(state, films)
    try:
        with FitProgress() as progress:
            count = _viewer("motion_recording").record_motion(scene, request.record, progress)
    finally:
        scene.close()
    _print_recorded(request.record, count)


def _show(window: Any, request: DemoRequest, size: str) -> None:
    """Open a window, serve it at an address, or print how fast it is; ``size`` are words about its size."""
    if request.profile:
        for what, took in window.profile().items():
            typer.echo(f"{what}: {took:.1f} ms from the change to its drawn picture{size}")
        return
    if request.address is not None:
        _serve(window, request.address)
    else:
        window.show()
    if message := window.finish():
        typer.echo(message)


_ADDRESS_KEYS = tuple(field.name for field in fields(WebAddress))


def _viewer(name: str) -> Any:
    """Import a module of the demo, which is above the package, so nothing of it is imported before it is needed."""
    return import_module(f"..viewer.{name}", __package__)


def _check_folder(request: DemoRequest, folder: Path) -> None:
    """Raise an InputError if an option was given that does not go with a fitted film."""
    given = {name: value for name, value in vars(request.files).items() if value is not None}
    given |= {"start": request.start} if request.start != _START else {}
    given |= {"target": request.target} if request.target != _EXAMPLE else {}
    for name, value in given.items():
        option = "format" if name == "keypoint_format" else name
        raise InputError(f"--{option}: {value}, with {folder}, a folder of a fitted film; expected the folder alone")


def _bodies(request: DemoRequest, seed: int) -> tuple[Any, Any]:
    """Make the first body and the target."""
    targets, files, photo, start = _viewer("targets"), request.files, request.photo, request.start
    if files.keypoints is not None:
        goal = targets.person_target(files.read(photo))
    elif any(given is not None for given in (files.parts, files.labels, files.keypoint_format)):
        raise InputError("--keypoints: none with --parts, --labels or --format; expected 2D keypoints, FILE.json")
    elif photo is not None:
        from ..pipelines.photo import person_in_photo

        if is_film(photo):
            raise InputError(f"{photo}: a film; expected the folder that `partdr fit {photo.name} --out FOLDER` wrote")
        with told_as("photo", photo):
            goal = targets.person_target(person_in_photo(read_photo(photo), files.person or 0))
    elif files.person is not None:
        raise InputError(f"--person: {files.person}, without a photo or keypoints; expected one of them")
    elif request.target == _EXAMPLE:
        example = Path(__file__).resolve().parents[1] / "assets" / "example"
        goal = targets.person_target(
            PersonFiles(example / "keypoints.json", parts=example / "parts.png", labels="cdcl14").read(
                example / "photo.png"
            )
        )
    else:
        goal = targets.body_target(targets.body_of(request.target, seed + 1))  # unlike a random first body
    if start.endswith(".npz"):
        return targets.read_body(start), goal
    return targets.network_body(goal) if start == targets.NETWORK else targets.body_of(start, seed), goal


def _has_display() -> bool:
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _serve(window: Any, address: WebAddress) -> None:
    import asyncio
    import contextlib
    import webbrowser

    web = _viewer("web")

    def ready(taken: int) -> None:
        page = web.page_address(address.host, taken)
        typer.echo(f"{page} shows the demo in a browser; Ctrl+C ends it")
        if address.browser and _has_display():
            webbrowser.open(page)

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(web.serve(window, address.host, address.port, ready))


def _record(state: Any, path: Path, steps: int) -> None:
    from .progress import FitProgress

    scene = _viewer("scene").PlottedScene(state)
    if state.target.photo is not None:
        scene.skin = _viewer("skin").ShownSkin()
    try:
        pictures = []
        with FitProgress() as progress:
            for picture in _viewer("recording").frames(scene, steps):
                pictures.append(picture)
                progress("recording", len(state.history), steps)
        _viewer("recording").write(pictures, path)
    finally:
        scene.close()
    _print_recorded(path, len(pictures))


def _print_recorded(path: Path, count: int) -> None:
    typer.echo(f"{path}: {count} pictures, {path.stat().st_size / 1e6:.1f} MB")
