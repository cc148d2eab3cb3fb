"""Rows of a data set of people, and their columns: plain numbers, texts, and lists of a fixed length.

A row is a person. A picture in which nobody was found has one row without ``person``, one that can't be read a row
with its ``error``; a person who can't be fitted has ``error``, too, and no body. Lists hold arrays row by row: reshape
``joints`` to (21, 3), as the field's metadata says (``shape``; ``names``: those of the first axis; ``unit``).

| column | shape | what |
|---|---|---|
| picture | | name of the picture, a path from the folder on |
| person, people | | number of the person in the picture, 0 = first, and how many there are |
| error | | why there is no body; null where nothing is wrong |
| height, width | | of the picture [px] |
| annotation | | id of the person's annotation, of COCO |
| score, box | (), (4) | confidence that there is a person; left, top, right, bottom [px] |
| keypoints | (J, 3) | x, y [px] and confidence, in the order of ``skeleton``'s keypoints |
| keypoint_error | | mean distance of sure keypoints from the body, as a share of the person's height |
| confidence | | probability that the body is right (docs/measured/confidence.md) |
| energy | | of the last stage of the fit; none without refinement |
| warnings | | sentences about faults of the input or of the body |
| global_orient, rotations, translation | (3, 3), (20, 3, 3), (3) | as ``body.npz``, in the camera frame |
| lengths, thicknesses | (12), (15) | measurements [m] |
| camera_perspective, camera_scale, camera_translation | (), (), (2) | as ``body.npz`` |
| camera_guessed | | True if the camera is not known, and a lens is assumed (``UsualLens``) |
| joints | (21, 3) | in the camera frame [m]: x right, y down, z away |
| joints_2d | (21, 2) | in the picture [px] |
| joint_spreads | (20) | of joints but the pelvis along the view, 68 % [m]: how sure the label network was |

With the mesh stage also, of the detailed body:

| column | shape | what |
|---|---|---|
| mesh_shape, mesh_rotations, mesh_translation | (S), (J, 3, 3), (3) | for ``model.pose``, in the camera frame |
| stature | | height of the model at rest [m] |
| clothes | (8) | thicknesses of clothes and hair [m] |

The schema's metadata holds, under ``warp-partdr``, JSON with versions, options, their SHA-256, and the shard.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ..body.lens import place_bodies
from ..body.parameters import BodyParameters
from ..body.posing import LandmarkGather
from ..body.rotations import rotation_from_axis_angle
from ..body.skeletons import Skeleton, skeleton
from ..body.template import BODY_SHAPES, JOINT_NAMES, LENGTH_NAMES, PART_NAMES, THICKNESS_NAMES
from ..cameras import Crop
from ..errors import printable
from ..inputs.keypoints import confident, person_heights
from ..inputs.observation import REFERENCE_SIZE
from ..models.clothes import CLOTHED
from ..models.measuring import statures
from ..models.model import DetailedModel
from ..solve.confidence.judge import judge_bodies, judge_fits, low_confidence
from ..solve.ellipsoids.batch_fits import BatchFits
from ..solve.ellipsoids.result import FitResult
from ..solve.mesh.mesh_stage import MeshFit

if TYPE_CHECKING:
    import pyarrow as pa

FORMAT = "warp-partdr people 1"
METADATA = b"warp-partdr"  # key in the schema's metadata
# Columns that are not written as such: True in rows whose error another run may not meet, and warnings about the file.
UNREAD, FILE_WARNINGS = "unread", "file_warnings"

Row = dict[str, Any]
Values = np.ndarray | Sequence[Any]  # arrays (N, ...), or N values, of which some may be None


@dataclass(frozen=True)
class RowPart:
    """Some columns of some rows.

    Attributes:
        rows: Indices of the rows, shape (N,).
        columns: Values of the columns, by the column's name.
    """

    rows: np.ndarray
    columns: Mapping[str, Values]

    def at(self, places: np.ndarray) -> RowPart:
        """Part with its rows at other places: row n moves to ``places[n]``."""
        return replace(self, rows=places[self.rows])

    def select(self, index: np.ndarray) -> RowPart:
        """Some of the rows."""
        own = {
            name: values[index] if isinstance(values, np.ndarray) else [values[row] for row in index.tolist()]
            for name, values in self.columns.items()
        }
        return RowPart(self.rows[index], own)


def error_part(row: int, error: str, *, passing: bool = False) -> RowPart:
    """The error of one row, and whether another run may not meet it."""
    return RowPart(np.array([row]), {"error": [error]} | ({UNREAD: [True]} if passing else {}))


@dataclass
class PeopleRows:
    """Rows of people, by columns.

    Where parts overlap, the last one holds. A value that no part has is missing.
    """

    count: int = 0
    parts: list[RowPart] = field(default_factory=list)

    @classmethod
    def of(cls, rows: Sequence[Row]) -> PeopleRows:
        """Columns of rows that were made one by one."""
        there: dict[str, list[int]] = {}
        for number, row in enumerate(rows):
            for name, value in row.items():
                if value is not None:
                    there.setdefault(name, []).append(number)
        parts = []
        for name, numbers in there.items():
            values = [rows[number][name] for number in numbers]
            each = np.stack(values) if isinstance(values[0], np.ndarray) else values
            parts.append(RowPart(np.array(numbers), {name: each}))
        return cls(len(rows), parts)

    def each(self) -> list[Row]:
        """Rows one by one, of which each has the values that it does not miss."""
        rows: list[Row] = [{} for _ in range(self.count)]
        for part in self.parts:
            for name, values in part.columns.items():
                for number, value in zip(part.rows.tolist(), values, strict=True):
                    rows[number][name] = value
        return rows

    def unread(self) -> list[int]:
        """Numbers of rows whose picture another run is to read again."""
        return sorted({int(row) for part in self.parts if UNREAD in part.columns for row in part.rows})

    def extend(self, other: PeopleRows) -> np.ndarray:
        """Add rows at the end; their numbers."""
        numbers = np.arange(self.count, self.count + other.count)
        self.parts += [part.at(numbers) for part in other.parts]
        self.count += other.count
        return numbers


@dataclass(frozen=True)
class Column:
    """One column: what it holds, of which shape, in which unit, and the names of the first axis."""

    name: str
    kind: str  # of pyarrow: "float32", for example
    shape: tuple[int, ...] = ()
    unit: str = ""
    names: tuple[str, ...] = ()


def columns(form: str | Skeleton, model: DetailedModel | None = None) -> tuple[Column, ...]:
    """Columns of people with keypoints of a format, and with the model's bodies, if there is one."""
    points = skeleton(form)
    axes: dict[str, tuple[str, ...]] = {
        "rotations": PART_NAMES,
        "lengths": LENGTH_NAMES,
        "thicknesses": THICKNESS_NAMES,
    }
    metres = ("translation", "lengths", "thicknesses")
    body = [
        Column(name, "float32", shape, "m" if name in metres else "", axes.get(name, ()))
        for name, shape in BODY_SHAPES.items()
    ]
    found = [
        Column("picture", "string"),
        Column("person", "int32"),
        Column("people", "int32"),
        Column("error", "string"),
        Column("height", "int32", unit="px"),
        Column("width", "int32", unit="px"),
        Column("annotation", "int64"),
        Column("score", "float32"),
        Column("box", "float32", (4,), "px", ("left", "top", "right", "bottom")),
        Column("keypoints", "float32", (len(points), 3), "px", points.landmarks),
        Column("keypoint_error", "float32"),
        Column("confidence", "float32"),
        Column("energy", "float32"),
        Column("warnings", "strings"),
        *body,
        Column("camera_perspective", "bool"),
        Column("camera_scale", "float32", unit="px/m, or px of perspective"),
        Column("camera_translation", "float32", (2,), "px"),
        Column("camera_guessed", "bool"),
        Column("joints", "float32", (len(JOINT_NAMES), 3), "m", JOINT_NAMES),
        Column("joints_2d", "float32", (len(JOINT_NAMES), 2), "px", JOINT_NAMES),
        Column("joint_spreads", "float32", (len(JOINT_NAMES) - 1,), "m", JOINT_NAMES[1:]),
    ]
    if model is not None:
        found += [
            Column("mesh_shape", "float32", (model.num_shapes,)),
            Column("mesh_rotations", "float32", (model.num_joints, 3, 3), names=model.joint_names),
            Column("mesh_translation", "float32", (3,), "m"),
            Column("stature", "float32", unit="m"),
            Column("clothes", "float32", (len(CLOTHED),), "m", CLOTHED),
        ]
    return tuple(found)


