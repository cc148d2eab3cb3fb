"""Bodies of a film's person: a file, and back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.files import body_file
from scipy.spatial.transform import Rotation

from warp_partdr.body.template import JOINT_NAMES, PART_NAMES
from warp_partdr.errors import InputError
from warp_partdr.results.predictions import ROW, FilmBodies, load_film_bodies


def film(count: int = 3) -> FilmBodies:
    rows, body = np.zeros(count, ROW), body_file()
    for name in set(ROW.names or ()) & set(vars(body)):
        rows[name] = getattr(body, name)
    rows["frames"], rows["times"] = 2 * np.arange(count), 0.1 * np.arange(count)
    rows["scores"], rows["keypoints"] = 0.9, 7.0
    rows["translation"][:, 2] = 3 + np.arange(count)
    return FilmBodies(rows, (400, 300), True)


def test_a_film_s_bodies_come_back(tmp_path: Path) -> None:
    film().save(tmp_path / "a.npz")
    loaded = load_film_bodies(tmp_path / "a.npz")
    assert (loaded.image_size, loaded.perspective) == ((400, 300), True)
    np.testing.assert_array_equal(loaded.rows, film().rows)
    body = loaded.body(1)
    body.save(tmp_path / "body.npz")
    assert body.translation.tolist() == [0, 0, 4]
    assert body.image_size.tolist() == [400, 300]
    with np.load(tmp_path / "a.npz") as data:
        assert data["joint_names"].tolist() == list(JOINT_NAMES)
        assert data["joints"].shape == (3, len(JOINT_NAMES), 3)
        np.testing.assert_allclose(data["joints"][:, 0], loaded.rows["translation"], atol=1e-6)
        assert np.ptp(data["joints"][0], axis=0)[1] > 1.2  # a standing adult [m]


def test_parts_come_in_any_order_by_name(tmp_path: Path) -> None:
    bodies, order = film(), np.random.default_rng(0).permutation(len(PART_NAMES))
    bodies.rows["rotations"] = Rotation.random(60, random_state=1).as_matrix().reshape(3, 20, 3, 3)
    bodies.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as data:
        mixed = {**data, "rotations": data["rotations"][:, order], "part_names": data["part_names"][order]}
    np.savez(tmp_path / "mixed.npz", **mixed)
    loaded = load_film_bodies(tmp_path / "mixed.npz")
    np.testing.assert_array_equal(loaded.rows["rotations"], bodies.rows["rotations"])
    np.testing.assert_allclose(loaded.joints(), bodies.joints())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": np.array("warp-partdr body 1")}, "format 'warp-partdr body 1'"),
        ({"rotations": np.zeros((2, 20, 3, 3))}, r"rotations: .* expected finite numbers \(3, 20, 3, 3\)"),
        ({"times": np.full(3, np.nan)}, "times: .* expected finite numbers"),
        ({"frames": np.zeros(0, int)}, "frames"),
        ({"image_size": np.array(["a", "b"])}, "image_size"),
        ({"boxes": None}, "no array boxes"),
        ({"lengths": np.full((3, 12), 1e-30)}, r"lengths: 1e-30; expected 0\.001 to 10 m"),
        ({"thicknesses": np.full((3, 15), -0.1)}, "thicknesses: -0.1; expected"),
        ({"rotations": np.full((3, 20, 3, 3), 0.4)}, "rotations: matrix .* expected rotation matrices"),
        ({"global_orient": -np.tile(np.eye(3), (3, 1, 1))}, "global_orient: .* mirrors"),
        ({"camera_scale": np.zeros(3)}, "camera_scale: 0; expected"),
        ({"translation": np.full((3, 3), 1e9)}, r"translation: 1e\+09; expected"),
        ({"scores": np.array([0.5, 1.5, 0.5])}, "scores: 1.5; expected 0 to 1"),
        ({"times": np.array([0.0, 0.3, 0.2])}, "times: they go back"),
        ({"times": np.array([-1.0, 0.3, 0.4])}, "times: -1; expected"),
        ({"image_size": np.array([2**60, 2])}, r"image_size: .* expected fewer than 2\*\*28 pixels"),
        ({"image_size": np.array([0, 2])}, "image_size: 0; expected positive"),
        ({"camera_perspective": np.array(7)}, "camera_perspective: 7; expected 0 or 1"),
        ({"part_names": np.array(["head"] * 20)}, "part_names: 'head'; expected the names of the 20 parts"),
    ],
)
def test_what_is_no_such_file_is_refused(change: dict[str, np.ndarray | None], words: str, tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    film().save(path)
    with np.load(path) as data:
        arrays = {**data, **change}
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    with pytest.raises(InputError, match=words):
        load_film_bodies(path)


def test_a_file_of_another_run_than_the_report_beside_it_is_refused(tmp_path: Path) -> None:
    film().save(tmp_path / "a.npz")
    (tmp_path / "predictions.json").write_text(json.dumps({"files": {"a.npz": 64 * "0"}}))
    with pytest.raises(InputError, match=r"a\.npz: not of the same run as predictions\.json"):
        load_film_bodies(tmp_path / "a.npz")
