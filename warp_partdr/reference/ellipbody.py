"""EllipBody (paper, eq. 13 to 15): the skeleton, and the ellipsoids along it.

``BodyTree`` brings the template's numbers, and all positions are in one frame [m].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True)
class BodyTree:
    """The template; parents come before their children.

    Attributes:
        parents: Parent of each bone, -1 = root.
        directions: Unit vector O along each bone at rest, shape (20, 3).
        axes: Ellipsoid axes at rest as columns (bone, first thickness, second thickness), shape (20, 3, 3).
        sizes: Index of length, first and second thickness of each bone (paper, table 1).
    """

    parents: tuple[int, ...]
    directions: np.ndarray
    axes: np.ndarray
    sizes: tuple[tuple[int, int, int], ...]


class PosedEllipsoid(NamedTuple):
    """One of the 20: axes as columns (3, 3), centre (3,) [m], full length and thicknesses [m]."""

    axes: np.ndarray
    centre: np.ndarray
    length: float
    first_thickness: float
    second_thickness: float


def place_joints(
    tree: BodyTree, orientation: np.ndarray, root: np.ndarray, rotations: np.ndarray, lengths: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Eq. 15: S_i = R (l_i O_i) + S_parent(i), and the global rotations R of the bones (20, 3, 3).

    Args:
        tree: Template with the parents and the directions O.
        orientation: Rotation of the whole body, shape (3, 3).
        root: Position S_0 of the pelvis [m], shape (3,).
        rotations: Rotation r of each bone with respect to its parent, R_k = R_parent(k) r_k, shape
            (20, 3, 3).
        lengths: Lengths l [m], shape (12,).

    The paper writes R_parent(i), the rotation of the joint where the bone starts; here rotations
    are counted by bones, and it is the bone's own. Joint k + 1 is the end of bone k.
    """
    joints, turns = [root], list[np.ndarray]()
    for k, parent in enumerate(tree.parents):
        above = orientation if parent < 0 else turns[parent]
        turns.append(above @ rotations[k])
        joints.append(turns[k] @ (lengths[tree.sizes[k][0]] * tree.directions[k]) + joints[parent + 1])
    return np.array(joints), np.array(turns)


def ellipsoids_of(
    tree: BodyTree, joints: np.ndarray, turns: np.ndarray, lengths: np.ndarray, thicknesses: np.ndarray
) -> list[PosedEllipsoid]:
    """Eq. 13: the body is the set of its ellipsoids {E_i | i = 1, ..., 20}.

    Args:
        tree: Axes at rest and table 1.
        joints: Joints S of eq. 15 [m], shape (21, 3).
        turns: Rotations R of eq. 15, shape (20, 3, 3).
        lengths: Lengths l [m], shape (12,).
        thicknesses: Thicknesses t [m], shape (15,).

    C_i is the midpoint of two joints. The paper leaves open how thicknesses lie about the bone:
    here the ellipsoid's axes turn with the bone from where the template has them. The pelvis is
    two of the 20.
    """
    ellipsoids = []
    for k, (length, first, second) in enumerate(tree.sizes):
        centre = (joints[tree.parents[k] + 1] + joints[k + 1]) / 2
        axes = turns[k] @ tree.axes[k]
        ellipsoids.append(PosedEllipsoid(axes, centre, lengths[length], thicknesses[first], thicknesses[second]))
    return ellipsoids


def deform_sphere(ellipsoid: PosedEllipsoid, sphere: np.ndarray) -> np.ndarray:
    """Eq. 14: E(R_i, C_i, l_i, t1_i, t2_i), the icosahedron moved onto an ellipsoid, shape (N, 3).

    Args:
        ellipsoid: R (its axes), C, l, t1 and t2; l and t are full widths, as in eq. 17.
        sphere: Vertices of a (subdivided) icosahedron on the unit sphere, shape (N, 3).
    """
    axes, centre, *sizes = ellipsoid
    return centre + (sphere * np.array(sizes) / 2) @ axes.T
