"""Charts of a fit: labels beside the target's, and the energy. They do without matplotlib, which takes long to load."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from PIL.Image import Image

    from ..solve.ellipsoids.result import FitResult

_PANEL_SIDE = 480  # [px]
_IGNORED = (150, 150, 150)


def panels(target: np.ndarray, drawn: np.ndarray, colours: np.ndarray) -> Image:
    """Draw target, result and difference side by side, cropped to the bodies.

    Args:
        target: Group ids of the target, shape (H, W), uint8; 255 where nothing is compared.
        drawn: Group ids of the fitted body, shape (H, W), uint8.
        colours: RGB of each group id, shape (256, 3), uint8.
    """
    from PIL import Image as PilImage
    from PIL import ImageDraw, ImageFont

    counted = target != 255
    wrong = counted & (drawn != target)
    # Colour-blind people can tell these colours apart, too.
    kinds = {
        "right": ((215, 215, 215), counted & (target > 0) & ~wrong),
        "missing": ((0, 90, 181), wrong & (drawn == 0)),
        "too much": ((220, 50, 32), wrong & (target == 0)),
        "another part": ((255, 194, 10), wrong & (drawn > 0) & (target > 0)),
        "ignored": (_IGNORED, ~counted),
    }
    difference = np.full((*target.shape, 3), 255, dtype=np.uint8)
    for colour, pixels in kinds.values():
        difference[pixels] = colour
    colours = colours.copy()
    colours[0], colours[255] = 255, _IGNORED

    size = np.array(target.shape)
    bodies = np.argwhere((counted & (target > 0)) | (drawn > 0))
    low, high = (bodies.min(0), bodies.max(0) + 1) if len(bodies) else (0 * size, size)
    margin = round(0.03 * (high - low).max()) + 1
    low, high = np.maximum(low - margin, 0), np.minimum(high + margin, size)
    zoom = _PANEL_SIDE / (high - low).max()
    # Enlarged by whole numbers, so that all pixels have one size.
    zoom = max(1, round(zoom)) if zoom > 0.7 else zoom
    rows, columns = (high - low).tolist()
    height, width = max(round(rows * zoom), 1), max(round(columns * zoom), 1)
    resample = PilImage.Resampling.NEAREST if zoom >= 1 else PilImage.Resampling.BOX

    font, gap, bar = ImageFont.load_default(15), 12, 34
    entries = [(text, colour, round(font.getlength(text)) + 38) for text, (colour, _) in kinds.items()]
    step = max(width, (sum(entry[2] for entry in entries) - gap) // 3) + gap
    sheet = PilImage.new("RGB", (gap + 3 * step, height + 2 * bar), "white")
    draw = ImageDraw.Draw(sheet)
    named = {"target": colours[target], "result": colours[drawn], "difference": difference}
    for column, (name, image) in enumerate(named.items()):
        x = gap + column * step
        draw.text((x, 9), name, fill="black", font=font)
        cut = PilImage.fromarray(image[low[0] : high[0], low[1] : high[1]])
        sheet.paste(cut.resize((width, height), resample), (x, bar))
        draw.rectangle([x - 1, bar - 1, x + width, bar + height], outline=(190, 190, 190))
    x, y = gap, bar + height + 10
    for text, colour, advance in entries:
        draw.rectangle([x, y, x + 14, y + 14], fill=colour, outline=(120, 120, 120))
        draw.text((x + 20, y - 2), text, fill="black", font=font)
        x += advance
    return sheet


def loss_chart(result: FitResult) -> Image:
    """Draw the energy of the best body and its ancestors over all iterations, one band a stage; the scale is log."""
    from PIL import Image as PilImage
    from PIL import ImageDraw, ImageFont

    smooth = 2  # factor by which it is drawn larger, for smooth lines
    width, height = 900 * smooth, 380 * smooth
    left, right, top, bottom = 62 * smooth, width - 14 * smooth, 66 * smooth, height - 44 * smooth
    chart = PilImage.new("RGB", (width, height), "white")
    draw = ImageDraw.Draw(chart)
    font, small = ImageFont.load_default(14 * smooth), ImageFont.load_default(12 * smooth)

    values = np.concatenate([*result.history, np.zeros(0)])
    good = (values > 0) & np.isfinite(values)
    powers = np.log10(values[good]) if good.any() else np.zeros(1)
    high = powers.max() + 0.05
    low = max(powers.min() - 0.05, high - 4)  # no stage falls by more decades
    ends = np.cumsum([0, *map(len, result.history)]).tolist()

    def at(iteration: float, energy: float) -> tuple[float, float]:
        share = (np.log10(min(max(energy, 10**low), 10**high)) - low) / (high - low)
        return left + (right - left) * iteration / max(ends[-1], 1), bottom - (bottom - top) * float(share)

    for index, stage in enumerate(result.stages):
        start = at(ends[index], 1.0)[0]
        end = at(ends[index + 1], 1.0)[0]
        draw.rectangle([start, top, end, bottom], fill=((246, 246, 246), (232, 237, 243))[index % 2])
        size = f"{stage.size} px" if stage.size and result.observation.labels is not None else "no labels"
        for line, text in enumerate((stage.name, size)):
            if small.getlength(text) < end - start:
                draw.text(((start + end) / 2, top - (26 - 16 * line) * smooth), text, "black", small, anchor="mm")
        draw.text((end, bottom + 6 * smooth), str(ends[index + 1]), "black", small, anchor="ma")
    for tick in (digit * 10.0**power for power in range(-6, 9) for digit in (1, 2, 5)):
        if low <= np.log10(tick) <= high:
            y = at(0, tick)[1]
            draw.line([left, y, right, y], fill=(205, 205, 205), width=1)
            draw.text((left - 6 * smooth, y), f"{tick:g}", "black", small, anchor="rm")
    for first, energies in zip(ends, result.history, strict=False):
        points = [at(first + k + 0.5, float(energy)) for k, energy in enumerate(np.nan_to_num(energies, nan=np.inf))]
        draw.line(points, fill=(20, 70, 140), width=2 * smooth, joint="curve")
    draw.rectangle([left, top, right, bottom], outline=(120, 120, 120), width=smooth)
    draw.text((left, 6 * smooth), "energy of the winner", "black", font)
    draw.text(((left + right) / 2, height - 8 * smooth), "iteration", "black", font, anchor="ms")
    return chart.resize((width // smooth, height // smooth), PilImage.Resampling.LANCZOS)
