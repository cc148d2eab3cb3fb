"""Body models from files that users bring: SMPL's three and SKEL as arrays, and folders of MHR and SOMA.

A file is not trusted. Only the arrays that are needed are read, nothing is unpickled, and an archive's sizes are
checked against limits first. ``partdr convert`` makes an ``.npz`` of a legacy pickle.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from ..errors import InputError, cause
from ..files.array_files import MAX_BYTES, read_npz
from ..files.disk import check_regular
from .anny import anny
from .mhr import mhr_model
from .model import DetailedModel
from .skel import SKEL_ARRAYS, find_skel, skel_model
from .smpl import ARRAYS, smpl_model
from .soma import soma_model

_SMPL_FILE, _SKEL_FILE = "file of SMPL, SMPL-H or SMPL-X", "file of SKEL"
_MHR, _SOMA, _SKEL = "mhr:", "soma:", "skel:"  # before the folder of their files


def load_model(
    source: str | Path = "anny",
    *,
    num_shapes: int | None = None,
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.float32,
) -> DetailedModel:
    """Load a body model by name or from a file.

    Args:
        source: Name or file of the model. "anny" comes with the package. "mhr:FOLDER" and "soma:FOLDER" name folders of
            their files (extra ``bodies``). "skel:FILE", or "skel:FOLDER" with one such file, names an ``.npz`` or
            ``.safetensors`` with ``SKEL_ARRAYS``. A path alone is such a file of SMPL, SMPL-H or SMPL-X, with the
            arrays v_template, shapedirs, posedirs, J_regressor, weights, kintree_table and f.
        num_shapes: Number of a file's first shape values to use, by default 10. Anny has all its 20, and MHR its 63.
        device: Device of the model.
        dtype: Dtype of the model, float32 or float64.

    Raises:
        ValueError: If the file is missing, damaged, too large or a pickle, or an array is missing or has a wrong shape,
            dtype or value.

    Examples:
        >>> from warp_partdr import load_model
        >>> model = load_model("SMPL_NEUTRAL.npz")
        >>> model.num_joints, model.num_shapes
        (24, 10)
        >>> load_model("anny").num_joints
        104
    """
    if str(source) == "anny":
        if num_shapes is not None:
            raise ValueError(f"num_shapes: {num_shapes}; expected None for Anny, all of whose shape values are used")
        return anny(torch.device(device), dtype)
    if str(source).startswith(_MHR):
        if num_shapes is not None:
            raise ValueError(f"num_shapes: {num_shapes}; expected None for MHR, whose shape values are 63")
        return mhr_model(str(source).removeprefix(_MHR), device=device, dtype=dtype)
    if str(source).startswith(_SOMA):
        folder = str(source).removeprefix(_SOMA)
        return soma_model(folder, num_shapes=num_shapes, device=device, dtype=dtype)
    if str(source).startswith(_SKEL):
        path = find_skel(Path(str(source).removeprefix(_SKEL)))
        arrays = _read_arrays(path, SKEL_ARRAYS, _SKEL_FILE)
        return skel_model(arrays, str(path), num_shapes=num_shapes, device=device, dtype=dtype)
    path = Path(source)
    arrays = _read_arrays(path, tuple(ARRAYS), _SMPL_FILE)
    return smpl_model(arrays, str(path), num_shapes=num_shapes, device=device, dtype=dtype)


def _read_arrays(path: Path, names: tuple[str, ...], kind: str) -> dict[str, np.ndarray]:
    """Read the named arrays of a file, as far as it has them."""
    if path.suffix in (".pkl", ".pickle"):
        raise ValueError(f"{path}: pickles can run code; make an .npz of it with partdr convert")
    if path.suffix == ".npz":
        return read_npz(path, (), names, expected=f"a {kind}", most=MAX_BYTES)
    if path.suffix == ".safetensors":
        return _read_safetensors(path, names, f"a {kind}")
    raise ValueError(f"{path}: expected 'anny', or an .npz or .safetensors {kind}")


def _read_safetensors(path: Path, names: tuple[str, ...], expected: str) -> dict[str, np.ndarray]:
    from safetensors import SafetensorError, safe_open

    try:
        check_regular(path)
        if (size := path.stat().st_size) > MAX_BYTES:
            raise InputError(f"{path}: {size / 1e9:.1f} GB; expected {expected}, at most {MAX_BYTES / 1e9:.1f} GB")
        with safe_open(path, framework="numpy") as file:
            return {name: file.get_tensor(name) for name in names if name in file.keys()}  # noqa: SIM118  no mapping
    except (OSError, SafetensorError, TypeError) as error:  # TypeError: a dtype that NumPy lacks
        raise InputError(f"{path}: {cause(error)}; expected {expected}") from error
