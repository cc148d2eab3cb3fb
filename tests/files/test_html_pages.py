"""HTML pages in one file."""

from __future__ import annotations

import base64
from html.parser import HTMLParser

from warp_partdr.files.html_pages import html_page, picture_element


class Page(HTMLParser):
    """Elements with their attributes, and texts by the element around them."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.pictures: list[dict[str, str | None]] = []
        self.texts: dict[str, str] = {}
        self._open = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._open = tag
        if tag == "img":
            self.pictures.append(dict(attrs))

    def handle_data(self, data: str) -> None:
        self.texts[self._open] = self.texts.get(self._open, "") + data


def test_titles_and_words_of_pictures_are_plain_text() -> None:
    picture = picture_element(b"\xff\xd8bytes", "jpeg", "O'Brien <left>")
    page = Page(html_page("a < b & c", "p{color:red}", f"<p>{picture}</p>"))
    assert page.texts["title"] == "a < b & c"
    assert page.texts["style"] == "p{color:red}"
    ((told, source),) = (each.values() for each in page.pictures)
    assert told == "O'Brien <left>"
    kind, _, data = str(source).partition(";base64,")
    assert (kind, base64.b64decode(data)) == ("data:image/jpeg", b"\xff\xd8bytes")
