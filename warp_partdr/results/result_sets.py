"""Results that are there as a set: all files of one run, or nothing that passes for one.

No file system puts several files in place at once. So a set has a report, ``report.json`` for example, which holds the
SHA-256 of the others. It is taken away before the first file is replaced, and written last: where it is, the set is
whole. Until then a folder in the results' folder, ``.partdr-unfinished-...``, says that files of two runs may lie side
by side; readers (``check_result``) look for both. A folder of results that isn't there yet appears by one renaming.
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
FILES = "files"  # a report's key for the SHA-256 of each file
_WRITING, _UNFINISHED = ".partdr-writing-", ".partdr-unfinished-"
_OLD = "old-"  # a report that was taken away
_PROCESS = re.compile(r"\.partdr-(?:writing|unfinished)-(?P<host>.+)-(?P<process>\d+)-\w+")
_DAY = 24 * 60 * 60  # [s] without a change, after which another machine's folder counts as left behind

_mine: set[str] = set()  # tokens of the folders that this process is busy with


@contextmanager
def replacing(folder: Path, name: str, report: dict[str, Any], *, outdates: tuple[str, ...] = ()) -> Iterator[Path]:
    """A temporary folder, whose files take their places in ``folder`` as a set when all are written.

    Files of other names in ``folder`` stay. On an error while they are written nothing there changes, and ``folder`` is
    not made.

    Args:
        folder: Made if it is not there.
        name: The report's file, one of ``REPORTS``.
        report: Written last; it gets the SHA-256 of the files as ``files``.
        outdates: Reports of older sets that go when this one comes, with their files that are as those left them.

    Raises:
        InputError: If something can't be written.
    """
    with _explained(folder):
        place = Path(os.path.realpath(folder))
        # Inside the folder, or the nearest one above that exists: on the same disk, files can take their places by
        # renaming alone, and nothing but these two folders need be writable.
        base = _existing(place)
        with scratch_folder(base) as scratch:
            parts = place.relative_to(base).parts
            top = base.joinpath(*parts[:1])  # what the temporary folder becomes, if nobody else makes it meanwhile
            temporary = scratch.joinpath(*parts[1:])
            temporary.mkdir(parents=True, exist_ok=True)
            yield temporary
            if taken := [path.name for path in temporary.iterdir() if (place / path.name).is_dir()]:
                raise InputError(f"{folder / taken[0]}: a folder; expected a file, or nothing")
            report[FILES] = {path.name: file_sha256(path) for path in sorted(temporary.iterdir())}
            (temporary / name).write_text(json.dumps(report, indent=1) + "\n")
            if missing := [path for path in (place, *place.parents) if not path.exists()]:
                (scratch / missing[-1].relative_to(top)).rename(missing[-1])
            else:
                unfinished = place / scratch.name.replace(_WRITING, _UNFINISHED)
                temporary.rename(unfinished)
                _take_places(unfinished, name, outdates)


def check_result(path: str | Path) -> None:
    """Raise if a file of results is not of the same run as the report beside it; one without a report is its own.

    Raises:
        InputError: If the report has another SHA-256 of it, or a run that replaced files here was ended.
        OSError: If it can't be read.
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
    """True if a set's report has a file of this name; False, too, where there is none or it can't be read."""
    with suppress(InputError):
        return name in _named(report)
    return False


def check_not_in_set(path: Path) -> None:
    """Raise an InputError if a set's report has this file, which is about to be written by itself."""
    for report, _ in _naming(path):
        raise InputError(f"{path}: of the run that {report} beside it is about; expected another name or folder")


def check_folder(folder: Path) -> None:
    """Raise an InputError before the work starts if results can't be written to ``folder``, which need not exist."""
    # Tried, not asked: permissions don't tell everything. Nothing of it stays.
    with _explained(folder), scratch_folder(_existing(Path(os.path.realpath(folder)))):
        pass


def check_inputs(folder: Path, given: Iterable[Path | None], files: Iterable[str]) -> None:
    """Raise an InputError if one of these files, written to ``folder``, would replace a given one."""
    results = {(folder / name).resolve() for name in files}
    for path in given:
        if path is not None and path.resolve() in results:
            raise InputError(f"--out: {folder}: the result would replace {path}; expected another folder")


def _take_places(new: Path, name: str, outdates: tuple[str, ...]) -> None:
    """Move a set from its own folder to the one around it, the report last."""
    folder = new.parent
    ended = [path for path in folder.glob(f"{_UNFINISHED}*") if _waiting(path) in (name, *outdates)]
    ended = [path for path in ended if _left_behind(path)]
    for report in dict.fromkeys((name, *outdates)):
        if (folder / report).exists():
            (folder / report).replace(new / f"{_OLD}{report}")
    names = [path.name for path in new.iterdir() if path.name != name and not path.name.startswith(_OLD)]
    for source in (place / f"{age}{report}" for place in (new, *ended) for age in ("", _OLD) for report in outdates):
        with suppress(InputError):  # what is no report names nothing
            for other, digest in _named(source).items():
                path = folder / other
                if other not in names and path.is_file() and file_sha256(path) == digest:
                    path.unlink()
    for file in names:
        (new / file).replace(folder / file)
    (new / name).replace(folder / name)
    for path in (new, *ended):
        # What an ended run left is told apart by its folder alone, until a set replaces or removes all of it.
        if name in outdates or _named(path / name).keys() <= set(names):
            shutil.rmtree(path, ignore_errors=True)


@contextmanager
def scratch_folder(folder: Path) -> Iterator[Path]:
    """A folder for files that are being written; those that earlier processes left behind are removed first."""
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
    """The report of a set that has not all its files in place."""
    if not unfinished.name.startswith(_UNFINISHED):
        return None
    return next((report for report in REPORTS if (unfinished / report).exists()), None)


def _left_behind(folder: Path) -> bool:
    """True if no process is busy any more with a folder of this module's."""
    match = _PROCESS.fullmatch(folder.name)
    # Only here is it known who runs; and on Windows, os.kill kills.
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
    """The SHA-256 of each file that a report names; none if it is not there, or no set's.

    Raises:
        InputError: If it is no JSON: it may have been a set's.
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
    """The reports beside a file that name it, and its SHA-256 there."""
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
    """The folder, or the nearest one above it that exists."""
    return next((path for path in (folder, *folder.parents) if path.exists()), folder)
