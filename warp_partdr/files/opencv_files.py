"""OpenCV's ``FileStorage`` files, YAML and JSON: mappings, lists, numbers, texts and matrices, no other YAML.

A small reader of its own, for a file of users must not make objects: a tag that is no matrix is refused.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, cause, shown
from .json_files import parse_json

_MATRICES = ("opencv-matrix", "opencv-nd-matrix")
_TAG = re.compile(r"!!?<?(?:tag:yaml\.org,2002:)?([\w./:-]*)>?(?:\s+|$)")
_KEY = re.compile(r"""("[^"]*"|'[^']*'|[^\s:'"\[\]{},#&*!|>%@-][^:'"\[\]{},]*?)\s*:(?:\s+|$)""")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_SPECIAL = {".nan": math.nan, ".inf": math.inf, "+.inf": math.inf, "-.inf": -math.inf}
# Numbers in OpenCV's JSON that JSON has not: "1." of its third version, ".Nan" and "-.Inf".
_BARE_POINT = re.compile(r"(?<=\d)\.(?=[\s,\]}eE])")
_NO_NUMBER = re.compile(r"(?<=[\s:\[,])(-?)\.(?:(Nan)|Inf)(?=[\s,\]}])")
_EXPECTED = "a file of OpenCV's FileStorage"
_Line = tuple[int, int, str]  # number, indent, text


