"""Photos of all formats, formats that can't be read, and files that are no photos."""

from __future__ import annotations

import importlib.util
import os
import socket
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from warp_partdr.errors import InputError
from warp_partdr.inputs import part_labels
from warp_partdr.inputs.films import is_photo
from warp_partdr.inputs.part_labels import photo_warnings, read_focal, read_parts, read_photo, scan_photo
from warp_partdr.inputs.photo_files import (
    ARCHIVES,
    PHOTO_SUFFIXES,
    RAW_SUFFIXES,
    LeftOut,
    foreign_format,
    is_heif,
    photos_among,
)

HEIC_HEAD = b"\0\0\0\x24ftypmif1\0\0\0\0mif1heicmiafMiHB" + bytes(200)
NEEDS_HEIF = pytest.mark.skipif(
    importlib.util.find_spec("pillow_heif") is None, reason="needs pillow-heif, the extra heic"
)
SIDES = (48, 32)


def gradient() -> Image.Image:
    """Brighter to the right, redder to the bottom, so that no turn of it looks the same."""
    x, y = np.meshgrid(np.linspace(0, 255, SIDES[0]), np.linspace(0, 255, SIDES[1]))
    return Image.fromarray(np.stack([y, x, x], axis=-1).astype(np.uint8))


def turned(orientation: int) -> Image.Exif:
    exif = Image.Exif()
    exif[0x0112] = orientation
    return exif


def refusal(path: Path, reader: Callable[[Path], Any] = read_photo) -> str:
    with pytest.raises(InputError) as caught:
        reader(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("ending", "kind", "tolerance"),
    [
        ("jpg", "jpeg", 12),
        ("JFIF", "jpeg", 12),
        ("jpe", "jpeg", 12),
        ("PNG", "png", 0),
        ("gif", "gif", 40),
        ("GIF", "gif", 40),
        ("webp", "webp", 20),
        ("bmp", "bmp", 0),
        ("tiff", "tiff", 0),
        ("ppm", "ppm", 0),
        ("tga", "tga", 0),
        ("jp2", "jpeg2000", 12),
        ("avif", "avif", 20),
    ],
)
def test_photos_of_many_formats_are_one_picture(ending: str, kind: str, tolerance: int, tmp_path: Path) -> None:
    path = tmp_path / f"a.{ending}"
    try:
        gradient().save(path, kind)
    except (KeyError, OSError):
        pytest.skip(f"this Pillow writes no {kind}")
    assert is_photo(path)
    found = read_photo(path)
    assert np.abs(found.astype(int) - np.asarray(gradient()).astype(int)).max() <= tolerance
    assert scan_photo(path) == found.shape[:2]
    assert photo_warnings(path) == ()
    assert list(photos_among([path.name], LeftOut())) == [path.name]


def test_content_counts_not_the_ending(tmp_path: Path) -> None:
    gradient().save(tmp_path / "a.png")
    (tmp_path / "a.png").rename(tmp_path / "a.jpg")
    np.testing.assert_array_equal(read_photo(tmp_path / "a.jpg"), np.asarray(gradient()))


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["tiff", "avif"])
def test_photos_are_turned_once(kind: str, orientation: int, tmp_path: Path) -> None:
    """A picture that is stored turned, with the orientation that says so, is read upright."""
    path = tmp_path / f"a.{kind}"
    stored = gradient()
    for turn in {
        1: [],
        2: [Image.Transpose.FLIP_LEFT_RIGHT],
        3: [Image.Transpose.ROTATE_180],
        4: [Image.Transpose.FLIP_TOP_BOTTOM],
        5: [Image.Transpose.TRANSPOSE],
        6: [Image.Transpose.ROTATE_90],
        7: [Image.Transpose.TRANSVERSE],
        8: [Image.Transpose.ROTATE_270],
    }[orientation]:
        stored = stored.transpose(turn)
    try:
        stored.save(path, exif=turned(orientation))
    except (KeyError, OSError):
        pytest.skip(f"this Pillow writes no {kind}")
    found = read_photo(path)
    assert found.shape[:2] == scan_photo(path) == SIDES[::-1]
    assert np.abs(found.astype(int) - np.asarray(gradient()).astype(int)).max() <= 20


def test_of_several_pictures_the_first_is_taken_and_that_is_said(tmp_path: Path) -> None:
    frames = [Image.new("RGB", (8, 6), (shade, shade, shade)) for shade in (10, 120, 240)]
    for name in ("a.gif", "a.webp", "a.tif", "a.png"):
        frames[0].save(tmp_path / name, save_all=True, append_images=frames[1:])
        assert np.abs(read_photo(tmp_path / name).astype(int) - 10).max() < 6
        assert photo_warnings(tmp_path / name) == ("3 pictures in the file; the first is taken",)
    frames[0].save(tmp_path / "a.mpo", "MPO", save_all=True, append_images=frames[1:])  # smaller copies, in phones'
    assert np.abs(read_photo(tmp_path / "a.mpo").astype(int) - 10).max() < 6
    assert photo_warnings(tmp_path / "a.mpo") == ()
    (tmp_path / "b.gif").write_bytes(b"GIF89a")
    assert photo_warnings(tmp_path / "b.gif") == ()  # reading it tells


