"""The converter of SMPL's legacy pickles runs nothing that is in them."""

from __future__ import annotations

import pickle
import struct
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from helpers.files import smpl_arrays

from warp_partdr.models.load import load_model
from warp_partdr.models.model_pickles import read_model_pickle
from warp_partdr.models.smpl import ARRAYS


class LegacyPickler(pickle._Pickler):
    """Writes as Python 2 did, protocol 2: bytes are strings, and a class is whatever it calls itself."""

    dispatch = pickle._Pickler.dispatch.copy()

    def save_bytes(self, value: bytes) -> None:
        self.write(pickle.BINSTRING + struct.pack("<i", len(value)) + value)
        self.memoize(value)

    dispatch[bytes] = save_bytes

    def save_global(self, value: type, name: str | None = None) -> None:
        self.write(pickle.GLOBAL + f"{value.__module__}\n{name or value.__name__}\n".encode())
        self.memoize(value)


def chumpy_object(kind: str, state: dict[str, object]) -> object:
    """An object of a class that calls itself one of chumpy's."""
    module, _, name = kind.rpartition(".")
    value = type(name, (), {"__module__": module})()
    value.__dict__.update(state)
    return value


def legacy_file(path: Path, **changes: object) -> Path:
    sparse = pytest.importorskip("scipy.sparse")
    arrays = smpl_arrays()
    all_shapes = np.concatenate([arrays["shapedirs"], np.ones((96, 3, 5))], axis=-1)
    chosen = np.arange(all_shapes.size).reshape(all_shapes.shape)[..., :12]
    source = chumpy_object("chumpy.ch.Ch", {"x": all_shapes, "_dirty_vars": set(), "_status": "new"})
    content = {
        **arrays,
        "v_template": chumpy_object("chumpy.ch.Ch", {"x": arrays["v_template"]}),
        "shapedirs": chumpy_object(
            "chumpy.reordering.Select",
            {"a": source, "idxs": chosen.ravel(), "preferred_shape": chosen.shape},
        ),
        "posedirs": np.asfortranarray(arrays["posedirs"]),
        "J_regressor": sparse.csc_matrix(arrays["J_regressor"]),
        "weights": arrays["weights"].astype(">f8"),
        "J": chumpy_object("chumpy.ch.MatVecMult", {"mtx": sparse.csr_matrix(np.eye(3))}),
        "bs_type": "lrotmin",
        **changes,
    }
    buffer = BytesIO()
    LegacyPickler(buffer, protocol=2).dump(content)
    path.write_bytes(buffer.getvalue())
    return path


def run(source: Path, target: Path) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "warp_partdr", "convert", source, target]
    return subprocess.run(line, capture_output=True, text=True)


def test_legacy_pickles_are_converted(tmp_path):
    path = legacy_file(tmp_path / "model.pkl")
    arrays = read_model_pickle(path)
    assert sorted(arrays) == sorted(ARRAYS)
    for name, wanted in smpl_arrays().items():
        np.testing.assert_array_equal(arrays[name], wanted, err_msg=name)
    done = run(path, tmp_path / "model.npz")
    assert done.returncode == 0, done.stderr
    assert "smpl, 96 vertices" in done.stdout
    assert load_model(tmp_path / "model.npz").num_joints == 24
    assert sorted(file.name for file in tmp_path.iterdir()) == ["model.npz", "model.pkl"]


class Foreign:
    def __init__(self, function: object, *arguments: object) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> tuple[object, ...]:
        return self.call


def test_foreign_objects_are_refused_and_not_run(tmp_path):
    marker = tmp_path / "ran"
    for foreign in (
        Foreign(Path.touch, marker),
        Foreign(eval, f"open({str(marker)!r}, 'w')"),
        Foreign(getattr, "", "join"),
    ):
        path = legacy_file(tmp_path / "model.pkl", v_template=foreign)
        with pytest.raises(ValueError, match="which no SMPL file needs"):
            read_model_pickle(path)
    assert not marker.exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "Ran out of input"),
        (b"not a pickle", "expected a pickle"),
        (pickle.dumps([1, 2]), "list; expected a dictionary"),
        (pickle.dumps({"f": "text"}), "f: str; expected an array"),
        (pickle.dumps({"f": np.array([object])}), "(f: an array of 'O8'|type, which no SMPL file needs)"),
    ],
)
def test_pickles_that_are_no_models_are_refused(content, message, tmp_path):
    path = tmp_path / "model.pkl"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message):
        read_model_pickle(path)


def test_expressions_are_refused(tmp_path):
    value = chumpy_object("chumpy.ch.MatVecMult", {"mtx": 1})
    with pytest.raises(ValueError, match=r"weights: an expression of chumpy\.ch\.MatVecMult"):
        read_model_pickle(legacy_file(tmp_path / "model.pkl", weights=value))


def test_a_failed_conversion_leaves_nothing(tmp_path):
    path = legacy_file(tmp_path / "model.pkl", f=np.full((4, 3), 1000))
    old = tmp_path / "model.npz"
    old.write_bytes(b"old")
    missing = tmp_path / "none" / "model.npz"
    for source, target in ((path, old), (legacy_file(tmp_path / "good.pkl"), missing)):
        done = run(source, target)
        assert done.returncode == 2
        assert done.stderr.startswith("partdr: ")
        assert "Traceback" not in done.stderr
    assert old.read_bytes() == b"old"
