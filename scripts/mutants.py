"""Mutation testing: a fault at a time in a copy of the project, and the tests that have to fail on it.

    python scripts/mutants.py [--quick] [--only WORD] [--jobs N]

``mutants.toml`` beside this file lists the faults, each one line of one file, with the tests that must notice it. The
project itself is never changed: each process works on a copy of its own under ``build/mutants``, where these tests are
seen to pass first. A fault is killed if one of its tests fails, and survives if all of them pass; then either a test is
missing, or the list explains (``survives``) why nothing can tell. The exit code is 1 if a fault survives unexplained,
or if an entry is wrong: its line is no longer there exactly once, or its tests can't run.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import track

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
    missing = [str(path) for path in mutated if path.suffix == ".py" and path not in loaded]
    (ROOT / "loaded.txt").write_text("\\n".join([f"not the copy's: {path}" for path in strange]
                                               + [f"not imported: {path}" for path in missing]))
"""


@dataclass(frozen=True)
class Mutant:
    """Fault: one line of one file, replaced, and the tests that must notice."""

    file: str  # from the project's folder
    find: str  # part of one line, there exactly once
    replace: str  # what stands there instead
    tests: tuple[str, ...]  # as pytest names them (``tests/test_x.py::test_y``)
    why: str  # what is wrong then
    survives: str = ""  # why no test can tell, if none can

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


def read_mutants() -> list[Mutant]:
    """The mutants in the order of the list; an entry that lacks something, or has what no mutant has, is refused."""
    entries = tomllib.loads(LIST.read_text(encoding="utf-8"))["mutant"]
    return [Mutant(**{**entry, "tests": tuple(entry["tests"])}) for entry in entries]


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


def try_mutant(mutant: Mutant, folder: Path) -> tuple[str, str]:
    """Put the fault into a copy, run its tests, and take it out again; returns what ``run_tests`` does."""
    path = folder / mutant.file
    try:
        text = mutant.apply(folder)
    except ValueError as error:
        return "error", str(error)
    original = path.read_text(encoding="utf-8")
    path.write_text(text, encoding="utf-8")
    try:
        return run_tests(folder, mutant.tests, [mutant.file], PATIENCE)
    finally:
        path.write_text(original, encoding="utf-8")


def main() -> int:
    """Try the mutants; return 1 if one survives unexplained or the list is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the first mutant of each file")
    parser.add_argument("--only", default="", metavar="WORD", help="mutants whose file, line or reason holds the word")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time; default: 2")
    options = parser.parse_args()
    if options.jobs < 1:
        parser.error(f"--jobs: {options.jobs}; expected 1 or more")
    mutants = quick(read_mutants()) if options.quick else read_mutants()
    mutants = [each for each in mutants if options.only in f"{each.file} {each.find} {each.replace} {each.why}"]
    if not mutants:
        parser.error(f"--only: {options.only!r}; no such mutant")
    console = Console(highlight=False, markup=False)

    folders = [WORK / f"copy{number}" for number in range(options.jobs)]
    for folder in folders:
        copy_project(folder)
    # Without a fault, all the tests pass; it also warms Warp's cache.
    tests = dict.fromkeys(test for mutant in mutants for test in mutant.tests)
    kind, said = run_tests(folders[0], list(tests), {mutant.file for mutant in mutants})
    if kind != "survived":
        console.print(f"without a fault: {said}")
        return 1
    kinds, bad = [], []

    def try_next(mutant: Mutant) -> tuple[str, str]:
        folder = folders.pop()  # one that is free
        try:
            return try_mutant(mutant, folder)
        finally:
            folders.append(folder)

    with ThreadPoolExecutor(options.jobs) as pool:
        outcomes = zip(mutants, pool.map(try_next, mutants), strict=True)
        for mutant, (kind, said) in track(outcomes, "mutants", len(mutants), console=console):
            console.print(f"{kind:8} {mutant.file}: {mutant.why}")
            kinds.append(kind)
            if kind == "error" or (kind == "survived" and not mutant.survives):
                bad.append(f"{mutant.file}: {mutant.replace}: {mutant.why}: {kind}: {said}")
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in ("killed", "survived", "error"))
    console.print(f"{len(kinds)} mutants: {counts}", *bad, sep="\n")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
