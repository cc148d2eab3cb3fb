"""Checkpoints: folders that are there as a whole or not at all, of safetensors and JSON, nothing pickled.

| file of OUT/checkpoints/step-00001000 | holds |
|---|---|
| model.safetensors | weights that are trained |
| mean.safetensors | their running mean |
| optimizer.safetensors | AdamW's moments and counts, by parameter |
| rank-0.safetensors, ... | generators, the state of the batches and losses not yet logged, of each process |
| state.json | step, time, config, the processes' other state, and the files' SHA-256 |
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Any

import torch

from ...errors import InputError, cause
from ...files.disk import file_sha256, sync
from ...files.json_files import parse_json

FORMAT = "warp-partdr training 1"
_STATE = "state.json"
_EXPECTED = "a checkpoint of partdr train"
_TENSOR = "__tensor__"  # stands in the JSON where a tensor was


@dataclass(frozen=True)
class Checkpoint:
    """Content of a checkpoint."""

    tensors: dict[str, dict[str, torch.Tensor]]  # by file and name
    about: dict[str, Any]  # JSON: step, seconds, config and the like
    ranks: list[Any]  # state of each process: tensors and JSON


def save_checkpoint(folder: Path, checkpoint: Checkpoint, keep: int) -> None:
    """Write ``folder/step-N`` and remove all but the newest ``keep``.

    It is written beside its place and then moved there, so a killed process leaves none that is not whole.
    """
    from safetensors.torch import save_file

    folder.mkdir(parents=True, exist_ok=True)
    for leftover in folder.glob(".step-*"):
        shutil.rmtree(leftover)
    place = folder / f"step-{checkpoint.about['step']:08d}"
    new = folder / f".{place.name}"
    new.mkdir()
    files = dict(checkpoint.tensors)
    ranks = []
    for rank, state in enumerate(checkpoint.ranks):
        files[f"rank-{rank}"], rest = split_tensors(state, "state")
        ranks.append(rest)
    hashes = {}
    for name, tensors in files.items():
        save_file({key: value.contiguous() for key, value in tensors.items()}, new / f"{name}.safetensors")
        hashes[name] = file_sha256(new / f"{name}.safetensors")
    state = {"format": FORMAT, **checkpoint.about, "ranks": ranks, "sha256": hashes}
    (new / _STATE).write_text(json.dumps(state, indent=1) + "\n", encoding="utf-8")
    for path in (*new.iterdir(), new):
        sync(path)
    os.replace(new, place)
    sync(folder)
    for old in list_checkpoints(folder)[:-keep]:
        gone = old.with_name(f".{old.name}")
        os.replace(old, gone)
        shutil.rmtree(gone)


def list_checkpoints(folder: Path) -> list[Path]:
    """The checkpoints in a folder, oldest first."""
    found = folder.iterdir() if folder.is_dir() else ()
    return sorted(
        (path for path in found if re.fullmatch(r"step-\d{8,}", path.name)), key=lambda path: int(path.name[5:])
    )


def load_checkpoint(folder: Path) -> Checkpoint:
    """Read a checkpoint.

    Raises:
        InputError: If it is damaged, or something else.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    expected = f"{_EXPECTED}; without the folder {folder.name} the run goes on from the one before"
    try:
        about = parse_json((folder / _STATE).read_text(encoding="utf-8"), f"{folder / _STATE}: damaged", expected)
        if not isinstance(about, dict) or about.get("format") != FORMAT:
            raise InputError(f"{folder}: of another format; expected {_EXPECTED}")
        tensors = {}
        for name, digest in about.pop("sha256").items():
            path = folder / f"{Path(name).name}.safetensors"
            if file_sha256(path) != digest:
                raise InputError(f"{path}: damaged (its SHA-256 is another); expected {expected}")
            tensors[name] = load_file(path)
        ranks = [join_tensors(tensors.pop(f"rank-{rank}"), rest) for rank, rest in enumerate(about.pop("ranks"))]
    except InputError:
        raise
    except (OSError, SafetensorError, KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputError(f"{folder}: damaged ({cause(error)}); expected {expected}") from error
    return Checkpoint(tensors, about, ranks)


def split_tensors(tree: Any, name: str) -> tuple[dict[str, torch.Tensor], Any]:
    """Split dicts with names as keys, lists, tuples and dataclasses of tensors and JSON into the two.

    Returns:
        Copies of the tensors on the CPU, whose names begin with ``name``; and JSON with each tensor's name, dataclasses
        as dicts and tuples as lists.
    """
    if isinstance(tree, torch.Tensor):
        return {name: tree.detach().cpu().clone(memory_format=torch.contiguous_format)}, {_TENSOR: name}
    if is_dataclass(tree):
        tree = vars(tree)
    if not isinstance(tree, Mapping | list | tuple):
        return {}, tree
    items = tree.items() if isinstance(tree, Mapping) else enumerate(tree)
    parts = {key: split_tensors(value, f"{name}.{key}") for key, value in items}
    tensors = {each: tensor for found, _ in parts.values() for each, tensor in found.items()}
    rest = {key: value for key, (_, value) in parts.items()}
    return tensors, rest if isinstance(tree, Mapping) else list(rest.values())


def join_tensors(tensors: Mapping[str, torch.Tensor], rest: Any) -> Any:
    """The tree that ``split_tensors`` split.

    Raises:
        KeyError: If a tensor is missing.
    """
    if isinstance(rest, list):
        return [join_tensors(tensors, value) for value in rest]
    if not isinstance(rest, dict):
        return rest
    if rest.keys() == {_TENSOR}:
        return tensors[rest[_TENSOR]]
    return {key: join_tensors(tensors, value) for key, value in rest.items()}


def optimizer_tensors(
    optimizer: torch.optim.Optimizer, names: Mapping[torch.nn.Parameter, str]
) -> dict[str, torch.Tensor]:
    """An optimizer's state: "exp_avg/PARAMETER" and so on."""
    states = ((name, optimizer.state.get(parameter, {})) for parameter, name in names.items())
    return {f"{key}/{name}": value for name, state in states for key, value in state.items()}


def load_optimizer(
    optimizer: torch.optim.Optimizer, names: Mapping[torch.nn.Parameter, str], tensors: Mapping[str, torch.Tensor]
) -> None:
    """Give an optimizer the state that ``optimizer_tensors`` took.

    Raises:
        KeyError: If a tensor is of no parameter.
        RuntimeError: If one is of another shape.
    """
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    index = {names[parameter]: position for position, parameter in enumerate(parameters)}
    state: dict[int, dict[str, torch.Tensor]] = {}
    for full, value in tensors.items():
        key, _, name = full.partition("/")
        if value.ndim:  # in the parameter's memory format
            value = torch.empty_like(parameters[index[name]], device="cpu", dtype=value.dtype).copy_(value)
        state.setdefault(index[name], {})[key] = value
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})
