"""body.npz: what is written comes back to the bit, and nothing else is let in."""

from __future__ import annotations

import pickle
import warnings
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.files import Trap
from hypothesis import given
from hypothesis import strategies as st

from warp_partdr import PART_NAMES, BodyParameters, InputError, load_body
from warp_partdr.results.body_file import FORMAT, BodyFile

*FIELDS, _, _ = BodyFile.__dataclass_fields__  # of floats


def some_body() -> BodyFile:
    generator = torch.Generator().manual_seed(1)
    mean = BodyParameters.mean(1)
    rotations = torch.linalg.qr(torch.randn(20, 3, 3, generator=generator)).Q
    return BodyFile(
        global_orient=mean.global_orient()[0].numpy(),
        translation=np.array([0.0, -0.0, 1e-40], dtype=np.float32),
        rotations=(rotations * torch.linalg.det(rotations)[:, None, None]).numpy(),
        lengths=mean.lengths[0].numpy(),
        thicknesses=mean.thicknesses[0].numpy(),
        camera_scale=np.float32(123.456).reshape(()),
        camera_translation=np.array([np.pi, -17.1], dtype=np.float32),
        image_size=np.array((480, 640)),
    )


def arrays() -> dict[str, Any]:
    """Arrays of a good file."""
    return {"format": np.array(FORMAT), **vars(some_body())}


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bodies") / "body.npz"
    np.savez(path, **arrays())
    return path


def test_comes_back_to_the_bit(tmp_path: Path) -> None:
    body = some_body()
    body.save(tmp_path / "body.npz")
    again = load_body(tmp_path / "body.npz")
    for name in FIELDS:
        before, after = getattr(body, name), getattr(again, name)
        assert (after.dtype, after.shape, after.tobytes()) == (np.float32, before.shape, before.tobytes()), name
    assert again.image_size.tolist() == [480, 640]
    with np.load(tmp_path / "body.npz") as archive:
        assert archive["part_names"].tolist() == list(PART_NAMES)
    assert again.camera().project(torch.zeros(1, 1, 3))[0, 0, :2].tolist() == body.camera_translation.tolist()
    numbers = again.body("cpu").numpy()
    np.testing.assert_array_equal(numbers["rotations"][0], body.rotations)


def test_a_perspective_camera_comes_back(tmp_path: Path) -> None:
    body = replace(some_body(), translation=np.array([0.2, 0.1, 4.0], np.float32), camera_perspective=np.array(1))
    body.save(tmp_path / "body.npz")
    again = load_body(tmp_path / "body.npz")
    pelvis = again.camera().project(torch.from_numpy(again.translation)[None, None])[0, 0]
    wanted = body.camera_translation + body.camera_scale * np.array([0.05, 0.025])
    np.testing.assert_allclose(pelvis.numpy(), [*wanted, 4.0], rtol=1e-6)


def test_numbers_of_other_types_are_taken(tmp_path: Path) -> None:
    data = arrays() | {"lengths": arrays()["lengths"].astype(np.float64), "camera_scale": np.array(3)}
    np.savez_compressed(tmp_path / "body.npz", **data)
    body = load_body(tmp_path / "body.npz")
    np.testing.assert_array_equal(body.lengths, some_body().lengths)
    assert body.camera_scale == 3
    assert body.camera_scale.dtype == np.float32


@pytest.mark.parametrize("kind", ["U", "S"])
def test_parts_come_in_any_order_by_name(kind: str, tmp_path: Path) -> None:
    """Joints are where they were, though rotations lie in another order."""
    body, order = some_body(), np.random.default_rng(4).permutation(20)
    data = arrays() | {"rotations": body.rotations[order], "part_names": np.array(PART_NAMES)[order].astype(kind)}
    np.savez(tmp_path / "body.npz", **data)
    again = load_body(tmp_path / "body.npz")
    np.testing.assert_array_equal(again.rotations, body.rotations)
    joints = [each.body("cpu").pose().joints.numpy() for each in (body, again)]
    np.testing.assert_array_equal(*joints)
    np.savez(tmp_path / "old.npz", **arrays())  # without names
    np.testing.assert_array_equal(load_body(tmp_path / "old.npz").rotations, body.rotations)


