"""Mutation testing: a fault at a time in a copy of the project, and the tests that have to fail on it.

    python scripts/mutants.py [--quick] [--only WORD] [--portion 1/4] [--jobs N] [--list]

``mutants.toml`` beside this file lists the faults, each one line of one file, with the tests that must notice it. The
project itself is never changed: each process works on a copy of its own under ``build/mutants``, where these tests are
seen to pass first. A fault is killed if one of its tests fails, and survives if all of them pass; then either a test is
missing, or the list explains (``survives``) why nothing can tell. The exit code is 1 if a fault survives unexplained,
or if an entry is wrong: its line is no longer there exactly once, or its tests can't run.
"""

from __future__ import annotations

import argparse
import os
import queue
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_suffix(".toml")
WORK = ROOT / "build" / "mutants"
COPIED = ("benchmarks", "body", "demos", "kernels", "pyproject.toml", "scripts", "tests", "warp_partdr")
# Python looks for warp_partdr in the copy's own folder first, so there the package's real layout is made of links.
LINKS = {"warp_partdr/kernels": "../kernels", "warp_partdr/body": "../body", "warp_partdr/viewer": "../demos/viewer"}
PATIENCE = 1200  # [s]; a fault may make a loop endless, and what hangs so long is noticed, too

# A plugin of pytest: the run counts only if all that was tested is the copy's, the mutated file among it.
GUARD = """
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent


def pytest_sessionfinish(session):
    loaded = {
        Path(module.__file__).resolve()
        for name, module in list(sys.modules.items())
        if name.partition(".")[0] == "warp_partdr" and getattr(module, "__file__", None)
    }
    strange = sorted(str(path) for path in loaded if not path.is_relative_to(ROOT))
    mutated = [ROOT / name for name in (ROOT / "mutated.txt").read_text().split()]
    missing = [str(path) for path in mutated if path not in loaded]
    (ROOT / "loaded.txt").write_text("\\n".join([f"not the copy's: {path}" for path in strange]
                                               + [f"not imported: {path}" for path in missing]))
"""


@dataclass(frozen=True)
class Mutant:
    """Fault: one line of one file, replaced, and the tests that must notice.

    Attributes:
        file: Where, from the project's folder.
        find: Part of one line, there exactly once.
        replace: What stands there instead.
        tests: Which must notice, as pytest names them (``tests/test_x.py::test_y``).
        why: What is wrong then.
        survives: Why no test can tell, if none can.
    """

    file: str
    find: str
    replace: str
    tests: tuple[str, ...]
    why: str
    survives: str = ""

    def apply(self, folder: Path) -> str:
        """The mutated text of the file.

        Raises:
            ValueError: If the line is not there exactly once, or the fault is none.
        """
        path = folder / self.file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if (count := text.count(self.find)) != 1:
            raise ValueError(f"{self.file}: {self.find!r} {count} times; expected once")
        if self.find == self.replace or "\n" in self.find + self.replace:
            raise ValueError(f"{self.file}: {self.find!r}; expected a change within one line")
        return text.replace(self.find, self.replace)


@dataclass(frozen=True)
class Outcome:
    """Result of a mutant: ``kind`` is killed, survived or error; ``said`` is the test, or what went wrong."""

    mutant: Mutant
    kind: str
    said: str
    seconds: float


def read_mutants(path: Path = LIST) -> list[Mutant]:
    """Read the mutants, in the order of the list.

    Raises:
        ValueError: If an entry lacks something, or has what no mutant has.
    """
    with path.open("rb") as file:
        entries = tomllib.load(file)["mutant"]
    mutants = []
    for entry in entries:
        try:
            mutants.append(Mutant(**{**entry, "tests": tuple(entry["tests"])}))
        except (KeyError, TypeError) as error:
            raise ValueError(f"{path.name}: {entry}: {error}") from error
    return mutants


def quick(mutants: Iterable[Mutant]) -> list[Mutant]:
    """The first mutant of each file."""
    return list({mutant.file: mutant for mutant in reversed(list(mutants))}.values())[::-1]


