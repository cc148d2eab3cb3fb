"""Lay out the pages of the documentation site, which ``make docs`` builds: python scripts/make_site.py FOLDER.

The folder mirrors the repository, so that links between pages stay as they are. Pages that are made here: a demo each
(its docstring, then its code), a public name each (from its docstring, by mkdocstrings), and a file of code each that a
page links to.
"""

from __future__ import annotations

import ast
import re
import shutil
import sys
from pathlib import Path

import warp_partdr

ROOT = Path(__file__).resolve().parent.parent
API = "api"
_COPIED = (".png", ".gif", ".jpg", ".ipynb", ".json", ".toml")
_LINK = re.compile(r"(\]\()([^)\s:]+?)(#[^)\s]*)?(\))")


def make_pages(folder: Path) -> None:
    """Write all pages and what they show."""
    shutil.rmtree(folder, ignore_errors=True)
    waiting = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
    waiting += [*sorted((ROOT / "warp_partdr/assets").glob("*.md")), *demos()]
    done: set[Path] = set()
    while waiting:
        source = waiting.pop()
        if source in done:
            continue
        done.add(source)
        if source.suffix in _COPIED:
            copy(source, folder / source.relative_to(ROOT))
            continue
        text, linked = page(source)
        write(folder / page_path(source), text)
        waiting += linked
    for name, module in warp_partdr._EXPORTS.items():
        write(folder / API / f"{name}.md", api_page(name, module))


def demos() -> list[Path]:
    """Scripts that are tutorials."""
    return sorted((ROOT / "demos").glob("*.py"))


def page_path(source: Path) -> Path:
    """Where a file's page lies, in the folder of pages."""
    path = source.relative_to(ROOT)
    if path.suffix == ".md":
        return path
    return path.with_suffix(".md") if source in demos() else path.with_name(f"{path.name}.md")


def page(source: Path) -> tuple[str, list[Path]]:
    """Text of a file's page, and the files that it links to."""
    text = source.read_text(encoding="utf-8")
    if source.suffix == ".py":
        return (tutorial(text) if source in demos() else code(source.relative_to(ROOT).as_posix(), text)), []
    if source.suffix != ".md":
        return code(source.name, text, ""), []
    linked: list[Path] = []

    def moved(match: re.Match[str]) -> str:
        target = (source.parent / match[2]).resolve()
        if not target.is_file():
            return match[0] if not target.is_dir() else f"{match[1]}{match[2].rstrip('/')}/README.md{match[4]}"
        linked.append(target)
        if target.suffix in (".md", *_COPIED):
            return match[0]
        place = page_path(target).name
        return f"{match[1]}{Path(match[2]).parent.as_posix()}/{place}{match[4]}"

    return _LINK.sub(moved, text), linked


def tutorial(text: str) -> str:
    """A demo as a page: what its docstring says, then how it is done."""
    module = ast.parse(text)
    lead, _, rest = (ast.get_docstring(module) or "").partition("\n")
    body = text[text.index('"""', text.index('"""') + 3) + 3 :].strip()
    return f"# {lead.rstrip('.')}\n{rest}\n\n{fenced(body, 'python')}"


def code(title: str, text: str, language: str = "python") -> str:
    """A file of code as a page."""
    return f"# {title}\n\n{fenced(text, language)}"


def fenced(text: str, language: str) -> str:
    """Code in a fence that is longer than any in it."""
    return f"````{language}\n{text.strip()}\n````\n"


def api_page(name: str, module: str) -> str:
    """A public name's page: its docstring, and where it is used."""
    places = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *demos()]
    used = [path for path in places if re.search(rf"\b{re.escape(name)}\b", path.read_text(encoding="utf-8"))]
    links = ", ".join(f"[{path.stem}](../{page_path(path).as_posix()})" for path in used)
    return f"# {name}\n\n`from warp_partdr import {name}`\n\n::: warp_partdr.{module}.{name}\n\nUsed in: {links}\n"


def write(path: Path, text: str) -> None:
    """Write a page in a folder made if it is not there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def copy(source: Path, path: Path) -> None:
    """Copy what pages show."""
    path.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, path)


if __name__ == "__main__":
    make_pages(Path(sys.argv[1]))
