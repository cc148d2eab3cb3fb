"""Every number of a training run in one dataclass, and TOML files of them: the package's own, and users'."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module, resources
from pathlib import Path
from typing import Any, Literal

from ...errors import InputError
from ...files.sections import read_section, read_toml, set_value

# Name: module of this package and class in it.
TASKS = {
    "label-network": ".label_task:LabelTask",
    "parts": ".part_task:PartTask",
    "ellipbodynet": ".picture_task:PictureTask",
}
# May differ when a run is resumed.
_FREE = "steps epochs minutes learning_rate clip log_every validate_every checkpoint_every keep out".split()
_PACKAGED = resources.files(__package__).joinpath("configs")


@dataclass(frozen=True)
class Phase:
    """A part of a run."""

    until: float = 1.0  # share of the run at which it ends; of the last phase 1
    learning_rate: float | None = None  # at its peak; None takes the run's
    frozen: tuple[str, ...] = ()  # parameters whose names begin so don't change
    without: tuple[str, ...] = ()  # loss terms left out


@dataclass(frozen=True)
class TrainingConfig:
    """A training run."""

    task: str  # label-network, parts, ellipbodynet, or "module:Class" of one's own (``task.Task``)
    # How long: so many steps of the optimizer, or every sample seen so often, where the task counts its samples.
    steps: int | None = None
    epochs: float | None = None
    # Wall-clock limit of the run with all its resumed parts: whichever of it and ``steps`` is nearer drives the
    # schedule and ends the run.
    minutes: float | None = None
    batch_size: int = 128  # samples of a batch, per process
    accumulation: int = 1  # batches whose gradients are averaged into one step
    # A trained network of the same sizes to begin with, a file of `partdr train`; "packaged" is the one in the package.
    initial: str | None = None
    # Batch normalisation with the statistics of all processes' samples, so that the gradients are those of the joint
    # batch; without, each process has its own, which costs nothing and is enough for large batches, and the first one's
    # running statistics are saved.
    joint_normalisation: bool = True
    learning_rate: float = 1e-3  # at the peak, to which it rises linearly in the first ``warm_up`` steps
    warm_up: int = 0
    schedule: Literal["cosine", "constant"] = "cosine"  # "cosine" falls to ``floor`` over the run
    floor: float = 0.0  # share of the learning rate at the end of the cosine
    weight_decay: float = 0.0  # of AdamW, for matrices and convolutions; none for biases and normalisation
    betas: tuple[float, float] = (0.9, 0.999)  # of AdamW
    # "muon" (Jordan et al., 2024) steps matrices and convolutions between a network's first and last layers, with the
    # learning rate and decay of AdamW, which steps all else.
    optimizer: Literal["adamw", "muon"] = "adamw"
    clip: float = 1.0  # largest norm of the gradient; larger ones are scaled down; inf leaves all as they are
    # Decay of the running mean of the weights, which is what is validated and released; it starts lower, as
    # (1 + step) / (10 + step).
    ema: float = 0.999
    precision: Literal["no", "bf16"] = "no"  # "bf16": the model runs in autocast to bfloat16; "no": in float32
    compile: bool = False  # the model by torch.compile, for long runs: it takes a minute, then steps are faster
    tf32: bool = True  # on CUDA, float32 products of matrices in the step may be rounded to TF32
    log_every: int = 50  # steps between lines of the log
    validate_every: int = 1000  # steps between validations, with a picture; 0: at the end alone
    checkpoint_every: int = 1000  # steps between checkpoints; there is one at the end, too
    keep: int = 3  # checkpoints kept, the newest
    seed: int = 0  # of weights and batches; each process adds its rank
    out: Path = Path("out/train")  # folder for all that is written
    weights: dict[str, float] = field(default_factory=dict)  # of the loss terms; the task's defaults for those left out
    phases: tuple[Phase, ...] = (Phase(),)  # in order
    model: Any = None  # sizes of the network, a dataclass of the task's
    data: Any = None  # of the samples, a dataclass of the task's

    def __post_init__(self) -> None:
        if (self.steps is None) == (self.epochs is None):
            raise InputError(f"steps: {self.steps}, epochs: {self.epochs}; expected one of them")
        for name in ("steps", "batch_size", "accumulation", "log_every", "checkpoint_every", "keep"):
            _check(name, getattr(self, name), lambda value: value >= 1, "1 or more")
        for name in ("epochs", "minutes", "learning_rate"):
            _check(name, getattr(self, name), lambda value: 0 < value < float("inf"), "a positive number")
        _check("clip", self.clip, lambda value: value > 0, "a positive number")
        for name in ("warm_up", "weight_decay", "seed", "validate_every"):
            _check(name, getattr(self, name), lambda value: 0 <= value < float("inf"), "0 or more")
        _check("floor", self.floor, lambda value: 0 <= value <= 1, "a number from 0 to 1")
        for name, decay in (("ema", self.ema), ("betas[0]", self.betas[0]), ("betas[1]", self.betas[1])):
            _check(name, decay, lambda value: 0 <= value < 1, "a number from 0 to below 1")
        ends = [phase.until for phase in self.phases]
        if not ends or ends != sorted(set(ends)) or ends[0] <= 0 or ends[-1] != 1:
            raise InputError(f"phases: until {ends}; expected rising shares of the run, the last one 1")
        for index, phase in enumerate(self.phases):
            _check(f"phases[{index}].learning_rate", phase.learning_rate, lambda value: value > 0, "a positive number")

    def phase_at(self, share: float) -> Phase:
        """The phase that holds after ``share`` of the run, 0 to 1."""
        return next((phase for phase in self.phases if share < phase.until), self.phases[-1])

    def learning_rate_at(self, step: int, share: float) -> float:
        """Learning rate after ``step`` steps and ``share`` of the run, 0 to 1."""
        own = self.phase_at(share).learning_rate
        peak = self.learning_rate if own is None else own
        rise = min(1.0, (step + 1) / self.warm_up) if self.warm_up else 1.0
        if self.schedule == "constant":
            return peak * rise
        return peak * rise * (self.floor + (1 - self.floor) * 0.5 * (1 + math.cos(math.pi * min(share, 1.0))))

    def to_json(self) -> dict[str, Any]:
        """All numbers, also the defaults, as JSON gives them back."""
        values: dict[str, Any] = json.loads(json.dumps(asdict(self), default=str))
        return values

    def changes(self, before: Mapping[str, Any]) -> tuple[list[str], list[str]]:
        """Lines of differences from a run's ``to_json``: what resuming it must keep, and what it may change."""
        lines: tuple[list[str], list[str]] = [], []
        for name, value in self.to_json().items():
            if before.get(name) != value:
                lines[name in _FREE].append(f"{name} was {before.get(name)}, is {value}")
        return lines


