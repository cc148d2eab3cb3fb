"""Label files in all their formats, faulty ones, and such as are too large, which their headers tell."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from conftest import HANG
from helpers.files import save_with_focal
from PIL import Image

from warp_partdr.body.labels import IGNORE, label_set
from warp_partdr.errors import InputError
from warp_partdr.inputs import part_labels
from warp_partdr.inputs.part_labels import (
    PartLabels,
    check_sizes,
    exif_focal_length,
    read_focal,
    read_parts,
    read_photo,
    scan_photo,
)

CDCL = label_set("cdcl14")
PALETTE = [value for k in range(256) for value in (k, 255 - k, (7 * k) % 256)]


def label_picture(value: int = 0) -> np.ndarray:
    picture = np.zeros((12, 16), dtype=np.uint8)
    picture[2:6, 4:9] = 2
    picture[6:11, 4:6] = 9
    picture[0, 0], picture[3, 3] = 255, value
    return picture


def save_palette(path: Path, picture: np.ndarray) -> None:
    image = Image.new("P", picture.shape[::-1])
    image.putdata(picture.ravel().tolist())
    image.putpalette(PALETTE)
    image.save(path)


@pytest.mark.parametrize(
    ("name", "save"),
    [
        ("gray.png", lambda path, picture: Image.fromarray(picture).save(path)),
        ("palette.png", save_palette),
        ("deep.png", lambda path, picture: Image.fromarray(picture.astype(np.uint16)).save(path)),
        ("LABELS.PNG", lambda path, picture: Image.fromarray(picture).save(path, "PNG")),
        ("bytes.npy", np.save),
        ("longs.npy", lambda path, picture: np.save(path, picture.astype(np.int64))),
        ("halves.npy", lambda path, picture: np.save(path, picture.astype(np.float16))),
        ("doubles.npy", lambda path, picture: np.save(path, picture.astype(np.float64))),
        ("fortran.npy", lambda path, picture: np.save(path, np.asfortranarray(picture))),
    ],
)
def test_labels_are_read_from_files_of_any_usual_type(
    name: str, save: Callable[[Path, np.ndarray], None], tmp_path: Path
) -> None:
    save(tmp_path / name, label_picture())
    parts = read_parts(tmp_path / name, CDCL)
    expected = label_picture()
    expected[expected == 9] = parts.label_set.group_names.index("right_upper_leg") + 1
    np.testing.assert_array_equal(parts.groups, expected)
    assert parts.groups.dtype == np.uint8
    assert parts.maps is None


@pytest.mark.parametrize("mode", ["1", "L"])
def test_silhouettes_are_read_as_one_group(mode: str, tmp_path: Path) -> None:
    mask = label_picture() % 255 > 0
    Image.fromarray((mask * 255).astype(np.uint8)).convert(mode).save(tmp_path / "mask.png")
    np.testing.assert_array_equal(read_parts(tmp_path / "mask.png", label_set("full1")).groups, mask)


@pytest.mark.parametrize("layout", [(0, 1, 2), (1, 2, 0)])
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_probability_maps_are_read_in_either_layout(
    layout: tuple[int, int, int], dtype: type, tmp_path: Path, rng: np.random.Generator
) -> None:
    logits = rng.normal(size=(20, 12, 16)) * 3
    probabilities = (np.exp(logits) / np.exp(logits).sum(axis=0)).astype(dtype)
    np.save(tmp_path / "soft.npy", probabilities.transpose(layout))
    labels = label_set("lip20")
    parts = read_parts(tmp_path / "soft.npy", labels)
    assert parts.maps is not None
    assert parts.maps.dtype == np.float32
    np.testing.assert_allclose(parts.maps, clear(labels.to_group_maps(probabilities.astype(np.float32))), atol=1e-6)
    ignored = 1 - parts.maps.sum(axis=0)
    np.testing.assert_array_equal(parts.groups == IGNORE, ignored > parts.maps.max(axis=0))
    sure = parts.groups != IGNORE
    np.testing.assert_array_equal(parts.groups[sure], parts.maps.argmax(axis=0)[sure])


def clear(maps: np.ndarray) -> np.ndarray:
    """Probabilities without those under 5 %, pixel by pixel; the last row is of what is ignored."""
    found = np.concatenate([maps, 1 - maps.sum(axis=0, keepdims=True)])
    for row, column in np.ndindex(maps.shape[1:]):
        pixel = found[:, row, column]
        pixel[pixel < 0.05] = 0
        pixel /= max(pixel.sum(), 0.05)
    return found[:-1]


def test_a_label_set_is_given_by_name_too(tmp_path: Path) -> None:
    Image.fromarray(np.array([[0, 1], [2, 3]], np.uint8)).save(tmp_path / "p.png")
    assert read_parts(tmp_path / "p.png", "cdcl14").label_set is label_set("cdcl14")
    with pytest.raises(InputError, match="labels: 'cdcl'; expected one of"):
        read_parts(tmp_path / "p.png", "cdcl")


def test_haze_over_all_classes_of_a_file_is_taken_as_none(tmp_path: Path) -> None:
    """A network that is asked itself has such haze, too."""
    ids = np.array([[0, 1, 2], [2, 1, 0]])
    sure = np.moveaxis(np.eye(15, dtype=np.float32)[ids], -1, 0)
    hazy = 0.97 * sure + 0.03 / 15
    hazy[:, 1, 2] = 0.04, *[0.96 / 14] * 14
    np.save(tmp_path / "soft.npy", hazy)
    parts = read_parts(tmp_path / "soft.npy", CDCL)
    assert parts.maps is not None
    np.testing.assert_allclose(parts.maps[:, 0], sure[:, 0], atol=1e-6)
    np.testing.assert_allclose(parts.maps[:, 1, :2], sure[:, 1, :2], atol=1e-6)
    np.testing.assert_allclose(parts.maps.sum(axis=0), 1, atol=1e-6)
    assert parts.maps[0, 1, 2] == 0


def soft(channels: int = 15, scale: float = 1.0) -> np.ndarray:
    return np.full((channels, 4, 5), scale / channels, dtype=np.float32)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (label_picture(15), "labels: ids 15 not in cdcl14; expected 0 to 14 (255 = ignore)"),
        (label_picture().astype(np.int16) - 1, "labels: ids -1, 254 not in cdcl14; expected 0 to 14"),
        (np.zeros((4, 5), dtype=np.uint8), "empty, no pixel of a body part; expected a person in the labels of cdcl14"),
        (np.full((4, 5), 255, dtype=np.uint8), "empty, no pixel of a body part"),
        (
            (label_picture() > 0).astype(np.uint8) * 2,
            "one part only (torso); expected several of cdcl14, or the label set full1",
        ),
        (np.full((4, 5), 1, dtype=np.uint8), "one part only (head); expected several"),
        (np.zeros((0, 5), dtype=np.uint8), "shape (0, 5); expected pixels"),
        (np.zeros(5, dtype=np.uint8), "shape (5,); expected (H, W), (N, H, W) masks, or (K, H, W) probabilities"),
        (np.zeros((2, 3, 4, 5), dtype=np.uint8), "shape (2, 3, 4, 5); expected (H, W)"),
        (np.zeros((4, 5), dtype=np.float32), "empty, no pixel of a body part"),
        (np.full((4, 5), 2.5, np.float32), "float32, 2.5 among them; expected whole numbers, the labels' ids"),
        (np.full((4, 5), np.nan, np.float64), "float64, nan among them; expected whole numbers"),
        (np.full((4, 5), np.inf, np.float16), "float16, inf among them; expected whole numbers"),
        (np.full((4, 5), 1e30, np.float32), "labels: ids 1000000000 not in cdcl14; expected 0 to 14"),
        (np.zeros((4, 5), dtype=np.complex64), "complex64; expected integers, bool, or floats"),
        (np.zeros((4, 5), dtype="U3"), "<U3; expected integers, bool, or floats"),
        (np.zeros((4, 5, 3), dtype=np.uint8), "empty, no pixel of a body part"),
        (np.ones((4, 5, 3), dtype=bool), "one part only (head); expected several of cdcl14, or the label set full1"),
        (np.full((4, 5, 3), 15), "labels: ids 15 not in cdcl14; expected 0 to 14"),
        (soft(14), "shape (14, 4, 5); expected (15, H, W) or (H, W, 15), one map per id of cdcl14"),
        (soft() * np.nan, "values from nan to nan; expected probabilities, 0 to 1"),
        (soft() - 1, "values from -0.933333 to -0.933333; expected probabilities"),
        (soft(scale=7.5), "class probabilities add up to 7.5 to 7.5; expected 1 at each pixel"),
        (np.array([[None, {}]]), "holds pickled Python objects, which could run code"),
    ],
)
def test_bad_label_arrays_are_refused_in_a_line(array: np.ndarray, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.npy"
    np.save(path, array, allow_pickle=True)
    with pytest.raises(InputError) as raised:
        read_parts(path, CDCL)
    error = str(raised.value)
    assert error.startswith(str(path))
    assert message in error
    assert "\n" not in error


@pytest.mark.parametrize("suffix", [".png", ".npy"])
def test_unreadable_label_files_are_refused(suffix: str, tmp_path: Path, rng: np.random.Generator) -> None:
    path, picture = tmp_path / f"parts{suffix}", rng.integers(0, 15, (64, 64)).astype(np.uint8)
    Image.fromarray(picture).save(path) if suffix == ".png" else np.save(path, picture)
    for content, reason in (
        (path.read_bytes()[:200], ".*"),
        (b"not at all", ".*"),
        (None, "No such file or directory"),
    ):
        path.unlink() if content is None else path.write_bytes(content)
        with pytest.raises(InputError, match=rf"parts\{suffix}: {reason}; expected a"):
            read_parts(path, CDCL)


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.int64])
def test_masks_by_instance_are_read_for_each_person(dtype: type, tmp_path: Path) -> None:
    """Their type alone tells them from probabilities; they may be 0 and 1, or 0 and 255."""
    masks = np.zeros((3, 6, 5), dtype=dtype)
    masks[0, 1:4, 1] = masks[1, 3:, 1:3] = 1 if dtype is bool else 255
    np.save(tmp_path / "masks.npy", masks)
    parts = read_parts(tmp_path / "masks.npy", label_set("full1"))
    assert parts.maps is None
    assert parts.instances is not None
    np.testing.assert_array_equal(parts.instances, masks > 0)
    np.testing.assert_array_equal(parts.groups, (masks > 0).any(axis=0))
    np.save(tmp_path / "masks.npy", (masks > 0).astype(np.float32))
    with pytest.raises(InputError, match=r"expected \(2, H, W\) .*of full1; or masks \(N, H, W\), as integers or bool"):
        read_parts(tmp_path / "masks.npy", label_set("full1"))
    with pytest.raises(InputError, match=r"instances: shape \(3, 6, 4\); expected \(N, 6, 5\)"):
        PartLabels(parts.label_set, parts.groups, instances=parts.instances[..., 1:])


def test_part_ids_of_each_person_are_joined_to_one_picture(tmp_path: Path) -> None:
    people = np.zeros((2, 3, 4), dtype=np.uint8)
    people[0, 0], people[0, 1], people[1, 1:] = 1, 255, 2
    np.save(tmp_path / "people.npy", people)
    parts = read_parts(tmp_path / "people.npy", CDCL)
    assert parts.groups[:, 0].tolist() == [1, 2, 2]
    np.testing.assert_array_equal(parts.instances, people)


def test_label_files_of_other_kinds_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"parts\.jpg: \.jpg; expected \.png or \.npy part labels"):
        read_parts(tmp_path / "parts.jpg", CDCL)
    for mode in ("RGB", "RGBA", "LA"):
        Image.fromarray(label_picture()).convert(mode).save(tmp_path / "colours.png")
        with pytest.raises(InputError, match=rf"colours\.png: {mode} picture; expected one channel of label ids"):
            read_parts(tmp_path / "colours.png", CDCL)


def test_a_photo_is_read_upright_and_must_have_the_labels_size(tmp_path: Path) -> None:
    image = Image.new("RGB", (6, 4), (1, 2, 3))
    exif = image.getexif()
    exif[0x0112] = 6  # Held upright, stored lying.
    image.save(tmp_path / "photo.jpg", exif=exif)
    photo = read_photo(tmp_path / "photo.jpg")
    assert photo.shape == (6, 4, 3)
    assert photo.dtype == np.uint8
    check_sizes(photo=(480, 640), parts=(480, 640))
    check_sizes(photo=None, parts=(480, 640))
    with pytest.raises(InputError, match=r"^photo: 640x480; parts: 320x240; expected one size$"):
        check_sizes(photo=(480, 640), parts=(240, 320))
    (tmp_path / "photo.jpg").write_text("no")
    with pytest.raises(InputError, match=r"photo\.jpg: cannot identify image file .*; expected a picture"):
        read_photo(tmp_path / "photo.jpg")
    with pytest.raises(InputError, match=r"none\.jpg: No such file or directory; expected a picture"):
        read_photo(tmp_path / "none.jpg")


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("ending", ["jpg", "png", "webp"])
def test_a_photo_that_is_looked_through_has_the_size_that_it_is_read_with(
    tmp_path: Path, rng: np.random.Generator, ending: str, orientation: int
) -> None:
    """It also has the same fault, if it is not whole."""
    path = tmp_path / f"photo.{ending}"
    image = Image.fromarray(rng.integers(0, 255, (61, 83, 3), dtype=np.uint8))
    exif = image.getexif()
    exif[0x0112] = orientation
    image.save(path, exif=exif)
    assert scan_photo(path) == read_photo(path).shape[:2]
    path.write_bytes(path.read_bytes()[:-900])
    with pytest.raises(InputError) as read:
        read_photo(path)
    with pytest.raises(InputError) as checked:
        scan_photo(path)
    # How many bytes are left over may differ.
    assert str(checked.value).partition("(")[0] == str(read.value).partition("(")[0]


def test_photos_of_any_mode_are_the_same_picture(tmp_path):
    """Modes are 8- and 16-bit gray, and colours with transparency."""
    gray = np.arange(0, 240, 5, dtype=np.uint8).reshape(6, 8)
    Image.fromarray(gray).save(tmp_path / "gray.png")
    Image.fromarray(gray.astype(np.uint16) * 257).save(tmp_path / "deep.png")
    Image.fromarray(gray).convert("RGBA").save(tmp_path / "rgba.png")
    for name in ("gray", "deep", "rgba"):
        np.testing.assert_array_equal(read_photo(tmp_path / f"{name}.png"), np.repeat(gray[..., None], 3, axis=2))


@pytest.mark.parametrize("size", [(400, 300), (300, 400), (200, 150)])
def test_the_focal_length_of_a_photo_comes_from_its_exif_data(tmp_path, size):
    """It also does for a photo that was turned or made smaller since it was taken."""
    save_with_focal(Image.new("RGB", size), tmp_path / "photo.jpg", focal=28, was=(400, 300))
    diagonal = np.hypot(*size)
    assert read_focal(tmp_path / "photo.jpg") == pytest.approx(28 / np.hypot(36, 24) * diagonal)
    assert exif_focal_length(tmp_path / "photo.jpg") == read_focal(tmp_path / "photo.jpg")


@pytest.mark.parametrize(
    ("size", "focal", "says"),
    [
        ((400, 300), 0, "no focal length in its EXIF data; expected the one on 35 mm film"),
        ((400, 300), 65535, "65535 mm on 35 mm film in its EXIF data; expected 4 to 3000"),
        ((400, 300), 1, "1 mm on 35 mm film in its EXIF data; expected 4 to 3000"),
        ((400, 300), "wide", "no focal length in its EXIF data"),
        ((300, 300), 28, "300x300, but 400x300 in its EXIF data; expected a photo that was not cut"),
    ],
)
def test_a_photo_without_a_usable_focal_length_says_so(tmp_path, size, focal, says):
    save_with_focal(Image.new("RGB", size), tmp_path / "photo.jpg", focal, was=(400, 300))
    with pytest.raises(InputError, match=says):
        read_focal(tmp_path / "photo.jpg")
    assert exif_focal_length(tmp_path / "photo.jpg") is None


def test_importing_inputs_loads_no_picture_library() -> None:
    code = "import warp_partdr.inputs, sys; sys.exit(bool({'PIL', 'torch', 'pyvista'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=HANG).returncode == 0


@pytest.mark.parametrize(("total", "taken"), [(0.995, True), (1.005, True), (0.95, False), (1.05, False)])
def test_probabilities_add_up_to_one_but_for_rounding(total, taken, tmp_path):
    maps = np.full((15, 6, 5), 0.02, np.float32)
    for channel, rows in ((0, slice(0, 2)), (1, slice(2, 4)), (2, slice(4, 6))):  # background, head and torso
        maps[channel, rows] = 0.72
    maps[:, 1, 1] *= total  # at one pixel
    np.save(tmp_path / "soft.npy", maps)
    says = pytest.raises(InputError, match=r"class probabilities add up to .*; expected 1 at each pixel")
    with nullcontext() if taken else says:
        assert read_parts(tmp_path / "soft.npy", CDCL).maps is not None


TOO_LARGE = r": more than .* megapixels; expected a smaller picture$"


@pytest.mark.parametrize("pil_limit", [None, 100, 300, 10**9])
def test_larger_pictures_are_refused_by_their_headers(pil_limit, tmp_path, monkeypatch):
    """PIL's own limit does not matter. Above twice that limit, PIL itself raises."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", pil_limit)
    monkeypatch.setattr(part_labels, "LARGEST_PICTURE", 199)
    path = tmp_path / "large.png"
    Image.fromarray(np.zeros((20, 20), dtype=np.uint8)).save(path)
    path.write_bytes(path.read_bytes()[:50])  # signature, IHDR and where pixels begin
    for read in (read_photo, lambda path: read_parts(path, CDCL)):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pytest.raises(InputError, match=r"large\.png" + TOO_LARGE):
                read(path)


