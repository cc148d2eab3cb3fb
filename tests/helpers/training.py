"""The smallest task there is, a linear regression, for tests of the training loop, also in other processes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch
from PIL import Image
from safetensors.torch import load_file, save_file

from warp_partdr.lab.training.config import TrainingConfig, find_task, make_config
from warp_partdr.lab.training.task import Task, weighted_losses

TASK = "helpers.training:TinyTask"


@dataclass(frozen=True)
class TinyModel:
    inputs: int = 4
    dropout: float = 0.2


@dataclass(frozen=True)
class TinyData:
    """``joint``: the processes share batches of so many rows."""

    noise: float = 0.1
    joint: int = 0


@dataclass(frozen=True)
class TinyBatch:
    inputs: torch.Tensor
    wanted: torch.Tensor


class TinyTask(Task):
    MODEL = TinyModel
    DATA = TinyData
    WEIGHTS = MappingProxyType({"fit": 1.0, "small": 1e-3})
    epoch: int | None = 64

    def __init__(self, config: TrainingConfig, *, rank: int, processes: int, device: torch.device) -> None:
        super().__init__(config, rank=rank, processes=processes, device=device)
        self.generator = torch.Generator().manual_seed(config.seed + (0 if config.data.joint else 1000 * rank))
        self.made = 0

    def model(self) -> torch.nn.Module:
        sizes = self.config.model
        return torch.nn.Sequential(
            torch.nn.Linear(sizes.inputs, 8, bias=False),
            torch.nn.BatchNorm1d(8),
            torch.nn.Dropout(sizes.dropout),
            torch.nn.Linear(8, 1),
        )

    def batch(self, device: torch.device) -> TinyBatch:
        data = self.config.data
        count = data.joint or self.config.batch_size
        inputs = torch.randn(count, self.config.model.inputs, generator=self.generator)
        wanted = inputs.sum(1, keepdim=True) + data.noise * torch.randn(count, 1, generator=self.generator)
        if data.joint:
            inputs, wanted = inputs[self.rank :: self.processes], wanted[self.rank :: self.processes]
        self.made += 1
        return TinyBatch(inputs.to(device), wanted.to(device))

    def loss(self, model: torch.nn.Module, batch: TinyBatch) -> dict[str, torch.Tensor]:
        error = model(batch.inputs) - batch.wanted
        terms = {"fit": error.square().mean(), "small": error.abs().mean()}
        return weighted_losses(terms, self.config.weights, self.left_out)

    def validate(self, model: torch.nn.Module, device: torch.device) -> dict[str, float]:
        inputs = torch.linspace(-1, 1, 8 * self.config.model.inputs).reshape(8, -1).to(device)
        torch.rand(3)  # what validation draws must not matter to training
        return {"error": float((model(inputs) - inputs.sum(1, keepdim=True)).abs().mean())}

    def pictures(self, model: torch.nn.Module, device: torch.device) -> Image.Image | None:
        return Image.new("RGB", (4, 3))

    def save(self, path: Path, weights: Mapping[str, torch.Tensor], about: Mapping[str, Any], *, bits: int) -> None:
        save_file({name: value.half() if bits == 16 else value for name, value in weights.items()}, path)

    def read(self, source: str) -> Mapping[str, torch.Tensor]:
        return load_file(source)

    def skipped(self) -> Sequence[str]:
        return ["picture7: damaged"]

    def state_dict(self) -> dict[str, Any]:
        return {"generator": self.generator.get_state(), "made": self.made}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.generator.set_state(state["generator"])
        self.made = state["made"]


def tiny_config(out: Path, **values: Any) -> TrainingConfig:
    """A config of this task."""
    numbers = {"task": TASK, "steps": 6, "batch_size": 8, "learning_rate": 0.01, "log_every": 4, "validate_every": 2}
    return make_config({**numbers, "out": str(out), **values})


def make_task(config: TrainingConfig, rank: int = 0, processes: int = 1) -> Task:
    """The config's task on the CPU."""
    task: Task = find_task(config.task)(config, rank=rank, processes=processes, device=torch.device("cpu"))
    return task
