"""Settings of a fit by name, as ``partdr fit --config`` and ``--set`` have them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from ...errors import InputError, shown
from ...files.sections import check_keys, read_section
from ...render.renderers import RendererMesh
from .energy import Weights
from .options import FitOptions
from .stages import OUTLINE, Stage

LABELS_FIRST = "labels-first"
MESH = "mesh"  # the stage
TRIANGLES = "triangles"
_FIELDS = tuple(field.name for field in fields(FitOptions) if field.name != "start")


def change_options(options: FitOptions, values: Mapping[str, Any]) -> FitOptions:
    """Options with some settings changed.

    Args:
        options: Options to begin with, such as ``FitOptions.at("fast")``.
        values: Fields of ``FitOptions``, all but ``start``; ``weights`` changes those of all stages, too. Under a
            stage's name, fields of that ``Stage``; under ``search``, the same for stages of the search. ``triangles``,
            true or fields of ``RendererMesh``, draws ellipsoids by that in every stage. ``outline``, true, fields of
            its ``Stage`` or "labels-first", adds that stage (``FitOptions.with_outline``).

    Raises:
        InputError: If a key is unknown, or its value is wrong or excludes another one.

    Examples:
        >>> from warp_partdr import FitOptions, change_options
        >>> options = change_options(FitOptions.at("fast"), {"weights": {"limits": 30.0}, "labels": {"iterations": 80}})
        >>> options.stages[0].iterations, options.stages[0].weights.limits
        (80, 30.0)
    """
    own = {name: value for name, value in values.items() if name in _FIELDS}
    if not isinstance(mesh := own.get(MESH, {}), Mapping):
        message = f"{MESH}: {shown(mesh)}; expected a table of the mesh stage"
        raise InputError(f"{message} (ellipsoids are drawn as a mesh by {TRIANGLES}=true)")
    if OUTLINE in values:
        options = _add_outline(options, values[OUTLINE], triangles=values.get(TRIANGLES, False) is not False)
    weights = own.get("weights", {})
    usual = read_section(Weights, weights, "weights", options.weights)
    options = replace(options, search=_change_weights(options.search, weights))
    if isinstance(search := own.get("search"), Mapping):
        options = replace(options, search=_change_stages(options.search, search, usual, "search"))
        del own["search"]
    options = read_section(type(options), own, base=options)
    names = [stage.name for stage in options.stages]
    check_keys(values, dict.fromkeys([*_FIELDS, TRIANGLES, *names, OUTLINE]))
    tables = {name: value for name, value in values.items() if name not in _FIELDS}
    triangles = tables.pop(TRIANGLES, False)
    if not isinstance(tables.get(OUTLINE, {}), Mapping):  # true, false or labels-first, which change no field
        del tables[OUTLINE]
    if triangles is not False:
        options = _draw_mesh(options, {} if triangles is True else triangles)
    return replace(options, stages=_change_stages(_change_weights(options.stages, weights), tables, usual))


def _change_weights(stages: tuple[Stage, ...], weights: object) -> tuple[Stage, ...]:
    """Change some weights of the stages that have weights of their own."""
    return tuple(
        stage
        if stage.weights is None
        else replace(stage, weights=read_section(Weights, weights, "weights", stage.weights))
        for stage in stages
    )


def _add_outline(options: FitOptions, outline: object, *, triangles: bool) -> FitOptions:
    if outline == LABELS_FIRST and triangles:
        message = f"{OUTLINE}: {LABELS_FIRST}, with {TRIANGLES}, which have no coverage gradient"
        raise InputError(f"{message}; expected one of two")
    if outline is False:
        return options
    if outline is True or outline == LABELS_FIRST or isinstance(outline, Mapping):
        return options.with_outline(labels_first=outline == LABELS_FIRST)
    raise InputError(f"{OUTLINE}: {shown(outline)}; expected true, false, a table or {LABELS_FIRST!r}")


def _draw_mesh(options: FitOptions, values: object) -> FitOptions:
    """Replace all renderers by the mesh, with their own ``max_distance`` unless it is given."""
    mesh = read_section(RendererMesh, values, TRIANGLES)
    assert isinstance(values, Mapping)
    if "tolerance" in values and mesh.subdivisions != "auto":
        raise InputError(f"{TRIANGLES}.tolerance: {mesh.tolerance}; expected {TRIANGLES}.subdivisions=auto with it")
    if "max_distance" in values:
        return options.drawn_by(lambda old: mesh)
    return options.drawn_by(lambda old: replace(mesh, max_distance=old.max_distance))


def _change_stages(
    stages: tuple[Stage, ...], tables: Mapping[str, Any], usual: Weights, where: str = ""
) -> tuple[Stage, ...]:
    """Change stages by the tables of their names. A stage without weights of its own changes from the usual ones."""

    def before(stage: Stage) -> Stage:
        table = tables.get(stage.name)
        some = isinstance(table, Mapping) and isinstance(table.get("weights"), Mapping)
        return replace(stage, weights=usual) if some and stage.weights is None else stage

    check_keys(tables, [stage.name for stage in stages], where)
    names = {stage.name: f"{where}.{stage.name}" if where else stage.name for stage in stages}
    return tuple(read_section(Stage, tables.get(stage.name, {}), names[stage.name], before(stage)) for stage in stages)
