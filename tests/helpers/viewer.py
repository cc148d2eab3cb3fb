"""Small states and windows of the demo, and clicks on their buttons."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from helpers.files import EXAMPLE
from warp_partdr.cli.options import PersonFiles
from warp_partdr.models.registration import RegistrationOptions
from warp_partdr.viewer.buttons import Button
from warp_partdr.viewer.controlled import ControlledWindow
from warp_partdr.viewer.settings import Settings
from warp_partdr.viewer.state import DemoState
from warp_partdr.viewer.targets import Photo, Target, body_of, body_target, person_target
from warp_partdr.viewer.window import Window

SMALL = Settings(size=64, steps=40)


def make_state(target: str = "walking", start: str = "t-pose", **settings: Any) -> DemoState:
    return DemoState(body_of(start), body_target(body_of(target)), replace(SMALL, **settings))


def play(state: DemoState, count: int) -> None:
    for _ in range(count):
        state.step()


def read_target(photo: Path, **labels: Any) -> Target:
    return person_target(PersonFiles(EXAMPLE / "keypoints.json", **labels).read(photo))


def cropped(photo: Photo, side: int) -> np.ndarray:
    """The crop of a photo, in which places are -1 to 1, RGB, shape (side, side, 3), uint8."""
    height, width = photo.pixels.shape[:2]
    low, high = ((edge - photo.low) / (photo.high - photo.low) * (width, height) for edge in (-1, 1))
    image = Image.fromarray(photo.pixels)
    return np.asarray(image.transform((side, side), Image.Transform.EXTENT, (*low, *high), Image.Resampling.BILINEAR))


@pytest.fixture(autouse=True)
def one_thread():
    """The command uses one thread, too: the tensors are small."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def open_window(can_draw, tmp_path):
    """Open a window of a state, that is closed at the end."""
    with ExitStack() as opened:

        def open_one(state: DemoState, **options: Any) -> Window:
            made = Window(state, tmp_path / "saved", off_screen=True, **({"more": True} | options))
            made.controls.registration = RegistrationOptions(iterations=2)  # which is near enough, and fast
            opened.callback(made.scene.close)
            return made

        yield open_one


@pytest.fixture
def window(open_window):
    return open_window(make_state())


def send(window: ControlledWindow, event: str, place: tuple[int, int]) -> None:
    """An event of the mouse, as the window system would send it."""
    interactor = window.scene.plotter.iren.interactor
    interactor.SetEventPosition(*place)
    interactor.InvokeEvent(event)


def middle(window: ControlledWindow, button: Button) -> tuple[int, int]:
    """Middle of a button in the window [px, y up]."""
    (placed,) = (placed for placed in window.panel.entries if placed.entry is button)
    panel = window.scene.panel
    column, row = panel.left + (placed.left + placed.right) / 2, panel.top + (placed.top + placed.bottom) / 2
    return round(column), round(window.scene.look_now.size[1] - row)


def buttons(window: ControlledWindow) -> list[Button]:
    """Buttons that are shown."""
    return [placed.entry for placed in window.panel.entries if isinstance(placed.entry, Button)]


def click(window: ControlledWindow, text: str, hint: str = "") -> None:
    """Click on the button that says ``text``; of two, on that with ``hint`` in its hint."""
    (button,) = (button for button in buttons(window) if button.text == text and hint in button.hint)
    place = middle(window, button)
    for event in ("LeftButtonPressEvent", "LeftButtonReleaseEvent"):
        send(window, event, place)


def said(window: ControlledWindow) -> str:
    """All words of the panel."""
    return " ".join(placed.entry for placed in window.panel.entries if isinstance(placed.entry, str))


def box(window: ControlledWindow, name: str) -> tuple[slice, slice]:
    """Rows and columns of a view in the window's picture."""
    view, (_, height) = window.scene.view(name), window.scene.look_now.size
    (left, bottom), (wide, tall) = view.GetOrigin(), view.GetSize()
    return slice(height - bottom - tall, height - bottom), slice(left, left + wide)


def image(window: Window, name: str) -> np.ndarray:
    return window.scene._images[name].image.point_data["rgb"].copy()
