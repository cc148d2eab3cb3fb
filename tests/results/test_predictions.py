"""Bodies of a film's person: a file, and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes.files import body_file

from warp_partdr.body.template import JOINT_NAMES
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


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": np.array("warp-partdr body 1")}, "format 'warp-partdr body 1'"),
        ({"rotations": np.zeros((2, 20, 3, 3))}, r"rotations: .* expected finite numbers \(3, 20, 3, 3\)"),
        ({"times": np.full(3, np.nan)}, "times: .* expected finite numbers"),
        ({"frames": np.zeros(0, int)}, "frames"),
        ({"image_size": np.array(["a", "b"])}, "image_size"),
        ({"boxes": None}, "no array boxes"),
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
