"""Annotation arrays of SPIN (nkolot/SPIN) and the many projects after it, for Human3.6M, 3DPW and others.

One ``.npz`` a data set, a row a person; docs/how_to/evaluate.md says what each array holds. 3DPW's own sequence
files are
pickles, which are not read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ....body.labels import LabelSet
from ....body.skeletons import MPJPE_JOINTS, skeleton
from ....errors import InputError
from ....files.array_files import read_npz
from ....inputs.keypoint_files import read_keypoints
from ....inputs.keypoints import Keypoints2D
from ....inputs.part_labels import read_parts
from ....inputs.sample import Sample
from .pictures import existing, read_mask

# Human3.6M's head (its joint 15) and the top of the head in LSP are one landmark, and so are LSP's neck and MPII's
# thorax: a data set has one of the two.
SPIN_JOINTS = (
    "right_ankle right_knee right_hip left_hip left_knee left_ankle right_wrist right_elbow right_shoulder "
    "left_shoulder left_elbow left_wrist neck head_top mid_hip neck spine head head_top nose left_eye right_eye "
    "left_ear right_ear"
).split()

MAX_BYTES = 8 << 30  # of a file's arrays when unpacked; all of Human3.6M has less

_SHAPES: dict[str, tuple[int | None, ...] | None] = {  # of a row; None: text
    "imgname": None,
    "center": (2,),
    "scale": (),
    "part": (len(SPIN_JOINTS), 3),
    "openpose": (len(skeleton("body25")), 3),
    "S": (len(SPIN_JOINTS), 4),
    "partname": None,
    "maskname": None,
    "vertices": (None, 3),
}
_REQUIRED = ("imgname", "center", "scale")
_FORMATS = ("lsp14", "h36m17", "coco17")  # what ``part`` may be; all of them within the 24 joints
# Files for ``expected`` in errors.
_HUMAN36M = (
    "an .npz of plain arrays: h36m_valid_protocol1.npz or h36m_valid_protocol2.npz, which SPIN's "
    "datasets/preprocess/h36m.py makes from the poses and boxes of vision.imar.ro/human3.6m "
    "(docs/how_to/evaluate.md). VideoPose3D's data_3d_h36m.npz and data_2d_h36m_*.npz hold pickles"
)
_PW3D = (
    "3dpw_test.npz, an .npz of plain arrays that SPIN's datasets/preprocess/pw3d.py makes from 3DPW's sequenceFiles "
    "(docs/how_to/evaluate.md)"
)


def read_human36m(
    path: str | Path, *, pictures: str | Path | None = None, keypoints: str | Path | None = None
) -> Iterator[Sample]:
    """The people of one of SPIN's files of Human3.6M; arguments and errors are those of ``read_spin``."""
    return read_spin(path, source="Human3.6M", expected=_HUMAN36M, pictures=pictures, keypoints=keypoints)


def read_pw3d(
    path: str | Path, *, pictures: str | Path | None = None, keypoints: str | Path | None = None
) -> Iterator[Sample]:
    """The people of SPIN's file of 3DPW; arguments and errors are those of ``read_spin``.

    Raises:
        InputError: If it is 3DPW's own folder or a pickle of it.
    """
    if Path(path).is_dir() or Path(path).suffix == ".pkl":
        raise InputError(
            f"{path}: 3DPW's sequence files are pickles, which could run code, so they are not read; expected {_PW3D}"
        )
    return read_spin(path, source="3DPW", expected=_PW3D, pictures=pictures, keypoints=keypoints)


def read_spin(
    path: str | Path,
    *,
    source: str,
    expected: str,
    pictures: str | Path | None = None,
    keypoints: str | Path | None = None,
    parts: str | Path | None = None,
    labels: LabelSet | None = None,
) -> Iterator[Sample]:
    """The people of an annotation file.

    Args:
        path: The ``.npz`` file.
        source: Name of the samples' source.
        expected: Description of the file and of the program that makes it, for errors.
        pictures: Folder of the data set. Pictures that are not there are left out.
        keypoints: Folder of JSON files, one for each picture. They are taken instead of the file's own keypoints.
        parts: Folder of the PNGs that partname and maskname name. By default, labels are not read.
        labels: The label set of the PNGs.

    Raises:
        InputError: If a file or an array that is needed is missing or wrong.
    """
    arrays = read_spin_arrays(path, expected=expected)
    if keypoints is None and not arrays.keys() & {"part", "openpose"}:
        raise InputError(
            f"{path}: no array part or openpose, so no 2D keypoints; expected them, or a folder of a detector's JSON "
            "files (--keypoints)"
        )
    if parts is not None and "partname" not in arrays:
        raise InputError(f"{path}: no array partname, but part labels are given; expected {expected}")
    for row in range(len(arrays["imgname"])):
        person = {name: values[row] for name, values in arrays.items()}
        name = str(person["imgname"])
        others: tuple[Keypoints2D, ...] = ()
        if keypoints is None:
            chosen = _own_keypoints(person)
        else:
            chosen, others = _detected(Path(keypoints), name, person["center"])
        read = mask = None
        if parts is not None and labels is not None:
            read = read_parts(existing(Path(parts), str(person["partname"]), "part labels"), labels)
            if "maskname" in person:
                mask = read_mask(existing(Path(parts), str(person["maskname"]), "silhouettes"), read.groups.shape)
        picture = None if pictures is None else Path(pictures) / name
        yield Sample(
            source=source,
            name=f"{Path(name).with_suffix('')}:{row}",
            keypoints=chosen,
            others=others,
            parts=read,
            target=None if read is None else read.groups,
            mask=mask,
            joints=_joints(person["S"]) if "S" in person else None,
            vertices=person.get("vertices"),
            picture=picture if picture is not None and picture.is_file() else None,
        )


