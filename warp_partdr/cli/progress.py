"""Progress bars on the terminal: for a fit, and for pictures that are processed."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from ..errors import printable
from ..kernels.messages import COMPILING, say_if_compiling

_NETWORKS = "loading networks"  # first words of a bar whose pictures are shown to networks, by kernels
_SPEED_OVER = 20.0  # [s], period over which rate and remaining time are measured


class FitProgress(Progress):
    """Progress bar on stderr for ``fit_body(progress=...)``; without a terminal it prints a line at most.

    The line says that kernels are compiled, if none is yet.
    """

    def __init__(self) -> None:
        console = Console(stderr=True)
        super().__init__(
            TextColumn("{task.description:16}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
        self._task = self.add_task(COMPILING, total=None)
        if not console.is_terminal:
            say_if_compiling("partdr")

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show that ``done`` of ``total`` iterations are done."""
        self.update(self._task, description=stage, completed=done, total=total)


class PictureProgress(Progress):
    """Progress bar on stderr for pictures and frames, with their rate and the remaining time."""

    def __init__(self, total: int | None, first: str = _NETWORKS) -> None:
        console = Console(stderr=True)
        super().__init__(
            TextColumn("{task.description:24}"),
            BarColumn(),
            MofNCompleteColumn(),
            _Rate(),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=True,
            speed_estimate_period=_SPEED_OVER,
        )
        self._task = self.add_task(first, total=total)
        if first == _NETWORKS:
            say_if_compiling("partdr")

    def __call__(self, name: str, count: int = 1) -> None:
        """Show that ``count`` more pictures are done, the last of them from the file ``name``."""
        self.update(self._task, description=escape(printable(name)), advance=count)

    def say(self, line: str) -> None:
        """Print a line on stderr, above the bar."""
        self.console.print(printable(line), markup=False, highlight=False, soft_wrap=True)


class _Rate(ProgressColumn):
    """Column with the pictures a second."""

    def render(self, task: Task) -> Text:
        """Draw the column."""
        return Text("" if task.speed is None else f"{task.speed:.1f}/s")