def test_large_pictures_are_read_without_a_word(tmp_path, monkeypatch):
    """PIL warns of them. Our limit is above PIL's warning, and below PIL's error and what the renderer takes."""
    assert Image.MAX_IMAGE_PIXELS < part_labels.LARGEST_PICTURE < 2 * Image.MAX_IMAGE_PIXELS
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 150)
    path = tmp_path / "fine.png"
    Image.fromarray(label_picture()).save(path)
    with pytest.warns(Image.DecompressionBombWarning):
        Image.open(path).close()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_photo(path).shape == (12, 16, 3)
        assert read_parts(path, CDCL).groups.shape == (12, 16)


@pytest.mark.parametrize(
    ("shape", "kind"),
    [
        ((20, 10), "<f4"),
        ((15, 20, 10), "<f4"),
        ((20, 10, 15), "<f4"),
        ((2, 20, 10), "|b1"),
        ((160, 2, 10), "|u1"),
    ],
)
def test_larger_arrays_are_refused_by_their_headers(shape, kind, tmp_path, monkeypatch):
    path = tmp_path / "labels.npy"
    with path.open("wb") as file:  # the header alone
        np.lib.format.write_array_header_1_0(file, {"descr": kind, "fortran_order": False, "shape": shape})
    for limit, message in ((199, r"labels\.npy" + TOO_LARGE), (200, "says that its shape is")):
        monkeypatch.setattr(part_labels, "LARGEST_PICTURE", limit)
        with pytest.raises(InputError, match=message):
            read_parts(path, CDCL)
