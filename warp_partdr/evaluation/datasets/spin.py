"""Annotation arrays of SPIN (nkolot/SPIN) and the many projects after it, for Human3.6M, 3DPW and others.

One ``.npz`` a data set, a row a person. 3DPW's own sequence files are pickles, which are not read.

=========  =============  ============================================================================================
array      shape          meaning
=========  =============  ============================================================================================
imgname    (N,)           the picture, relative to the data set's folder
center     (N, 2)         middle of the person's box [px]
scale      (N,)           its side / 200 px
part       (N, 24, 3)     2D keypoints [px] and confidence, in the order of ``SPIN_JOINTS``
openpose   (N, 25, 3)     2D keypoints of a detector, OpenPose's BODY_25
S          (N, 24, 4)     3D joints, camera frame, around the pelvis [m], and confidence
pose       (N, 72)        SMPL's pose, the root's in the camera frame; or (N, 24, 3)
shape      (N, 10)        SMPL's betas
gender     (N,)           "m" or "f"
partname   (N,)           PNG of part labels, relative to a folder of its own
maskname   (N,)           PNG of the silhouette, in the same folder
vertices   (N, V, 3)      of a mesh, in the frame of S [m]; not in SPIN's own files
=========  =============  ============================================================================================

imgname, center and scale must be there, and 2D keypoints: here, or one JSON file a picture.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ...body.labels import LabelSet
from ...body.skeletons import MPJPE_SKELETON, skeleton
from ...errors import InputError
from ...files.array_files import read_npz
from ...inputs.keypoint_files import read_keypoints
from ...inputs.keypoints import Keypoints2D
from ...inputs.part_labels import read_parts
from ...inputs.sample import Sample, SmplFit
from .pictures import existing, read_mask

# Human3.6M's head (its joint 15) and the top of the head in LSP are one landmark, and so are LSP's neck and MPII's
# thorax: a data set has one of the two.
SPIN_JOINTS = (
    "right_ankle right_knee right_hip left_hip left_knee left_ankle right_wrist right_elbow right_shoulder "
    "left_shoulder left_elbow left_wrist neck head_top mid_hip neck spine head head_top nose left_eye right_eye "
    "left_ear right_ear"
).split()

MAX_BYTES = 8 << 30  # of a file's arrays when unpacked; all of Human3.6M has less

Shape = tuple[int | None, ...]

_SHAPES: dict[str, Shape | None] = {  # of a row; None: text
    "imgname": None,
    "center": (2,),
    "scale": (),
    "part": (len(SPIN_JOINTS), 3),
    "openpose": (len(skeleton("body25")), 3),
    "S": (len(SPIN_JOINTS), 4),
    "pose": (24, 3),
    "shape": (10,),
    "gender": None,
    "partname": None,
    "maskname": None,
    "vertices": (None, 3),
}
_REQUIRED = ("imgname", "center", "scale")
_FORMATS = ("lsp14", "h36m17", "coco17")  # what ``part`` may be; all of them within the 24 joints
_GENDERS = {"m": "male", "f": "female"}
_BOX = 200.0  # [px] that ``scale`` is in units of
# Files for ``expected`` in errors.
_HUMAN36M = (
    "an .npz of plain arrays: h36m_valid_protocol1.npz or h36m_valid_protocol2.npz, which SPIN's "
    "datasets/preprocess/h36m.py makes from the poses and boxes of vision.imar.ro/human3.6m (docs/evaluation.md). "
    "VideoPose3D's data_3d_h36m.npz and data_2d_h36m_*.npz hold pickles"
)
_PW3D = (
    "3dpw_test.npz, an .npz of plain arrays that SPIN's datasets/preprocess/pw3d.py makes from 3DPW's sequenceFiles "
    "(docs/evaluation.md)"
)


def read_human36m(
    path: str | Path, *, pictures: str | Path | None = None, keypoints: str | Path | None = None
) -> Iterator[Sample]:
    """The people of one of SPIN's files of Human3.6M.

    Args:
        path: ``h36m_valid_protocol1.npz`` or another of this layout.
        pictures: The folder that its imgname is relative to.
        keypoints: Folder of 2D keypoints, one JSON file a picture; SPIN's validation files have none of their own.

    Raises:
        InputError: If a file or an array that is needed is missing or wrong.
    """
    return read_spin(path, source="Human3.6M", expected=_HUMAN36M, pictures=pictures, keypoints=keypoints)


def read_pw3d(
    path: str | Path, *, pictures: str | Path | None = None, keypoints: str | Path | None = None
) -> Iterator[Sample]:
    """The people of SPIN's file of 3DPW.

    Args:
        path: ``3dpw_test.npz`` or another of this layout.
        pictures: The folder that its imgname is relative to.
        keypoints: Folder of 2D keypoints, one JSON file a picture; SPIN's file has none of its own.

    Raises:
        InputError: If it is 3DPW's own folder or a pickle of it, or something is missing or wrong.
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
        source: What the samples' source is called.
        expected: What file this should be and who makes it, for errors.
        pictures: The data set's folder; pictures that are not there are left out.
        keypoints: Folder of JSON files, one a picture, which are taken instead of the file's own keypoints.
        parts: Folder of the PNGs that partname and maskname name; by default labels are not read.
        labels: The label set of the PNGs.

    Raises:
        InputError: If a file or an array that is needed is missing or wrong.
    """
    optional = tuple(_SHAPES.keys() - set(_REQUIRED))
    arrays = read_npz(path, _REQUIRED, optional, expected=expected, most=MAX_BYTES)
    if "pose" in arrays and arrays["pose"].ndim == 2 and arrays["pose"].shape[1] == 72:
        arrays["pose"] = arrays["pose"].reshape(-1, 24, 3)
    rows = _check_arrays(arrays, _SHAPES, path)
    if keypoints is None and not arrays.keys() & {"part", "openpose"}:
        raise InputError(
            f"{path}: no array part or openpose, so no 2D keypoints; expected them, or a folder of a detector's JSON "
            "files (--keypoints)"
        )
    if parts is not None and "partname" not in arrays:
        raise InputError(f"{path}: no array partname, but part labels are given; expected {expected}")
    for row in range(rows):
        picture = str(arrays["imgname"][row])
        u, v = map(float, arrays["center"][row])
        half = float(arrays["scale"][row]) * _BOX / 2
        others: tuple[Keypoints2D, ...] = ()
        if keypoints is None:
            chosen = _own_keypoints(arrays, row)
        else:
            chosen, others = _detected(Path(keypoints), picture, (u, v))
        read = mask = None
        if parts is not None and labels is not None:
            read = read_parts(existing(Path(parts), str(arrays["partname"][row]), "part labels"), labels)
            if "maskname" in arrays:
                mask = read_mask(existing(Path(parts), str(arrays["maskname"][row]), "silhouettes"), read.groups.shape)
        yield Sample(
            source=source,
            name=f"{Path(picture).with_suffix('')}:{row}",
            keypoints=chosen,
            others=others,
            parts=read,
            target=None if read is None else read.groups,
            mask=mask,
            joints=_joints(arrays["S"][row]) if "S" in arrays else None,
            vertices=arrays["vertices"][row] if "vertices" in arrays else None,
            smpl=_smpl(arrays, row) if arrays.keys() >= {"pose", "shape"} else None,
            picture=_picture(pictures, picture),
            box=(u - half, v - half, u + half, v + half),
        )


def _check_arrays(arrays: Mapping[str, np.ndarray], shapes: Mapping[str, Shape | None], where: str | Path) -> int:
    """Raise unless arrays have the same N first, and these shapes.

    Args:
        arrays: By name; those without a shape are not looked at.
        shapes: Shape of one row by name, in which None takes any size; of finite numbers. None alone: rows of text.
        where: The file, for errors.

    Returns:
        N.

    Raises:
        InputError: For the first array that does not fit.
    """
    rows = len(np.atleast_1d(next(iter(arrays.values()))))
    for name in (name for name in arrays if name in shapes):
        values, shape = arrays[name], shapes[name]
        expected = (rows, *(shape or ()))
        fits = values.ndim == len(expected) and all(
            want in (None, have) for have, want in zip(values.shape, expected, strict=True)
        )
        if not fits:
            sizes = ", ".join("*" if size is None else str(size) for size in expected)
            raise InputError(f"{where}: {name}: shape {values.shape}; expected ({sizes})")
        if shape is None and values.dtype.kind not in "US":
            raise InputError(f"{where}: {name}: {values.dtype}; expected text")
        if shape is not None and (values.dtype.kind not in "fiu" or not np.isfinite(values).all()):
            raise InputError(f"{where}: {name}: {values.dtype}, or NaN or infinity in it; expected finite numbers")
    return rows


def _picture(folder: str | Path | None, name: str) -> Path | None:
    path = None if folder is None else Path(folder) / name
    return path if path is not None and path.is_file() else None


def _own_keypoints(arrays: dict[str, np.ndarray], row: int) -> Keypoints2D:
    """The annotators' keypoints, in the format that holds most of them; a detector's where there are none."""
    name, points, confidence = max(_formats(arrays, row), key=lambda found: np.count_nonzero(found[2] > 0))
    points = np.where(confidence[:, None] > 0, points, 0.0)
    return Keypoints2D(name, points.astype(np.float32), np.clip(confidence, 0.0, 1.0).astype(np.float32))


def _formats(arrays: dict[str, np.ndarray], row: int) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    if "part" in arrays and ("openpose" not in arrays or (arrays["part"][row, :, 2] > 0).any()):
        for name in _FORMATS:
            yield name, *_select(arrays["part"][row], skeleton(name).landmarks)
    else:
        values = arrays["openpose"][row]
        yield "body25", values[:, :2], values[:, 2]


def _detected(folder: Path, picture: str, middle: tuple[float, float]) -> tuple[Keypoints2D, tuple[Keypoints2D, ...]]:
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


def _select(values: np.ndarray, landmarks: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Positions and confidences of landmarks among the 24 joints; of two that are one, the one that is known."""
    confidence = values[:, -1]
    joints = [
        max((k for k, name in enumerate(SPIN_JOINTS) if name == landmark), key=lambda k: confidence[k])
        for landmark in landmarks
    ]
    return values[joints, :-1], confidence[joints]


def _joints(values: np.ndarray) -> np.ndarray:
    points, confidence = _select(values, skeleton(MPJPE_SKELETON).landmarks)
    return np.where(confidence[:, None] > 0, points, np.nan)


def _smpl(arrays: dict[str, np.ndarray], row: int) -> SmplFit:
    gender = str(arrays["gender"][row]) if "gender" in arrays else ""
    return SmplFit(arrays["pose"][row], arrays["shape"][row], _GENDERS.get(gender[:1], "neutral"))
