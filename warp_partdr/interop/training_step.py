"""Steps of a training: loss, gradient and optimiser, on CUDA as one captured graph that Python only starts.

Python needs ten times as long to launch a step's short kernels as a GPU needs to run them. A graph of the whole step is
one launch. What it launches is fixed, so each shape of the inputs has a graph, the learning rate is read from a tensor,
and checks can't wait: a kernel notes the first step that is not finite in the host's memory, where the next call looks.
"""

from __future__ import annotations

import warnings
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any
from weakref import ref

import numpy as np
import torch
import warp as wp

from ..errors import check_whole
from ..kernels.checks import launch_watch_step
from .arrays import warp_array
from .captured_step import CapturedStep
from .gradient_mode import with_gradients
from .streams import launching, on_side_stream, on_torch_stream

if TYPE_CHECKING:
    from torch.optim import Optimizer

_Inputs = tuple[torch.Tensor, ...]
_NOT_IN_KEY = ("params", "lr", "initial_lr")  # of an optimiser's groups

_NO_WAITING = (
    "Within the step nothing may wait for the device: expected no .item(), print or `if` of a tensor, no copy to or "
    "from the CPU (make what torch.tensor makes outside), validate=False in functions that check numbers, and no "
    "generator that `generators` doesn't name. captured=False takes the same steps one kernel at a time"
)


