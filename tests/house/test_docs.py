"""README and docs: links lead somewhere, JSON parses, and each page's Python runs from top to bottom."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from warp_partdr.inputs.part_labels import read_photo
from warp_partdr.interop.torch_threads import one_torch_thread
from warp_partdr.results.film_file import write_film
from warp_partdr.solve.mesh.energy import TERMS

ROOT = Path(__file__).resolve().parents[2]
FILM = "walk.mp4"  # the film of pages' readers
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]


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
    """Without them, the tests below would look at nothing."""
    assert sum(len(links(page)) for page in PAGES) > 50
    assert all(any(blocks(page, language) for page in PAGES) for language in ("json", "python"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_of_pages_lead_somewhere_and_json_is_valid(page):
    for link in links(page):
        if "://" in link:
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link
    for block in blocks(page, "json"):
        json.loads(block)


def test_the_page_of_scenes_lists_the_energy_s_terms():
    section = (
        (ROOT / "docs/explanation/scenes.md")
        .read_text(encoding="utf-8")
        .partition("## Energy\n")[2]
        .partition("\n## ")[0]
    )
    assert re.findall(r"(?m)^\| `(\w+)` \|", section) == [term.name for term in TERMS]


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")], ids=lambda page: page.stem)
def test_python_blocks_of_pages_run(page, tmp_path, monkeypatch):
    (tmp_path / "warp_partdr").symlink_to(ROOT / "warp_partdr")  # pages name the example's files from the root
    monkeypatch.chdir(tmp_path)
    code = "\n".join(blocks(page, "python"))
    if FILM in code:
        pytest.importorskip("av", reason="needs PyAV, the extra film")
        write_film(tmp_path / FILM, [read_photo(ROOT / "warp_partdr/assets/example/photo.png")] * 3, rate=10)
    # With names of its own, but in this process: in one of its own, most of a page's time went into imports.
    with one_torch_thread():
        exec(compile(code, page.name, "exec"), {"__name__": "__main__"})
    left = {path.name for path in tmp_path.iterdir()}
    assert left <= {"warp_partdr", "out", FILM}, "a page leaves files where it is run"
