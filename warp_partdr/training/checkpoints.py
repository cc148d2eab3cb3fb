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

import hashlib
import json
import os
import random
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..errors import InputError
from ..files.json_files import parse_json
from .tensor_tree import join_tensors, split_tensors

FORMAT = "warp-partdr training 1"
_STATE = "state.json"
_EXPECTED = "a checkpoint of partdr train"


@dataclass(frozen=True)
class Checkpoint:
    """Content of a checkpoint.

    Attributes:
        tensors: By file and name.
        about: JSON: step, seconds, config and the like.
        ranks: Each process' state, as ``process_state`` gives it.
    """

    tensors: dict[str, dict[str, torch.Tensor]]
    about: dict[str, Any]
    ranks: list[Any]


def save_checkpoint(folder: Path, step: int, checkpoint: Checkpoint, keep: int) -> None:
    """Write ``folder/step-N`` and remove all but the newest ``keep``.

    It is written beside its place and then moved there, so a killed process leaves none that is not whole.
    """
    from safetensors.torch import save_file

    folder.mkdir(parents=True, exist_ok=True)
    for leftover in folder.glob(".step-*"):
        shutil.rmtree(leftover)
    place = folder / f"step-{step:08d}"
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
        hashes[name] = _hash(new / f"{name}.safetensors")
    state = {"format": FORMAT, "step": step, **checkpoint.about, "ranks": ranks, "sha256": hashes}
    (new / _STATE).write_text(json.dumps(state, indent=1) + "\n", encoding="utf-8")
    for path in (*new.iterdir(), new):
        _sync(path)
    os.replace(new, place)
    _sync(folder)
    for old in list_checkpoints(folder)[:-keep]:
        gone = old.with_name(f".{old.name}")
        os.replace(old, gone)
        shutil.rmtree(gone)


def list_checkpoints(folder: Path) -> list[Path]:
    """The checkpoints in a folder, oldest first."""
    found = folder.iterdir() if folder.is_dir() else ()
    steps = {int(path.name[5:]): path for path in found if re.fullmatch(r"step-\d{8,}", path.name)}
    return [steps[step] for step in sorted(steps)]


def load_checkpoint(place: Path) -> Checkpoint:
    """Read a checkpoint.

    Raises:
        InputError: If it is damaged, or something else.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        state = place / _STATE
        about = parse_json(state.read_text(encoding="utf-8"), str(state), f"{_EXPECTED}; {_remedy(place)}")
        if not isinstance(about, dict) or about.get("format") != FORMAT:
            raise InputError(f"{place}: of another format; expected {_EXPECTED}")
        tensors = {}
        for name, digest in about.pop("sha256").items():
            path = place / f"{Path(name).name}.safetensors"
            if _hash(path) != digest:
                raise InputError(f"{path}: damaged (its SHA-256 is another); expected {_EXPECTED}; {_remedy(place)}")
            tensors[name] = load_file(path)
        ranks = [join_tensors(tensors.pop(f"rank-{rank}"), rest) for rank, rest in enumerate(about.pop("ranks"))]
    except OSError as error:
        raise InputError(f"{place}: {error.strerror or error}; expected {_EXPECTED}; {_remedy(place)}") from error
    except (SafetensorError, KeyError, TypeError, AttributeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = " ".join(str(error).split())
        raise InputError(f"{place}: damaged ({reason}); expected {_EXPECTED}; {_remedy(place)}") from error
    return Checkpoint(tensors, about, ranks)


def optimizer_tensors(
    optimizer: torch.optim.Optimizer, names: Mapping[torch.nn.Parameter, str]
) -> dict[str, torch.Tensor]:
    """An optimizer's state: "exp_avg/PARAMETER" and so on."""
    return {
        f"{key}/{name}": value.detach().cpu().clone()
        for parameter, name in names.items()
        for key, value in optimizer.state.get(parameter, {}).items()
    }


def load_optimizer(
    optimizer: torch.optim.Optimizer, names: Mapping[torch.nn.Parameter, str], tensors: Mapping[str, torch.Tensor]
) -> None:
    """Give an optimizer the state that ``optimizer_tensors`` took.

    Raises:
        ValueError: If a tensor is of no parameter, or of another shape.
    """
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    index = {names[parameter]: position for position, parameter in enumerate(parameters)}
    state: dict[int, dict[str, torch.Tensor]] = {}
    for full, value in tensors.items():
        key, _, name = full.partition("/")
        if name not in index or (value.ndim and value.shape != parameters[index[name]].shape):
            raise ValueError(f"optimizer: {full}: of no parameter here")
        if value.ndim:  # in the parameter's memory format
            value = torch.empty_like(parameters[index[name]], device="cpu", dtype=value.dtype).copy_(value)
        state.setdefault(index[name], {})[key] = value
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def process_state(own: dict[str, Any], device: torch.device) -> dict[str, Any]:
    """State of one process: all global generators, and what else is its own, on the CPU."""
    kind, keys, *rest = np.random.get_state()  # noqa: NPY002  what others draw from is saved, too
    return {
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state(device) if device.type == "cuda" else None,
        "numpy": [kind, torch.from_numpy(np.asarray(keys, dtype=np.int64)), *rest],
        "python": random.getstate(),
        "own": join_tensors(*split_tensors(own, "own")),
    }


def restore_process(state: dict[str, Any], device: torch.device) -> dict[str, Any]:
    """Set the global generators to what ``process_state`` took, and return the rest."""
    torch.set_rng_state(state["torch"])
    if device.type == "cuda" and state["cuda"] is not None:
        torch.cuda.set_rng_state(state["cuda"], device)
    kind, keys, *rest = state["numpy"]
    np.random.set_state((kind, keys.numpy().astype(np.uint32), *rest))  # noqa: NPY002
    version, numbers, gauss = state["python"]
    random.setstate((version, tuple(numbers), gauss))
    own: dict[str, Any] = state["own"]
    return own


def _remedy(place: Path) -> str:
    return f"without the folder {place.name} the run goes on from the one before"


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
