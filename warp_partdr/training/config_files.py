"""Training runs in TOML files: the package's own, and users'."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..files.sections import read_section, read_toml, set_value
from .config import TrainingConfig
from .task import find_task


def packaged_configs() -> list[str]:
    """Names of the configs that come with the package."""
    return sorted(path.name.removesuffix(".toml") for path in _packaged().iterdir() if path.name.endswith(".toml"))


def read_config(source: str | Path, overrides: Sequence[str] = ()) -> TrainingConfig:
    """A config from a TOML file or by a packaged name.

    Args:
        source: A ``.toml`` file, or one of ``packaged_configs()``.
        overrides: ``key=value``, the value as in TOML, a text without quotes too; ``data.key`` reaches into a table.

    Raises:
        InputError: If there is no such file, it is no TOML, or a key is unknown or has a wrong value.
    """
    name = str(source)
    place = Path(name) if name.endswith(".toml") else _packaged().joinpath(f"{name}.toml")
    values = read_toml(place, name, f"a .toml file, or one of {', '.join(packaged_configs())}")
    for override in overrides:
        key = set_value(values, override)
        if key in ("steps", "epochs"):  # one takes the other's place
            values.pop("epochs" if key == "steps" else "steps", None)
    return make_config(values)


def make_config(values: Mapping[str, Any]) -> TrainingConfig:
    """A config from what TOML or JSON gave; the task's own tables are read by its dataclasses.

    Raises:
        InputError: If a key is unknown, missing, or has a wrong value.
    """
    config = read_section(TrainingConfig, values)
    task = find_task(config.task)
    if unknown := config.weights.keys() - task.WEIGHTS.keys():
        raise InputError(f"weights.{min(unknown)}: unknown; expected one of {', '.join(task.WEIGHTS)}")
    for index, phase in enumerate(config.phases):
        if missing := set(phase.without) - task.WEIGHTS.keys():
            raise InputError(f"phases[{index}].without: {min(missing)}; expected some of {', '.join(task.WEIGHTS)}")
    return replace(
        config,
        weights={**task.WEIGHTS, **config.weights},
        model=read_section(task.MODEL, values.get("model", {}), "model"),
        data=read_section(task.DATA, values.get("data", {}), "data"),
    )


def _packaged() -> Any:
    return resources.files(__package__).joinpath("configs")