@torch.no_grad()
def describe_bodies(fits: Sequence[FitResult] | Sequence[MeshFit]) -> list[RowPart]:
    """Bodies of people, alike in keypoints' format and camera's kind, as far as a fit knows them, numbered as there.

    A body with a number that is NaN or infinite is an ``error`` instead.
    """
    meshes = [] if isinstance(fits, BatchFits) else [each for each in fits if isinstance(each, MeshFit)]
    known = _known_of(fits)
    bodies, lenses = known.bodies, known.lenses
    device = bodies.shift.device
    posed, camera = place_bodies(bodies, bodies.posed(), lenses, REFERENCE_SIZE)
    zooms = torch.tensor([each.zoom for each in known.crops], device=device)[:, None]
    corners = torch.tensor([[each.left, each.top] for each in known.crops], device=device)
    intrinsics = camera.intrinsics
    gather = LandmarkGather(skeleton(known.skeleton).marks, device)
    projected = camera.project(gather(posed))[..., :2] / zooms[:, None] + corners[:, None]
    arrays = {
        "global_orient": bodies.global_orient(),
        "translation": posed.joints[:, 0] if lenses is not None else torch.zeros(len(fits), 3),
        "rotations": rotation_from_axis_angle(bodies.free_rotations()),
        "lengths": bodies.lengths,
        "thicknesses": bodies.thicknesses,
        "camera_scale": (intrinsics[:, :1] / zooms)[:, 0],
        "camera_translation": intrinsics[:, 2:] / zooms + corners,
        "joints": posed.joints,
        "joints_2d": camera.project(posed.joints)[..., :2] / zooms[:, None] + corners[:, None],
        "joint_spreads": known.joint_spreads,
    }
    if meshes:
        arrays |= {
            "mesh_shape": torch.cat([each.body.shape for each in meshes]),
            "mesh_rotations": torch.cat([each.body.rotations for each in meshes]),
            "mesh_translation": torch.cat([each.body.translation for each in meshes]),
            "stature": statures(meshes[0].body.model, torch.cat([each.body.shape for each in meshes])),
            "clothes": torch.cat([each.clothes for each in meshes]),
        }
    numbers = {name: values.cpu().numpy() for name, values in arrays.items()}
    fine = np.all([np.isfinite(each.reshape(len(fits), -1)).all(axis=1) for each in numbers.values()], axis=0)
    columns: dict[str, Values] = {
        **numbers,
        "camera_perspective": np.full(len(fits), lenses is not None),
        "camera_guessed": np.full(len(fits), known.lens_assumed),
        "keypoint_error": _keypoint_errors(known, projected.cpu().numpy()),
        "confidence": known.confidences,
        "energy": known.energies,
        "warnings": [
            [*warnings, *low_confidence(probability)]
            for warnings, probability in zip(known.warnings, known.confidences, strict=True)
        ],
    }
    every = RowPart(np.arange(len(fits)), columns)
    if fine.all():
        return [every]
    error = "the body holds NaN or infinity; expected finite numbers"
    return [every.select(np.flatnonzero(fine)), *(error_part(row, error) for row in np.flatnonzero(~fine).tolist())]