def _check(name: str, value: float | None, fits: Any, expected: str) -> None:
    if value is not None and not fits(value):
        raise InputError(f"{name}: {value}; expected {expected}")


def packaged_configs() -> list[str]:
    """Names of the configs that come with the package."""
    return sorted(path.name.removesuffix(".toml") for path in _PACKAGED.iterdir() if path.name.endswith(".toml"))


def read_config(source: str | Path, overrides: Sequence[str] = ()) -> TrainingConfig:
    """A config from a ``.toml`` file, or one of ``packaged_configs()``.

    An override is ``key=value``, the value as in TOML, a text without quotes too; ``data.key`` reaches into a table.

    Raises:
        InputError: If there is no such file, it is no TOML, or a key is unknown or has a wrong value.
    """
    name = str(source)
    path = Path(name) if name.endswith(".toml") else _PACKAGED.joinpath(f"{name}.toml")
    values = read_toml(path, name, f"a .toml file, or one of {', '.join(packaged_configs())}")
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


def find_task(name: str) -> type[Any]:
    """The class of a task (``task.Task``): one of ``TASKS``, or "module:Class" of one's own.

    Raises:
        InputError: If there is no such task.
    """
    module, _, attribute = TASKS.get(name, name).partition(":")
    expected = f"expected {', '.join(TASKS)} or module:Class"
    if not attribute:
        raise InputError(f"task: {name}; {expected}")
    try:
        task: type[Any] = getattr(import_module(module, __package__), attribute)
    except (ImportError, AttributeError) as error:
        raise InputError(f"task: {name}: {error}; {expected}") from error
    return task
