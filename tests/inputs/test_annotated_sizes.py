"""Sizes that annotations state, against the picture: scaled, turned as EXIF data say, or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from warp_partdr.errors import InputError
from warp_partdr.inputs.annotated_sizes import PictureChange, match_sizes, stated_size
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.part_labels import read_orientation, read_photo

STORED = (24, 40)  # (H, W)


def save(path: Path, pixels: np.ndarray, orientation: int | None) -> Path:
    exif = Image.Exif()
    if orientation is not None:
        exif[ExifTags.Base.Orientation] = orientation
    Image.fromarray(pixels).save(path, exif=exif)
    return path


@pytest.mark.parametrize("orientation", range(1, 9))
def test_what_was_annotated_as_stored_is_turned_as_the_photo_is(tmp_path: Path, orientation: int) -> None:
    """A bright rectangle, by its mask, corners and box, lies where it does in the upright photo."""
    pixels = np.zeros((*STORED, 3), dtype=np.uint8)
    pixels[3:9, 5:21] = 255
    upright = read_photo(save(tmp_path / "photo.png", pixels, orientation))[..., 0] > 0
    for ending in ("png", "jpg", "webp", "tiff"):
        assert read_orientation(save(tmp_path / f"photo.{ending}", pixels, orientation)) == orientation
    change = PictureChange(STORED, upright.shape, orientation)
    np.testing.assert_array_equal(change.mask(pixels[..., 0] > 0), upright)
    rows, columns = np.flatnonzero(upright.any(axis=1)), np.flatnonzero(upright.any(axis=0))
    box = (columns[0], rows[0], columns[-1] + 1, rows[-1] + 1)
    assert change.box((5, 3, 21, 9)) == pytest.approx(box)
    centre = change.points(np.array([[5.5, 3.5]]))[0]
    marked = np.zeros(STORED, dtype=bool)
    marked[3, 5] = True
    ((row, column),) = np.argwhere(change.mask(marked))
    np.testing.assert_allclose(centre, [column + 0.5, row + 0.5])
    if orientation > 4:
        found = match_sizes(STORED, upright.shape, orientation, "p")
        assert found.orientation == orientation
        assert found.warning == (
            f"made at 40 x 24 px, as the photo is stored; turned by its EXIF orientation {orientation} "
            "to the picture's 24 x 40"
        )
        upright_too = match_sizes((40, 24), upright.shape, orientation, "p")
        assert not upright_too.changes
        assert upright_too.warning is None


@pytest.mark.parametrize(("orientation", "size"), [(2, (24, 40)), (3, (24, 40)), (4, (24, 40)), (6, (30, 30))])
def test_a_turn_that_no_size_reveals_is_a_warning(orientation: int, size: tuple[int, int]) -> None:
    change = match_sizes(size, size, orientation, "p")
    assert not change.changes
    assert change.warning is not None
    told = f"the photo is turned by its EXIF orientation {orientation}, and no size tells"
    assert change.warning.startswith(told)
    halved = match_sizes((size[0] * 2, size[1] * 2), size, orientation, "p")
    assert halved.orientation == 1
    assert "scaled" in str(halved.warning)
    assert "no size tells" in str(halved.warning)


def test_annotations_are_scaled_with_the_picture() -> None:
    change = match_sizes((400, 300), (200, 150), 1, "p")
    assert change.warning == "made at 300 x 400 px, scaled to the picture's 150 x 200"
    np.testing.assert_allclose(change.points(np.array([[300.0, 400], [30, 100]])), [[150, 200], [15, 50]])
    assert change.box((10, 20, 30, 44)) == (5, 10, 15, 22)
    mask = np.zeros((400, 300), dtype=bool)
    mask[100:200, 40:60] = True
    expected = np.zeros((200, 150), dtype=bool)
    expected[50:100, 20:30] = True
    np.testing.assert_array_equal(change.mask(mask), expected)
    thinned = PictureChange((6, 2), (2, 1)).mask(np.arange(12).reshape(6, 2))
    np.testing.assert_array_equal(thinned, [[3], [9]])  # centres of pixels
    larger = match_sizes((200, 150), (400, 300), 1, "p")
    np.testing.assert_array_equal(larger.mask(expected), mask)
    both = match_sizes((48, 80), (40, 24), 6, "p")  # stored, and at twice the size
    assert (both.orientation, both.changes) == (6, True)
    np.testing.assert_allclose(both.points(np.array([20.0, 8.0])), [24 - 4, 10])


def test_missing_keypoints_stay_missing() -> None:
    points = np.zeros((17, 2), dtype=np.float32)
    points[0] = 100, 40
    confidence = np.zeros(17, dtype=np.float32)
    confidence[0] = 0.5
    moved = match_sizes((40, 200), (200, 40), 8, "p").keypoints(Keypoints2D("coco17", points, confidence))
    assert moved.points.dtype == np.float32
    assert moved.points[0].tolist() == [40, 100]
    assert not moved.points[1:].any()
    same = Keypoints2D("coco17", points, confidence)
    assert match_sizes((200, 40), (200, 40), 8, "p").keypoints(same) is same


@pytest.mark.parametrize(
    ("annotated", "picture"),
    [
        ((427, 640), (333, 500)),  # both of a larger one
        ((640, 427), (80, 53)),
        ((481, 640), (480, 640)),
        ((21, 32), (427, 640)),
        ((333, 500), (2000, 3000)),
    ],
)
def test_rounding_of_sides_is_no_other_shape(annotated: tuple[int, int], picture: tuple[int, int]) -> None:
    for before, after in ((annotated, picture), (picture, annotated)):
        change = match_sizes(before, after, 1, "p")
        corner = change.points(np.array([[before[1], before[0]]], dtype=np.float64))
        np.testing.assert_allclose(corner, [[after[1], after[0]]])
    if max(np.abs(np.subtract(annotated, picture))) <= 1:
        assert change.warning is None
    else:
        assert change.warning is not None


@pytest.mark.parametrize(
    ("annotated", "picture", "orientation"),
    [
        ((1024, 768), (500, 384), 1),  # cut
        ((24, 40), (40, 24), 1),  # turned without EXIF data
        ((24, 40), (40, 24), 3),
        ((640, 640), (480, 640), 1),  # stretched
        ((1, 1), (480, 640), 1),
        ((1088, 1920), (1080, 1920), 1),
        ((24, 40), (40, 30), 6),
    ],
)
def test_sizes_that_no_turn_and_no_scale_explain_are_refused(
    annotated: tuple[int, int], picture: tuple[int, int], orientation: int
) -> None:
    told = f"{annotated[1]} x {annotated[0]} px, picture {picture[1]} x {picture[0]}"
    with pytest.raises(InputError, match=f"^a.jpg: annotated at {told} .*; expected one shape"):
        match_sizes(annotated, picture, orientation, "a.jpg")


def test_a_size_may_be_missing_and_of_any_spelling() -> None:
    assert stated_size({"width": 30, "height": 40.0}, "i") == (40, 30)
    assert stated_size({"imageWidth": "30", "imageHeight": 40}, "i", "imageWidth", "imageHeight") == (40, 30)
    for entry in ({}, {"width": None, "height": None}, {"width": 0, "height": 0}, {"width": 30}, {"width": -1}):
        assert stated_size(entry, "i") is None
    for orientation in range(1, 9):
        change = match_sizes(None, (40, 30), orientation, "p")
        assert not change.changes
        assert (change.warning is None) == (orientation == 1)
    for wrong in (30.5, "wide", True, [30], float("nan"), float("inf"), 10**400):
        with pytest.raises(InputError, match=r"^i: width: .*; expected whole pixels"):
            stated_size({"width": wrong, "height": 40}, "i")
    with pytest.raises(ValueError, match=r"mask: shape \(3, 3\); expected \(40, 30\)"):
        PictureChange((40, 30), (40, 30)).mask(np.zeros((3, 3), dtype=bool))


def test_exif_orientations_that_are_not_defined_count_as_upright(tmp_path: Path) -> None:
    pixels = np.zeros((*STORED, 3), dtype=np.uint8)
    for orientation in (None, 0, 9):
        assert read_orientation(save(tmp_path / "photo.jpg", pixels, orientation)) == 1
