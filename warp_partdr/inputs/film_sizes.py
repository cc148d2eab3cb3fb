"""Sizes in bytes that films' files state, for the formats RIFF (AVI) and Matroska (MKV, WebM)."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

_EBML, _SEGMENT = b"\x1a\x45\xdf\xa3", b"\x18\x53\x80\x67"  # Matroska's header, and the rest of a file
_HEADER = 4096  # bytes that hold the sizes of both


def stated_bytes(path: str | Path) -> int:
    """Size that a film's file states [bytes]; 0 if it states none, or has another format."""
    with open(path, "rb") as file:
        head = file.read(_HEADER)
        if head.startswith(b"RIFF"):
            return _riff_size(file)
    return _matroska_size(head) if head.startswith(_EBML) else 0


def _riff_size(file: BinaryIO) -> int:
    """End of the last RIFF chunk of an AVI file; a large file has several."""
    offset = 0
    while True:
        file.seek(offset)
        head = file.read(8)
        if len(head) < 8 or head[:4] != b"RIFF":
            return offset
        length = struct.unpack("<I", head[4:])[0]
        if not length:  # the file was never finished
            return 0
        offset += 8 + length + length % 2


def _matroska_size(head: bytes) -> int:
    """End of a Matroska file's segment [bytes]; 0 if it is unknown."""
    size, offset = _number(head, len(_EBML))
    offset += size
    if head[offset : offset + len(_SEGMENT)] != _SEGMENT:
        return 0
    start = offset + len(_SEGMENT)
    size, offset = _number(head, start)
    unknown = size == 2 ** (7 * (offset - start)) - 1  # as in live films
    return 0 if unknown else offset + size


def _number(data: bytes, offset: int) -> tuple[int, int]:
    """Read an EBML number, and the offset after it; 0 if it is cut off. Its leading zeros give its length."""
    if offset >= len(data) or not data[offset]:
        return 0, offset
    length = 9 - data[offset].bit_length()
    value = int.from_bytes(data[offset : offset + length], "big") - (1 << 7 * length)
    return value, offset + length
