"""Names of renderers and gradients in tables, charts and JSON."""

from __future__ import annotations

from ..render.options import Gradient

EXACT, COVERAGE, PARTDR, MESH = "exact, edges", "exact, coverage", "exact, PartDR", "mesh E1"
GRADIENTS: dict[str, Gradient] = {EXACT: "edges", COVERAGE: "coverage", PARTDR: "partdr"}  # of exact ellipsoids
LEVELS = {f"mesh E{level}": level for level in range(4)}  # subdivisions of the mesh