class TrainingStep:
    """Steps of a training: a loss, its gradient, and an optimiser's step; on CUDA, one captured graph for each shape.

    ``step(*inputs)`` does what this loop does, with the same results, and returns the loss before the step::

        optimizer.zero_grad()
        loss = function(*inputs)
        loss.backward()
        optimizer.step()

    On CUDA, the first call with new shapes runs kernel by kernel, which loads what is needed. The second one captures
    the step and replays it, and later ones copy the inputs to fixed memory and replay it. Each call is one step. On the
    CPU, all calls run the loop.

    The function is called twice for each shape, and never again. So tensors that it reads besides its inputs must stay
    the same ones, changed in place, and Python's numbers in it stay as they were. Random numbers of torch on the device
    are new in each step. ``torch.autocast`` must stand in the function. Learning rates may change at any time, by a
    scheduler or by hand. Another change of the optimiser's options, or of what it trains, captures anew.

    Where the choice is left open, the optimiser is made ``capturable`` and ``fused`` on CUDA. It must be one of torch's
    that can be, such as Adam, AdamW or SGD.

    Args:
        function: Function of tensors that returns a loss, a tensor of one number. On CUDA it must not wait for the
            device.
        optimizer: Optimiser of the parameters, all on one device. Gradients are gone after a step.
        clip_norm: Largest norm of the gradient of all parameters; a larger one is scaled down to it. None: any.
        accumulation: Number of parts that the inputs are cut into, along their first dimension. Their gradients are
            averaged, so that a large batch takes the memory of a small one.
        generators: Generators on the device that the function draws from, besides torch's own one.
        max_graphs: Number of graphs that are kept. They share their memory; the least recently used one goes first.
        captured: False runs all calls kernel by kernel, with the optimiser's options as they are.

    Attributes:
        gradient_norm: Norm of the gradient of the last step before it was clipped, shape (); None before a step.
        num_graphs: Number of graphs that are kept now.

    Raises:
        ValueError: If an argument is out of range, parameters are on several devices, or, at a call, inputs can't be
            used, the loss is not one number with a gradient, or autocast is on around it.
        TypeError: If the optimiser can't be captured.
        RuntimeError: If torch trains in several processes, or at a call, if the step waits for the device.
        FloatingPointError: At a call, and by ``check``, if the loss or the gradient of an earlier step was NaN or
            infinite.

    Examples:
        >>> import torch
        >>> from warp_partdr import BodyParameters, RendererEllipsoids, TrainingStep
        >>> labels = torch.zeros(1, 64, 64, dtype=torch.uint8)
        >>> leaves, renderer = BodyParameters.mean(1).leaves(log_sizes=True), RendererEllipsoids("edges")
        >>> optimizer = torch.optim.Adam(leaves.tensors().values(), lr=0.01)
        >>> step = TrainingStep(lambda target: renderer.crop_loss(leaves.bodies(), target).sum(), optimizer)
        >>> losses = [step(labels) for _ in range(3)]
        >>> step.check()
        >>> bool(losses[2] < losses[0])
        True
    """

    def __init__(
        self,
        function: Callable[..., torch.Tensor],
        optimizer: Optimizer,
        *,
        clip_norm: float | None = None,
        accumulation: int = 1,
        generators: Sequence[torch.Generator] = (),
        max_graphs: int = 8,
        captured: bool = True,
    ) -> None:
        if clip_norm is not None and not clip_norm > 0:
            raise ValueError(f"clip_norm: {clip_norm}; expected a positive number or None")
        self._function, self._clip_norm = function, clip_norm
        self._accumulation = check_whole("accumulation", accumulation, 1)
        self._generators = tuple(generators)
        self._max_graphs = check_whole("max_graphs", max_graphs, 1)
        self._optimizer = _unwrapped(optimizer)
        _check_processes()
        self._device = _device_of(self._optimizer)
        self._graphs: OrderedDict[Hashable, _Graph | None] = OrderedDict()  # None after the first call
        self._num_forgotten = 0
        self._norm: torch.Tensor | None = None
        self._captured = captured and self._device.type == "cuda"
        with torch.inference_mode(False):
            self._watch = _Watch(self._device)
        if self._captured:
            self._stream = torch.cuda.Stream(self._device)
            self._pool = torch.cuda.graph_pool_handle()
            self._prepare()
            self._optimizer.register_load_state_dict_post_hook(partial(_prepare_again, ref(self)))

    @property
    def gradient_norm(self) -> torch.Tensor | None:
        """Norm of the gradient of the last step before it was clipped, shape (); None before a step."""
        return None if self._norm is None else self._norm.clone()

    @property
    def num_graphs(self) -> int:
        """Number of graphs that are kept now."""
        return sum(graph is not None for graph in self._graphs.values())

    def check(self) -> None:
        """Wait for the device, and raise FloatingPointError if a step's loss or gradient was NaN or infinite.

        Calls look without waiting, so they raise as soon as the device is through with that step.
        """
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)
        self._watch.look()

    def __call__(self, *inputs: torch.Tensor) -> torch.Tensor:
        """Take a step.

        Args:
            *inputs: Inputs of the function, on any device. From pinned memory they are copied without waiting.

        Returns:
            The loss before the step, shape (), without gradient, on the parameters' device.
        """
        self._watch.look()
        self._check_inputs(inputs)
        if not self._captured:
            return self._step_now(inputs)
        if torch.is_autocast_enabled("cuda"):
            raise ValueError("torch.autocast: around a TrainingStep; expected it in the function")
        if len(self._rates.tensors) != len(self._optimizer.param_groups):
            self._prepare()
        self._rates.update()
        key = tuple([(each.shape, each.dtype) for each in inputs]), *map(_about, self._optimizer.param_groups)
        if key not in self._graphs:
            self._renew_accumulators()
            with on_side_stream(self._stream), self._rates.on_device():
                loss = self._step_now(inputs)
            self._remember(key, None)
            return loss
        graph = self._graphs[key] or self._capture(inputs)
        self._remember(key, graph)
        loss, self._norm = graph.replay(inputs)
        return loss.clone()

    def _prepare(self) -> None:
        """Let the optimiser's steps be captured: options, counts of steps and learning rates on the device."""
        _make_capturable(self._optimizer, self._device)
        with torch.inference_mode(False):
            self._rates = _Rates(self._optimizer, self._device)
        with launching():  # no graph may be freed while another one is captured
            self._graphs.clear()

    @with_gradients()
    def _step_now(self, inputs: _Inputs) -> torch.Tensor:
        """Take a step kernel by kernel, and return the loss."""
        here = [each.to(self._device, non_blocking=True) for each in inputs]
        # Autograd refuses tensors of inference mode.
        loss, self._norm = self._step(tuple([each.clone() if each.is_inference() else each for each in here]))
        return loss

    @with_gradients()
    def _capture(self, inputs: _Inputs) -> _Graph:
        self._renew_accumulators()
        buffers = tuple([torch.empty_like(each, device=self._device) for each in inputs])
        try:
            with self._rates.on_device():
                captured = CapturedStep(
                    lambda: self._step(buffers),
                    self._device,
                    stream=self._stream,
                    pool=self._pool,
                    generators=self._generators,
                )
        except RuntimeError as error:
            for parameter in _parameters(self._optimizer):
                parameter.grad = None  # in memory of the graph
            raise RuntimeError(
                f"TrainingStep: the step can't be captured as a CUDA graph ({_first(error)}). {_NO_WAITING}"
            ) from error
        return _Graph(buffers, captured)

    def _renew_accumulators(self) -> None:
        """Let autograd make the nodes anew at which the gradients of parameters end.

        A node that an earlier loop's graph of gradients keeps alive belongs to the stream of that time, usually the
        default one, and a capture must not touch that one. Torch forgets it when the data changes its type.
        """
        for parameter in _parameters(self._optimizer):
            data = parameter.data
            parameter.data = data.new_empty(0, dtype=torch.float64 if data.dtype == torch.float32 else torch.float32)
            parameter.data = data

    def _remember(self, key: Hashable, graph: _Graph | None) -> None:
        self._graphs[key] = graph
        self._graphs.move_to_end(key)
        if len(self._graphs) <= self._max_graphs:
            return
        with launching():
            self._graphs.popitem(last=False)
        self._num_forgotten += 1
        if self._num_forgotten == self._max_graphs:
            warnings.warn(
                f"TrainingStep: more than max_graphs = {self._max_graphs} shapes of inputs or options of the optimiser "
                "take turns, so that steps are captured again and again; pad inputs to few shapes, or raise max_graphs",
                stacklevel=3,
            )

    def _check_inputs(self, inputs: _Inputs) -> None:
        for index, each in enumerate(inputs):
            if not isinstance(each, torch.Tensor):
                raise TypeError(f"inputs[{index}]: {type(each).__name__}; expected a torch.Tensor")
            if each.requires_grad:
                raise ValueError(
                    f"inputs[{index}]: has a gradient; expected none: compute it in the function, or detach it"
                )
            if self._accumulation > 1 and (each.dim() == 0 or len(each) % self._accumulation):
                raise ValueError(
                    f"inputs[{index}]: shape {tuple(each.shape)}; expected a first dimension that accumulation = "
                    f"{self._accumulation} divides"
                )

    def _step(self, inputs: _Inputs) -> tuple[torch.Tensor, torch.Tensor]:
        """Take a step, which may be captured; returns the loss and the gradient's norm, shape () each."""
        parameters = [each for each in _parameters(self._optimizer) if each.requires_grad]
        loss, found = self._find_gradients(inputs, parameters)
        trained = [each for each, gradient in zip(parameters, found, strict=True) if gradient is not None]
        gradients = [
            _laid_out(gradient, parameter)
            for parameter, gradient in zip(parameters, found, strict=True)
            if gradient is not None
        ]
        norm = torch.nn.utils.get_total_norm(gradients)
        if self._clip_norm is not None:  # as torch's ``clip_grad_norm_``, but not in place: others may hold them, too
            share = (self._clip_norm / (norm + 1e-6)).clamp(max=1.0)
            gradients = list(torch._foreach_mul(gradients, share))
        self._optimizer.zero_grad()
        for parameter, gradient in zip(trained, gradients, strict=True):
            parameter.grad = gradient
        self._optimizer.step()
        self._optimizer.zero_grad()
        self._watch.see(loss, norm)
        return loss, norm

    def _find_gradients(
        self, inputs: _Inputs, parameters: list[torch.Tensor]
    ) -> tuple[torch.Tensor, list[torch.Tensor | None]]:
        """Compute the loss, and the gradient with respect to each parameter; None if the loss does not depend on it."""
        count = self._accumulation
        parts = list(zip(*(each.chunk(count) for each in inputs), strict=True)) if count > 1 else [inputs]
        sums: list[torch.Tensor | None] = [None] * len(parameters)
        losses = []
        for part in parts:
            loss = _checked(self._function(*part)) / len(parts)
            gradients = torch.autograd.grad(loss, parameters, allow_unused=True)
            for index, gradient in enumerate(gradients):
                if gradient is not None:
                    before = sums[index]
                    sums[index] = gradient if before is None else before + gradient
            losses.append(loss.detach())
        return torch.stack(losses).sum() if len(losses) > 1 else losses[0], sums


