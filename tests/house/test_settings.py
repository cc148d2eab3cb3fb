"""The page of settings lists each field of the options, with the default that it has in the code."""

from __future__ import annotations

import re
from dataclasses import MISSING, Field, fields
from pathlib import Path

import pytest

from warp_partdr import FitOptions, RegistrationOptions, RendererEllipsoids, RendererMesh, Stage, Weights
from warp_partdr.solve.mesh.mesh_options import MeshOptions
from warp_partdr.solve.scene.options import SceneOptions

PAGE = Path(__file__).resolve().parents[2] / "docs/reference/settings.md"
SECTIONS = {
    "Photos": FitOptions,
    "Stages": Stage,
    "Weights": Weights,
    "Exact ellipsoids": RendererEllipsoids,
    "Mesh of the ellipsoids": RendererMesh,
    "Mesh stage": MeshOptions,
    "Films": SceneOptions,
    "Registration": RegistrationOptions,
}

pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="needs the pages beside the tests")


def written(field: Field) -> str | None:
    """Default of a field as the page writes it; None for those that have a table of their own."""
    if field.default is MISSING:
        return "" if field.default_factory is MISSING else None
    if field.default is None:
        return "none"
    if isinstance(field.default, bool):
        return str(field.default).lower()
    if isinstance(field.default, tuple) and field.default:
        return None
    return f"{field.default:g}" if isinstance(field.default, float) else str(field.default)


@pytest.mark.parametrize("name", SECTIONS)
def test_the_page_lists_each_field_with_its_default(name: str) -> None:
    section = PAGE.read_text(encoding="utf-8").partition(f"\n## {name}\n")[2].partition("\n## ")[0]
    rows = re.findall(r"(?m)^\| `(\w+)` \| [^|]*\|([^|]*)\| [^|]+ \|$", section)
    listed = {key: default.strip() for key, default in rows}
    own = fields(SECTIONS[name])
    assert list(listed) == [field.name for field in own]
    for field in own:
        default = written(field)
        if default is None:
            assert listed[field.name].startswith("["), f"{field.name}: leads to its table"
        else:
            assert listed[field.name] == default, field.name
