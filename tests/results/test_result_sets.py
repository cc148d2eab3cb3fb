"""Results as sets: in place as a whole, or told; and nothing else in the folder is touched."""

from __future__ import annotations

import hashlib
import io
import json
import os
import platform
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.files import body_file, tree

from warp_partdr import InputError, load_body
from warp_partdr.results.result_sets import (
    FIT_REPORT,
    PREDICTIONS_REPORT,
    REGISTRATION_REPORT,
    check_folder,
    check_inputs,
    check_result,
    replacing,
)
from warp_partdr.results.save import DETAILED_FILES

FIT = FIT_REPORT, FIT_REPORT, REGISTRATION_REPORT  # a report, and those that it outdates
REGISTRATION = REGISTRATION_REPORT, REGISTRATION_REPORT
PREDICTIONS = (PREDICTIONS_REPORT,)


def fill(folder: Path, kind: tuple[str, ...] = FIT, *, then: BaseException | None = None, **files: str) -> None:
    with replacing(folder, kind[0], {"about": "a run"}, outdates=kind[1:]) as temporary:
        for name, text in files.items():
            (temporary / name).write_text(text)
        if then is not None:
            raise then


def reads(path: Path) -> bool:
    """True if a file is there and passes for one of a finished run, or for one by itself."""
    try:
        check_result(path)
    except (InputError, FileNotFoundError):
        return False
    return path.is_file()


def passing(folder: Path) -> dict[str, str]:
    """Contents of the files that pass; those of a test's runs have one letter."""
    return {path.name: path.read_text() for path in sorted(folder.glob("?")) if reads(path)}


# --- ended at any step ---------------------------------------------------------------------------------------------


class Killed(BaseException):
    pass


@contextmanager
def killed_after(changes: int) -> Iterator[None]:
    """Let so many changes of files happen, and none after them: what a process that is killed leaves."""
    left = changes

    def counted(change: Callable[..., Any], *, opens: bool = False) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            nonlocal left
            if not opens or "w" in arguments[1]:
                if left <= 0:
                    raise Killed
                left -= 1
            return change(*arguments, **options)

        return call

    with pytest.MonkeyPatch.context() as patch:
        for name in ("mkdir", "rename", "replace", "unlink", "rmdir"):
            patch.setattr(os, name, counted(getattr(os, name)))
        patch.setattr(io, "open", counted(io.open, opens=True))
        yield


def killed(root: Path, before: Callable[[Path], None], run: Callable[[Path], None]) -> Iterator[Path]:
    """Folders in which a run was ended, one change later each, up to the one that came to its end."""
    for changes in range(100):
        folder = root / str(changes) / "x" / "out"
        folder.parents[1].mkdir()
        before(folder)
        try:
            with killed_after(changes):
                run(folder)
        except Killed:
            yield folder
        else:
            assert changes > 5
            return
    pytest.fail("it never ends")


def nothing(folder: Path) -> None:
    pass


def notes(folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / "notes").write_text("mine")


def older(folder: Path) -> None:
    notes(folder)
    fill(folder, a="old", b="old", g="old")


def older_and_detailed(folder: Path) -> None:
    older(folder)
    fill(folder, REGISTRATION, d="old", e="old")


def of_an_older_version(folder: Path) -> None:
    notes(folder)
    for name in ("a", "b"):
        (folder / name).write_text("old")
    (folder / FIT_REPORT).write_text("{}")


def newer(folder: Path) -> None:
    fill(folder, a="new", b="new", m="new")


def other(folder: Path) -> None:
    fill(folder, a="third", b="third")


@pytest.mark.parametrize("after", [newer, other])
@pytest.mark.parametrize("before", [nothing, notes, older, older_and_detailed, of_an_older_version])
def test_ended_at_any_change_no_mixture_passes_and_the_next_run_puts_all_right(
    before: Callable[[Path], None], after: Callable[[Path], None], tmp_path: Path
) -> None:
    (tmp_path / "clean").mkdir()
    if before is not nothing:
        notes(tmp_path / "clean" / "x" / "out")
    after(tmp_path / "clean" / "x" / "out")
    new, seen = {"a": "new", "b": "new", "m": "new"}, []
    for folder in killed(tmp_path, before, newer):
        if before is nothing:
            assert not folder.parent.exists()  # a new folder appears as the last change
        else:
            found = passing(folder)
            assert found == new or set(found.values()) <= {"old"}
            if (folder / FIT_REPORT).exists() and before is not of_an_older_version:
                assert found == new or {"a", "b", "g"} <= found.keys()
            assert (folder / "notes").read_text() == "mine"
            seen.append(found)
        after(folder)
        assert tree(folder.parents[1]) == tree(tmp_path / "clean")
    assert before is nothing or (new in seen and {} in seen)


