"""Kinds of files: photos by their ending, unreadable formats by their first bytes, and files that are no photos."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

# Endings of files that are taken for photos.
PHOTO_SUFFIXES = (
    *(".jpg", ".jpeg", ".jpe", ".jfif", ".mpo", ".png", ".apng", ".webp", ".bmp", ".dib", ".tif", ".tiff"),
    *(".gif", ".avif", ".avifs", ".heic", ".heif", ".hif", ".jp2", ".j2k", ".ppm", ".pgm", ".pnm", ".tga"),
)
RAW_SUFFIXES = (
    *(".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".sr2", ".srf", ".raf", ".orf", ".rw2", ".pef", ".srw"),
    *(".raw", ".3fr", ".iiq", ".mrw", ".x3f", ".dcr", ".kdc", ".erf", ".mef", ".mos", ".rwl"),
)
KEYPOINTS, PARTS = "keypoints.json", "parts.png"  # endings of files beside a photo, after the photo's stem and a point
ARCHIVES = (".zip", ".7z", ".rar", ".gz", ".bz2", ".xz", ".zst", ".tgz", ".tbz2", ".txz")
_SYSTEM_FILES = ("thumbs.db", "desktop.ini", "icon\r", "@eadir")  # written by Windows, macOS and Synology; lower case

RAW, JPEG_XL = "raw photos: develop them first", "JPEG XL: convert them first"
ARCHIVE, NO_PICTURE = "archives: unpack them first", "no picture format"
ALONE = "no photo of that name beside it"
_REASONS = {**dict.fromkeys(RAW_SUFFIXES, RAW), ".jxl": JPEG_XL, **dict.fromkeys(ARCHIVES, ARCHIVE)}
_MOST_KINDS = 8  # endings that a line names for each reason

_AVIF_BRANDS = {b"avif", b"avis"}
_HEIF_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs", b"mif1", b"msf1"}
_PICTURE, _DEVELOPED = "a picture", "it developed, such as to JPEG"
# First bytes of files that people take for pictures, with the format's name and the file that is expected instead.
_BEGINNINGS = (
    (b"\xff\x0a", "a JPEG XL picture", "it converted, such as to PNG"),
    (b"\0\0\0\x0cJXL ", "a JPEG XL picture", "it converted, such as to PNG"),
    (b"IIU\0", "a raw photo", _DEVELOPED),
    (b"IIRO", "a raw photo", _DEVELOPED),
    (b"IIRS", "a raw photo", _DEVELOPED),
    (b"FUJIFILMCCD-RAW", "a raw photo", _DEVELOPED),
    (b"%PDF", "a PDF document", _PICTURE),
    (b"PK\x03\x04", "a zip file", _PICTURE),
    (b"\x1f\x8b", "a gzip file", _PICTURE),
    (b"version https://git-lfs", "a pointer of Git LFS", "the file itself: git lfs pull"),
    (b"<!doctype html", "an HTML page", _PICTURE),
    (b"<html", "an HTML page", _PICTURE),
    (b"<svg", "an SVG drawing", _PICTURE),
)


def ending_of(name: str) -> str:
    """Ending of a file's name in lower case, with the point; "" if it has none."""
    return os.path.splitext(name)[1].lower()  # called for each file, and Path would take long


def is_hidden_name(name: str) -> bool:
    """True for a file or folder that the system hides, or keeps beside pictures, such as ``Thumbs.db``."""
    return name.startswith(".") or name.lower() in _SYSTEM_FILES


@dataclass
class LeftOut:
    """Files that are left out, counted by the reason and their ending."""

    counts: dict[str, Counter[str]] = field(default_factory=dict)

    def add(self, name: str, reason: str | None = None) -> None:
        """Count a file; without a ``reason``, its ending decides it."""
        ending = ending_of(name)
        self.count(ending or "without an ending", reason or _REASONS.get(ending, NO_PICTURE))

    def count(self, kind: str, reason: str) -> None:
        """Count a file of a kind, such as ".txt"."""
        self.counts.setdefault(reason, Counter())[kind] += 1

    def __bool__(self) -> bool:
        return bool(self.counts)

    def __str__(self) -> str:
        """One line, such as ``3 files left out: 2 .txt, 1 .psd (no picture format)``; "" if there are none."""
        if not self.counts:
            return ""
        total = sum(kinds.total() for kinds in self.counts.values())
        reasons = "; ".join(f"{_listed(kinds)} ({reason})" for reason, kinds in sorted(self.counts.items()))
        return f"{total} file{'s' * (total > 1)} left out: {reasons}"


def photos_among(names: Iterable[str], left_out: LeftOut, more: tuple[str, ...] = ()) -> Iterator[str]:
    """Names of photos among the files of a folder, in their order.

    Files that belong to photos, the label set ``labels.json``, and hidden files are skipped without being counted.

    Args:
        names: Names of all files, without their folder.
        left_out: Counter of the other files, which are left out.
        more: Endings that are also taken as photos, such as those of films.
    """
    files = [name for name in names if not is_hidden_name(name)]
    keys = {os.path.splitext(name)[0] for name in files if ending_of(name) in PHOTO_SUFFIXES}
    for name in files:
        beside = next((each for each in (KEYPOINTS, PARTS) if name.lower().endswith(f".{each}")), None)
        if beside is not None:
            if not name.endswith(f".{beside}") or name[: -len(beside) - 1] not in keys:
                left_out.count(f".{beside}", ALONE)
        elif ending_of(name) in (*PHOTO_SUFFIXES, *more):
            yield name
        elif name != "labels.json":
            left_out.add(name)


def _listed(kinds: Counter[str]) -> str:
    ordered = sorted(kinds.items(), key=lambda each: (-each[1], each[0]))
    listed = [f"{count} {kind}" for kind, count in ordered[:_MOST_KINDS]]
    if others := sum(count for _, count in ordered[_MOST_KINDS:]):
        listed.append(f"{others} others")
    return ", ".join(listed)


def is_heif(head: bytes) -> bool:
    """True if a file with these first bytes is a HEIF picture, such as a phone's HEIC."""
    brands = _brands(head)
    return bool(brands & _HEIF_BRANDS) and not brands & _AVIF_BRANDS


class Foreign(NamedTuple):
    """Format that can't be read: its name, the file that is expected instead, and the library that could read it."""

    name: str
    expected: str
    library: str = ""


def foreign_format(head: bytes) -> Foreign | None:
    """Format of a file that Pillow does not know, from its first bytes; None if it is not known here either."""
    if not head:
        return Foreign("empty", _PICTURE)
    brands = _brands(head)
    if brands & _AVIF_BRANDS:
        return Foreign("an AVIF picture, with an old Pillow", "a newer one: pip install 'pillow>=11.3'", "pillow")
    if is_heif(head):
        return Foreign("a HEIC picture, without pillow-heif", "it: pip install pillow-heif", "pillow_heif")
    if b"crx " in brands:
        return Foreign("a raw photo", _DEVELOPED)
    if brands:
        return Foreign("a film", _PICTURE)
    start = head.lstrip().lower() if head.lstrip().startswith(b"<") else head
    for beginning, name, expected in _BEGINNINGS:
        if start.startswith(beginning):
            return Foreign(name, expected)
    return None


def _brands(head: bytes) -> set[bytes]:
    """Brands of an ISO media file, which films, HEIF and AVIF pictures have; empty for another file."""
    if head[4:8] != b"ftyp":
        return set()
    end = min(int.from_bytes(head[:4], "big"), len(head))
    return {head[8:12], *(head[start : start + 4] for start in range(16, end - 3, 4))}
