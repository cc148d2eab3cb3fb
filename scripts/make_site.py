"""Lay out the pages of the documentation site, which ``make docs`` builds: python scripts/make_site.py FOLDER.

The folder mirrors the repository, so that links between pages stay as they are. Pages that are made here: a demo each
(its docstring, then its code), a public name each (from its docstring, by mkdocstrings), and a file of code each that a
page links to. The formula book's equations are drawn by the browser itself (MathML), so the site needs no script from
elsewhere; the gallery shows the pictures of all pages.
"""

from __future__ import annotations

import ast
import importlib
import re
import shutil
import sys
import tomllib
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

import warp_partdr

ROOT = Path(__file__).resolve().parent.parent
API = "api"
SUBMODULES = ("benchmark", "metrics", "plot")  # public ones of the package: a page each
LATER = "boost: 0.5"  # rule of the search for pages that come after those that explain
_COPIED = (".png", ".gif", ".jpg", ".ipynb", ".json", ".toml", ".js")
_LINK = re.compile(r"(\]\()([^)\s:]+?)(#[^)\s]*)?(\))")
_PICTURE = re.compile(r"!\[([^\]]+)\]\(([^)]+)\)")
_AT_THE_TOP = ("kernels", "body")  # folders of the repository that lie in the package


def make_pages(folder: Path) -> None:
    """Write all pages and what they show."""
    shutil.rmtree(folder, ignore_errors=True)
    waiting = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
    waiting += [*sorted((ROOT / "warp_partdr/assets").glob("*.md")), *demos(), ROOT / "docs" / "iframe-worker.js"]
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
        if source == ROOT / "CHANGELOG.md":
            text = searched(text, LATER)
        write(folder / page_path(source), text)
        waiting += linked
    for name, module in warp_partdr._EXPORTS.items():
        write(folder / API / f"{name}.md", searched(api_page(name, module), LATER))
    for face in SUBMODULES:
        write(folder / API / f"{face}.md", searched(submodule_page(face), LATER))
    write(folder / "gallery.md", gallery())


def demos() -> list[Path]:
    """Scripts that are tutorials."""
    return sorted((ROOT / "demos").glob("*.py"))


def page_path(source: Path) -> Path:
    """Path of a file's page, in the folder of pages."""
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
    if source == ROOT / "docs/reference/formula_book.md":
        text = re.sub(r"(?m)(?:^\|.*\n)+", lambda _: equations(), text, count=1)
    linked: list[Path] = []

    def moved(match: re.Match[str]) -> str:
        target = (source.parent / match[2]).resolve()
        if not target.is_file():
            return match[0] if not target.is_dir() else f"{match[1]}{match[2].rstrip('/')}/README.md{match[4]}"
        linked.append(target)
        if target.suffix in (".md", *_COPIED):
            return match[0]
        place = page_path(target).name
        line = re.sub("^#L", "#__span-0-", match[3] or "")  # mkdocs.yml has the same name of a line
        return f"{match[1]}{Path(match[2]).parent.as_posix()}/{place}{line}{match[4]}"

    return _LINK.sub(moved, text), linked


def equations() -> str:
    """The formula book's equations, a section each: rendered, with links to their code."""
    index = (ROOT / "warp_partdr" / "reference" / "index.toml").read_text(encoding="utf-8")
    return "\n".join(equation_section(number, each) for number, each in tomllib.loads(index).items())


def equation_section(number: str, equation: dict[str, Any]) -> str:
    """One equation, and the lines where function, kernels, torch functions and tests are defined."""
    named = {
        "Book": [code_link(f"reference.{equation['book']}")],
        "Kernels": [code_link(name) for name in equation["kernels"]],
        "Torch": [code_link(name) for name in equation["torch"]],
        "Tests": [link(name, ROOT / file) for file, _, name in (test.partition("::") for test in equation["tests"])],
    }
    # Browsers know columns' alignment as a style alone.
    formula = convert(equation["latex"], display="block").replace('columnalign="left"', 'style="text-align: left"')
    formula = f"<div>{formula}</div>"
    entries = [f"- {title}: {', '.join(links)}" for title, links in named.items() if links]
    return "\n".join([f"### Equation {number}: {equation['title']}", "", formula, "", *entries, ""])


