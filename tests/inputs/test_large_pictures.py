"""Pictures too large are refused by their headers; of those that are read, PIL says nothing."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from warp_partdr.body.labels import label_set
from warp_partdr.errors import InputError
from warp_partdr.inputs import part_labels
from warp_partdr.inputs.part_labels import read_parts, read_photo

CDCL = label_set("cdcl14")


def picture(path: Path, width: int, height: int, *, cut: bool = False) -> Path:
    """Labels 0 to 14 as PNG; cut: the pixels are missing."""
    Image.fromarray((np.arange(width * height).reshape(height, width) % 15).astype(np.uint8)).save(path)
    if cut:
        path.write_bytes(path.read_bytes()[:50])  # signature, IHDR and where pixels begin
    return path


@pytest.mark.parametrize("pil_limit", [None, 100, 300, 10**9])
def test_larger_pictures_are_refused_by_their_headers(
    pil_limit: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever PIL's own limit is; above twice that, it raises."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", pil_limit)
    monkeypatch.setattr(part_labels, "LARGEST_PICTURE", 199)
    path = picture(tmp_path / "large.png", 20, 20, cut=True)
    for read in (read_photo, lambda path: read_parts(path, CDCL)):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pytest.raises(InputError, match=r"large\.png: more than .* megapixels; expected a smaller picture$"):
                read(path)


def test_large_ones_are_read_without_a_word(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 300)  # PIL warns above it
    path = picture(tmp_path / "fine.png", 20, 20)
    with pytest.warns(Image.DecompressionBombWarning):
        Image.open(path).close()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_photo(path).shape == (20, 20, 3)
        assert read_parts(path, CDCL).groups.shape == (20, 20)


def test_the_limit() -> None:
    """Above PIL's warning, below its error, and below what the renderer takes."""
    assert Image.MAX_IMAGE_PIXELS is not None
    assert Image.MAX_IMAGE_PIXELS < part_labels.LARGEST_PICTURE < 2 * Image.MAX_IMAGE_PIXELS


@pytest.mark.parametrize("shape", [(20, 10), (15, 20, 10), (20, 10, 15)])
def test_arrays_are_refused_by_their_headers(
    shape: tuple[int, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "labels.npy"
    with path.open("wb") as file:  # the header alone
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})
    monkeypatch.setattr(part_labels, "LARGEST_PICTURE", 199)
    with pytest.raises(InputError, match=r"labels\.npy: more than .* megapixels; expected a smaller picture$"):
        read_parts(path, CDCL)
    monkeypatch.setattr(part_labels, "LARGEST_PICTURE", 200)
    with pytest.raises(InputError, match="says that its shape is"):
        read_parts(path, CDCL)