def copy_project(folder: Path) -> None:
    """Make the copy that a process mutates."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder)
    for link, target in LINKS.items():
        (folder / link).symlink_to(target, target_is_directory=True)
    (folder / "guard.py").write_text(GUARD)


def run_tests(
    folder: Path, tests: Sequence[str], mutated: Iterable[str], patience: float | None = None
) -> tuple[str, str]:
    """Run tests in a copy until one fails, or for so many seconds.

    Returns:
        What became of the mutated files, killed, survived or error; and the first failure, or what went wrong.
    """
    (folder / "mutated.txt").write_text("\n".join(mutated))
    (folder / "loaded.txt").write_text("no tests ran")
    environment = {
        **os.environ,
        "PYTHONPATH": str(folder),  # for the processes that tests start elsewhere
        "PYTHONDONTWRITEBYTECODE": "1",  # a file may change twice within what a .pyc can tell apart
        "WARP_CACHE_PATH": str(WORK / "kernels"),  # so that the user's own does not fill with faults
        "CI": "1",  # Hypothesis draws the same cases in every run
        "PARTDR_TEST_DEVICES": "cpu",
        "OMP_NUM_THREADS": "1",  # the copies' processes share the cores
    }
    options = ["-x", "-q", "--no-header", "--tb=line", "-p", "guard", "-p", "no:cacheprovider", "-p", "no:xdist"]
    command = [sys.executable, "-m", "pytest", *options, *tests]
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=patience
        )
    except subprocess.TimeoutExpired:
        return "killed", f"hung for {patience} s"
    if done.returncode < 0:
        return "killed", f"crashed with signal {-done.returncode}"
    lines = (done.stdout + done.stderr).strip().splitlines() or ["nothing said"]
    said = next((line for line in lines if line.startswith(("FAILED", "ERROR"))), lines[-1])
    if done.returncode not in (0, 1):  # pytest's own codes: a test is not there, or can't be collected
        return "error", said
    if wrong := (folder / "loaded.txt").read_text():
        return "error", wrong
    return "killed" if done.returncode else "survived", said


def try_mutant(mutant: Mutant, folder: Path) -> Outcome:
    """Put the fault into a copy, run its tests, and take it out again."""
    began = time.perf_counter()

    def outcome(kind: str, said: str) -> Outcome:
        return Outcome(mutant, kind, said, time.perf_counter() - began)

    path = folder / mutant.file
    try:
        text = mutant.apply(folder)
    except ValueError as error:
        return outcome("error", str(error))
    original = path.read_text(encoding="utf-8")
    path.write_text(text, encoding="utf-8")
    try:
        return outcome(*run_tests(folder, mutant.tests, [mutant.file], PATIENCE))
    finally:
        path.write_text(original, encoding="utf-8")


def try_all(mutants: Sequence[Mutant], jobs: int, told: Callable[[Outcome], None]) -> list[Outcome]:
    """Every mutant, ``jobs`` at a time, in the list's order."""
    folders: queue.SimpleQueue[Path] = queue.SimpleQueue()
    for number in range(jobs):
        folders.put(WORK / f"copy{number}")

    def work(mutant: Mutant) -> Outcome:
        folder = folders.get()
        try:
            return try_mutant(mutant, folder)
        finally:
            folders.put(folder)

    outcomes: dict[Mutant, Outcome] = {}
    with ThreadPoolExecutor(jobs) as pool:
        for future in as_completed([pool.submit(work, mutant) for mutant in mutants]):
            outcome = future.result()
            outcomes[outcome.mutant] = outcome
            told(outcome)
    return [outcomes[mutant] for mutant in mutants]


def check_copies(mutants: Sequence[Mutant], jobs: int) -> str:
    """Make the copies, and see the tests pass in one of them: empty, or what is wrong. It also warms Warp's cache."""
    for number in range(jobs):
        copy_project(WORK / f"copy{number}")
    tests = dict.fromkeys(test for mutant in mutants for test in mutant.tests)
    kind, said = run_tests(WORK / "copy0", list(tests), {mutant.file for mutant in mutants})
    return "" if kind == "survived" else said


def report(outcomes: Sequence[Outcome], console: Console) -> None:
    """Print the mutants that were not killed, and the number that were."""
    table = Table("mutant", "what is wrong", "outcome", title="Not killed")
    for each in outcomes:
        if each.kind != "killed":
            said = each.mutant.survives or each.said
            table.add_row(f"{each.mutant.file}\n{each.mutant.replace}", each.mutant.why, f"{each.kind}: {said}")
    if table.row_count:
        console.print(table)
    kinds = [each.kind for each in outcomes]
    console.print(
        f"{len(kinds)} mutants: {kinds.count('killed')} killed ({kinds.count('killed') / max(len(kinds), 1):.1%}), "
        f"{kinds.count('survived')} survived, {kinds.count('error')} errors"
    )


def main(argv: list[str] | None = None) -> int:
    """Try the mutants; return 1 if one survives unexplained or the list is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the first mutant of each file")
    parser.add_argument("--only", default="", metavar="WORD", help="mutants whose file, line or reason holds the word")
    parser.add_argument("--portion", default="1/1", metavar="K/N", help="the K-th of N shares of them; default: all")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time; default: 2")
    parser.add_argument("--list", action="store_true", help="say which, and try none")
    options = parser.parse_args(argv)
    if options.jobs < 1:
        parser.error(f"--jobs: {options.jobs}; expected 1 or more")
    mutants = quick(read_mutants()) if options.quick else read_mutants()
    mutants = [each for each in mutants if options.only in f"{each.file} {each.find} {each.replace} {each.why}"]
    share, shares = map(int, options.portion.split("/"))
    if not 1 <= share <= shares:
        parser.error(f"--portion: {options.portion}; expected such as 1/4")
    mutants = mutants[len(mutants) * (share - 1) // shares : len(mutants) * share // shares]
    console = Console()
    if options.list or not mutants:
        for each in mutants:
            console.print(f"{each.file}: {each.why}", highlight=False)
        return 0 if mutants else parser.error(f"--only: {options.only!r}; no such mutant")

    with console.status("without a fault"):
        wrong = check_copies(mutants, options.jobs)
    if wrong:
        console.print(f"without a fault: {wrong}", highlight=False, markup=False)
        return 1
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("mutants", total=len(mutants))

        def told(each: Outcome) -> None:
            line = f"{each.kind:8} {each.seconds:4.0f} s  {each.mutant.file}: {each.mutant.why}"
            console.print(line, highlight=False, markup=False)
            progress.advance(task)

        outcomes = try_all(mutants, options.jobs, told)
    report(outcomes, console)
    bad = [each for each in outcomes if each.kind == "error" or (each.kind == "survived" and not each.mutant.survives)]
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
