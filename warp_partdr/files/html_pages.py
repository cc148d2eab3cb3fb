"""HTML pages in one file: pictures are within them, and nothing is fetched."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from html import escape

PAGE_STYLE = """
:root{color-scheme:light dark;--ink:#1c2430;--soft:#5a6675;--paper:#fff;--panel:#f4f6f9;--line:#d8dde5;--mark:#fff4d6;
--accent:#c2410c;--warn:#9a5b00;--bar:#3f76b5;--link:#0b57a4}
@media(prefers-color-scheme:dark){:root{--ink:#e4e8ee;--soft:#a2adbb;--paper:#15191f;--panel:#20262e;--line:#38414d;
--mark:#3d3213;--accent:#fb923c;--warn:#f0b24a;--bar:#6ea3dd;--link:#8abdf5}}
body{font:15px/1.45 system-ui,sans-serif;color:var(--ink);background:var(--paper);max-width:1180px;margin:24px auto;
padding:0 20px}
a{color:var(--link)}
h1{font-size:24px;margin:0 0 4px}
h2{font-size:18px;margin:34px 0 10px;border-bottom:1px solid var(--line);padding-bottom:4px}
p{margin:6px 0;max-width:80ch}.soft{color:var(--soft)}.warn{color:var(--warn)}
.mark{background:var(--mark);border-left:4px solid #d99a00;padding:8px 14px}
figure{margin:0}figcaption{font-size:13px;color:var(--soft)}
table{border-collapse:collapse;width:100%;font-size:14px}
td,th{text-align:left;padding:4px 12px 4px 0;vertical-align:top}
tr+tr td{border-top:1px solid var(--line)}td:first-child,.n{white-space:nowrap;width:1%}
td{overflow-wrap:anywhere}td.n,th.n{text-align:right}
code{background:var(--panel);padding:1px 4px;border-radius:3px}
"""
"""Rules of CSS that pages share, for light and dark screens."""


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


def join_lines(parts: Iterable[str]) -> str:
    """Lines of a page, one for each part that is not empty."""
    return "".join(f"{part}\n" for part in parts if part)
