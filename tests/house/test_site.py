"""The documentation site has every page, demo and public name, and links lead somewhere."""

from __future__ import annotations

import importlib
import re
import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

import warp_partdr
from warp_partdr.reference.index import EQUATIONS

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site") / "pages"
    runpy.run_path(str(ROOT / "scripts" / "make_site.py"))["make_pages"](folder)
    return folder


def entries(nav: object) -> list[str]:
    """Pages of a navigation, from first to last."""
    if isinstance(nav, str):
        return [nav]
    parts = nav if isinstance(nav, list) else list(nav.values())  # type: ignore[attr-defined]
    return [entry for part in parts for entry in entries(part)]


def test_the_navigation_has_each_page(pages: Path) -> None:
    nav = entries(yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"])
    assert len(set(nav)) == len(nav)
    expected = {path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md")}
    expected |= {f"demos/{path.stem}.md" for path in (ROOT / "demos").glob("*.py")}
    expected |= {f"api/{name}.md" for name in [*warp_partdr._EXPORTS, "benchmark", "metrics", "plot"]}
    expected |= {f"warp_partdr/assets/{path.name}" for path in (ROOT / "warp_partdr/assets").glob("*.md")}
    assert expected | {"README.md", "CHANGELOG.md", "gallery.md"} == set(nav)
    for entry in nav:
        assert (pages / entry).is_file(), entry


def test_search_needs_no_network(pages: Path) -> None:
    """The plugin "offline" takes its own script from elsewhere, unless one of that name is there."""
    (script,) = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["extra"]["polyfills"]
    assert "iframe-worker" in script
    assert "window.Worker = class" in (pages / script).read_text()


def front_matter(page: str) -> dict[str, Any]:
    """Settings of a page, which stand before its text."""
    found = re.match(r"---\n(.*?)\n---\n\n# ", page, re.DOTALL)
    return yaml.safe_load(found[1]) if found else {}


def test_the_search_finds_pages_before_sources(pages: Path) -> None:
    rules: dict[str, set[str]] = {"words": set(), "api": set(), "code": set()}
    for path in pages.rglob("*.md"):
        name, kind = path.relative_to(pages).as_posix(), "words"
        if path.suffixes != [".md"] or name == "LICENSE.md":
            kind = "code"
        elif name.startswith("api/") or name == "CHANGELOG.md":
            kind = "api"
        rules[kind].add(str(front_matter(path.read_text()).get("search", {})))
    assert rules == {"words": {"{}"}, "api": {"{'boost': 0.5}"}, "code": {"{'exclude': True}"}}


def test_code_on_pages_is_no_hit_of_the_search() -> None:
    """A hook marks sources below entries of the API, and the scripts of tutorials."""
    (hook,) = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["hooks"]
    mark = runpy.run_path(str(ROOT / hook))["on_page_content"]
    html = '<p>words</p><details class="mkdocstrings-source">code</details><div class="highlight">example</div>'
    found = {}
    for name in ("api/fit_body.md", "demos/own_loss.md"):
        marked = mark(html, page=SimpleNamespace(file=SimpleNamespace(src_uri=name)))
        found[name] = re.findall(r"<(\w+)[^>]* data-search-exclude", marked)
        assert marked.replace(" data-search-exclude", "") == html
    assert found == {"api/fit_body.md": ["details"], "demos/own_loss.md": ["details", "div"]}


def test_the_names_of_the_api_are_grouped_by_topic() -> None:
    nav = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]
    (api,) = (entry["API"] for entry in nav if "API" in entry)
    groups = {title: part for entry in api for title, part in entry.items() if isinstance(part, list)}
    assert sorted(entries(list(groups.values()))) == sorted(f"api/{name}.md" for name in warp_partdr._EXPORTS)
    assert max(len(part) for part in groups.values()) < 15


def test_links_lead_somewhere(pages: Path) -> None:
    missing = [
        f"{path.relative_to(pages)}: {link}"
        for path in pages.rglob("*.md")
        if path.suffixes == [".md"]
        for link in re.findall(r"\]\(([^)\s:#]+)(?:#[^)\s]*)?\)", path.read_text())
        if not (path.parent / link).exists()
    ]
    assert not missing


def test_a_public_name_has_an_example(pages: Path) -> None:
    """Each is used in the README, a page or a demo, and its page says where."""
    for name in warp_partdr._EXPORTS:
        text = (pages / "api" / f"{name}.md").read_text()
        assert f"from warp_partdr import {name}" in text
        assert re.search(r"Used in: \[", text), name


@pytest.mark.parametrize("face", ["benchmark", "metrics", "plot"])
def test_a_public_submodule_has_a_page_with_all_its_names(pages: Path, face: str) -> None:
    text = (pages / "api" / f"{face}.md").read_text()
    names = importlib.import_module(f"warp_partdr.{face}").__all__
    assert re.findall(rf"`from warp_partdr\.{face} import (\w+)`", text) == names
    for name in names:
        (path,) = re.findall(rf"(?m)^::: (warp_partdr\..*)\.{name}$", text)
        assert hasattr(importlib.import_module(path), name)


def test_a_demo_is_a_page_of_its_own_words(pages: Path) -> None:
    page = (pages / "demos" / "own_loss.md").read_text()
    assert page.startswith("# Write your own loss on part maps: any function of them has a gradient\n")
    assert page.count('"""Write your own') == 0
    assert "\n````python\nfrom __future__ import annotations\n" in page


def test_each_equation_is_rendered_and_leads_to_its_code(pages: Path) -> None:
    page = (pages / "docs" / "reference" / "formula_book.md").read_text()
    sections = re.split(r"(?m)^### Equation (\d+): ", page)
    assert [int(number) for number in sections[1::2]] == list(EQUATIONS)
    for equation, section in zip(EQUATIONS.values(), sections[2::2], strict=True):
        assert section.count("<math ") == section.count("</math>") == 1
        assert "\\" not in section, "a command of LaTeX was not understood"
        names = [f"reference.{equation.book}", *equation.kernels, *equation.torch]
        names += [test.partition("::")[2] for test in equation.tests]
        for name in names:
            (link,) = re.findall(rf"\[`{re.escape(name)}`\]\(\.\./\.\./([^)]+)\.md#__span-0-(\d+)\)", section)
            line = (ROOT / link[0]).read_text().splitlines()[int(link[1]) - 1]
            assert re.match(rf"\s*(def|class) {name.rpartition('.')[2]}\b", line), name
    assert "| eq. |" not in page


def test_the_gallery_shows_all_pictures(pages: Path) -> None:
    page = (pages / "gallery.md").read_text()
    shown = re.findall(r"!\[[^\]]+\]\((docs/images/[^)]+)\)", page)
    assert sorted(shown) == sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs/images").iterdir())
    assert all((pages / picture).is_file() for picture in shown)
    assert "[performance](docs/measured/performance.md), by `partdr bench kernels --device cuda`" in page
