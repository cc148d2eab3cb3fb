"""Leeds Sports Pose: 14 joints in ``joints.mat``, and the six-part labels that Unite the People (UP-3D) made for it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ....body.labels import LabelSet, label_set
from ....body.skeletons import skeleton
from ....errors import InputError, install_command
from ....files.array_files import read_npz
from ....inputs.keypoints import Keypoints2D
from ....inputs.part_labels import read_parts
from ....inputs.sample import Sample
from .pictures import existing, read_mask
from .spin import read_spin

_TEST = 1001  # number of the first picture of the test set; 1 to 1000 are for training
_JOINTS = len(skeleton("lsp14"))
_EXPECTED_NPZ = (
    "lsp_dataset_test.npz of SPIN's datasets/preprocess/lsp_dataset.py, or up_3d_*.npz of GraphCMR's "
    "datasets/preprocess/up_3d.py (docs/how_to/evaluate.md)"
)
_EXPECTED = (
    "the folder lsp_dataset with joints.mat and images (Leeds Sports Pose, Johnson and Everingham), or joints.npz with "
    "an array joints of the same numbers"
)
_PARTS = "part labels of UPi-S1h (files.is.tuebingen.mpg.de/classner/up), the folder data/lsp in it"


def read_lsp(
    path: str | Path,
    *,
    parts: str | Path | None = None,
    labels: LabelSet | None = None,
    pictures: str | Path | None = None,
    test_only: bool = True,
) -> Iterator[Sample]:
    """The people of LSP, or of UP-3D by way of an annotation file.

    Args:
        path: Folder ``lsp_dataset``, or an ``.npz`` file in the layout of ``datasets.spin``.
        parts: Folder of ``im1001_part_segmentation.png`` and, if silhouettes are to count apart from them,
            ``im1001_segmentation.png``; of an ``.npz`` file, the folder that its partname is relative to. Without it
            there are no labels, neither to fit nor to score.
        labels: Label set of the parts. By default, it is lsp6.
        pictures: Folder that an ``.npz`` file's imgname is relative to.
        test_only: True leaves out the pictures for training, 1 to 1000.

    Raises:
        InputError: If a file or an array that is needed is missing or wrong.
    """
    labels = labels or label_set("lsp6")
    if Path(path).suffix == ".npz":
        return read_spin(path, source="LSP", expected=_EXPECTED_NPZ, pictures=pictures, parts=parts, labels=labels)
    return _read_folder(Path(path), None if parts is None else Path(parts), labels, test_only)


def _read_folder(folder: Path, parts: Path | None, labels: LabelSet, test_only: bool) -> Iterator[Sample]:
    if any(folder.glob("*_body.pkl")):
        raise InputError(f"{folder}: UP-3D's bodies are pickles, which are not read; expected {_EXPECTED_NPZ}")
    joints = _read_joints(folder)
    start = _TEST - 1 if test_only else 0
    if len(joints) <= start:
        raise InputError(f"{folder}: {len(joints)} people, none of the test set; expected more than {start}")
    for index in range(start, len(joints)):
        name = f"im{index + 1:04d}"
        read = mask = None
        if parts is not None:
            read = read_parts(existing(parts, f"{name}_part_segmentation.png", _PARTS), labels)
            silhouette = parts / f"{name}_segmentation.png"
            mask = read_mask(silhouette, read.groups.shape) if silhouette.is_file() else None
        picture = folder / "images" / f"{name}.jpg"
        yield Sample(
            source="LSP",
            name=name,
            # Hidden joints are annotated as well as the others; the third row, which tells them apart, is not used.
            keypoints=Keypoints2D("lsp14", joints[index], np.ones(_JOINTS, dtype=np.float32)),
            parts=read,
            target=None if read is None else read.groups,
            mask=mask,
            picture=picture if picture.is_file() else None,
        )


def _read_joints(folder: Path) -> np.ndarray:
    """Positions [px], shape (N, 14, 2), float32, from (3, 14, N), or from (14, 3, N) as in LSP's extended set."""
    where = folder / "joints.npz"
    if where.is_file():
        values = read_npz(where, ("joints",), expected=_EXPECTED)["joints"]
    else:
        where = existing(folder, "joints.mat", _EXPECTED)
        values = _read_matlab(where)
    if values.ndim == 3 and values.shape[:2] == (_JOINTS, 3):
        values = values.swapaxes(0, 1)
    if values.ndim != 3 or values.shape[:2] != (3, _JOINTS) or values.dtype.kind not in "fiu":
        raise InputError(f"{where}: joints: {values.dtype} {values.shape}; expected numbers of shape (3, {_JOINTS}, N)")
    if not np.isfinite(values[:2]).all():
        raise InputError(f"{where}: joints: holds NaN or infinity; expected pixels")
    return values[:2].T.astype(np.float32)


def _read_matlab(path: Path) -> np.ndarray:
    try:
        from scipy.io import loadmat
    except ImportError as error:
        reason = f"MATLAB files need SciPy; expected it ({install_command('lsp')}), or joints.npz"
        raise InputError(f"{path}: {reason}") from error
    try:
        return np.asarray(loadmat(path, variable_names=["joints"])["joints"])
    except KeyError as error:
        raise InputError(f"{path}: no array joints; expected {_EXPECTED}") from error
    except Exception as error:  # of many kinds, for a damaged file
        raise InputError(f"{path}: not readable ({' '.join(str(error).split())}); expected {_EXPECTED}") from error
