"""Progress of a run: a bar, lines on stderr, log.jsonl, TensorBoard and pictures."""

from __future__ import annotations

import json
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from PIL import Image


class RunLog(ExitStack):
    """The log of a run of ``steps`` steps, in its folder ``out``. If it is ``silent``, it says and writes nothing.

    It goes on from ``step``: later lines of an earlier part are dropped.
    """

    def __init__(self, out: Path, step: int, steps: int, *, silent: bool) -> None:
        super().__init__()
        self._silent, self._out, self._steps = silent, out, steps
        console = Console(stderr=True, quiet=silent, highlight=False)
        columns = BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), TimeRemainingColumn()
        unseen = silent or not console.is_terminal
        bar = Progress(TextColumn("{task.description}"), *columns, console=console, disable=unseen, transient=True)
        self._bar = self.enter_context(bar)
        self._task = self._bar.add_task("the first step", total=1.0)
        self.advance(step / steps)
        self._board: Any = None
        if silent:
            return
        self._lines = out / "log.jsonl"
        if self._lines.exists():
            lines = [line for line in self._lines.read_text(encoding="utf-8").splitlines() if _step_of(line) <= step]
            self._lines.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            self.say("no TensorBoard here: its logs are left out (pip install tensorboard)")
        else:
            self._board = self.enter_context(SummaryWriter(str(out / "tensorboard"), purge_step=step + 1))

    def say(self, text: str) -> None:
        """A line on stderr."""
        self._bar.console.print(text, markup=False, soft_wrap=True)

    def advance(self, share: float) -> None:
        """Move the bar to a share of the run, 0 to 1."""
        self._bar.update(self._task, completed=share)

    def losses(self, step: int, terms: dict[str, float], rates: dict[str, float]) -> None:
        """Means since the last such line, and learning rate, samples a second and the like."""
        text = f"step {step}/{self._steps}  loss {terms['total']:.4g}  {rates['samples/s']:,.0f} samples/s"
        self._bar.update(self._task, description=text)
        if self._bar.disable:
            self.say(text)
        self._write(step, {"loss": terms, "rate": rates})

    def errors(self, step: int, errors: dict[str, float], sheet: Image.Image | None) -> None:
        """Write the errors of a validation, and its pictures."""
        self.say(f"step {step}  " + "  ".join(f"{name} {value:.4g}" for name, value in errors.items()))
        self._write(step, {"validation": errors})
        if sheet is not None:
            folder = self._out / "pictures"
            folder.mkdir(exist_ok=True)
            sheet.save(folder / f"step-{step:08d}.png")
            if self._board is not None:
                import numpy as np

                self._board.add_image("validation", np.asarray(sheet.convert("RGB")), step, dataformats="HWC")

    def _write(self, step: int, groups: dict[str, dict[str, float]]) -> None:
        if self._silent:
            return
        with self._lines.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"step": step, "time": round(time.time(), 3), **groups}) + "\n")
        if self._board is not None:
            for group, values in groups.items():
                for name, value in values.items():
                    self._board.add_scalar(f"{group}/{name}", value, step)


def _step_of(line: str) -> float:
    try:
        return float(json.loads(line)["step"])
    except (ValueError, KeyError, TypeError):
        return float("inf")  # the line that a killed process was writing
