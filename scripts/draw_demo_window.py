"""Draw the demo's window as it is while it plays, with its buttons: ``docs/images/demo_window.png``.

python scripts/draw_demo_window.py [--out docs/images/demo_window.png]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
import warp as wp
from PIL import Image

from warp_partdr.viewer.state import DemoState
from warp_partdr.viewer.targets import body_of, body_target
from warp_partdr.viewer.window import Window

STEPS = 25  # of each setting


def main() -> None:
    """Two settings are tried, one after the other, from the same start; the second is still on its way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(__file__).resolve().parents[1] / "docs" / "images" / "demo_window.png"
    parser.add_argument("--out", type=Path, default=default, help="PNG")
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    torch.set_num_threads(1)  # the tensors are small
    state = DemoState(body_of("t-pose"), body_target(body_of("walking")))
    window = Window(state, options.out.parent, off_screen=True)
    window.scene.screenshot()  # off-screen, nothing is drawn before the first picture
    for quality in ("F7", "F9"):
        window.press(quality)
        window.press("space")
        for _ in range(STEPS):
            window.tick()
        if quality != "F9":
            window.press("space")
    Image.fromarray(window.scene.screenshot()).save(options.out, optimize=True)


if __name__ == "__main__":
    main()