@dataclass(frozen=True)
class _Known:
    """Facts of N fits that rows are made of."""

    bodies: BodyParameters
    lenses: torch.Tensor | None
    lens_assumed: bool
    joint_spreads: torch.Tensor
    crops: Sequence[Crop]
    skeleton: str | Skeleton
    points: np.ndarray  # keypoints (N, J, 2) [px]
    confidence: np.ndarray
    confidences: Sequence[float]
    energies: Sequence[float | None]
    warnings: list[list[str]]


def _known_of(fits: Sequence[FitResult] | Sequence[MeshFit]) -> _Known:
    if isinstance(fits, BatchFits):
        assert fits.uncertainty is not None  # fits of data sets start from the network
        return _Known(
            fits.parameters,
            fits.observations.lens,
            fits.observations.lens_assumed,
            fits.uncertainty.depths,
            fits.people.crops,
            fits.people.skeleton,
            fits.people.points,
            fits.people.confidence,
            judge_bodies(fits.parameters, fits.observations, fits.uncertainty)[0].tolist(),
            fits.losses() or [None] * len(fits),
            [list(fits.warnings(row)) for row in range(len(fits))],
        )
    results = [each.ellipbody if isinstance(each, MeshFit) else each for each in fits]
    keypoints = [each.evidence.keypoints for each in results]
    lenses = [lens for each in results if (lens := each.observation.lens) is not None]
    return _Known(
        BodyParameters.joined([each.parameters for each in results]),
        torch.stack(lenses) if lenses else None,
        results[0].observation.lens_assumed,
        torch.cat([each.uncertainty.depths for each in results if each.uncertainty is not None]),
        [each.crop for each in results],
        keypoints[0].skeleton,
        np.stack([each.points for each in keypoints]),
        np.stack([each.confidence for each in keypoints]),
        [each.probability for each in judge_fits(results)],
        [sum(each.energy.values()) if each.energy else None for each in results],
        [list(each.warnings) for each in results],
    )


