"""Registration of a detailed body on EllipBody (paper, eq. 16 to 18).

The paper names ICP and leaves its distances open. Here they are those of surfaces, both ways, and count ever less from
``scale`` on (Geman and McClure), so that what has no partner pulls on nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .ellipbody import PosedEllipsoid

BAND = 0.7  # share of a bone's half-length, from its middle, where an ellipsoid is as thick as its limb


@dataclass(frozen=True)
class DetailedSurface:
    """M^S, the posed mesh of a detailed model.

    Attributes:
        vertices: Vertices v^S [m], shape (V, 3).
        areas: Share of the skin that is around each vertex, 0 inside the body, shape (V,).
        parts: Ellipsoid 0 to 19 of each vertex, shape (V,).
        faces: Vertex indices of each face, shape (F, 3).
        face_parts: Ellipsoid 0 to 19 of each face, shape (F,).
    """

    vertices: np.ndarray
    areas: np.ndarray
    parts: np.ndarray
    faces: np.ndarray
    face_parts: np.ndarray


def registration_loss(
    surface: DetailedSurface,
    ellipsoids: list[PosedEllipsoid],
    samples: np.ndarray,
    sample_areas: np.ndarray,
    *,
    scale: float,
    reach: float,
    icp_weight: float = 1.0,
    penetration_weight: float = 1.0,
) -> float:
    """Eq. 16: L_ICP(M^S, M^E) + L_PEN(v^S, M^E), which shape and pose of the detailed body minimise.

    Args:
        surface: Mesh M^S of the detailed body.
        ellipsoids: Ellipsoids M^E of the body.
        samples: Points on M^E [m], shape (20 N, 3). Those of one ellipsoid follow those of another.
        sample_areas: Share of the area of each point, 0 where another ellipsoid covers it, shape
            (20 N,).
        scale: Distance from which on ICP counts less [m].
        reach: Distance beyond which a sample has no closest point [m].
        icp_weight: Weight of L_ICP in square metres.
        penetration_weight: Weight of L_PEN.

    Distances are from surface to surface, both ways, and robust. ``register`` adds joints,
    measures and priors of shape and pose.
    """
    icp = icp_to_mesh(surface, samples, sample_areas, scale, reach) + icp_to_ellipsoids(surface, ellipsoids, scale)
    penetration = penetration_loss(surface.vertices, ellipsoids, surface.areas)
    return icp_weight * icp + penetration_weight * penetration


def radial_distance(vertices: np.ndarray, ellipsoid: PosedEllipsoid) -> np.ndarray:
    """Eq. 17: e(v, E) = ‖2 d_x / l, 2 d_y / t1, 2 d_z / t2‖, 1 on the ellipsoid, less inside, shape (V,).

    Args:
        vertices: Vertices v [m], shape (V, 3).
        ellipsoid: Ellipsoid E, with d = R^-1 (v - C).
    """
    axes, centre, *sizes = ellipsoid
    return np.linalg.norm(2 * ((vertices - centre) @ axes) / np.array(sizes), axis=1)


def penetration_loss(vertices: np.ndarray, ellipsoids: list[PosedEllipsoid], areas: np.ndarray | None = None) -> float:
    """Eq. 18: L_PEN = sum over v and E of a (1 - e(v, E))², with a = 0 where v is outside E, else 1.

    Args:
        vertices: Vertices v [m], shape (V, 3).
        ellipsoids: Ellipsoids E.
        areas: Weight of each vertex, shape (V,). The paper has none, so that fine meshes count for
            more.
    """
    weights = np.ones(len(vertices)) if areas is None else areas
    total = 0.0
    for ellipsoid in ellipsoids:
        e = radial_distance(vertices, ellipsoid)
        a = np.where(e > 1, 0.0, 1.0)
        total += weights @ (a * (1 - e) ** 2)
    return total


def icp_to_ellipsoids(surface: DetailedSurface, ellipsoids: list[PosedEllipsoid], scale: float) -> float:
    """L_ICP from the mesh [m²]: squared distances (e - 1) / |e'| of vertices from their ellipsoids, to first order."""
    total = 0.0
    for part, ellipsoid in enumerate(ellipsoids):
        axes, centre, *sizes = ellipsoid
        halves = np.array(sizes) / 2
        unit = (surface.vertices - centre) @ axes / halves
        e = radial_distance(surface.vertices, ellipsoid)
        squares = ((e - 1) / np.linalg.norm(unit / halves / e[:, None], axis=1)) ** 2
        counted = (surface.parts == part) & (np.abs(unit[:, 0]) < BAND)
        total += (counted * surface.areas) @ (squares / (1 + squares / scale**2))
    return total


def icp_to_mesh(
    surface: DetailedSurface, samples: np.ndarray, sample_areas: np.ndarray, scale: float, reach: float
) -> float:
    """L_ICP to the mesh [m²]: squared distances along the normal of the closest face of a sample's own part.

    The weight is the one under which a step of least squares lowers Geman and McClure's cost, 1 / (1 + d² / scale²)².
    """
    total = 0.0
    skin = (surface.areas[surface.faces] > 0).all(1)
    per_part = len(samples) // 20
    for i in np.flatnonzero(sample_areas):
        sample = samples[i]
        triangles = surface.vertices[surface.faces[skin & (surface.face_parts == i // per_part)]]
        points = closest_points(sample, triangles)
        distances = np.linalg.norm(points - sample, axis=1)
        nearest = distances.argmin()
        if distances[nearest] > reach:
            continue
        a, b, c = triangles[nearest]
        normal = np.cross(b - a, c - a)
        along = (points[nearest] - sample) @ normal / np.linalg.norm(normal)
        total += sample_areas[i] * along**2 / (1 + distances[nearest] ** 2 / scale**2) ** 2
    return total


def closest_points(point: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The point of each triangle (F, 3, 3) that is closest to a point: above its inside, or on one of its sides."""
    found = np.empty((4, len(triangles), 3))
    for k in range(3):
        start, way = triangles[:, k], triangles[:, (k + 1) % 3] - triangles[:, k]
        share = ((point - start) * way).sum(1) / (way**2).sum(1)
        found[k] = start + np.clip(share, 0, 1)[:, None] * way
    a = triangles[:, 0]
    normals = np.cross(triangles[:, 1] - a, triangles[:, 2] - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found[3] = point - ((point - a) * normals).sum(1)[:, None] * normals
    squares = ((found - point) ** 2).sum(2)
    for k in range(3):
        inward = np.cross(normals, triangles[:, (k + 1) % 3] - triangles[:, k])
        squares[3, ((found[3] - triangles[:, k]) * inward).sum(1) < 0] = np.inf
    return found[squares.argmin(0), np.arange(len(triangles))]
