"""HTML pages in one file: pictures are within them, and nothing is fetched."""

from __future__ import annotations

import base64
from html import escape


def html_page(title: str, style: str, body: str) -> str:
    """A whole page.

    Args:
        title: Title of the page, as plain text.
        style: Rules of CSS.
        body: Contents, as HTML.
    """
    head = f"<meta charset=utf-8><meta name=viewport content='width=device-width'><title>{escape(title)}</title>"
    return f"<!DOCTYPE html>\n<html lang=en><head>{head}<style>{style}</style></head><body>\n{body}</body></html>\n"


def data_address(data: bytes, kind: str) -> str:
    """Address that holds a picture itself, of a kind such as "jpeg"."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def picture_element(data: bytes, kind: str, told: str) -> str:
    """Element of a picture that is within the page.

    Args:
        data: Bytes of its file.
        kind: Kind of the file, such as "jpeg".
        told: Words for what the picture shows, as plain text.
    """
    return f"<img alt='{escape(told)}' src='{data_address(data, kind)}'>"