def test_predictions_add_up_and_a_mixture_of_them_does_not_pass(tmp_path: Path) -> None:
    def first(folder: Path) -> None:
        fill(folder, PREDICTIONS, a="old", b="old", c="old")

    def second(folder: Path) -> None:
        fill(folder, PREDICTIONS, a="new", b="new")

    for folder in killed(tmp_path, first, second):
        found = passing(folder)
        assert found in ({"a": "old", "b": "old", "c": "old"}, {"a": "new", "b": "new", "c": "old"}, {})
        fill(folder, PREDICTIONS, x="third")
        assert set(passing(folder)) >= {"x"}
        assert {passing(folder).get(name) for name in "ab"} in ({"old"}, {"new"}, {None})
        second(folder)
        assert passing(folder) == {"a": "new", "b": "new", "c": "old", "x": "third"}
        assert not list(folder.glob(".partdr-*"))


CHILD = """
import os, pathlib, sys, threading
from warp_partdr.results.result_sets import FIT_REPORT, replacing

def replace(source, target, real=os.replace):
    real(source, target)
    if pathlib.Path(target).name in "ab":
        print("replaced one", flush=True)
        threading.Event().wait()

os.replace = replace
with replacing(pathlib.Path(sys.argv[1]), FIT_REPORT, {}, outdates=(FIT_REPORT,)) as temporary:
    for name in "ab":
        (temporary / name).write_text("new")
"""


