"""Views of real people of any data set that is known here."""

from __future__ import annotations

from pathlib import Path

from ....errors import InputError
from ....files.array_files import array_names
from .h36m_fetch import H36M_FILE, read_human36m_hdf5
from .mpi_inf_3dhp import TEST_FILE, TRAIN_FILE, read_mpi_inf_3dhp
from .spin_views import read_spin_views
from .trajectories import read_trajectories
from .views import FILE_NAMES, Views, read_views

_EXPECTED = (
    f"a folder with {' or '.join(FILE_NAMES)}; of MPI-INF-3DHP, with {TRAIN_FILE} or {TEST_FILE}; of Human3.6M, with "
    f"{H36M_FILE}; or a file: .npz of views, of SPIN or of joints over time, or .trc"
)


def read_real(
    path: str | Path,
    *,
    cameras: str | Path | None = None,
    films: str | Path | None = None,
    axes: str | None = None,
) -> Views:
    """Read views of real people with 3D truth, of whatever kind the file or folder is.

    Args:
        path: File or folder, as docs/how_to/evaluate.md lists them.
        cameras: Calibrated cameras, which joints over time need.
        films: Folder of the films of these cameras.
        axes: Axes of the joints, as in ``read_trajectories``.

    Raises:
        InputError: If it is of no kind that is known, or can't be read.
    """
    path = Path(path)
    names = array_names(path) if path.suffix == ".npz" else set()
    if path.suffix.lower() == ".trc" or ("joints_world" in names and "joints_camera" not in names):
        if cameras is None:
            raise InputError(f"{path}: joints over time, without cameras; expected a file of them (--cameras)")
        return read_trajectories(path, cameras, films=films, axes=axes)
    for name, given in (("cameras", cameras), ("films", films), ("axes", axes)):
        if given is not None:
            raise InputError(f"{name}: {given}, for {path}; expected none, but for joints over time")
    if "imgname" in names:
        return read_spin_views(path)
    if not path.is_dir() or any((path / name).is_file() for name in FILE_NAMES):
        return read_views(path)
    if any(path.rglob(TRAIN_FILE)) or any(path.rglob(TEST_FILE)):
        return read_mpi_inf_3dhp(path)
    if any(path.rglob(H36M_FILE)):
        return read_human36m_hdf5(path)
    raise InputError(f"{path}: none of these; expected {_EXPECTED}")