def _prepare_again(step: ref[TrainingStep], _: Optimizer) -> None:
    """Prepare the optimiser of a step, if the step is still there."""
    found = step()
    if found is not None:
        found._prepare()


@dataclass(frozen=True)
class _Graph:
    """Captured step with the memory of its inputs."""

    inputs: _Inputs
    captured: CapturedStep[tuple[torch.Tensor, torch.Tensor]]

    def replay(self, inputs: _Inputs) -> tuple[torch.Tensor, torch.Tensor]:
        """Take a step; the results stay until the next one."""
        for own, given in zip(self.inputs, inputs, strict=True):
            own.copy_(given, non_blocking=True)  # of pictures, three times as fast as ``_foreach_copy_``
        self.captured.replay()
        return self.captured.result


class _Watch:
    """Watch over steps that are not finite. The device writes what it finds to the host's memory."""

    def __init__(self, device: torch.device) -> None:
        on_cuda = device.type == "cuda"
        first = torch.zeros(1, dtype=torch.int32, pin_memory=on_cuda)
        wrong = torch.zeros(2, pin_memory=on_cuda)
        self._device = device
        self._steps = torch.zeros(1, dtype=torch.int32, device=device)
        self._first: np.ndarray = first.numpy()  # keeps the memory
        self._wrong: np.ndarray = wrong.numpy()
        wp.init()  # does nothing the second time; the next line relies on it
        where = wp.device_from_torch(device)
        self._arrays = (
            warp_array(self._steps),
            wp.array(ptr=first.data_ptr(), dtype=wp.int32, shape=1, device=where),
            wp.array(ptr=wrong.data_ptr(), dtype=wp.float32, shape=2, device=where),
        )

    def see(self, loss: torch.Tensor, norm: torch.Tensor) -> None:
        """Look at a step's numbers, on the device."""
        loss_array = warp_array(loss.float().reshape(1))
        norm_array = warp_array(norm.float().reshape(1))
        with on_torch_stream(self._device):
            launch_watch_step(loss_array, norm_array, *self._arrays)

    def look(self) -> None:
        """Raise FloatingPointError if the device has found a step that is not finite, without waiting for it."""
        if not self._first[0]:
            return
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)  # so that all of it is written
        step, (loss, norm) = int(self._first[0]), self._wrong.tolist()
        self._first[0] = 0
        raise FloatingPointError(
            f"TrainingStep: step {step}: the loss is {loss:.6g} and the norm of its gradient is {norm:.6g}; expected "
            f"finite numbers. The parameters have been changed by it: go back to earlier ones"
        )