def test_a_killed_process_leaves_a_set_that_the_next_run_mends(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    older(folder)
    with subprocess.Popen([sys.executable, "-c", CHILD, str(folder)], stdout=subprocess.PIPE, text=True) as child:
        try:
            assert child.stdout is not None
            assert child.stdout.readline() == "replaced one\n"
            (unfinished,) = folder.glob(".partdr-*")
            assert passing(folder) == {}
            with pytest.raises(InputError, match=r"perhaps not of the same run.*run it again"):
                check_result(folder / "a")
            check_folder(folder)
            other(folder)  # by another process meanwhile
            assert unfinished.exists()  # is not taken from one that lives
            assert passing(folder).keys() >= {"a", "b"}
        finally:
            child.send_signal(signal.SIGKILL)
    assert sorted((folder / name).read_text() for name in "ab") == ["third", "third"]
    newer(folder)
    assert set(tree(folder)) == {"a", "b", "m", "notes", FIT_REPORT}


def test_a_running_process_keeps_its_folder_and_others_leavings_go(tmp_path: Path) -> None:
    left = {
        f".partdr-writing-{platform.node()}-999999999-0": True,  # no such process
        ".partdr-writing-elsewhere-1-0": True,
        ".partdr-abcdefgh": True,  # of an older version
        ".partdr-writing-elsewhere-2-0": False,
        ".partdr-ijklmnop": False,
    }
    for name, old in left.items():
        (tmp_path / name / "sub").mkdir(parents=True)
        if old:
            os.utime(tmp_path / name, (0, 0))
    (tmp_path / ".partdr-mine").write_text("no folder")
    with replacing(tmp_path / "out", FIT_REPORT, {}) as temporary:
        check_folder(tmp_path / "out")
        assert temporary.exists()
    kept = {name for name, old in left.items() if not old} | {".partdr-mine", "out"}
    assert {path.name for path in tmp_path.iterdir()} == kept


def test_runs_into_folders_that_appear_meanwhile_keep_both(tmp_path: Path) -> None:
    """Two runs into neighbouring folders, or the same, that were not there when either began."""
    for name in ("one", "other", "other"):
        with replacing(tmp_path / "results" / name, FIT_REPORT, {}) as temporary:
            (temporary / "a").write_text(name)
            fill(tmp_path / "results" / "other", a="inner", b="inner")
    assert set(tree(tmp_path)) == {
        "results",
        *(f"results/one{name}" for name in ("", "/a", f"/{FIT_REPORT}")),
        *(f"results/other{name}" for name in ("", "/a", "/b", f"/{FIT_REPORT}")),
    }
    assert passing(tmp_path / "results" / "other") == {"a": "other", "b": "inner"}


# --- readers -------------------------------------------------------------------------------------------------------


def test_a_body_is_read_with_its_own_report_or_with_none(tmp_path: Path) -> None:
    with replacing(tmp_path / "fit", FIT_REPORT, {}) as temporary:
        body_file().save(temporary / "body.npz")
    load_body(tmp_path / "fit" / "body.npz")
    before = tree(tmp_path)
    other = replace(body_file(), camera_scale=np.array(50.0))
    with pytest.raises(InputError, match=r"fit/body\.npz: of the run that report\.json"):
        other.save(tmp_path / "fit" / "body.npz")
    assert tree(tmp_path) == before
    for alone in (tmp_path / "body.npz", tmp_path / "fit" / "other.npz"):  # also by itself beside a fit
        other.save(alone)
        load_body(alone)
    shutil.copy(tmp_path / "body.npz", tmp_path / "fit")
    with pytest.raises(InputError, match=r"fit/body\.npz: not of the same run as report\.json") as told:
        load_body(tmp_path / "fit" / "body.npz")
    assert len(str(told.value).splitlines()) == 1
    (tmp_path / "fit" / FIT_REPORT).unlink()
    load_body(tmp_path / "fit" / "body.npz")


@pytest.mark.parametrize(
    "text", ["{}", "[1]", '{"files": 1}', '{"files": {"../body.npz": "0"}}', '{"files": ["body.npz"]}']
)
def test_other_reports_say_nothing_about_a_body(text: str, tmp_path: Path) -> None:
    (tmp_path / FIT_REPORT).write_text(text)
    body_file().save(tmp_path / "body.npz")
    load_body(tmp_path / "body.npz")


def test_a_body_beside_an_unreadable_report_is_refused(tmp_path: Path) -> None:
    body_file().save(tmp_path / "body.npz")
    (tmp_path / FIT_REPORT).write_text('{"files": {"bod')
    with pytest.raises(InputError, match=r"report\.json: can't be read as JSON; expected"):
        load_body(tmp_path / "body.npz")
    fill(tmp_path, a="new")
    load_body(tmp_path / "body.npz")


def test_a_report_removes_nothing_outside_its_folder_and_nothing_changed(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    fill(folder, a="old", b="old", c="old")
    (tmp_path / "precious").write_text("old")
    report = json.loads((folder / FIT_REPORT).read_text())
    report["files"]["../precious"] = report["files"]["a"]
    (folder / FIT_REPORT).write_text(json.dumps(report))
    (folder / "b").write_text("edited")
    fill(folder, a="new")
    assert tree(tmp_path).keys() == {"out", "out/a", "out/b", f"out/{FIT_REPORT}", "precious"}


# --- into place ----------------------------------------------------------------------------------------------------


def test_replacing_keeps_files_of_others_in_the_folder(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "a").write_text("old")
    (folder / "notes").write_text("mine")
    (folder / "sub").mkdir()
    with replacing(folder, FIT_REPORT, {}) as temporary:
        (temporary / "a").write_text("new")
        (temporary / "b").write_text("more")
        assert (folder / "a").read_text() == "old"
        assert not (folder / "b").exists()
    sums = {name: hashlib.sha256(text).hexdigest() for name, text in (("a", b"new"), ("b", b"more"))}
    report = json.dumps({"files": sums}, indent=1).encode() + b"\n"
    assert tree(folder) == {"a": b"new", "b": b"more", "notes": b"mine", "report.json": report, "sub": None}
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.parametrize("error", [RuntimeError("x"), KeyboardInterrupt("x"), OSError("x"), None])
@pytest.mark.parametrize("there", [True, False])
def test_an_error_leaves_everything_as_it_was(error: BaseException | None, there: bool, tmp_path: Path) -> None:
    """Without one, a folder in a file's place is refused before anything moves."""
    folder = tmp_path / "x" / "y" / "out"
    if there or error is None:
        (folder / "b").mkdir(parents=True)
        (folder / "a").write_text("old")
    before = tree(tmp_path)
    with pytest.raises(InputError if error is None or isinstance(error, OSError) else type(error)) as told:
        fill(folder, a="new", b="new", then=error)
    assert error is not None or "b: a folder" in str(told.value)
    assert tree(tmp_path) == before


def test_relative_and_current_folders_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in (".", "out", "x/y"):
        check_folder(Path(name))
        fill(Path(name), a=name)
    found = {name: content for name, content in tree(tmp_path).items() if not name.endswith(FIT_REPORT)}
    assert found == {"a": b".", "out": None, "out/a": b"out", "x": None, "x/y": None, "x/y/a": b"x/y"}


def test_results_never_replace_what_is_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    check_inputs(Path("out"), (Path("body.npz"), None, Path("other/detailed.npz")), DETAILED_FILES)
    for given in ("out/detailed.npz", "out/../out/detailed.npz", tmp_path / "out" / "detailed.npz"):
        with pytest.raises(InputError, match=r"would replace .*detailed\.npz"):
            check_inputs(Path("out"), (None, Path(given)), DETAILED_FILES)


def test_check_folder_refuses_what_can_be_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for bad in (tmp_path / "file", tmp_path / "file" / "out", tmp_path / ("x" * 300)):
        with pytest.raises(InputError, match="expected a folder"):
            check_folder(bad)
    check_folder(tmp_path / "new" / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_folder_in_a_file_s_place_stays(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "picture").mkdir(parents=True)
    with (
        pytest.raises(InputError, match=r"out/picture: a folder; expected a file, or nothing"),
        replacing(out, "report.json", {}) as new,
    ):
        (new / "picture").write_text("new")
    assert [path.name for path in out.iterdir()] == ["picture"]
    assert (out / "picture").is_dir()
