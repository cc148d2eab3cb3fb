"""Renderers and gradients by the names that they have in tables, charts and JSON."""

from __future__ import annotations

from ...render.options import Gradient
from ...render.renderers import Renderer, RendererEllipsoids, RendererMesh

EXACT, COVERAGE, PARTDR, MESH = "exact, edges", "exact, coverage", "exact, PartDR", "mesh E1"
LEVELS = {f"mesh E{level}": level for level in range(4)}  # subdivisions of the mesh
GRADIENTS: dict[str, Gradient] = {EXACT: "edges", COVERAGE: "coverage", PARTDR: "partdr"}  # of exact ellipsoids
RENDERERS: dict[str, Renderer] = {
    **{name: RendererMesh(level) for name, level in LEVELS.items()},
    **{name: RendererEllipsoids(gradient) for name, gradient in GRADIENTS.items()},
}
