"""Fit a body to a photo from its part labels and keypoints, and look at what came out.

    python demos/fit_photo.py --out FOLDER

The packaged example: the photo itself only lies under the overlay. Writes ``overlay.png``, ``parts.png``, ``loss.png``,
``turntable.png`` and ``keypoints_or_labels.png``, which compares the fit with one of the keypoints alone.
"""

from __future__ import annotations

from pathlib import Path

import typer
import warp as wp

import warp_partdr
from warp_partdr import FitResult, choose_person, fit_body, label_set, read_keypoints, read_parts, read_photo
from warp_partdr.metrics import mpjpe
from warp_partdr.plot import compare_bodies, loss_curve, overlay, part_panels, turntable

EXAMPLE = Path(warp_partdr.__path__[0]) / "assets" / "example"


def main(out: Path = Path("out/fit_photo"), quality: str = "balanced") -> FitResult:
    """Fit, and write pictures to a folder; quality: fast, balanced or accurate."""
    wp.config.log_level = wp.LOG_WARNING
    out.mkdir(parents=True, exist_ok=True)

    # Part labels are an image of ids, and a label set says what the ids mean. Keypoints come in a usual format.
    photo = read_photo(EXAMPLE / "photo.png")
    parts = read_parts(EXAMPLE / "parts.png", label_set("cdcl14"))
    person = choose_person(read_keypoints(EXAMPLE / "keypoints.json"), parts.groups)

    # The fit starts with a network's guess, follows the keypoints, then the labels of ever larger pictures.
    result = fit_body(person, parts, quality=quality)
    overlay(result, photo, keypoints=person).savefig(out / "overlay.png")
    part_panels(parts, result).savefig(out / "parts.png")
    loss_curve(result).savefig(out / "loss.png")
    turntable(result).savefig(out / "turntable.png")

    # What do labels add? The same fit without them.
    alone = fit_body(person, quality=quality)
    names = ("keypoints and labels", "keypoints alone")
    compare_bodies(result, alone, names=names).savefig(out / "keypoints_or_labels.png")
    moved = float(mpjpe(result.posed.joints[0], alone.posed.joints[0], centre_on=[0])) * 1000
    print(f"Labels move the joints by {moved:.0f} mm on average")
    print(f"Pictures: {out}")
    return result


if __name__ == "__main__":
    typer.run(main)