def read_opencv(path: str | Path, expected: str = _EXPECTED) -> dict[str, Any]:
    """Read the top of a ``FileStorage`` file (.yml, .yaml or .json), matrices still as mappings (``to_matrix``).

    Raises:
        InputError: If it can't be read, is of another form, or has a key twice.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {cause(error)}; expected {expected}") from error
    if text.lstrip().startswith("{"):
        text = _NO_NUMBER.sub(lambda found: "NaN" if found[2] else f"{found[1]}Infinity", text)
        found = parse_json(_BARE_POINT.sub(".0", text), str(path), expected)
    else:
        found = _Yaml(str(path), expected).read(text)
    if not isinstance(found, dict):
        raise InputError(f"{path}: {shown(found)}; expected {expected}")
    return found


def is_matrix(value: Mapping[str, Any]) -> bool:
    """True for a matrix as ``read_opencv`` gives it."""
    return {"rows", "cols", "data"} <= value.keys() or {"sizes", "data"} <= value.keys()


def to_matrix(value: object, where: str) -> np.ndarray:
    """Numbers of a ``FileStorage`` matrix or of nested lists, float64.

    Raises:
        InputError: If it is neither, or numbers are too few, too many or not finite.
    """
    rows: Any = value
    shape: tuple[int, ...] | None = None
    if isinstance(value, Mapping):
        if not is_matrix(value):
            raise InputError(f"{where}: keys {', '.join(map(str, value))}; expected rows, cols and data of a matrix")
        sides = value.get("sizes", [value.get("rows"), value.get("cols")])
        rows, shape = value["data"], tuple(sides) if isinstance(sides, list) else (sides,)
    try:
        found = np.array(rows, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: {shown(rows)}; expected numbers") from error
    if shape is not None:
        if found.ndim != 1 or not all(isinstance(side, int) for side in shape) or math.prod(shape) != found.size:
            raise InputError(f"{where}: {found.size} numbers; expected as many as {' x '.join(map(str, shape))}")
        found = found.reshape(shape)
    if not found.size or not np.isfinite(found).all():
        raise InputError(f"{where}: {shown(rows)}; expected finite numbers")
    return found


class _Yaml:
    """The part of YAML that OpenCV writes, a line at a time."""

    def __init__(self, where: str, expected: str) -> None:
        self.where, self.expected = where, expected
        self.lines: list[_Line] = []
        self.at = 0

    def read(self, text: str) -> Any:
        self.lines = self._joined(text)
        if not self.lines:
            return {}
        try:
            found = self._block(self.lines[0][1])
        except RecursionError:
            raise InputError(f"{self.where}: nested too deeply; expected {self.expected}") from None
        if self.at < len(self.lines):
            raise self._wrong(self.lines[self.at], "indented as no line before")
        return found

    def _wrong(self, line: _Line, reason: str) -> InputError:
        return InputError(f"{self.where}: line {line[0]}: {shown(line[2])}: {reason}; expected {self.expected}")

    def _joined(self, text: str) -> list[_Line]:
        """Lines that say something; brackets that are open at a line's end take the next ones in."""
        lines: list[_Line] = []
        parts: list[str] = []  # of the line whose brackets are open
        depth = documents = start = indent = 0
        for number, raw in enumerate(text.splitlines(), start=1):
            line = _without_comment(raw).rstrip()
            bare = line.lstrip()
            if not bare or (not lines and bare.startswith("%YAML")):
                continue
            if not parts:
                if bare in ("---", "..."):
                    documents += bare == "---"
                    if documents > 1:
                        raise self._wrong((number, 0, bare), "a second document")
                    continue
                start, indent = number, len(line) - len(bare)
                if "\t" in line[:indent]:
                    raise self._wrong((number, 0, bare), "a tab before it")
            parts.append(bare)
            depth += _open_brackets(bare)
            if depth <= 0:
                lines.append((start, indent, " ".join(parts)))
                parts, depth = [], 0
        if parts:
            raise self._wrong((start, indent, " ".join(parts)), "a bracket that is not closed")
        return lines

    def _block(self, indent: int) -> Any:
        return self._list(indent) if self._is_item() else self._map(indent)

    def _is_item(self) -> bool:
        text = self.lines[self.at][2]
        return text == "-" or text.startswith("- ")

    def _list(self, indent: int) -> list[Any]:
        found = []
        while self.at < len(self.lines) and self.lines[self.at][1] == indent and self._is_item():
            number, _, text = self.lines[self.at]
            rest = text[1:].lstrip()
            if rest and _KEY.match(rest):  # a mapping that begins on the dash's own line
                inner = indent + len(text) - len(rest)
                self.lines[self.at] = (number, inner, rest)
                found.append(self._map(inner))
            else:
                self.at += 1
                found.append(self._value(rest, (number, indent, text)))
        return found

    def _map(self, indent: int) -> dict[str, Any]:
        found: dict[str, Any] = {}
        while self.at < len(self.lines) and self.lines[self.at][1] == indent and not self._is_item():
            line = self.lines[self.at]
            match = _KEY.match(line[2])
            if match is None:
                raise self._wrong(line, "no key")
            key = match[1].strip("\"'")
            if key in found:
                raise self._wrong(line, f"key {key!r} twice")
            self.at += 1
            found[key] = self._value(line[2][match.end() :], line)
        return found

    def _value(self, text: str, line: _Line) -> Any:
        """The value after a key or a dash; nothing there means the lines below, further in."""
        tag = _TAG.match(text) if text.startswith("!") else None
        if tag is not None:
            if tag[1] not in _MATRICES:
                raise self._wrong(line, f"tag {tag[0].strip()}, which is not read")
            text = text[tag.end() :]
        if text:
            return self._flow(text, line)
        if self.at < len(self.lines):
            indent = self.lines[self.at][1]
            if indent > line[1] or (indent == line[1] and self._is_item() and not line[2].startswith("-")):
                return self._block(indent)
        return None

    def _flow(self, text: str, line: _Line) -> Any:
        """A number, a text, or what is in brackets."""
        tokens = re.findall(r'"(?:[^"\\]|\\.)*"|\'[^\']*\'|[\[\]{},]|[^\s\[\]{},"\'][^\[\]{},"\']*', text)
        if tokens[:1] in (["["], ["{"]):
            found, end = self._bracket(tokens, 0, line)
            if end < len(tokens):
                raise self._wrong(line, "more after its bracket")
            return found
        return self._scalar(text, line)

    def _bracket(self, tokens: list[str], at: int, line: _Line) -> tuple[Any, int]:
        """A bracket's inside, and where it ends; OpenCV leaves no space after a colon there."""
        close, pairs = ("]", False) if tokens[at] == "[" else ("}", True)
        items: list[Any] = []
        found: dict[str, Any] = {}
        at += 1
        while at < len(tokens) and tokens[at] != close:
            key = ""
            if pairs:
                head, colon, rest = tokens[at].partition(":")
                if tokens[at][0] in "\"'" and at + 1 < len(tokens) and tokens[at + 1].startswith(":"):
                    head, colon, rest = tokens[at], ":", tokens[at + 1][1:]
                    at += 1
                key = head.strip().strip("\"'")
                if not colon or not key or key in found:
                    raise self._wrong(line, "no key, or one twice")
                tokens[at] = rest.strip()
                at += not tokens[at]
            if at < len(tokens) and tokens[at] in ("[", "{"):
                value, at = self._bracket(tokens, at, line)
            elif at < len(tokens) and tokens[at] not in ("]", "}", ","):
                value, at = self._scalar(tokens[at].strip(), line), at + 1
            else:
                raise self._wrong(line, "a value is missing")
            if pairs:
                found[key] = value
            else:
                items.append(value)
            if at < len(tokens) and tokens[at] == ",":
                at += 1
            elif at >= len(tokens) or tokens[at] != close:
                raise self._wrong(line, "a bracket that is not closed")
        if at >= len(tokens):
            raise self._wrong(line, "a bracket that is not closed")
        return (found if pairs else items), at + 1

    def _scalar(self, text: str, line: _Line) -> Any:
        if _NUMBER.fullmatch(text):
            return int(text) if re.fullmatch(r"[-+]?\d+", text) else float(text)
        if (special := _SPECIAL.get(text.lower())) is not None:
            return special
        if text.startswith('"') and text.endswith('"') and len(text) > 1:
            try:
                return json.loads(text)
            except ValueError:
                return text[1:-1]
        if text.startswith("'") and text.endswith("'") and len(text) > 1:
            return text[1:-1]
        if text[0] in "!&*|>@`%":
            raise self._wrong(line, f"{text[0]!r}, which is not read")
        return {"true": True, "false": False, "null": None, "~": None}.get(text, text)


def _without_comment(line: str) -> str:
    """A line up to a '#' that stands outside quotes, at the start or after a space."""
    quote = ""
    for place, sign in enumerate(line):
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "\"'":
            quote = sign
        elif sign == "#" and (place == 0 or line[place - 1].isspace()):
            return line[:place]
    return line


def _open_brackets(text: str) -> int:
    """Brackets that a line opens and does not close, quotes left out."""
    bare = re.sub(r'"(?:[^"\\]|\\.)*"|\'[^\']*\'', "", text)
    return sum(bare.count(sign) for sign in "[{") - sum(bare.count(sign) for sign in "]}")
