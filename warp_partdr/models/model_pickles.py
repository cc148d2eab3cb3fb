"""Arrays of a pickle of SKEL, or a legacy one of SMPL, SMPL-H or SMPL-X, read without running what is in it.

Unpickling calls what a file names, so a foreign file can do anything. Here every name stands for an inert class of this
module: NumPy's arrays, chumpy's and SciPy's sparse matrices are only remembered as what the file says about them, and a
name that SMPL's files don't need is refused. SMPL's seven arrays, or SKEL's eight, are then made of it.
"""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Container
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..errors import InputError
from ..files.array_files import MAX_BYTES
from .skel import SKEL_ARRAYS, check_skel
from .smpl import ARRAYS, check_smpl


class _Shell:
    """An object of a pickle: its class's name and its state, never its behaviour."""

    kind = ""

    def __init__(self, *_: object) -> None:
        self.state: Any = None

    def __setstate__(self, state: object) -> None:
        self.state = state


class _Array(_Shell):
    """A NumPy array: state (version, shape, dtype, in Fortran order, bytes)."""


class _DType(_Shell):
    """A NumPy dtype: its code, and state (version, byte order, ...)."""

    def __init__(self, code: object = "", *_: object) -> None:
        super().__init__()
        self.code = code


def _object(kind: object, *_: object) -> object:
    if not (isinstance(kind, type) and issubclass(kind, _Shell)):
        raise pickle.UnpicklingError("an object of a class that is not allowed")
    return kind()


def _bytes(text: object, codec: object = "latin1") -> bytes:
    if not isinstance(text, str) or codec != "latin1":
        raise pickle.UnpicklingError("text in a code that is not allowed")
    return text.encode("latin1")


_ALLOWED: dict[tuple[str, str], object] = {
    **{(module, "_reconstruct"): _Array for module in ("numpy.core.multiarray", "numpy._core.multiarray")},
    **{(module, "scalar"): _Shell for module in ("numpy.core.multiarray", "numpy._core.multiarray")},
    ("numpy", "ndarray"): _Array,
    ("numpy", "dtype"): _DType,
    **{(module, "_reconstructor"): _object for module in ("copy_reg", "copyreg")},
    **{(module, name): _Shell for module in ("__builtin__", "builtins") for name in ("object", "set")},
    ("_codecs", "encode"): _bytes,
}


_SPARSE = ("csc_matrix", "csr_matrix", "coo_matrix")


class _InertUnpickler(pickle.Unpickler):
    """Unpickles plain values, and anything else as a ``_Shell``."""

    def __init__(self, file: IO[bytes]) -> None:
        super().__init__(file, fix_imports=False, encoding="latin1")

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in _ALLOWED:
            return _ALLOWED[module, name]
        is_sparse = module.startswith("scipy.sparse.") and name in _SPARSE
        if is_sparse or module.split(".")[0] == "chumpy":
            return type(name, (_Shell,), {"kind": name if is_sparse else f"{module}.{name}"})
        raise pickle.UnpicklingError(f"names {module}.{name}, which no SMPL file needs")


def _to_array(value: object) -> np.ndarray:
    """The numbers of an array, a sparse matrix, or chumpy's arrays and selections.

    Raises:
        ValueError: If it is anything else, or what it says about itself does not fit together.
    """
    if isinstance(value, _Array):
        return _from_bytes(value)
    if not isinstance(value, _Shell) or not isinstance(value.state, dict):
        raise ValueError(f"{type(value).__name__}; expected an array")
    state = value.state
    if value.kind == "chumpy.ch.Ch":
        return _to_array(state["x"])
    if value.kind == "chumpy.reordering.Select":
        return _to_array(state["a"]).ravel()[_to_array(state["idxs"])].reshape(state["preferred_shape"])
    if value.kind in _SPARSE:
        return _dense(state, value.kind)
    raise ValueError(f"an expression of {value.kind or 'an unknown class'}; expected an array")


