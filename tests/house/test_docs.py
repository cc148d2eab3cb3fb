"""README and docs: links lead somewhere, JSON parses, and each page's Python runs from top to bottom."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import HANG

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
QUIET = "import torch, warp\ntorch.set_num_threads(1)\nwarp.config.log_level = warp.LOG_ERROR\n"


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Anchors of the page's headings."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def links(page: Path) -> list[str]:
    """Targets of the page's links."""
    return re.findall(r"\[[^\]]*\]\(([^)]+)\)", page.read_text())


def test_pages_have_links_and_examples():
    """Or the tests below would look at nothing."""
    assert sum(len(links(page)) for page in PAGES) > 50
    assert all(any(blocks(page, language) for page in PAGES) for language in ("json", "python"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_and_json(page):
    for link in links(page):
        if "://" in link:
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link
    for block in blocks(page, "json"):
        json.loads(block)


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")], ids=lambda page: page.stem)
def test_python_runs(page, tmp_path):
    (tmp_path / "warp_partdr").symlink_to(ROOT / "warp_partdr")  # pages name the example's files from the root
    code = QUIET + "\n".join(blocks(page, "python"))
    command = [sys.executable, "-P", "-c", code]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=HANG)
    assert done.returncode == 0, done.stderr[-2000:]
    assert {path.name for path in tmp_path.iterdir()} <= {"warp_partdr", "out"}, "a page leaves files where it is run"
