"""Body models from files that users bring: SMPL, SMPL-H and SMPL-X as ``.npz`` or ``.safetensors``.

A file is not trusted. Only the arrays that are needed are read, nothing is unpickled, and what an archive says it
holds is checked against limits first. ``scripts/convert_smpl_pickle.py`` makes an ``.npz`` of a legacy pickle.
"""

from __future__ import annotations

import math
import zipfile
from pathlib import Path

import numpy as np
import torch

from .anny import anny
from .detailed import DetailedModel
from .detailed_smpl import ARRAYS, smpl_model

MAX_BYTES = 1 << 30  # of all arrays together; SMPL-X in float64 with 400 shape directions takes 240 MB
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def load_model(
    source: str | Path = "anny",
    *,
    num_shapes: int | None = None,
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.float32,
) -> DetailedModel:
    """A body model by name or from a file.

    Args:
        source: "anny", which comes with the package, or an ``.npz`` or ``.safetensors`` file of SMPL, SMPL-H or SMPL-X,
            with the arrays v_template, shapedirs, posedirs, J_regressor, weights, kintree_table and f.
        num_shapes: How many of a file's shape values to use, the first ones; by default 10. Anny has all its 20 always.
        device: Of the model.
        dtype: Of the model, float32 or float64.

    Raises:
        ValueError: If the file is missing, damaged, too large or a pickle, or an array is missing or has a wrong shape,
            dtype or value.
    """
    if str(source) == "anny":
        if num_shapes is not None:
            raise ValueError(f"num_shapes: {num_shapes}; expected None for Anny, all of whose shape values are used")
        return anny(torch.device(device), dtype)
    path = Path(source)
    if path.suffix in (".pkl", ".pickle"):
        raise ValueError(f"{path}: pickles can run code; make an .npz of it with scripts/convert_smpl_pickle.py")
    readers = {".npz": _read_npz, ".safetensors": _read_safetensors}
    if path.suffix not in readers:
        raise ValueError(f"{path}: expected 'anny', or an .npz or .safetensors file of SMPL, SMPL-H or SMPL-X")
    try:
        arrays = readers[path.suffix](path)
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror or error}; expected a file of SMPL, SMPL-H or SMPL-X") from error
    except Exception as error:  # of many kinds: NumPy, zipfile and zlib each have their own for a damaged file
        reason = " ".join(str(error).split())
        raise ValueError(f"{path}: {reason}; expected a file of SMPL, SMPL-H or SMPL-X") from error
    return smpl_model(arrays, str(path), num_shapes=num_shapes, device=device, dtype=dtype)


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(path) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        wanted = {name: members[name] for name in ARRAYS if name in members}
        _check_size(sum(info.file_size for info in wanted.values()))
        return {name: _read_member(archive, name, info) for name, info in wanted.items()}


def _read_member(archive: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> np.ndarray:
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # those that are unpacked piece by piece
        raise ValueError(f"{name}: compressed in a way that NumPy does not use")
    with archive.open(info) as file:
        version = np.lib.format.read_magic(file)
        if version not in _HEADERS:
            raise ValueError(f"{name}: NumPy format {version}")
        shape, _, dtype = _HEADERS[version](file)
    if dtype.hasobject:
        raise ValueError(f"{name}: holds pickled objects, which can run code")
    # NumPy makes room for what the header says before it reads.
    if math.prod(shape) * dtype.itemsize > info.file_size:
        raise ValueError(f"{name}: says that its shape is {shape}, but holds {info.file_size} bytes")
    with archive.open(info) as file:
        return np.lib.format.read_array(file, allow_pickle=False)


def _read_safetensors(path: Path) -> dict[str, np.ndarray]:
    from safetensors import safe_open

    _check_size(path.stat().st_size)
    with safe_open(path, framework="numpy") as file:
        return {name: file.get_tensor(name) for name in ARRAYS if name in file.keys()}  # noqa: SIM118  no mapping


def _check_size(size: int) -> None:
    if size > MAX_BYTES:
        raise ValueError(f"{size / 1e9:.1f} GB of arrays, at most {MAX_BYTES / 1e9:.1f} GB are read")