def test_people_of_all_sizes_are_taken(tmp_path: Path) -> None:
    for factor in (0.3, 1.7):
        sizes = {name: factor * arrays()[name] for name in ("lengths", "thicknesses")}
        np.savez(tmp_path / "body.npz", **arrays() | sizes)
        np.testing.assert_array_equal(load_body(tmp_path / "body.npz").lengths, sizes["lengths"])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"format": np.array("warp-partdr body 2")}, "'warp-partdr body 2'"),
        ({"format": np.zeros(1000)}, FORMAT),
        ({"format": None}, "format"),
        ({"lengths": None}, "lengths"),
        ({"rotations": np.zeros((19, 3, 3))}, r"rotations.*\(19, 3, 3\).*\(20, 3, 3\)"),
        ({"camera_scale": np.ones(1)}, r"camera_scale.*\(1,\)"),
        ({"camera_perspective": np.array(2)}, "camera_perspective: 2; expected 0 or 1"),
        (
            {"camera_perspective": np.array(1), "translation": np.zeros(3)},
            "translation: .* m away; expected a body before the camera",
        ),
        ({"lengths": np.full(12, np.nan)}, "lengths.*NaN"),
        ({"translation": np.array([0, np.inf, 0])}, "translation.*infinity"),
        ({"lengths": np.full(12, 1e300)}, "lengths.*infinity"),
        ({"image_size": np.array([1.5, 2.5])}, "image_size.*integers"),
        ({"lengths": np.array(["a"] * 12)}, "lengths.*numbers"),
        ({"lengths": np.ones(12, dtype=complex)}, "lengths.*numbers"),
        ({"lengths": np.full(12, 1e30)}, r"lengths: 1e\+30; expected 0\.001 to 10 m"),
        ({"lengths": np.array([0.3] * 11 + [1e-44])}, "lengths: 9.80909e-45; expected 0.001 to 10 m"),
        ({"thicknesses": np.array([0.1] * 14 + [120.0])}, "thicknesses: 120; expected 0.001 to 10 m"),
        ({"translation": np.array([0.0, -3e6, 4.0])}, r"translation: -3e\+06; expected -100000 to 100000 m"),
        ({"camera_scale": np.array(1e20)}, r"camera_scale: 1e\+20; expected .* pixels"),
        ({"camera_translation": np.array([1e12, 4.0])}, r"camera_translation: 1e\+12; expected .* pixels"),
        ({"image_size": np.array([2**60, 2**60])}, r"image_size: .* expected fewer than 2\*\*28 pixels"),
        ({"image_size": np.array([2**14, 2**14])}, r"image_size: 16384 x 16384; expected fewer than"),
        ({"part_names": np.array(PART_NAMES[:19])}, r"part_names: .* \(19,\); expected the names of the 20 parts"),
        ({"part_names": np.array([*PART_NAMES[:19], "tail"])}, "part_names: 'tail'; expected"),
        ({"part_names": np.array([*PART_NAMES[:19], "chest"])}, "part_names: 'chest'; expected"),
        ({"part_names": np.arange(20)}, "part_names: int64"),
    ],
)
def test_other_content_is_refused(change: dict[str, Any], says: str, tmp_path: Path) -> None:
    path = tmp_path / "body.npz"
    np.savez(path, **{name: value for name, value in (arrays() | change).items() if value is not None})
    with pytest.raises(InputError, match=says) as caught:
        load_body(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("where", ["lengths", "format", "more", "whole file"])
def test_nothing_is_unpickled(where: str, tmp_path: Path) -> None:
    path, sprung = tmp_path / "body.npz", tmp_path / "sprung"
    trap = np.array([Trap(sprung)], dtype=object)
    if where == "whole file":
        path.write_bytes(pickle.dumps(Trap(sprung)))
    else:
        np.savez(path, **(arrays() | {where: trap}))
    # What it does not need, it does not read.
    with nullcontext() if where == "more" else pytest.raises(InputError, match=r"body\.npz"):
        load_body(path)
    assert not sprung.exists()
    if where == "lengths":  # the trap is one
        np.load(path, allow_pickle=True)["lengths"]
        assert sprung.exists()


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"\x93NUMPY", b"no archive", None])
def test_other_files_are_refused(content: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "body.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"body\.npz.*expected"):
        load_body(path)
    with pytest.raises(InputError, match="expected"):
        load_body(tmp_path)  # a folder
    np.save(tmp_path / "array.npy", np.zeros(3))
    with pytest.raises(InputError, match=r"array\.npy"):
        load_body(tmp_path / "array.npy")


def test_truncated_files_are_refused(saved: Path, tmp_path: Path) -> None:
    data, path = saved.read_bytes(), tmp_path / "body.npz"
    for length in range(0, len(data), 29):
        path.write_bytes(data[:length])
        with pytest.raises(InputError):
            load_body(path)


@given(changes=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=20))
def test_damaged_files_give_a_body_or_an_error(changes: list[tuple[int, int]], saved: Path) -> None:
    data = bytearray(saved.read_bytes())
    for position, value in changes:
        data[position % len(data)] = value
    damaged = saved.with_name("damaged.npz")
    damaged.write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            body = load_body(damaged)
        except InputError:
            return
    assert all(np.isfinite(getattr(body, name)).all() for name in FIELDS)


@pytest.mark.parametrize("value", [0, -1])
@pytest.mark.parametrize("name", ["lengths", "thicknesses", "camera_scale", "image_size"])
def test_sizes_are_positive_each_of_them(name: str, value: int, tmp_path: Path) -> None:
    sizes = np.array(arrays()[name])
    sizes[(..., -1) if sizes.ndim else ()] = value
    np.savez(tmp_path / "body.npz", **arrays() | {name: sizes})
    with pytest.raises(InputError, match=f"{name}: {value}; expected positive"):
        load_body(tmp_path / "body.npz")
