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
| energy | | of the last stage of the fit; none without refinement |
| warnings | | sentences about faults of the input or of the body |
| global_orient, rotations, translation | (3, 3), (20, 3, 3), (3) | as ``body.npz``, in the camera frame |
| lengths, thicknesses | (12), (15) | measurements [m] |
| camera_perspective, camera_scale, camera_translation | (), (), (2) | as ``body.npz`` |
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
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ..body.lens import place_bodies
from ..body.parameters import BodyParameters
from ..body.posing import LandmarkGather
from ..body.rotations import rotation_from_axis_angle
from ..body.skeletons import skeleton
from ..body.template import BODY_SHAPES, JOINT_NAMES, LENGTH_NAMES, PART_NAMES, THICKNESS_NAMES
from ..cameras import Crop
from ..clothing.clothes import CLOTHED
from ..clothing.measuring import statures
from ..clothing.model import DetailedModel
from ..fit.mesh_stage import MeshFit
from ..fit.result import FitResult
from ..fit.together import BatchFits
from ..inputs.keypoints import Keypoints2D, confident, person_heights
from ..inputs.observation import REFERENCE_SIZE

if TYPE_CHECKING:
    import pyarrow as pa

FORMAT = "warp-partdr people 1"
METADATA = b"warp-partdr"  # key in the schema's metadata

Row = dict[str, Any]


@dataclass(frozen=True)
class Column:
    """One column: what it holds, of which shape, in which unit, and the names of the first axis."""

    name: str
    kind: str  # of pyarrow: "float32", for example
    shape: tuple[int, ...] = ()
    unit: str = ""
    names: tuple[str, ...] = ()


def columns(form: str, model: DetailedModel | None = None) -> tuple[Column, ...]:
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
        Column("energy", "float32"),
        Column("warnings", "strings"),
        *body,
        Column("camera_perspective", "bool"),
        Column("camera_scale", "float32", unit="px/m, or px of perspective"),
        Column("camera_translation", "float32", (2,), "px"),
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
def describe_bodies(fits: Sequence[FitResult] | Sequence[MeshFit]) -> list[Row]:
    """Bodies of people, alike in keypoints' format and camera's kind, as far as a fit knows them.

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
    gather = LandmarkGather(known.keypoints[0].format.marks, device)
    seen = camera.project(gather(posed))[..., :2] / zooms[:, None] + corners[:, None]
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
    others = {
        "camera_perspective": [lenses is not None] * len(fits),
        "keypoint_error": _keypoint_errors(known.keypoints, seen.cpu().numpy()),
        "energy": known.energies,
        "warnings": known.warnings,
    }
    names, columns = (*numbers, *others), (*numbers.values(), *others.values())
    rows: list[Row] = [dict(zip(names, values, strict=True)) for values in zip(*columns, strict=True)]
    for index in np.flatnonzero(~fine):
        rows[index] = {"error": "the body holds NaN or infinity; expected finite numbers"}
    return rows


@dataclass(frozen=True)
class _Known:
    """Facts of N fits that rows are made of."""

    bodies: BodyParameters
    lenses: torch.Tensor | None
    joint_spreads: torch.Tensor
    crops: list[Crop]
    keypoints: list[Keypoints2D]
    energies: Sequence[float | None]
    warnings: list[list[str]]


def _known_of(fits: Sequence[FitResult] | Sequence[MeshFit]) -> _Known:
    if isinstance(fits, BatchFits):
        return _Known(
            fits.parameters,
            fits.lenses,
            fits.uncertainty.depths,
            [each.crop for each in fits.people],
            [each.evidence.keypoints for each in fits.people],
            fits.losses() or [None] * len(fits),
            [list(fits.warnings(row)) for row in range(len(fits))],
        )
    results = [each.ellipbody if isinstance(each, MeshFit) else each for each in fits]
    lenses = [lens for each in results if (lens := each.observation.lens) is not None]
    return _Known(
        BodyParameters.joined([each.parameters for each in results]),
        torch.stack(lenses) if lenses else None,
        torch.cat([each.uncertainty.depths for each in results if each.uncertainty is not None]),
        [each.crop for each in results],
        [each.evidence.keypoints for each in results],
        [sum(each.energy.values()) if each.energy else None for each in results],
        [list(each.warnings) for each in results],
    )


def people_table(rows: Sequence[Row], form: Sequence[Column], about: Mapping[str, Any]) -> pa.Table:
    """A table of rows, in which what is missing is null, with ``about`` in its schema's metadata."""
    import pyarrow as pa

    arrays, fields = [], []
    for column in form:
        values = [row.get(column.name) for row in rows]
        array = _array(column, values)
        said = {"shape": json.dumps(column.shape)} if column.shape else {}
        said |= {"unit": column.unit} if column.unit else {}
        said |= {"names": json.dumps(column.names)} if column.names else {}
        arrays.append(array)
        fields.append(pa.field(column.name, array.type, metadata=said or None))
    schema = pa.schema(fields, metadata={METADATA: json.dumps(dict(about))})
    return pa.Table.from_arrays(arrays, schema=schema)


def _array(column: Column, values: Sequence[Any]) -> pa.Array:
    import pyarrow as pa

    if column.kind == "strings":
        return pa.array(values, pa.list_(pa.string()))
    kind = pa.type_for_alias(column.kind)
    if not column.shape:
        return pa.array(values, kind)
    size = math.prod(column.shape)
    missing = np.array([value is None for value in values], dtype=bool)
    numbers = np.zeros((len(values), size), dtype=column.kind)
    if not missing.all():
        numbers[~missing] = np.stack([value for value in values if value is not None]).reshape(-1, size)
    return pa.FixedSizeListArray.from_arrays(pa.array(numbers.reshape(-1)), size, mask=pa.array(missing))


def _keypoint_errors(given: Sequence[Keypoints2D], points: np.ndarray) -> list[float | None]:
    """Mean distance of each body's points (N, J, 2) [px] from sure keypoints, as a share of the person's height."""
    places, confidence = np.stack([each.points for each in given]), np.stack([each.confidence for each in given])
    sure, heights = confident(confidence), person_heights(given[0].skeleton, places, confidence)
    distances = np.linalg.norm(points - places, axis=2).astype(np.float64)
    means = np.where(sure, distances, 0.0).sum(axis=1) / sure.sum(axis=1)
    return [
        mean / height if height > 0 else None for mean, height in zip(means.tolist(), heights.tolist(), strict=True)
    ]
