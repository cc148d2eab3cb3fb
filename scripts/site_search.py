"""Hook of mkdocs that keeps code out of the search: sources below API entries, and the scripts of tutorials."""

from __future__ import annotations

from typing import Any

_SOURCE = '<details class="mkdocstrings-source"'
_BLOCK = '<div class="highlight"'


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Mark code as what the search leaves out, in a page's HTML."""
    html = html.replace(_SOURCE, f"{_SOURCE} data-search-exclude")
    return html.replace(_BLOCK, f"{_BLOCK} data-search-exclude") if page.file.src_uri.startswith("demos/") else html