class _Rates:
    """Learning rates on the device, where a graph reads them. Users and schedulers see those that they set."""

    def __init__(self, optimizer: Optimizer, device: torch.device) -> None:
        self._optimizer = optimizer
        self.tensors = [torch.zeros((), device=device) for _ in optimizer.param_groups]
        self._known: list[float | None] = [None] * len(self.tensors)

    def update(self) -> None:
        """Copy the rates that have changed."""
        for index, (group, tensor) in enumerate(zip(self._optimizer.param_groups, self.tensors, strict=True)):
            rate = group["lr"]
            if isinstance(rate, torch.Tensor):
                tensor.copy_(rate, non_blocking=True)
            elif rate != self._known[index]:
                tensor.fill_(rate)
                self._known[index] = rate

    @contextmanager
    def on_device(self) -> Iterator[None]:
        """Let the optimiser read the tensors within."""
        groups = self._optimizer.param_groups
        rates = [group["lr"] for group in groups]
        for group, tensor in zip(groups, self.tensors, strict=True):
            group["lr"] = tensor
        try:
            yield
        finally:
            for group, rate in zip(groups, rates, strict=True):
                group["lr"] = rate


def _unwrapped(optimizer: Any) -> Optimizer:
    """Return torch's optimiser of one that accelerate has prepared."""
    if getattr(optimizer, "scaler", None) is not None:
        raise TypeError("optimizer: scales float16's gradients; expected bfloat16, which needs no scale, or float32")
    inner: Optimizer = getattr(optimizer, "optimizer", optimizer)
    if not hasattr(inner, "param_groups"):
        raise TypeError(f"optimizer: {type(optimizer).__name__}; expected one of torch.optim")
    return inner


