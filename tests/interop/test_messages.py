"""Warp's messages: the package is quiet by itself, and a program that imports Warp decides itself."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import HANG

from warp_partdr.cli.progress import FitProgress, PictureProgress
from warp_partdr.kernels import messages

compiled = messages.kernels_are_compiled  # as it is, whatever the tests' fixture puts there
WORK = "print(*BodyParameters.mean(1).posed().joints.shape)"


def said(code: str, **environment: str) -> tuple[str, str]:
    """Text that a program writes to stdout, and to stderr without Warp's line that there is no GPU."""
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | environment, capture_output=True, text=True, timeout=HANG
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, "".join(line for line in done.stderr.splitlines(True) if "NVIDIA CUDA driver" not in line)


def test_the_package_is_quiet_by_itself(tmp_path: Path) -> None:
    code = f"from warp_partdr import BodyParameters\n{WORK}"
    first, second = (said(code, WARP_CACHE_PATH=str(tmp_path)) for _ in range(2))
    line = f"warp_partdr: {messages.COMPILING}: the first run takes up to a minute longer\n"
    assert first == ("1 21 3\n", line)
    assert second == ("1 21 3\n", "")


@pytest.mark.parametrize(
    ("before", "after", "heard"),
    [
        ("import warp as wp", "", True),
        ("import warp as wp; wp.config.log_level = wp.LOG_INFO", "", True),
        ("import warp as wp; wp.config.log_level = wp.LOG_WARNING", "", False),
        ("", "import warp as wp; wp.config.log_level = wp.LOG_INFO", True),
    ],
)
def test_a_program_that_imports_warp_decides_what_it_tells(before: str, after: str, heard: bool) -> None:
    told, _ = said("\n".join([before, "from warp_partdr import BodyParameters", after, WORK]))
    assert told.endswith("1 21 3\n")
    assert ("load on device" in told) is heard


def test_an_error_of_the_compiler_is_told(tmp_path: Path) -> None:
    code = """
from warp_partdr import BodyParameters
BodyParameters.mean(1).posed()
import warp as wp
@wp.kernel
def wrong(values: wp.array(dtype=float)):
    values[wp.tid()] = wp.vec3()
try:
    wp.launch(wrong, 1, [wp.zeros(1)])
except Exception as error:
    print(error)
"""
    (tmp_path / "wrong.py").write_text(code)
    told, _ = said(f"import runpy; runpy.run_path({str(tmp_path / 'wrong.py')!r})")
    assert "vec3" in told


def test_compiled_kernels_are_found_where_warp_keeps_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import warp as wp

    monkeypatch.setattr(wp.config, "kernel_cache_dir", None)
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path / "mine"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "usual"))
    (tmp_path / "mine" / wp.config.version / "wp___main___0123456").mkdir(parents=True)  # a user's own kernels
    assert not compiled()
    (tmp_path / "mine" / wp.config.version / "wp_warp_partdr.kernels.turns_0123456").mkdir()
    assert compiled()
    monkeypatch.setattr(
        wp.config, "kernel_cache_dir", str(tmp_path / "mine" / wp.config.version)
    )  # once Warp has begun
    assert compiled()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", None)
    monkeypatch.delenv("WARP_CACHE_PATH")
    monkeypatch.setattr(sys, "platform", "linux")
    assert not compiled()
    (tmp_path / "usual" / "warp" / wp.config.version / "wp_warp_partdr.kernels.turns_0123456").mkdir(parents=True)
    assert compiled()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "nowhere"))
    monkeypatch.setattr(sys, "platform", "darwin")
    assert compiled(), "where the cache is not known, nothing is said"


@pytest.mark.parametrize("there", [True, False])
def test_a_command_without_a_terminal_says_why_it_takes_long(
    there: bool, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(messages, "kernels_are_compiled", lambda: there)
    line = f"partdr: {messages.COMPILING}: the first run takes up to a minute longer\n"
    for make in (FitProgress, lambda: PictureProgress(3)):
        make()
        assert capfd.readouterr().err == line * (not there)
    PictureProgress(3, "shards")  # it reads what others made: no kernel runs
    assert capfd.readouterr().err == ""
