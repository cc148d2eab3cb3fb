"""Make every picture of README and docs that comes from this code: ``make pictures``.

    python scripts/pictures.py [--out docs/images] [NAME ...]

Says of each whether it is as it was; those of the demo never are to the last pixel, for measured milliseconds stand in
them. A picture that can't be made (VTK without OpenGL) is left as it is, and the exit code is 1. Charts of long
measurements are not made here: ``MEASURED`` says what draws them, each beside a JSON file of its figures.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"

# The pictures that a command makes, and its arguments, from the project's folder; OUT is where it is to write to.
DRAWN: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    (("ellipbody.png", "example.png"), ("scripts/make_docs_pictures.py", "--out", "OUT")),
    (("two_triangles.png",), ("demos/two_triangles.py", "--out", "OUT/two_triangles.png")),
    (("edits.png", "between.png"), ("demos/edit_body.py", "--out", "OUT")),
    (
        ("demo.gif",),
        ("-m", "warp_partdr", "demo", "--record", "OUT/demo.gif", "--target", "crossed arms", "--set", "steps=60"),
    ),
    (("demo_window.png",), ("scripts/draw_demo_window.py", "--out", "OUT/demo_window.png")),
)

MEASURED = {
    "bench-cpu.png": "partdr bench kernels --device cpu",
    "bench-h200.png": "partdr bench kernels --device cuda",
    "tradeoff-cpu.png": "partdr bench tradeoff --device cpu",
    "tradeoff-h200.png": "partdr bench tradeoff --device cuda",
}


def difference(first: Path, second: Path) -> float:
    """Share of pixels that differ, over all frames; 1 if sizes or numbers of frames do."""
    with Image.open(first) as one, Image.open(second) as other:
        frames = getattr(one, "n_frames", 1)
        if one.size != other.size or frames != getattr(other, "n_frames", 1):
            return 1.0
        shares = []
        for frame in range(frames):
            one.seek(frame)
            other.seek(frame)
            shares.append(float((np.asarray(one.convert("RGB")) != np.asarray(other.convert("RGB"))).any(-1).mean()))
    return sum(shares) / frames


def make(names: tuple[str, ...], arguments: tuple[str, ...], out: Path) -> bool:
    """Run a command and keep its pictures of these names; True if it made them."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, *(argument.replace("OUT", folder) for argument in arguments)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            reason = done.stderr.strip().splitlines()[-1:]
            print(f"{', '.join(names)}: left as it was; {' '.join(arguments)}: {''.join(reason)}")
            return False
        for name in names:
            made, kept = Path(folder) / name, out / name
            if not kept.exists():
                news = "new"
            elif (share := difference(made, kept)) == 0:
                news = "as it was"
            else:
                news = f"{share:.2%} of its pixels are new"
            kept.write_bytes(made.read_bytes())
            print(f"{name}: {kept.stat().st_size / 1024:.0f} KiB, {news}", flush=True)
    return True


def main(argv: list[str] | None = None) -> int:
    """Make the pictures; return 1 if one couldn't be made."""
    choices = [name for names, _ in DRAWN for name in names]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of {', '.join(choices)}; default: all")
    parser.add_argument("--out", type=Path, default=IMAGES, help="folder; default: docs/images")
    options = parser.parse_args(argv)
    if unknown := set(options.names) - set(choices):
        parser.error(f"NAME: {', '.join(sorted(unknown))}; expected some of {', '.join(choices)}")
    options.out.mkdir(parents=True, exist_ok=True)
    asked = set(options.names or choices)
    done = [
        make(chosen, arguments, options.out)
        for names, arguments in DRAWN
        if (chosen := tuple(name for name in names if name in asked))
    ]
    if not options.names:
        for name, command in MEASURED.items():
            print(f"{name}: not made here; {command} draws it")
    return 0 if all(done) else 1


if __name__ == "__main__":
    sys.exit(main())
