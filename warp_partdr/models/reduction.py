"""Detailed models with few vertices, for drawing: where a scene shows less than the mesh holds, less is enough."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from ..body.template import NUM_PARTS
from ..errors import check_whole
from .model import DetailedModel
from .normals import vertex_normals
from .packaged import packaged_findings
from .surfaces import vertex_parts

_LEAST = 12  # vertices of a part
LEAST_VERTICES = _LEAST * NUM_PARTS
# Spacings of a part's vertices by which normals that differ by 1 are apart. Those of opposite sides differ by 2: even
# those of a finger are a spacing apart then, so that each keeps vertices, and the faces between them.
_TURNED = 0.5
_ROUNDS = 3  # of moving vertices to where the surface was
# Share of these moves that is made, for outlines to be as wide as they were. Sides of length L along a curvature k with
# corners on the surface are outlined k L² / 24 too narrow, sides that it is at distance 0 from on average as much too
# wide.
_SHARE = 0.5
_MOST = 0.98  # share of the area that the error holds for
_VERTICES_FOR = 9.37  # [m]: so many vertices, over an error, have that error at most, of human bodies
_MORE = 1.25  # times as many, where they have a larger one
_NOTHING = 1e-6  # of a landmark: what a joint carries less of counts nothing


@dataclass(frozen=True, eq=False)
class Reduced:
    """Model of few vertices.

    Attributes:
        model: Model with the same shapes, joints and landmarks. Faces have the first ``drawn`` vertices. The others
            carry landmarks, which are exactly those of the whole model.
        drawn: Number of vertices with faces.
        kept: Index of the whole model's vertex that each of these stands for, shape (drawn,), int64.
        error: Distance of the whole model's surface from this one at rest [m]. It is exceeded on 2 % of the area.
    """

    model: DetailedModel
    drawn: int
    kept: torch.Tensor
    error: float


@dataclass(frozen=True, eq=False)
class FewVertices:
    """Vertices of a model that its reduced one has, and the faces between them.

    Attributes:
        kept: Indices of the vertices, shape (N,), int64.
        moves: Move of each of them at rest [m], shape (N, 3).
        faces: Indices among ``kept`` of each face's corners, shape (F, 3), int32.
        face_parts: Part label of each face, shape (F,), uint8.
        error: ``Reduced.error`` [m], shape ().
    """

    kept: np.ndarray
    moves: np.ndarray
    faces: np.ndarray
    face_parts: np.ndarray
    error: np.ndarray


def reduce_within(model: DetailedModel, error: float) -> Reduced | None:
    """Reduce a model to about as few vertices as have at most this error [m]; None: it has no more than it needs."""
    count = first_count(error)
    while count < model.num_vertices:
        reduced = reduce_model(model, int(count))
        if reduced.error <= error:
            return reduced
        count *= _MORE
    return None


def first_count(error: float) -> float:
    """Number of vertices, not yet whole, that is tried first for this error [m]."""
    return max(_VERTICES_FOR / error, LEAST_VERTICES)


def reduce_model(model: DetailedModel, vertices: int) -> Reduced:
    """Reduce a model to about so many vertices, spread evenly over each part's skin, those of small parts denser.

    Where skin turns within their spacing, as around fingers, they are denser, too, or what is thin would have no faces.
    A face stays where its corners fall to three different vertices. These move along their normals, by millimetres, so
    that on average outlines are where they were.

    Args:
        model: Any.
        vertices: That faces have, 240 or more.

    Raises:
        ValueError: If ``vertices`` is less than that, or more than the model has.
    """
    count = check_whole("vertices", vertices, LEAST_VERTICES, model.num_vertices)
    packaged = packaged_findings(model, few_name(count))
    few = find_few(model, count) if packaged is None else FewVertices(**packaged)
    points, joints, weights = _landmark_points(model)
    some = torch.from_numpy(few.kept).to(model.faces.device)

    def rows(values: torch.Tensor) -> torch.Tensor:
        """Values of the kept vertices, then of the landmarks' points, from values of all vertices (..., V, C)."""
        columns = values.movedim(-2, 0)  # (V, ..., C), for one product of matrices instead of one for each shape value
        sums = (points @ columns.flatten(1)).unflatten(1, columns.shape[1:]).movedim(0, -2)
        return torch.cat([values[..., some, :], sums], dim=-2)

    rests, bends = rows(model.rest_vertices), model.pose_directions
    rests[: len(some)] += torch.from_numpy(few.moves).to(rests)
    alone = torch.nn.functional.one_hot(joints, model.num_joints).to(rests)
    reduced = replace(
        model,
        faces=torch.from_numpy(few.faces).to(some.device),
        face_parts=torch.from_numpy(few.face_parts).to(some.device),
        rest_vertices=rests,
        shape_directions=rows(model.shape_directions),
        skin_weights=torch.cat([model.skin_weights[some], alone]),
        landmark_weights=torch.nn.functional.pad(weights, (len(some), 0)),
        pose_directions=None if bends is None else rows(bends.unflatten(1, (-1, 3))).flatten(1),
    )
    return Reduced(reduced, len(some), some, float(few.error))


def few_name(count: int) -> str:
    """Name of the packaged findings about a model with so many vertices."""
    return f"{count} vertices"


