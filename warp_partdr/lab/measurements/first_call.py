"""Shares of the first call of ``fit_photo`` in this process, beside those of later calls.

The packaged example is fitted, then a photo of another size with three people, and the example again. Shares overlap:
stages hold everything that is done in them. A convolution is counted where a library computes it, for each library
chooses its kernels anew for each shape of the pictures and of the weights. Kernels that are not compiled yet count,
too: run it twice.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any
from unittest.mock import patch

import numpy as np
import torch

from ...inputs.part_labels import read_photo
from ...interop.captured_step import CapturedStep
from ...pipelines import photo as photo_pipeline
from ..bench.kernels.first_call import EXAMPLE
from ..options import Device
from ..tables import FigureTable

_COLUMNS = {"call": "", "all [ms]": ".0f"}
_COUNTS = {"steps captured": "d", "convolutions": "d", "of new shapes": "d"}
_STAGES = {  # functions of ``pipelines.photo``
    "people [ms]": "find_people",
    "ellipsoids [ms]": "fit_evidence",
    "mesh [ms]": "refine_people",
}


class _Counted:
    """Times of stages, and numbers of captures and convolutions, since the last look at them."""

    def __init__(self, device: str) -> None:
        self.counts: Counter[str] = Counter()
        self._device = torch.device(device)
        self._shapes: set[tuple[Any, ...]] = set()

    def wait(self) -> None:
        """Wait for the device."""
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)

    def timed(self, name: str, work: Callable[..., Any]) -> Callable[..., Any]:
        """Function whose time counts under a name [ms]."""

        def run(*args: Any, **options: Any) -> Any:
            started = time.perf_counter()
            found = work(*args, **options)
            self.wait()
            self.counts[name] += 1000 * (time.perf_counter() - started)  # type: ignore[assignment]  # of milliseconds
            return found

        return run

    def convolution(self, work: Callable[..., torch.Tensor]) -> Callable[..., torch.Tensor]:
        """Convolution of a library that is counted, and once more if its shapes are new."""

        def run(values: torch.Tensor, weight: torch.Tensor, *rest: Any, **options: Any) -> torch.Tensor:
            shapes = values.shape, weight.shape, values.dtype, *[str(each) for each in rest[1:]], str(options)
            self.counts["convolutions"] += 1
            self.counts["of new shapes"] += shapes not in self._shapes
            self._shapes.add(shapes)
            return work(values, weight, *rest, **options)

        return run

    def captured(self, make: Callable[..., None]) -> Callable[..., None]:
        """``CapturedStep.__init__`` that is counted."""

        def run(*args: Any, **options: Any) -> None:
            self.counts["steps captured"] += 1
            make(*args, **options)

        return run


def measure_first_call(*, device: Device = "auto") -> Iterator[FigureTable]:
    """Time the shares of a first call and of later calls.

    Args:
        device: Device of the fits.
    """
    example = read_photo(EXAMPLE)
    others = np.concatenate([example, example[:, ::-1], example], axis=1)
    table = FigureTable(f"fit_photo on {device}", {**_COLUMNS, **dict.fromkeys(_STAGES, ".0f"), **_COUNTS})
    counted = _Counted(device)
    with ExitStack() as patched:
        for name, function in _STAGES.items():
            timed = counted.timed(name, getattr(photo_pipeline, function))
            patched.enter_context(patch.object(photo_pipeline, function, timed))
        convolve = counted.convolution(torch.nn.functional.conv2d)
        patched.enter_context(patch.object(torch.nn.functional, "conv2d", convolve))
        patched.enter_context(patch.object(CapturedStep, "__init__", counted.captured(CapturedStep.__init__)))
        calls = ("first", example), ("other size, three people", others), ("example again", example), ("later", example)
        for name, picture in calls:
            counted.counts.clear()
            counted.timed("all [ms]", photo_pipeline.fit_photo)(picture, device=device)
            counts = counted.counts
            table.add(name, *[counts[each] for each in ("all [ms]", *_STAGES, *_COUNTS)])
    yield table
