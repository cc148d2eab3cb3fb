"""Pages and comments name measurements and options that exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from warp_partdr.lab import harness

ROOT = Path(__file__).resolve().parents[2]
COMMAND = re.compile(r"python -m warp_partdr\.lab +([a-z-]+)((?:[^`\n]|\n(?=[^`\n]*`))*)")

pytestmark = pytest.mark.skipif(not (ROOT / "pyproject.toml").exists(), reason="needs the repository around the tests")


def named_commands() -> list[tuple[str, str, str]]:
    """Page, name and options of each command that a page or a comment has."""
    folders = ("docs", "warp_partdr/assets", "warp_partdr", "body")
    files = [*ROOT.glob("*.md"), *(path for folder in folders for path in (ROOT / folder).rglob("*.[mp][dy]"))]
    return [
        (path.relative_to(ROOT).as_posix(), name, options)
        for path in dict.fromkeys(files)
        for name, options in COMMAND.findall(path.read_text(encoding="utf-8"))
    ]


def test_pages_name_measurements_and_options_that_exist(capsys: pytest.CaptureFixture[str]) -> None:
    found = named_commands()
    assert len({page for page, _, _ in found}) >= 10
    known: dict[str, str] = {}
    for page, name, options in found:
        assert name in harness.measurements(), page
        if name not in known:
            harness.run_measurement(name, ["--help"])
            known[name] = capsys.readouterr().out
        unknown = [option for option in re.findall(r"--[a-z-]+", options) if f"{option} " not in known[name]]
        assert unknown == [], f"{page}: {name}"


def test_each_measurement_is_named_by_a_page() -> None:
    named = {name for _, name, _ in named_commands()}
    assert sorted(harness.measurements().keys() - named) == []
