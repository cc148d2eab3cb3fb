"""HTML pages, read as a browser would."""

from __future__ import annotations

import base64
import io
from html.parser import HTMLParser
from pathlib import Path

from PIL import Image


class Page(HTMLParser):
    """Pictures of a page, its text, links, anchors, whatever it would load, and whether its elements are closed."""

    VOID = ("meta", "img", "br")
    IMPLIED = ("tr", "td", "th")  # closed by what follows

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.images: list[Image.Image] = []
        self.loads: list[str] = []
        self.links: list[str] = []
        self.anchors: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        source = given.get("src")
        if tag == "img" and source and source.startswith("data:image/jpeg;base64,"):
            self.images.append(Image.open(io.BytesIO(base64.b64decode(source.partition(",")[2]))))
        elif source or tag in ("script", "link", "iframe"):
            self.loads.append(tag)
        if tag == "a":
            self.links.append(given["href"] or "")
        if "id" in given:
            self.anchors.append(given["id"] or "")
        if tag not in (*self.VOID, *self.IMPLIED):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.IMPLIED:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def read_page(path: str | Path = "report.html") -> Page:
    """Read a page, which must be whole and load nothing."""
    page = Page(Path(path).read_text(encoding="utf-8"))
    assert page.open == []
    assert page.loads == []
    return page