def code_link(name: str) -> str:
    """A link from docs/reference/ to where a dotted name of the package is defined."""
    parts = name.split(".")
    folder = ROOT if parts[0] in _AT_THE_TOP else ROOT / "warp_partdr"
    files = (folder.joinpath(*parts[:count]).with_suffix(".py") for count in range(1, len(parts)))
    return link(name, next(file for file in files if file.is_file()))


def link(name: str, file: Path) -> str:
    """A link from docs/reference/ to the line of a file that defines a name."""
    lines = file.read_text(encoding="utf-8").splitlines()
    definition = re.compile(rf"\s*(?:def|class) {name.rpartition('.')[2]}\b")
    number = next(count for count, line in enumerate(lines, 1) if definition.match(line))
    return f"[`{name}`](../../{file.relative_to(ROOT).as_posix()}#L{number})"


def gallery() -> str:
    """All pictures that pages show, charts last, each with its line, its page and the command that makes it."""
    pictures = ast.parse((ROOT / "scripts" / "pictures.py").read_text(encoding="utf-8"))
    (elsewhere,) = (
        ast.literal_eval(node.value)
        for node in pictures.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "MADE_ELSEWHERE"
    )
    shown: dict[str, str] = {}
    for source in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        for line, path in _PICTURE.findall(source.read_text(encoding="utf-8")):
            picture = (source.parent / path).resolve().relative_to(ROOT).as_posix()
            command = elsewhere.get(Path(path).name, "make pictures")
            page = source.relative_to(ROOT).as_posix()
            shown.setdefault(picture, f"![{line}]({picture})\n\n{line}: [{source.stem}]({page}), by `{command}`.\n")
    return "# Gallery\n\n" + "\n".join(
        shown[each] for each in sorted(shown, key=lambda picture: Path(picture).name in elsewhere)
    )


def tutorial(text: str) -> str:
    """A demo as a page: what its docstring says, then how it is done."""
    module = ast.parse(text)
    lead, _, rest = (ast.get_docstring(module) or "").partition("\n")
    body = text[text.index('"""', text.index('"""') + 3) + 3 :].strip()
    return f"# {lead.rstrip('.')}\n{rest}\n\n{fenced(body, 'python')}"


def code(title: str, text: str, language: str = "python") -> str:
    """A file of code as a page, which the search leaves out."""
    return searched(f"# {title}\n\n{fenced(text, language)}", "exclude: true")


def searched(text: str, rule: str) -> str:
    """A page with a rule for the search: whether, or how early, it is found."""
    return f"---\nsearch:\n  {rule}\n---\n\n{text}"


def fenced(text: str, language: str) -> str:
    """Code in a fence that is longer than any in it."""
    return f"````{language}\n{text.strip()}\n````\n"


def api_page(name: str, module: str) -> str:
    """A public name's page: its docstring, and where it is used."""
    places = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *demos()]
    used = [path for path in places if re.search(rf"\b{re.escape(name)}\b", path.read_text(encoding="utf-8"))]
    links = ", ".join(f"[{path.stem}](../{page_path(path).as_posix()})" for path in used)
    return f"# {name}\n\n`from warp_partdr import {name}`\n\n::: warp_partdr.{module}.{name}\n\nUsed in: {links}\n"


def submodule_page(face: str) -> str:
    """A public submodule's page: its docstring, then that of each of its names."""
    module = importlib.import_module(f"warp_partdr.{face}")
    where = getattr(module, "_EXPORTS", dict.fromkeys(module.__all__, face))
    names = [
        f"## {name}\n\n`from warp_partdr.{face} import {name}`\n\n::: warp_partdr.{where[name]}.{name}\n"
        for name in module.__all__
    ]
    return "\n".join([f"# warp_partdr.{face}\n\n{(module.__doc__ or '').strip()}\n", *names])


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