def read_spin_arrays(path: str | Path, *, expected: str) -> dict[str, np.ndarray]:
    """Arrays of an annotation file by name; InputError if one is missing or wrong."""
    optional = tuple(_SHAPES.keys() - set(_REQUIRED))
    arrays = read_npz(path, _REQUIRED, optional, expected=expected, most=MAX_BYTES)
    for name, values in arrays.items():
        _check_array(arrays, name, path)
        if values.dtype.kind == "S":  # of Python 2
            arrays[name] = np.char.decode(values, "utf-8", "replace")
    return arrays


def _check_array(arrays: Mapping[str, np.ndarray], name: str, where: str | Path) -> None:
    """Raise unless an array has the shape of ``_SHAPES``, as many rows as imgname, and finite numbers or text."""
    values, shape = arrays[name], _SHAPES[name]
    expected = (len(np.atleast_1d(arrays["imgname"])), *(shape or ()))
    if len(values.shape) != len(expected) or any(
        want not in (None, have) for have, want in zip(values.shape, expected, strict=True)
    ):
        sizes = ", ".join("*" if size is None else str(size) for size in expected)
        raise InputError(f"{where}: {name}: shape {values.shape}; expected ({sizes})")
    if shape is None and values.dtype.kind not in "US":
        raise InputError(f"{where}: {name}: {values.dtype}; expected text")
    if shape is not None and (values.dtype.kind not in "fiu" or not np.isfinite(values).all()):
        raise InputError(f"{where}: {name}: {values.dtype}, or NaN or infinity in it; expected finite numbers")


def _own_keypoints(person: Mapping[str, np.ndarray]) -> Keypoints2D:
    """The annotators' keypoints, in the format that holds most of them; a detector's where there are none."""
    found = {"body25": person["openpose"]} if "openpose" in person else {}
    if "part" in person and (not found or (person["part"][:, 2] > 0).any()):
        found = {name: select_joints(person["part"], skeleton(name).landmarks) for name in _FORMATS}
    name, values = max(found.items(), key=lambda item: np.count_nonzero(item[1][:, 2] > 0))
    points, confidence = values[:, :2], values[:, 2]
    points = np.where(confidence[:, None] > 0, points, 0.0)
    return Keypoints2D(name, points.astype(np.float32), np.clip(confidence, 0.0, 1.0).astype(np.float32))


def _detected(folder: Path, picture: str, middle: np.ndarray) -> tuple[Keypoints2D, tuple[Keypoints2D, ...]]:
    """The person nearest to the middle of the box, and the others."""
    stem = Path(picture).with_suffix("")
    names = [
        f"{base}{ending}" for base in (stem, stem.name) for ending in (".json", "_keypoints.json", ".keypoints.json")
    ]
    found = next((folder / name for name in names if (folder / name).is_file()), None)
    if found is None:
        raise InputError(
            f"{folder}: no keypoints of {picture}; expected {stem.name}.json or {stem.name}_keypoints.json"
        )
    people = read_keypoints(found)
    chosen = min(people, key=lambda person: np.linalg.norm(person.points[person.confident].mean(0) - middle))
    return chosen, tuple(person for person in people if person is not chosen)


def select_joints(values: np.ndarray, landmarks: tuple[str, ...]) -> np.ndarray:
    """Rows of landmarks among the 24 joints; of two that are one, the one that is known."""
    confidence = values[:, -1]
    joints = [
        max((k for k, name in enumerate(SPIN_JOINTS) if name == landmark), key=lambda k: confidence[k])
        for landmark in landmarks
    ]
    return values[joints]


def _joints(values: np.ndarray) -> np.ndarray:
    selected = select_joints(values, MPJPE_JOINTS)
    return np.where(selected[:, 3:] > 0, selected[:, :3], np.nan)