def find_few(model: DetailedModel, count: int) -> FewVertices:
    """Choose about so many vertices of a model, where they move to, and the faces between them."""
    part, shares = (values.cpu().numpy() for values in vertex_parts(model))
    rest = model.rest_vertices.double().cpu().numpy()
    faces = model.faces.cpu().numpy().astype(np.int64)
    skin = shares > 0
    areas = np.where(skin, _areas(rest, faces), 0.0)
    kept, nearest = _spread(rest, vertex_normals(rest, faces), np.where(skin, part, -1), areas, count)
    corners = nearest[faces]
    whole = (corners != np.roll(corners, 1, axis=1)).all(1) & (corners >= 0).all(1)
    corners = corners[whole]
    # Each face once, from its lowest corner on: a flap has two, one for each side.
    turned = np.take_along_axis(corners, (corners.argmin(1)[:, None] + np.arange(3)) % 3, axis=1)
    corners, first = np.unique(turned, axis=0, return_index=True)
    labels = model.face_parts.cpu().numpy()[whole][first]
    places, error = _settle(rest, areas, kept, nearest, corners)
    return FewVertices(kept, places - rest[kept], corners.astype(np.int32), labels, np.array(error))


def _areas(rest: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area of the surface around each vertex, a third of each of its faces [m²]."""
    corners = rest[faces]
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return np.bincount(faces.ravel(), np.repeat(doubled / 6, 3), len(rest))


def _spread(
    rest: np.ndarray, normals: np.ndarray, part: np.ndarray, areas: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices to keep, and for each vertex the place of its nearest among them; -1 for one of no part."""
    totals = np.bincount(part[part >= 0], areas[part >= 0], NUM_PARTS)
    shares = np.sqrt(totals)
    wanted = np.maximum(_LEAST, count * shares / shares.sum())
    kept: list[int] = []
    nearest = np.full(len(rest), -1)
    for index in range(NUM_PARTS):
        members = np.flatnonzero(part == index)
        if not len(members):
            continue
        turned = _TURNED * np.sqrt(totals[index] / wanted[index]) * normals[members]
        places = np.concatenate([rest[members], turned], axis=1)
        chosen: list[int] = []
        squares, own = np.full(len(members), np.inf), np.zeros(len(members), dtype=np.int64)
        farthest = int(np.square(places - places.mean(0)).sum(1).argmax())
        while len(chosen) < min(wanted[index], len(members)):
            distance = np.square(places - places[farthest]).sum(1)
            own = np.where(distance < squares, len(chosen), own)
            squares = np.minimum(squares, distance)
            chosen.append(farthest)
            farthest = int(squares.argmax())
        nearest[members] = len(kept) + own
        kept += members[chosen].tolist()
    return np.array(kept), nearest


def _settle(
    rest: np.ndarray, areas: np.ndarray, kept: np.ndarray, nearest: np.ndarray, corners: np.ndarray
) -> tuple[np.ndarray, float]:
    """Places of the kept vertices whose outlines are as wide as the old surface's on average, and the error."""
    from trimesh.triangles import closest_point  # whose import takes a while

    members = np.flatnonzero(nearest >= 0)
    own, areas = nearest[members], areas[members]
    # All faces about each member's vertex, one after another.
    order = np.argsort(corners, axis=None, kind="stable")
    counts = np.bincount(corners.ravel(), minlength=len(kept))
    repeats = counts[own]
    starts = np.cumsum(repeats) - repeats
    within = np.arange(repeats.sum()) - np.repeat(starts, repeats)
    about = order[np.repeat((np.cumsum(counts) - counts)[own], repeats) + within] // 3
    points = np.repeat(rest[members], repeats, axis=0)
    near = repeats > 0

    def distances(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances of the members from the faces, positive outside, and the normals of the kept vertices."""
        triangles = places[corners]
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        offsets = points - closest_point(triangles[about], points)
        lengths = np.linalg.norm(offsets, axis=1)
        shortest = np.minimum.reduceat(lengths, starts[near])
        signs = np.sign(
            np.add.reduceat(
                (offsets * normals[about]).sum(1) * (lengths == np.repeat(shortest, repeats[near])), starts[near]
            )
        )
        found = np.zeros(len(members))
        found[near] = shortest * signs
        sums = np.zeros_like(places)
        for corner in corners.T:
            np.add.at(sums, corner, normals)
        return found, sums / np.linalg.norm(sums, axis=1, keepdims=True).clip(1e-12)

    places, weight = rest[kept], np.bincount(own, areas, len(kept)).clip(1e-12)
    for _ in range(_ROUNDS):
        found, normals = distances(places)
        places = places + (np.bincount(own, found * areas, len(kept)) / weight)[:, None] * normals
    places = rest[kept] + _SHARE * (places - rest[kept])
    found = np.abs(distances(places)[0])
    order = found.argsort()
    return places, float(found[order[np.searchsorted(areas[order].cumsum(), _MOST * areas.sum())]])


def _landmark_points(model: DetailedModel) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Points of which landmarks are sums, each carried by one joint alone, so that few of them are exact.

    Returns:
        The points as sums of vertices, shape (P, V); their joints, shape (P,); and the landmarks as sums of points and
        of joints, shape (L, P + J).
    """
    vertices = model.num_vertices
    by_vertex = model.landmark_weights[:, :vertices]
    shares = by_vertex @ model.skin_weights  # of each landmark that each joint carries
    landmarks, joints = (shares.abs() > _NOTHING).nonzero(as_tuple=True)
    share = shares[landmarks, joints]
    points = by_vertex[landmarks]  # a copy of many megabytes, so the rest is done in its memory
    points *= model.skin_weights.mT[joints]
    points /= share[:, None]
    weights = torch.zeros(len(by_vertex), len(share)).to(share)
    weights[landmarks, torch.arange(len(share), device=share.device)] = share
    return points, joints, torch.cat([weights, model.landmark_weights[:, vertices:]], dim=1)
