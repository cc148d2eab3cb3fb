"""Sets of results: either all files of one run are there, or a reader sees that the set is not whole.

No file system can replace several files at once. So a set has a report, such as ``report.json``, which holds the
SHA-256 of the other files. The report is removed before the first file is replaced, and is written last: if it is
there, the set is whole. Until then, a folder ``.partdr-unfinished-...`` in the results' folder says that files of two
runs may lie side by side. Readers (``check_result``) check both. A new folder of results appears by one renaming.
"""

from __future__ import annotations

import json
import os
import platform
import re
import secrets
import shutil
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..files.disk import check_regular, file_sha256

REPORTS = "report.json", "registration.json", "predictions.json", "people.json"
FIT_REPORT, REGISTRATION_REPORT, PREDICTIONS_REPORT, PEOPLE_REPORT = REPORTS
FILES = "files"  # key in a report for the SHA-256 of each file
_WRITING, _UNFINISHED = ".partdr-writing-", ".partdr-unfinished-"
_OLD = "old-"  # prefix of a report that was removed
_PROCESS = re.compile(r"\.partdr-(?:writing|unfinished)-(?P<host>.+)-(?P<process>\d+)-\w+")
_DAY = 24 * 60 * 60  # [s] without a change, after which another machine's folder counts as left behind

_mine: set[str] = set()  # tokens of the folders that this process writes to


@contextmanager
def replacing(folder: Path, name: str, report: dict[str, Any], *, outdates: tuple[str, ...] = ()) -> Iterator[Path]:
    """Temporary folder within. Afterwards, its files replace those in ``folder`` as a set.

    Files with other names in ``folder`` stay. If an error is raised within, nothing changes there, and ``folder`` is
    not made.

    Args:
        folder: Folder for the set, made if it does not exist.
        name: File of the report, one of ``REPORTS``.
        report: Report, which is written last; it gets the SHA-256 of the files under the key ``files``.
        outdates: Reports of older sets that are removed, together with those of their files that have not changed.

    Raises:
        InputError: If something can't be written.
    """
    with _explained(folder):
        target = Path(os.path.realpath(folder))
        # The temporary folder is inside the folder, or inside the nearest one above that exists. It is on the same
        # disk, so files can be moved by renaming, and only these two folders must be writable.
        base = _existing(target)
        with scratch_folder(base) as scratch:
            parts = target.relative_to(base).parts
            top = base.joinpath(*parts[:1])  # the temporary folder becomes this one, if nobody else makes it meanwhile
            temporary = scratch.joinpath(*parts[1:])
            temporary.mkdir(parents=True, exist_ok=True)
            yield temporary
            if taken := [path.name for path in temporary.iterdir() if (target / path.name).is_dir()]:
                raise InputError(f"{folder / taken[0]}: a folder; expected a file, or nothing")
            report[FILES] = {path.name: file_sha256(path) for path in sorted(temporary.iterdir())}
            (temporary / name).write_text(json.dumps(report, indent=1) + "\n")
            if missing := [path for path in (target, *target.parents) if not path.exists()]:
                (scratch / missing[-1].relative_to(top)).rename(missing[-1])
            else:
                unfinished = target / scratch.name.replace(_WRITING, _UNFINISHED)
                temporary.rename(unfinished)
                _move_set(unfinished, name, outdates)


def check_result(path: str | Path) -> None:
    """Raise if a file of results is not of the same run as the report beside it. A file without a report may be alone.

    Raises:
        InputError: If the report has another SHA-256 of it, or a run that replaced files here was ended.
        OSError: If it can't be read.

    Examples:
        After ``save_fit(result, "fitted")``:

        >>> from warp_partdr import check_result
        >>> check_result("fitted/body.npz")  # raises InputError if the file is not of report.json's run
    """
    path = Path(path)
    for report, digest in _naming(path):
        if file_sha256(path) != digest:
            raise InputError(
                f"{path}: not of the same run as {report} beside it, which has another SHA-256 of it; expected the "
                "files of one run, or this one in a folder of its own"
            )
        return
    if any(_waiting(folder) for folder in path.parent.glob(f"{_UNFINISHED}*")):
        raise InputError(
            f"{path}: perhaps not of the same run as the files beside it: one that replaces them was ended, or has not "
            "finished; expected a finished run's: run it again"
        )


def names_file(report: Path, name: str) -> bool:
    """True if a set's report names this file; False also if there is no report, or it can't be read."""
    with suppress(InputError):
        return name in _named(report)
    return False


def check_not_in_set(path: Path) -> None:
    """Raise an InputError if a set's report names this file, which would be written outside of the set."""
    for report, _ in _naming(path):
        raise InputError(f"{path}: of the run that {report} beside it is about; expected another name or folder")


