"""Nested dicts of tensors and JSON as flat names and tensors, which safetensors files hold, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import torch

_TENSOR = "__tensor__"  # stands in the JSON where a tensor was


def split_tensors(tree: Any, name: str) -> tuple[dict[str, torch.Tensor], Any]:
    """Tensors by name, and the rest as JSON, with each tensor's name where it was.

    Args:
        tree: Dicts with names as keys, lists, tuples and dataclasses of tensors and JSON.
        name: Of the tree; names of tensors begin so.

    Returns:
        Tensors on the CPU, copies; and the JSON, dataclasses as dicts and tuples as lists.
    """
    if isinstance(tree, torch.Tensor):
        return {name: tree.detach().cpu().clone(memory_format=torch.contiguous_format)}, {_TENSOR: name}
    if is_dataclass(tree) and not isinstance(tree, type):
        tree = {field.name: getattr(tree, field.name) for field in fields(tree)}
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
