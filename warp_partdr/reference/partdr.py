"""PartDR's rule (paper, eq. 10 to 12), which meshes and exact ellipsoids share.

The paper and the Neural Mesh Renderer (NMR) leave much open. The choices made here, with g^i(P) the gradient of the
loss with respect to part i's map at pixel P, in which all is linear:

x and y: every row (for x) and column (for y) of pixels whose centre line crosses an edge of part i, on its own.
    1. The crossing moves straight along that line.
    2. Where the first pixel outside shows the same label, the edge lies inside its own part's picture: it does nothing.
    3. Outward, pixels up to the picture's border, or to the next pixel that shows the part, switch on (dI = +1).
       Inward, pixels up to the first that shows background switch off (dI = -1) if they show the part.
    4. A pixel that shows another part gives 0 and does not end the walk (eq. 11).
    5. The crossing's derivative is the sum of g dI / (x1 - x0) over these pixels (eq. 10).
z: at a pixel P that shows part j, for a part i != j that is there but hidden,
    6. the nearest surface of part i and the one that shows exchange places, so A^i(P) gains 1: the point of the first
       that is seen at P comes forward (eq. 12), and that of the second goes back by as much.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

MIN_DELTA_Z = 1e-4  # [m]


@dataclass(frozen=True)
class Rule:
    """Options of the rule.

    Attributes:
        occlusion: Rule for other parts. With "depth", a part that lies farther away than the edge counts as background
            does, for the edge would cover it. With "paper", which is eq. 11 to the letter, every other part gives 0.
        edges: Edges that count. With "silhouette", they are those of the part. With "all", NMR's rule, each face's
            edges count alone, where the pixel just inside shows that face: outward over all background to the border,
            and inward over the pixels of this very face. "all" is for meshes only.
        max_distance: End of both walks [px].
        depth_weight: Lambda of eq. 12; 0 leaves z out.
    """

    occlusion: Literal["depth", "paper"] = "depth"
    edges: Literal["silhouette", "all"] = "silhouette"
    max_distance: float = np.inf
    depth_weight: float = 1.0


class PixelLine(NamedTuple):
    """A row or column of pixels, each of shape (N,): labels shown, depths [m], g^i, and faces shown (of a mesh)."""

    shown: np.ndarray
    depth: np.ndarray
    g: np.ndarray
    faces: np.ndarray | None = None


def switch_slope(change: float, x0: float, x1: float, direction: float) -> float:
    """Derivative of a pixel's value with respect to an edge's place: eq. 10, dI / (x1 - x0).

    Args:
        change: Change dI of the pixel, +1 where it switches on, -1 where it switches off.
        x0: The edge's crossing of the line [px].
        x1: The pixel's centre [px].
        direction: Sign of x1 - x0, also where that is 0.

    The paper prints x0 - x1, and moves vertices of every face by at least a pixel. Here silhouette
    edges' crossings of pixel rows and columns do, and either end of an edge gets the share that it
    has in the crossing. dI is not the residual to the truth, which is in the gradient g: any loss
    may stand behind it.
    """
    return change * direction / max(abs(x1 - x0), 1.0)


def switches_on(shown: int, part: int, depth: float, edge_depth: float, occlusion: str) -> bool:
    """True where a pixel that an edge reaches would show its part: eq. 11, whose upper case gives 0.

    Args:
        shown: Label F that the pixel shows, 0 = background.
        part: Label i of the edge's part.
        depth: Depth of the surface that the pixel shows [m].
        edge_depth: Depth of the edge at its crossing [m].
        occlusion: See ``Rule``.

    By the paper a pixel that shows another part gives 0 (occlusion="paper"). By default that holds
    for parts in front alone: the edge would cover what lies behind it.
    """
    if shown == 0:
        return True
    return shown != part and occlusion == "depth" and depth > edge_depth


def depth_slope(delta_z: float, weight: float = 1.0) -> float:
    """Derivative of a hidden pixel's value with respect to the depth of the hidden point: eq. 12.

    Args:
        delta_z: Depth between the hidden point Q and what hides it [m], at least 0.1 mm.
        weight: Lambda.

    The sign says that coming forward (z down) switches the pixel on; what hides it goes back by as
    much. M0 is where the line from vertex v_k through Q meets the opposite side, so that
    Delta(M0, Q) / Delta(M0, v_k) is v_k's barycentric weight w. The paper's log(w / dz + 1) for
    each vertex is w log(1 / dz + 1) here: their shares sum to what the point gets.
    """
    return -weight * float(np.log(1 / max(delta_z, MIN_DELTA_Z) + 1))


def line_slope(
    line: PixelLine, part: int, side: int, crossing: float, edge_depth: float, rule: Rule, face: int = -1
) -> float:
    """Derivative of the loss with respect to an edge's place on a line of pixels: choices 2 to 5.

    Args:
        line: Labels, depths and gradients along the line.
        part: Label of the edge's part.
        side: Side of the part, 1 where it ends towards larger coordinates, and -1 towards smaller ones.
        crossing: Place x0 of the edge on the line [px].
        edge_depth: Depth of the edge there [m].
        rule: Options of the rule.
        face: Index of the face that the edge belongs to, for ``edges="all"``.
    """
    positions = np.arange(len(line.shown)) + 0.5
    distances = np.abs(positions - crossing)
    ahead = (positions - crossing) * side > 0
    outside, inside = np.flatnonzero(ahead)[::side], np.flatnonzero(~ahead)[::-side]
    every_edge = rule.edges == "all"
    if every_edge:
        assert line.faces is not None
        if not (len(inside) and distances[inside[0]] <= 1 and line.faces[inside[0]] == face):
            return 0.0
    elif len(outside) and distances[outside[0]] <= 1 and line.shown[outside[0]] == part:
        return 0.0
    slope = 0.0
    for pixel in outside:
        shown = line.shown[pixel]
        if (shown == part and not every_edge) or distances[pixel] > rule.max_distance:
            break
        if switches_on(shown, part, line.depth[pixel], edge_depth, rule.occlusion):
            slope += line.g[pixel] * switch_slope(1.0, crossing, positions[pixel], side)
    for pixel in inside:
        shown = line.shown[pixel]
        if shown == 0 or distances[pixel] > rule.max_distance:
            break
        if every_edge and line.faces is not None and line.faces[pixel] != face:
            break
        if shown == part:
            slope += line.g[pixel] * switch_slope(-1.0, crossing, positions[pixel], -side)
    return slope