def _check_processes() -> None:
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        count = torch.distributed.get_world_size()
        if count > 1:
            raise RuntimeError(
                f"TrainingStep: {count} processes train together; expected one: gradients are not averaged over "
                "processes here. Use DistributedDataParallel and a loop"
            )


def _parameters(optimizer: Optimizer) -> list[torch.Tensor]:
    return [parameter for group in optimizer.param_groups for parameter in group["params"]]


def _device_of(optimizer: Optimizer) -> torch.device:
    parameters = _parameters(optimizer)
    devices = {parameter.device for parameter in parameters}
    if len(devices) != 1:
        raise ValueError(f"optimizer: parameters on {sorted(map(str, devices))}; expected one device")
    if any(getattr(parameter, "_post_accumulate_grad_hooks", None) for parameter in parameters):
        raise ValueError("optimizer: a parameter has a hook for its accumulated gradient; expected none")
    return devices.pop()


def _make_capturable(optimizer: Optimizer, device: torch.device) -> None:
    """Set the options that a capture needs, where they are open, and move counts of steps to the device."""
    for options in (optimizer.defaults, *optimizer.param_groups):
        if "capturable" in options:
            options["capturable"] = True
        is_open = options.get("fused", False) is None and not options.get("foreach")
        if is_open and not options.get("differentiable"):
            options["fused"] = True
    for group in optimizer.param_groups:
        if not group.get("capturable") and not group.get("fused"):
            raise TypeError(
                f"optimizer: {type(optimizer).__name__}; expected one of torch.optim that is capturable or fused, such "
                "as Adam, AdamW or SGD, or captured=False"
            )
    for state in optimizer.state.values():
        if isinstance(state.get("step"), torch.Tensor):
            state["step"] = state["step"].to(device, torch.float32)


def _about(group: dict[str, Any]) -> Hashable:
    """Return what a graph of a group's steps depends on: its options but the rate, and where its parameters are."""
    options = [
        tuple(value) if isinstance(value, list) else value for name, value in group.items() if name not in _NOT_IN_KEY
    ]
    where = [each.data_ptr() if each.requires_grad else 0 for each in group["params"]]
    return tuple(options), tuple(where)


def _checked(loss: object) -> torch.Tensor:
    if not isinstance(loss, torch.Tensor):
        raise TypeError(f"function: returned {type(loss).__name__}; expected a torch.Tensor, the loss")
    if loss.numel() != 1:
        raise ValueError(f"function: returned shape {tuple(loss.shape)}; expected one number: take the sum or the mean")
    if not loss.requires_grad:
        raise ValueError("function: returned a loss without gradient; expected one of the optimiser's parameters")
    return loss.reshape(())


def _laid_out(gradient: torch.Tensor, parameter: torch.Tensor) -> torch.Tensor:
    """Return a gradient with its parameter's strides, as a fused optimiser needs them; a copy if they differ."""
    if gradient.stride() == parameter.stride():
        return gradient
    return torch.empty_like(parameter).copy_(gradient)


def _first(error: BaseException) -> str:
    """Return the message of the error that led to this one: the end of a capture raises another one."""
    while error.__context__ is not None:
        error = error.__context__
    return str(error).partition("\n")[0]  # CUDA's errors have further lines
