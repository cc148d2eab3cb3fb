"""Bytes that films' files say they have: of RIFF (AVI) and Matroska (MKV, WebM)."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

_EBML, _SEGMENT = b"\x1a\x45\xdf\xa3", b"\x18\x53\x80\x67"  # Matroska's header, and the rest of a file
_HEADER = 4096  # bytes, that hold both of their sizes


def stated_bytes(path: str | Path) -> int:
    """Bytes that a film's file states it has; 0 if it states none, or is of another kind."""
    with open(path, "rb") as file:
        head = file.read(_HEADER)
        if head.startswith(b"RIFF"):
            return _riff_size(file)
    return _matroska_size(head) if head.startswith(_EBML) else 0


def _riff_size(file: BinaryIO) -> int:
    """End of the last chunk that begins one of an AVI's parts, of which a large file has several."""
    place = 0
    while True:
        file.seek(place)
        head = file.read(8)
        if len(head) < 8 or head[:4] != b"RIFF":
            return place
        length = struct.unpack("<I", head[4:])[0]
        if not length:  # it was never finished
            return 0
        place += 8 + length + length % 2


def _matroska_size(head: bytes) -> int:
    """End of the segment."""
    size, place = _number(head, len(_EBML))
    place += size
    if head[place : place + len(_SEGMENT)] != _SEGMENT:
        return 0
    start = place + len(_SEGMENT)
    size, place = _number(head, start)
    unknown = size == 2 ** (7 * (place - start)) - 1  # as in live films
    return 0 if unknown else place + size


def _number(data: bytes, place: int) -> tuple[int, int]:
    """An EBML number, whose leading zeros tell its length, and the place after it; 0 if it is cut off."""
    if place >= len(data) or not data[place]:
        return 0, place
    length = 9 - data[place].bit_length()
    value = int.from_bytes(data[place : place + length], "big") - (1 << 7 * length)
    return value, place + length