def _from_bytes(array: _Array) -> np.ndarray:
    _, shape, dtype, in_fortran_order, data = array.state
    if not isinstance(dtype, _DType) or not isinstance(dtype.code, str) or dtype.code[:1] not in "fiu":
        raise ValueError(f"an array of {getattr(dtype, 'code', dtype)!r}; expected numbers")
    order: Any = dtype.state[1] if dtype.state else "<"
    held = data.encode("latin1") if isinstance(data, str) else data
    numbers = np.frombuffer(held, np.dtype(dtype.code).newbyteorder(order))
    return numbers.reshape(shape, order="F" if in_fortran_order else "C").astype(numbers.dtype.newbyteorder("="))


def _dense(state: dict[str, Any], kind: str) -> np.ndarray:
    """A sparse matrix, shape (rows, columns)."""
    data = _to_array(state["data"])
    rows, columns = state["_shape"] if "_shape" in state else state["shape"]
    if rows * columns * data.itemsize > MAX_BYTES:
        raise ValueError(f"a sparse matrix of shape ({rows}, {columns}); too large")
    dense = np.zeros((rows, columns), dtype=data.dtype)
    if kind == "coo_matrix":
        row, column = state["coords"] if "coords" in state else (state["row"], state["col"])
        np.add.at(dense, (_to_array(row), _to_array(column)), data)
        return dense
    indices, starts = _to_array(state["indices"]), _to_array(state["indptr"])
    outer = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    np.add.at(dense, (outer, indices) if kind == "csr_matrix" else (indices, outer), data)
    return dense


def read_model_pickle(path: Path) -> dict[str, np.ndarray]:
    """The arrays of ``ARRAYS``, or ``SKEL_ARRAYS``, in a pickle.

    Raises:
        InputError: If the file is missing, too large or no pickle, names what is not allowed, or has an array that
            can't be read.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path}: {path.stat().st_size / 1e9:.1f} GB; expected at most {MAX_BYTES / 1e9:.1f} GB")
        with path.open("rb") as file:
            content = _InertUnpickler(file).load()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; expected a pickle of SMPL or SKEL") from error
    except InputError:
        raise
    except Exception as error:  # of any kind: a damaged pickle may do everything wrong
        raise InputError(f"{path}: {error}; expected a pickle of SMPL, SMPL-H, SMPL-X or SKEL") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: {type(content).__name__}; expected a dictionary of arrays")
    arrays = {}
    for name in SKEL_ARRAYS if _is_skel(content) else ARRAYS:
        if name in content:
            try:
                arrays[name] = _to_array(content[name])
            except Exception as error:  # as above
                raise InputError(f"{path}: {name}: {error}") from error
    return arrays


def _is_skel(names: Container[str]) -> bool:
    return any(name in names for name in set(SKEL_ARRAYS) - set(ARRAYS))


def convert_pickle(source: Path, target: Path) -> str:
    """Write the arrays of a pickle as an ``.npz`` that ``load_model`` reads; return what it holds in words.

    The arrays are checked as ``load_model`` checks them. Nothing else of the file is kept.

    Args:
        source: Pickle of SMPL, SMPL-H, SMPL-X or SKEL.
        target: File to write; it is left as it is where the pickle can't be converted.

    Raises:
        InputError: If the pickle is missing, damaged, too large, names what is not allowed, or is no such model; or the
            file can't be written.
    """
    arrays = read_model_pickle(source)
    try:
        model = (check_skel if _is_skel(arrays) else check_smpl)(arrays, str(source))
    except ValueError as error:
        raise InputError(str(error)) from error
    try:
        with tempfile.TemporaryDirectory(dir=target.parent) as folder:  # all or nothing
            np.savez_compressed(made := Path(folder) / "model.npz", **arrays)  # type: ignore[arg-type]  # by name
            made.replace(target)
    except OSError as error:
        raise InputError(f"{target}: {error.strerror or error}; expected a file to write, .npz") from error
    return f"{model}, {len(arrays['posedirs'])} vertices"
