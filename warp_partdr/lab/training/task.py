"""The interface between the training loop and its tasks."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import torch

from .config import Phase, TrainingConfig

if TYPE_CHECKING:
    from PIL import Image

PACKAGED_NETWORK = "packaged"  # instead of a file to begin with


class Task(Protocol):
    """Model, batches, loss and errors of what is trained.

    A task draws random numbers from generators of its own, made of ``config.seed`` and ``rank``, so that each process
    has other batches, and ``state_dict`` holds them.

    Attributes:
        MODEL: Dataclass of the config's table ``[model]``; ``config.model`` is one.
        DATA: Dataclass of the config's table ``[data]``; ``config.data`` is one.
        WEIGHTS: The loss terms' weights by default; ``config.weights`` has the same names.
        BITS: Bits of each weight in the trained network's file, unless others are asked for.
        epoch: Samples in an epoch, over all processes; None where samples never end.
        left_out: Loss terms that the phase leaves out.
    """

    MODEL: ClassVar[type[Any]]
    DATA: ClassVar[type[Any]]
    WEIGHTS: ClassVar[Mapping[str, float]]
    BITS: ClassVar[int] = 32
    epoch: int | None = None
    config: TrainingConfig
    rank: int
    processes: int
    device: torch.device
    left_out: tuple[str, ...]

    def __init__(self, config: TrainingConfig, *, rank: int, processes: int, device: torch.device) -> None:
        self.config, self.rank, self.processes, self.device = config, rank, processes, device
        self.left_out = ()

    def model(self) -> torch.nn.Module:
        """A new network with random weights, drawn from torch's global generator, on any device."""

    def begin(self, phase: Phase) -> None:
        """A phase begins: ``loss`` leaves out the terms ``phase.without`` from now on. Also called on resuming."""
        self.left_out = phase.without

    def batch(self, device: torch.device) -> Any:
        """The next training batch of ``config.batch_size`` samples: tensors in a dataclass, dict, tuple or list."""

    def loss(self, model: torch.nn.Module, batch: Any) -> dict[str, torch.Tensor]:
        """The terms, each with its weight, and "total", their sum: means over the batch, shape (), left on the device.

        ``model`` may be wrapped for several processes; it is called once, as ``model(...)``. Under bf16 its forward
        runs in autocast, so what it returns is to be made float32 before it is used in geometry.
        """

    def validate(self, model: torch.nn.Module, device: torch.device) -> dict[str, float]:
        """Errors on fixed held-out samples, by name with unit ("PA-MPJPE [mm]").

        ``model`` is in evaluation mode, and no gradient is recorded; the state of the batches stays as it is.
        """

    def pictures(self, model: torch.nn.Module, device: torch.device) -> Image.Image | None:
        """A contact sheet of some of these samples."""

    def save(self, path: Path, weights: Mapping[str, torch.Tensor], about: Mapping[str, Any], *, bits: int) -> None:
        """Write a trained network (safetensors), with its sizes, for those who use it; see ``NetworkFiles.save``.

        ``weights`` are the ``state_dict`` of such a model as ``model`` returns, ``about`` is JSON of its training.
        """

    def read(self, source: str) -> Mapping[str, torch.Tensor]:
        """Weights of a trained network of ``config.model``'s sizes, from a file that ``save`` wrote, or "packaged".

        Raises:
            InputError: If there is none, or its sizes are others.
        """

    def skipped(self) -> Sequence[str]:
        """Samples that could not be read: name and reason, each once."""
        return ()

    def state_dict(self) -> dict[str, Any]:
        """State that makes the next batches what they are: tensors and JSON, in dicts with names as keys."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from such a state."""


def weighted_losses(
    terms: Mapping[str, torch.Tensor], weights: Mapping[str, float], left_out: Collection[str]
) -> dict[str, torch.Tensor]:
    """The terms times their weights, but for those left out, and "total", their sum."""
    weighted = {name: weights[name] * term for name, term in terms.items() if name not in left_out}
    return {**weighted, "total": torch.stack(list(weighted.values())).sum()}
