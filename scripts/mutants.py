"""Mutation testing: a fault at a time in a copy of the project, and the tests that have to fail on it.

    python scripts/mutants.py [--quick] [--since COMMIT] [--only WORD] [--jobs N]

``mutants.toml`` beside this file lists the faults, each one expression or statement of one function, with the tests
that must notice it; the list's head says how an entry is written. The project itself is never changed: each process
works on a copy of its own under ``build/mutants``, where these tests are seen to pass first. A fault is killed if one
of its tests fails, and survives if all of them pass; then either a test is missing, or the list explains
(``survives``) why nothing can tell. The exit code is 1 if a fault survives unexplained, or if an entry is wrong: its
function or its expression is no longer there exactly once, or its tests can't run.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Sequence
from compileall import compile_dir
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from py_compile import PycInvalidationMode

from find_code import Module, Project, matches
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
    """Fault: a piece of code, replaced, and the tests that must notice."""

    find: str  # an expression or a statement, compared by its syntax tree; in files that are no Python, a text
    replace: str  # what stands there instead
    tests: tuple[str, ...]  # as pytest names them (``tests/test_x.py::test_y``)
    why: str  # what is wrong then
    definition: str = ""  # the function, method, variable or parameter that holds it, see find_code.py
    file: str = ""  # what tells files apart if several have the definition; the whole path if there is no definition
    occurrence: int = 0  # which one, from 1, if the definition holds several
    survives: str = ""  # why no test can tell, if none can

    def path(self, project: Project) -> str:
        """The mutated file, from the project's folder.

        Raises:
            ValueError: If the definition is not in one file.
        """
        return project.file_with(self.definition, self.file) if self.definition else self.file

    def apply(self, project: Project) -> str:
        """The mutated text of the file.

        Raises:
            ValueError: If the definition is not in one file, its code is not there exactly once, or the fault is none.
        """
        path = self.path(project)
        if not path.endswith(".py"):
            return self._apply_to_text(project.folder / path)
        if path not in project.modules:
            raise ValueError(f"{path}: no such file; expected one of the project's")
        module = project.modules[path]
        roots = module.definitions[self.definition] if self.definition else module.statements
        found = matches(roots, self.find, self.replace)
        if len(found) == 1 and not self.occurrence:
            return module.replaced(found[0], self.replace)
        if len(found) > 1 and 1 <= self.occurrence <= len(found):
            return module.replaced(found[self.occurrence - 1], self.replace)
        expected = f"{max(self.occurrence, 2)} times or more" if self.occurrence else "once, or an occurrence"
        raise ValueError(f"{self.name(path)} {len(found)} times; expected {expected}")

    def _apply_to_text(self, path: Path) -> str:
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if (count := text.count(self.find)) != 1:
            raise ValueError(f"{self.file}: {self.find!r} {count} times; expected once")
        if self.find == self.replace:
            raise ValueError(f"{self.file}: {self.find!r}; expected a change")
        return text.replace(self.find, self.replace)

    def name(self, path: str) -> str:
        """Place of the fault, for messages."""
        return f"{path}: {self.definition}: {self.find!r}"

    def words(self, project: Project) -> str:
        """All that ``--only`` looks at."""
        return f"{self.name(self.path(project))} {self.find} {self.replace} {self.why}"


def read_mutants() -> list[Mutant]:
    """The mutants in the order of the list; an entry that lacks something, or has what no mutant has, is refused."""
    entries = tomllib.loads(LIST.read_text(encoding="utf-8"))["mutant"]
    return [Mutant(**{**entry, "tests": tuple(entry["tests"])}) for entry in entries]


def quick(mutants: Iterable[Mutant], project: Project) -> list[Mutant]:
    """The first mutant of each file."""
    first: dict[str, Mutant] = {}
    for mutant in mutants:
        first.setdefault(mutant.path(project), mutant)
    return list(first.values())


def changed_since(commit: str, mutants: Iterable[Mutant], project: Project) -> list[Mutant]:
    """The mutants whose definition, or whose entry in the list, is not as it was in a commit.

    Raises:
        subprocess.CalledProcessError: If git does not know the commit.
    """
    changed = {*git("diff", "--name-only", commit).split(), *git("ls-files", "--others", "--exclude-standard").split()}
    old_list = tomllib.loads(git("show", f"{commit}:scripts/{LIST.name}"))["mutant"]
    listed = {(entry.get("definition"), entry["find"], entry["replace"]) for entry in old_list}
    old_modules: dict[str, Module] = {}
    chosen = []
    for mutant in mutants:
        path = mutant.path(project)
        is_new = (mutant.definition, mutant.find, mutant.replace) not in listed
        if not is_new and path in changed and mutant.definition:
            if path not in old_modules:
                old_modules[path] = Module(git("show", f"{commit}:{path}", missing=""))
            is_new = project.modules[path].code(mutant.definition) != old_modules[path].code(mutant.definition)
        elif path in changed:
            is_new = True
        if is_new:
            chosen.append(mutant)
    return chosen


def git(*arguments: str, missing: str | None = None) -> str:
    """Answer of git in the project, or another text if it fails."""
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=missing is None)
    return missing if done.returncode and missing is not None else done.stdout


def copy_project(folder: Path) -> None:
    """Make the copy that a process mutates."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder)
    for link, target in LINKS.items():
        if not (folder / link).is_symlink():  # the project itself may have it
            (folder / link).symlink_to(target, target_is_directory=True)
    (folder / "guard.py").write_text(GUARD)
    # Told apart by their contents, so that a file that changes twice in a second is never taken for what it was.
    compile_dir(folder, quiet=2, invalidation_mode=PycInvalidationMode.CHECKED_HASH)


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
        "PYTHONDONTWRITEBYTECODE": "1",  # faults are not kept
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


