"""Progress of a fit on the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn


class FitProgress(Progress):
    """A bar on stderr for ``fit_body(progress=...)``; plain silence where stderr is no terminal."""

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
        self._task = self.add_task("compiling kernels, once for this machine", total=None)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show that ``done`` of ``total`` iterations are over."""
        self.update(self._task, description=stage, completed=done, total=total)