def check_folder(folder: Path) -> None:
    """Raise an InputError, before the work starts, if results can't be written to ``folder``, which need not exist."""
    # A folder is made and removed again, because permissions alone don't tell everything.
    with _explained(folder), scratch_folder(_existing(Path(os.path.realpath(folder)))):
        pass


def check_inputs(folder: Path, given: Iterable[Path | None], files: Iterable[str]) -> None:
    """Raise an InputError if one of the results ``files``, written to ``folder``, would replace a given file."""
    results = {(folder / name).resolve() for name in files}
    for path in given:
        if path is not None and path.resolve() in results:
            raise InputError(f"--out: {folder}: the result would replace {path}; expected another folder")


def _move_set(new: Path, name: str, outdates: tuple[str, ...]) -> None:
    """Move a set from its own folder to the folder around it, the report last."""
    folder = new.parent
    ended = [path for path in folder.glob(f"{_UNFINISHED}*") if _waiting(path) in (name, *outdates)]
    ended = [path for path in ended if _left_behind(path)]
    for report in dict.fromkeys((name, *outdates)):
        if (folder / report).exists():
            (folder / report).replace(new / f"{_OLD}{report}")
    names = [path.name for path in new.iterdir() if path.name != name and not path.name.startswith(_OLD)]
    for source in (where / f"{age}{report}" for where in (new, *ended) for age in ("", _OLD) for report in outdates):
        with suppress(InputError):  # a file that is no report names nothing
            for other, digest in _named(source).items():
                path = folder / other
                if other not in names and path.is_file() and file_sha256(path) == digest:
                    path.unlink()
    for file in names:
        (new / file).replace(folder / file)
    (new / name).replace(folder / name)
    for path in (new, *ended):
        # The folder is the only sign of an ended run's files, until a set has replaced or removed all of them.
        if name in outdates or _named(path / name).keys() <= set(names):
            shutil.rmtree(path, ignore_errors=True)


@contextmanager
def scratch_folder(folder: Path) -> Iterator[Path]:
    """Folder for files that are being written; folders that earlier processes left behind are removed first."""
    for path in folder.glob(".partdr-*"):
        if path.is_dir() and _waiting(path) is None and _left_behind(path):
            shutil.rmtree(path, ignore_errors=True)
    token = f"{_host()}-{os.getpid()}-{secrets.token_hex(4)}"
    scratch = folder / f"{_WRITING}{token}"
    _mine.add(token)
    try:
        scratch.mkdir()
        yield scratch
    finally:
        _mine.discard(token)
        shutil.rmtree(scratch, ignore_errors=True)


def _waiting(unfinished: Path) -> str | None:
    """Name of the report in the folder of a set that is not moved completely; None for another folder."""
    if not unfinished.name.startswith(_UNFINISHED):
        return None
    return next((report for report in REPORTS if (unfinished / report).exists()), None)


def _left_behind(folder: Path) -> bool:
    """True if no process uses a folder of this module any more."""
    match = _PROCESS.fullmatch(folder.name)
    # Only this machine's processes are known; and on Windows, os.kill kills.
    if match and match["host"] == _host() and os.name == "posix":
        process = int(match["process"])
        if process == os.getpid():
            return folder.name.removeprefix(_WRITING).removeprefix(_UNFINISHED) not in _mine
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        except (OSError, OverflowError):
            pass
    try:
        return time.time() - folder.stat().st_mtime > _DAY
    except OSError:
        return False  # gone by now


def _host() -> str:
    return re.sub(r"[^\w.]", "_", platform.node())[:60] or "unknown"


def _named(report: Path) -> dict[str, str]:
    """SHA-256 of each file that a report names; empty if there is no report, or it is not a set's.

    Raises:
        InputError: If it is no JSON, because it may have been a set's report.
    """
    try:
        check_regular(report)
        data = json.loads(report.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{report}: can't be read as JSON; expected what partdr left, or no such file") from error
    files = data.get(FILES) if isinstance(data, dict) else None
    files = files if isinstance(files, dict) else {}
    return {name: digest for name, digest in files.items() if Path(name).name == name}


def _naming(path: Path) -> Iterator[tuple[str, str]]:
    """Names of the reports beside a file that name it, and its SHA-256 in them."""
    for report in REPORTS:
        if (digest := _named(path.parent / report).get(path.name)) is not None:
            yield report, digest


@contextmanager
def _explained(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror or error}; expected a folder to write to") from error


def _existing(folder: Path) -> Path:
    """Return the folder, or the nearest one above it that exists."""
    return next((path for path in (folder, *folder.parents) if path.exists()), folder)
