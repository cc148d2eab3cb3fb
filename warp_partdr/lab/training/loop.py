"""The training loop, the same on one processor, many GPUs or many machines (``accelerate``)."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ...errors import InputError, cause, install_command
from ...interop.precision import matmul_precision
from ...networks.regression.checkpoint import check_weight_bits
from .checkpoints import (
    Checkpoint,
    list_checkpoints,
    load_checkpoint,
    load_optimizer,
    optimizer_tensors,
    save_checkpoint,
)
from .config import Phase, TrainingConfig, find_task
from .guards import FiniteWatch, memory_errors, signals
from .joint_norm import normalise_jointly
from .logs import RunLog
from .optimizers import make_optimizer
from .running_mean import RunningMean
from .task import Task

MODEL_FILE = "model.safetensors"
REPORT_FILE = "report.json"
_KEPT = ("step", "summed", "errors", "validated")  # attributes of a run, in its checkpoints


@dataclass(frozen=True)
class Trained:
    """Result of a run."""

    step: int  # steps done in all
    stopped: int | None  # the signal that stopped it, None if it is complete
    report: dict[str, Any]  # of report.json, errors of the last validation; empty in all processes but the first


def run_training(
    config: TrainingConfig, *, resume: bool = False, device: str = "auto", bits: int | None = None
) -> Trained:
    """Train, and write checkpoints, logs, pictures, the trained network and a report to ``config.out``.

    Started by ``torchrun`` or ``accelerate launch`` it is one of several processes that train together.

    Args:
        config: Numbers of the run.
        resume: True goes on from the newest checkpoint in ``config.out``, where there is one.
        device: Device, "auto", "cpu" or "cuda".
        bits: Bits of each weight of the trained network in its file, 32, 16 or 8, see ``NetworkFiles.save``. None
            takes the task's, ``Task.BITS``.

    Raises:
        InputError: If the folder holds a run and ``resume`` is not set; if a checkpoint is damaged or of another
            config; if a loss is NaN; if the GPU's memory is too small; if there are no such files.
    """
    bits = find_task(config.task).BITS if bits is None else bits
    check_weight_bits(bits)
    torch.backends.cudnn.benchmark = True  # batches have one shape, for which the fastest convolutions are looked up
    with memory_errors(config), _accelerated(config, device) as accelerator:
        return _Run(config, accelerator, resume=resume).go(bits)


@contextmanager
def _accelerated(config: TrainingConfig, device: str) -> Iterator[Any]:
    """Accelerate's accelerator for one run; afterwards it forgets precision and device, so that others may follow."""
    try:
        from accelerate import Accelerator, DistributedDataParallelKwargs
        from accelerate.state import AcceleratorState, GradientState
    except ImportError as error:
        raise InputError(f"{error}; expected what training needs: {install_command('train')}") from error
    accelerator = Accelerator(
        cpu=device == "cpu",
        mixed_precision=config.precision,
        gradient_accumulation_steps=config.accumulation,
        kwargs_handlers=[
            # Buffers are running statistics, with joint normalisation the same in every process, else each one's own:
            # nothing to send at each step. Those of the first process are validated, saved and released.
            DistributedDataParallelKwargs(gradient_as_bucket_view=True, broadcast_buffers=False)
        ],
    )
    try:
        yield accelerator
    finally:
        accelerator.end_training()
        AcceleratorState._reset_state(reset_partial_state=True)
        GradientState._reset_state()