def metadata(about: Mapping[str, Any]) -> dict[bytes, str]:
    """Metadata of a table's schema, with what it says about itself."""
    return {METADATA: json.dumps(dict(about))}


def people_table(rows: PeopleRows, form: Sequence[Column], about: Mapping[str, Any]) -> pa.Table:
    """A table of rows, in which what is missing is null, with ``about`` in its schema's metadata."""
    import pyarrow as pa

    arrays, fields = [], []
    for column in form:
        array = _array(column, rows)
        said = {"shape": json.dumps(column.shape)} if column.shape else {}
        said |= {"unit": column.unit} if column.unit else {}
        said |= {"names": json.dumps(column.names)} if column.names else {}
        arrays.append(array)
        fields.append(pa.field(column.name, array.type, metadata=said or None))
    schema = pa.schema(fields, metadata=metadata(about))
    return pa.Table.from_arrays(arrays, schema=schema)


def _array(column: Column, rows: PeopleRows) -> pa.Array:
    import pyarrow as pa

    given = [(part.rows, part.columns[column.name]) for part in rows.parts if column.name in part.columns]
    if column.kind == "string":
        return pa.array([None if text is None else printable(text) for text in _texts(rows, column.name)], pa.string())
    if column.kind == "strings":
        lists = _texts(rows, column.name)
        for row, first in enumerate(_texts(rows, FILE_WARNINGS)):
            if first is not None:
                lists[row] = [*first, *(lists[row] or ())]
        return pa.array(lists, pa.list_(pa.string()))
    size = math.prod(column.shape)
    missing, numbers = np.ones(rows.count, dtype=bool), np.zeros((rows.count, size), dtype=column.kind)
    for rows_there, values in given:
        if not isinstance(values, np.ndarray):
            there = [row for row, value in enumerate(values) if value is not None]
            rows_there, values = rows_there[there], np.array([values[row] for row in there], dtype=column.kind)
        numbers[rows_there], missing[rows_there] = values.reshape(-1, size), False
    if not column.shape:
        return pa.array(numbers[:, 0], mask=missing)
    # Not as lists of a fixed size: Arrow before version 26 can't read nulls of these (apache/arrow issue 35692).
    ends = np.concatenate([[0], np.cumsum(~missing * size)]).astype(np.int32)
    return pa.ListArray.from_arrays(ends, pa.array(numbers[~missing].reshape(-1)), mask=pa.array(missing))


def _texts(rows: PeopleRows, name: str) -> list[Any]:
    """Values of a column of texts, or of lists of them; None where there is none."""
    texts: list[Any] = [None] * rows.count
    for part in rows.parts:
        if name in part.columns:
            for row, value in zip(part.rows.tolist(), part.columns[name], strict=True):
                texts[row] = value
    return texts


def _keypoint_errors(known: _Known, points: np.ndarray) -> list[float | None]:
    """Mean distance of each body's points (N, J, 2) [px] from sure keypoints, as a share of the person's height."""
    sure, heights = confident(known.confidence), person_heights(known.skeleton, known.points, known.confidence)
    distances = np.linalg.norm(points - known.points, axis=2).astype(np.float64)
    means = np.where(sure, distances, 0.0).sum(axis=1) / sure.sum(axis=1)
    return [
        mean / height if height > 0 else None for mean, height in zip(means.tolist(), heights.tolist(), strict=True)
    ]