def try_mutant(mutant: Mutant, folder: Path, project: Project) -> tuple[str, str]:
    """Put the fault into a copy of the project, run its tests, and take it out again.

    Returns:
        What ``run_tests`` does, or an error if the fault can't be made.
    """
    try:
        file, text = mutant.path(project), mutant.apply(project)
    except ValueError as error:
        return "error", str(error)
    path = folder / file
    original = path.read_text(encoding="utf-8")
    path.write_text(text, encoding="utf-8")
    try:
        return run_tests(folder, mutant.tests, [file], PATIENCE)
    finally:
        path.write_text(original, encoding="utf-8")


def main() -> int:
    """Try the mutants; return 1 if one survives unexplained or the list is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the first mutant of each file")
    parser.add_argument("--since", metavar="COMMIT", help="mutants whose function or entry has changed since")
    parser.add_argument("--only", default="", metavar="WORD", help="mutants whose file, code or reason holds the word")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time; default: 2")
    options = parser.parse_args()
    if options.jobs < 1:
        parser.error(f"--jobs: {options.jobs}; expected 1 or more")
    project = Project(ROOT)
    mutants = read_mutants()
    try:
        if options.since is not None:
            mutants = changed_since(options.since, mutants, project)
        if options.quick:
            mutants = quick(mutants, project)
        mutants = [mutant for mutant in mutants if options.only in mutant.words(project)]
    except subprocess.CalledProcessError as error:
        parser.error(f"--since: {options.since!r}: {error.stderr.strip()}")
    except ValueError as error:
        parser.error(str(error))
    console = Console(highlight=False, markup=False)
    if not mutants:
        console.print("no such mutant")
        return 0 if options.since is not None else 2

    folders = [WORK / f"copy{number}" for number in range(options.jobs)]
    for folder in folders:
        copy_project(folder)
    # Without a fault, all the tests pass; it also warms Warp's cache.
    tests = dict.fromkeys(test for mutant in mutants for test in mutant.tests)
    kind, said = run_tests(folders[0], list(tests), {mutant.path(project) for mutant in mutants})
    if kind != "survived":
        console.print(f"without a fault: {said}")
        return 1
    kinds, bad = [], []

    def try_next(mutant: Mutant) -> tuple[str, str]:
        folder = folders.pop()  # one that is free
        try:
            return try_mutant(mutant, folder, project)
        finally:
            folders.append(folder)

    with ThreadPoolExecutor(options.jobs) as pool:
        outcomes = zip(mutants, pool.map(try_next, mutants), strict=True)
        for mutant, (kind, said) in track(outcomes, "mutants", len(mutants), console=console):
            name = mutant.name(mutant.path(project))
            console.print(f"{kind:8} {name}: {mutant.why}")
            kinds.append(kind)
            if kind == "error" or (kind == "survived" and not mutant.survives):
                bad.append(f"{name}: {mutant.replace!r}: {mutant.why}: {kind}: {said}")
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in ("killed", "survived", "error"))
    console.print(f"{len(kinds)} mutants: {counts}", *bad, sep="\n")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
