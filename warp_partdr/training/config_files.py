"""Training runs in TOML files: the package's own, and users'."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..files.sections import read_section
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
    try:
        values = tomllib.loads(place.read_text(encoding="utf-8"))
    except OSError as error:
        expected = f"a .toml file, or one of {', '.join(packaged_configs())}"
        raise InputError(f"{name}: {error.strerror or error}; expected {expected}") from error
    except (ValueError, RecursionError) as error:  # TOMLDecodeError and UnicodeDecodeError are ValueErrors
        raise InputError(f"{name}: {error}; expected TOML") from error
    for override in overrides:
        _set(values, override)
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


def _set(values: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    *tables, last = key.strip().split(".")
    if not equals or not last:
        raise InputError(f"--set: {override}; expected key=value")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError):
        value = text.strip()
    for name in tables:
        table = values.setdefault(name, {})
        if not isinstance(table, dict):
            raise InputError(f"--set: {override}: {name} is no table; expected one of the config's keys")
        values = table
    if not tables and last in ("steps", "epochs"):  # one takes the other's place
        values.pop("epochs" if last == "steps" else "steps", None)
    values[last] = value


def _packaged() -> Any:
    return resources.files(__package__).joinpath("configs")