def test_a_heic_picture_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So does one that is called .jpg, as phones export them, and one in memory."""
    monkeypatch.setattr(part_labels, "find_spec", lambda name: None)
    says = "a HEIC picture, without pillow-heif; expected it: pip install pillow-heif"
    for name in ("IMG_1.HEIC", "b.jpg", "c.heif"):
        (tmp_path / name).write_bytes(HEIC_HEAD)
        for reader in (read_photo, scan_photo, read_focal):
            assert refusal(tmp_path / name, reader) == f"{tmp_path / name}: {says}"
    with pytest.raises(InputError, match="a HEIC picture"):
        read_photo(BytesIO(HEIC_HEAD))


@NEEDS_HEIF
@pytest.mark.parametrize("name", ["a.heic", "a.HEIF", "a.jpg"])
def test_heic_pictures_are_read(name: str, tmp_path: Path) -> None:
    from pillow_heif import from_pillow

    exif = turned(1)
    exif.get_ifd(0x8769)[0xA405] = 26
    path = tmp_path / name
    from_pillow(gradient()).save(path, quality=95, exif=exif.tobytes())
    found = read_photo(path)
    assert np.abs(found.astype(int) - np.asarray(gradient()).astype(int)).max() <= 20
    assert scan_photo(path) == found.shape[:2]
    assert read_focal(path) == pytest.approx(26 / np.hypot(36, 24) * np.hypot(*SIDES))


@NEEDS_HEIF
@pytest.mark.parametrize("orientation", range(1, 9))
def test_heic_pictures_are_turned_once(orientation: int, tmp_path: Path) -> None:
    """The container turns them; EXIF data that say the same again are a copy."""
    from pillow_heif import from_pillow

    path = tmp_path / "a.heic"
    back = {
        1: None,
        2: Image.Transpose.FLIP_LEFT_RIGHT,
        3: Image.Transpose.ROTATE_180,
        4: Image.Transpose.FLIP_TOP_BOTTOM,
        5: Image.Transpose.TRANSPOSE,
        6: Image.Transpose.ROTATE_90,
        7: Image.Transpose.TRANSVERSE,
        8: Image.Transpose.ROTATE_270,
    }[orientation]
    stored = gradient() if back is None else gradient().transpose(back)
    from_pillow(stored).save(path, quality=95, exif=turned(orientation).tobytes())
    found = read_photo(path)
    assert found.shape[:2] == scan_photo(path) == SIDES[::-1]
    assert np.abs(found.astype(int) - np.asarray(gradient()).astype(int)).max() <= 25


def ftyp(major: bytes, *brands: bytes) -> bytes:
    size = 16 + 4 * len(brands)
    return size.to_bytes(4, "big") + b"ftyp" + major + bytes(4) + b"".join(brands) + b"heicmeta"


@pytest.mark.parametrize(
    ("head", "says"),
    [
        (b"", "empty; expected a picture"),
        (ftyp(b"heix"), "a HEIC picture, without pillow-heif; expected it: pip install pillow-heif"),
        (ftyp(b"msf1", b"hevc"), "a HEIC picture"),
        (ftyp(b"mif1", b"miaf", b"avif"), "an AVIF picture, with an old Pillow; expected a newer one: pip install"),
        (ftyp(b"avis"), "an AVIF picture"),
        (ftyp(b"crx ", b"isom"), "a raw photo; expected it developed"),
        (ftyp(b"isom", b"mp42"), "a film; expected a picture"),
        (ftyp(b"qt  "), "a film; expected a picture"),
        (b"\xff\x0a" + bytes(30), "a JPEG XL picture; expected it converted"),
        (b"\0\0\0\x0cJXL \r\n\x87\n", "a JPEG XL picture; expected it converted"),
        (b"IIU\0" + bytes(30), "a raw photo"),
        (b"FUJIFILMCCD-RAW 0201", "a raw photo"),
        (b"%PDF-1.7", "a PDF document"),
        (b"PK\x03\x04" + bytes(20), "a zip file"),
        (b"\n\n <!DOCTYPE HTML>\n<html>", "an HTML page; expected a picture"),
        (b"version https://git-lfs.github.com/spec/v1\noid", "a pointer of Git LFS; expected the file itself"),
    ],
)
def test_other_formats_are_called_by_their_name(
    head: bytes, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(part_labels, "find_spec", lambda name: None)
    Image.init()  # or formats that are registered meanwhile would be lost afterwards
    monkeypatch.setattr(Image, "ID", [each for each in Image.ID if each not in ("AVIF", "HEIF")])  # an old Pillow
    (tmp_path / "a.jpg").write_bytes(head)
    assert refusal(tmp_path / "a.jpg").startswith(f"{tmp_path / 'a.jpg'}: {says}")


def test_what_nobody_knows_is_told_as_pillow_does(tmp_path: Path) -> None:
    assert foreign_format(b"nothing of that kind") is None
    assert foreign_format(b"\0\0\0\x18") is None
    assert not is_heif(b"heic")
    (tmp_path / "a.jpg").write_bytes(b"nothing of that kind")
    assert "cannot identify image file" in refusal(tmp_path / "a.jpg")


def test_raw_photos_are_no_thumbnails(tmp_path: Path) -> None:
    """Pillow reads the small picture in them, for they are TIFF."""
    gradient().save(tmp_path / "a.nef", "TIFF")
    gradient().save(tmp_path / "a.tif", tiffinfo={50706: b"\1\4\0\0"})
    gradient().save(tmp_path / "fine.tif", tiffinfo={305: "scanner"})
    for name in ("a.nef", "a.tif"):
        assert refusal(tmp_path / name).endswith(": a raw photo; expected it developed, such as to JPEG")
    assert read_photo(tmp_path / "fine.tif").shape == (32, 48, 3)


def test_what_a_damaged_file_raises_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of Pillow's formats raises an error of its own."""
    gradient().save(tmp_path / "a.png")

    def fails(self: Image.Image, mode: str | None = None) -> None:
        raise IndexError("index out of\nrange")

    monkeypatch.setattr(Image.Image, "getexif", fails)
    assert refusal(tmp_path / "a.png", read_focal).endswith("a.png: index out of range; expected a picture")


