"""Jobs one after another, with their progress told."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from ...solve.ellipsoids.stages import Progress

Job = tuple[str, Callable[[], None]]  # its name, and what it does


def run_jobs(jobs: Iterable[Job], progress: Progress | None = None) -> None:
    """Run each job; ``progress`` is called with (name, jobs done, jobs in all)."""
    tell = progress or (lambda name, done, total: None)
    jobs = list(jobs)
    for index, (name, job) in enumerate(jobs):
        tell(name, index, len(jobs))
        job()
    tell("done", len(jobs), len(jobs))