class _Run:
    def __init__(self, config: TrainingConfig, accelerator: Any, *, resume: bool) -> None:
        from accelerate.utils import set_seed

        from ...results.result_sets import check_folder

        self.config, self.accelerator = config, accelerator
        self.checkpoints = config.out / "checkpoints"
        found = list_checkpoints(self.checkpoints)
        if found and not resume:
            raise InputError(f"{config.out}: holds a run; expected --resume to go on with it, or another --out")
        check_folder(config.out)
        config.out.mkdir(parents=True, exist_ok=True)

        self.device: torch.device = accelerator.device
        self.processes, rank = accelerator.num_processes, accelerator.process_index
        task = find_task(config.task)
        self.task: Task = task(config, rank=rank, processes=self.processes, device=self.device)
        self.steps = _count_steps(config, self.task.epoch, self.processes)
        set_seed(config.seed)
        self.bare = self.task.model().to(self.device)
        if config.initial is not None and not found:
            self.bare.load_state_dict(self.task.read(config.initial))
        set_seed(config.seed, device_specific=True)
        self.mean = RunningMean(self.bare, config.ema)
        if self.processes > 1 and config.joint_normalisation:
            normalise_jointly(self.bare)
        self.names = {parameter: name for name, parameter in self.bare.named_parameters()}
        _check_frozen(config, self.names.values())
        self.optimizer = make_optimizer(config, self.bare, self.device)
        if config.compile:
            self.bare.compile()
        self.model = accelerator.prepare(self.bare)

        self.step = 0
        self.share = 0.0  # how much of the run is over, the larger of steps and time
        self.sums: dict[str, torch.Tensor] = {}  # of the terms since the last line of the log
        self.summed = 0  # steps in these
        self.phase: Phase | None = None
        self.errors: dict[str, float] = {}
        self.validated = 0  # the step
        self.told: list[int] = []  # signals that this process was sent
        self.stopped: int | None = None  # one of any process, once all know of it
        self.seconds = 0.0  # of earlier parts of the run
        self.aside = 0.0  # seconds of this part that went into validation and checkpoints
        suffix = f"-rank-{rank}" if self.processes > 1 else ""
        self.watch = FiniteWatch(config.out / f"nan-batch{suffix}.safetensors")
        said = self._resume(found[-1], rank) if found else []
        if resume:
            said.append(f"goes on from step {self.step}" if found else f"no checkpoint in {config.out}: begins anew")
        self.first = self.saved = self.step
        self.logged = 0.0, self.step  # when, in seconds of this part
        self.log = RunLog(config.out, self.step, self.steps, silent=not accelerator.is_main_process)
        for line in said:
            self.log.say(line)

    def go(self, bits: int) -> Trained:
        self.began = time.monotonic()
        with signals() as self.told, self.log:
            self._agree()
            while self.step < self.steps and self.share < 1 and self.stopped is None:
                self._train_step()
                if self.step % self.config.log_every == 0:
                    self._agree()
                    self._say()
                elif self.processes == 1:
                    self._agree()
                self.log.advance(self.share)
                if self.config.validate_every and self.step % self.config.validate_every == 0:
                    self._validate()
                if self.step % self.config.checkpoint_every == 0:
                    self._save()
            if self.stopped is None and self.validated < self.step:
                self._validate()
            if self.saved < self.step:
                self._save()
            report = self._report()
            if self.stopped is None and report:
                self.task.save(self.config.out / MODEL_FILE, self.mean.module.state_dict(), report, bits=bits)
                (self.config.out / REPORT_FILE).write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
        self.accelerator.wait_for_everyone()
        return Trained(self.step, self.stopped, report)

    @property
    def elapsed(self) -> float:
        return self.seconds + time.monotonic() - self.began

    @property
    def working(self) -> float:
        """Seconds of this part that went into steps."""
        return time.monotonic() - self.began - self.aside

    @property
    def step_size(self) -> int:
        """Samples of a step, of all processes."""
        return self.config.batch_size * self.config.accumulation * self.processes

    def _agree(self) -> None:
        """Let all processes know how much is over, and whether one of them was told to stop."""
        limit = self.config.minutes
        gathered = [self.elapsed / (60 * limit) if limit else 0.0, max(self.told, default=0)]
        if self.processes > 1:
            gathered = self.accelerator.gather(torch.tensor([gathered], device=self.device)).amax(0).tolist()
        self.share = max(self.step / self.steps, gathered[0])
        self.stopped = int(gathered[1]) or None

    def _train_step(self) -> None:
        config = self.config
        phase, rate = config.phase_at(self.share), config.learning_rate_at(self.step, self.share)
        if phase != self.phase:
            self.task.begin(phase)
            self.phase = phase
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.model.train()
        totals, batches = [], []
        for _ in range(config.accumulation):
            with self.accelerator.accumulate(self.model):  # gradients are exchanged after the last one alone
                batch = self.task.batch(self.device)
                with matmul_precision("high" if config.tf32 and self.device.type == "cuda" else "highest"):
                    terms = self.task.loss(self.model, batch)
                    self.accelerator.backward(terms["total"])
            for name, term in terms.items():
                self.sums[name] = self.sums.get(name, 0) + term.detach().float() * (1 / config.accumulation)
            totals.append(terms["total"].detach().float())
            batches.append(batch)
        gradient = self._clip(phase)
        self.sums["gradient"] = self.sums.get("gradient", 0) + gradient
        self.optimizer.step()
        self.optimizer.zero_grad()
        self.step += 1
        self.summed += 1
        self.mean.update(self.bare)
        self.share = max(self.step / self.steps, self.share)
        self.watch.see(self.step, [*totals, gradient], batches)

    def _clip(self, phase: Phase) -> torch.Tensor:
        if phase.frozen:
            for parameter, name in self.names.items():
                if name.startswith(phase.frozen):
                    parameter.grad = None  # AdamW leaves it alone, and the norm doesn't count it
        return torch.nn.utils.clip_grad_norm_(self.bare.parameters(), self.config.clip)

    def _say(self) -> None:
        """Write the losses' means since the last time; waits for the device."""
        means = torch.stack([*self.sums.values()]) / self.summed
        if self.processes > 1:
            means = self.accelerator.reduce(means, "mean")
        terms = dict(zip(self.sums, means.tolist(), strict=True))
        (before, step), self.logged = self.logged, (self.working, self.step)
        rates = {
            "learning_rate": self.optimizer.param_groups[0]["lr"],
            "gradient": terms.pop("gradient"),
            "samples/s": (self.step - step) * self.step_size / (self.logged[0] - before),
        }
        self.log.losses(self.step, terms, rates)
        self.sums, self.summed = {}, 0

    def _validate(self) -> None:
        self.validated = self.step
        if not self.accelerator.is_main_process:
            return
        devices = [self.device] if self.device.type == "cuda" else []
        with self._set_aside(), torch.no_grad(), torch.random.fork_rng(devices):
            self.errors = self.task.validate(self.mean.module, self.device)
            self.log.errors(self.step, self.errors, self.task.pictures(self.mean.module, self.device))

    @contextmanager
    def _set_aside(self) -> Iterator[None]:
        """Leave the time within out of the training's."""
        self.watch.settle()
        began = time.monotonic()
        yield
        self.aside += time.monotonic() - began

    def _save(self) -> None:
        from accelerate.utils import gather_object, send_to_device

        self.saved = self.step
        with self._set_aside():
            own = send_to_device({"task": self.task.state_dict(), "sums": self.sums}, "cpu")
            cuda = torch.cuda.get_rng_state(self.device) if self.device.type == "cuda" else None
            ranks = gather_object([{"torch": torch.get_rng_state(), "cuda": cuda, "own": own}])
            if not self.accelerator.is_main_process:
                return
            tensors = {
                "model": self.bare.state_dict(),
                "mean": self.mean.module.state_dict(),
                "optimizer": optimizer_tensors(self.optimizer, self.names),
            }
            about = {name: getattr(self, name) for name in _KEPT}
            about |= {"seconds": self.elapsed, "config": self.config.to_json()}
            save_checkpoint(self.checkpoints, Checkpoint(tensors, about, ranks), self.config.keep)

    def _resume(self, folder: Path, rank: int) -> list[str]:
        """Take over a checkpoint; says what of the config has changed."""
        checkpoint = load_checkpoint(folder)
        wrong, changed = self.config.changes(checkpoint.about["config"])
        if wrong:
            raise InputError(f"{folder}: {wrong[0]}; expected the same")
        if len(checkpoint.ranks) != self.processes:
            raise InputError(f"{folder}: of {len(checkpoint.ranks)} processes; expected as many, not {self.processes}")
        try:
            self.bare.load_state_dict(checkpoint.tensors["model"])
            self.mean.module.load_state_dict(checkpoint.tensors["mean"])
            load_optimizer(self.optimizer, self.names, checkpoint.tensors["optimizer"])
        except (RuntimeError, ValueError, KeyError) as error:
            raise InputError(f"{folder}: {cause(error)}; expected a checkpoint of this network") from error
        for name in ("seconds", *_KEPT):
            setattr(self, name, checkpoint.about[name])
        self.mean.steps = self.step
        state = checkpoint.ranks[rank]
        torch.set_rng_state(state["torch"])
        if self.device.type == "cuda" and state["cuda"] is not None:
            torch.cuda.set_rng_state(state["cuda"], self.device)
        self.task.load_state_dict(state["own"]["task"])
        self.sums = {name: value.to(self.device) for name, value in state["own"]["sums"].items()}
        return changed

    def _report(self) -> dict[str, Any]:
        from accelerate.utils import gather_object

        from ..bench.machine import about

        working = max(self.working, 1e-9)
        skipped = gather_object(list(self.task.skipped()))
        if not self.accelerator.is_main_process:
            return {}
        on_cuda = self.device.type == "cuda"
        return {
            "errors": self.errors,
            "steps": self.step,
            "seconds": round(self.elapsed, 1),
            "processes": self.processes,
            "samples_per_step": self.step_size,
            "samples_per_second": round((self.step - self.first) * self.step_size / working, 1),
            "resumed_at": self.first,
            "skipped": sorted(set(skipped)),
            "commit": _commit(),
            **about(self.device.type),
            **({"gpu_memory_gib": round(torch.cuda.max_memory_allocated() / 2**30, 2)} if on_cuda else {}),
            "config": self.config.to_json(),
        }


def _count_steps(config: TrainingConfig, epoch: int | None, processes: int) -> int:
    if config.epochs is None:
        assert config.steps is not None  # the config has one of them
        return config.steps
    if epoch is None:
        raise InputError(f"epochs: {config.epochs}; expected steps: this task's samples never end")
    return max(1, round(config.epochs * epoch / (config.batch_size * config.accumulation * processes)))


def _check_frozen(config: TrainingConfig, names: Collection[str]) -> None:
    for index, phase in enumerate(config.phases):
        for prefix in phase.frozen:
            if not any(name.startswith(prefix) for name in names):
                raise InputError(f"phases[{index}].frozen: {prefix}; expected the beginning of a parameter's name")


def _commit() -> str | None:
    """Commit of the package's source, with "-dirty" where files differ from it; None outside a git tree."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