@pytest.mark.skipif(os.name != "posix", reason="needs pipes with names")
@pytest.mark.parametrize("reader", [read_photo, scan_photo, read_focal, lambda path: read_parts(path, "full1")])
def test_pipes_are_refused(reader: Callable[[Path], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody will ever write into them."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "x.png").symlink_to(tmp_path / "pipe")
    assert ": a pipe, no regular file; expected " in refusal(tmp_path / "x.png", reader)
    (tmp_path / "x.png").unlink()
    with socket.socket(socket.AF_UNIX) as server:
        monkeypatch.chdir(tmp_path)  # the names of sockets are short
        server.bind("x.png")
        assert "x.png: a socket, no regular file; expected " in refusal(Path("x.png"), reader)


def test_files_of_a_folder_are_photos_or_counted() -> None:
    left_out = LeftOut()
    names = [
        *("a.jpg", "A.HEIC", "b.Avif", "c.gif", "d.MPO", "scan.tif", "photo 2.0 take 3.png"),
        *("a.keypoints.json", "a.parts.png", "photo 2.0 take 3.keypoints.json", "labels.json"),
        *(".DS_Store", "Thumbs.db", "desktop.ini", "._a.jpg", ".a.jpg.swp"),
        *("lost.parts.png", "lost.keypoints.json", "a.Keypoints.json"),
        *("notes.txt", "README.TXT", "drawing.psd", "IMG.CR2", "IMG.dng", "new.jxl", "old.zip", "LICENSE", "film.mp4"),
    ]
    assert list(photos_among(names, left_out)) == names[:7]
    assert str(left_out) == (
        "12 files left out: 1 .jxl (JPEG XL: convert them first); 1 .zip (archives: unpack them first); "
        "2 .keypoints.json, 1 .parts.png (no photo of that name beside it); "
        "2 .txt, 1 .mp4, 1 .psd, 1 without an ending (no picture format); "
        "1 .cr2, 1 .dng (raw photos: develop them first)"
    )
    assert list(photos_among(names, LeftOut(), (".mp4",))) == [*names[:7], "film.mp4"]


def test_what_is_left_out_is_one_short_line() -> None:
    left_out = LeftOut()
    assert not left_out
    assert str(left_out) == ""
    left_out.add("a.txt")
    assert left_out
    assert str(left_out) == "1 file left out: 1 .txt (no picture format)"
    for number in range(300):
        left_out.add(f"a.{number // 10:03}")
    assert str(left_out).startswith("301 files left out: 10 .000, 10 .001, ")
    assert str(left_out).endswith("10 .007, 221 others (no picture format)")


def test_endings_are_of_one_kind() -> None:
    for one, other in ((PHOTO_SUFFIXES, RAW_SUFFIXES), (PHOTO_SUFFIXES, ARCHIVES), (RAW_SUFFIXES, ARCHIVES)):
        assert not set(one) & set(other)


def test_an_avif_picture_is_no_heic() -> None:
    assert is_heif(ftyp(b"mif1", b"heic"))
    assert not is_heif(ftyp(b"mif1", b"avif"))
    assert not is_heif(ftyp(b"isom"))
