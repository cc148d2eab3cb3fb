"""Second stage of the paper as a captured Warp graph, whose loop doesn't need torch; ``refine`` uses it."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Any

import torch
import warp as wp

from ...body.parameters import ROW, BodyParameters
from ...body.template import LOCKED_PARTS, NUM_PARTS
from ...errors import check_whole
from ...interop.arrays import warp_array
from ...interop.checks import check_steps, check_tensor
from ...interop.graph_cache import BYTES_PER_PIXEL, graphs
from ...interop.streams import capture_graph, on_torch_stream
from ...kernels.ellipsoids.forces import NUM_SUMS
from ...kernels.launch import launch_side_by_side, run_slices, split_batch
from ...kernels.refine.iteration import launch_compare, launch_start, launch_step
from ...kernels.refine.state import (
    NUM_TERMS,
    Bodies,
    Drawn,
    Load,
    Problem,
    Pull,
    State,
    StepRule,
    Terms,
    Wrench,
)
from ...kernels.refine.step import BETAS
from ...render.captured import CapturedEllipsoids
from ...render.renderers import RendererEllipsoids
from .batch import Batch
from .energy import TERMS, Energy
from .stepper import LEARNING_RATE, SHAPE_RATE, SIZES, Descent, Refined, rate_share, size_bounds
from .tables import LANDMARK_NAMES, bone_arrays, landmark_arrays, mixture_arrays, rule_arrays

# Numbers of columns of a body's parameters, which follow one another in a row.
_WIDTHS = [math.prod(shape) for shape in ROW.values()]

# Memory of a kept graph for one body, beside its pictures. On the CPU this estimate stands for a count of the memory.
_BYTES_PER_BODY = 2**15


class CapturedRefinement:
    """Minimiser of an energy from B starts as a batch, in fixed buffers; ``refine`` uses it.

    The kernels of an iteration draw, compare and step. They are captured once and replayed, and the host waits for
    nothing in between. Runs with the same input give the same bits.

    Args:
        energy: Energy of N people; body b has observation b % N.
        batch_size: Number of bodies that are refined at once, B.
        iterations: Number of steps of Adam.
        learning_rate: Learning rate at the first step, which ``refine`` describes.
        frozen: Names of ``BodyParameters`` that stay as they start.
        people: Arrays of the energy, if they are made already; ``take`` can replace them.

    Raises:
        ValueError: If the energy has label probabilities or draws a mesh, or if ``frozen`` has an unknown name, or the
            names of all parameters.
    """

    def __init__(
        self,
        energy: Energy,
        batch_size: int,
        *,
        iterations: int = 50,
        learning_rate: float = LEARNING_RATE,
        frozen: Collection[str] = (),
        people: Batch | None = None,
    ) -> None:
        free = BodyParameters.free(frozen)
        iterations = check_steps(iterations, learning_rate)
        batch_size = check_whole("batch_size", batch_size, 0)
        self._energy = energy
        self._device = energy.observations.points.device
        if energy.with_probabilities:
            raise ValueError("energy: probabilities of labels; expected labels, ``refine`` takes probabilities")
        if not can_capture(energy):
            raise ValueError(f"energy: {energy.renderer}; expected exact ellipsoids, ``refine`` takes others")
        self._people = people = people or Batch.of(energy)

        # The host reads and writes these buffers, so they are in torch's memory.
        buffer = partial(torch.zeros, device=self._device)
        rows = batch_size, sum(_WIDTHS)
        self._parameters = buffer(rows)
        self._gradient = buffer(rows)
        self._best = buffer(rows)
        self._best_energy = buffer(batch_size)
        self._best_terms = buffer(batch_size, NUM_TERMS)
        self._history = buffer(iterations + 1, batch_size)
        # After the last step, one more iteration at rate 0 evaluates the energy of the last state.
        shares = [rate_share(step, iterations) for step in range(iterations)]
        self._rates = [learning_rate * share for share in (*shares, 0.0)]
        # In torch's memory, the arrays count in the budget of kept graphs.
        with on_torch_stream(self._device, torch_memory=True) as device_name:
            self._state = self._make_state(device_name)
            self._problem = self._make_problem(device_name, people, free)
            self._renderer = self._make_renderer(people)
            self._drawn = Drawn() if self._renderer is None else self._renderer.drawn
        if batch_size > 0:
            self._rewind_graph = capture_graph(self._rewind, self._device)
            self._graph = capture_graph(self.iterate, self._device)

    def _make_renderer(self, people: Batch) -> CapturedEllipsoids | None:
        """Make the renderer that compares posed ellipsoids with label images; None if there are no images."""
        renderer = self._energy.renderer
        label_set = self._energy.observations.label_set
        if people.targets is None or label_set is None:
            return None
        assert isinstance(renderer, RendererEllipsoids)
        labels = [int(group) for group in label_set.part_groups[1:]]
        perspective = self._energy.observations.lens is not None
        return CapturedEllipsoids(renderer, labels, people.targets, self._state.ellipsoids, perspective)

    def _make_state(self, device_name: str) -> State:
        """Allocate the state of the bodies on a Warp device."""
        batch = len(self._parameters)
        prior = self._energy.prior

        def zeros(*shape: int, dtype: Any = float) -> wp.array:
            return wp.zeros((batch, *shape), dtype=dtype, device=device_name)

        state = State()
        state.iteration = zeros(dtype=int)
        state.bodies, state.gradient = _bodies(self._parameters), _bodies(self._gradient)
        rows = state.rows
        rows.parameters = warp_array(self._parameters)
        rows.gradient = warp_array(self._gradient)
        rows.best = warp_array(self._best)
        rows.first_moment = zeros(sum(_WIDTHS))
        rows.second_moment = zeros(sum(_WIDTHS))
        records = state.records
        records.better = zeros(dtype=int)
        records.energy = warp_array(self._best_energy)
        records.terms = warp_array(self._best_terms, Terms)
        records.history = warp_array(self._history)

        state.turns = zeros(NUM_PARTS, dtype=wp.mat33)
        state.orientations = zeros(dtype=wp.mat33)
        state.roots = zeros(dtype=wp.vec3)
        ellipsoids = state.ellipsoids
        ellipsoids.centres = zeros(NUM_PARTS, dtype=wp.vec3)
        ellipsoids.axes = zeros(NUM_PARTS, dtype=wp.mat33)
        ellipsoids.semi_axes = zeros(NUM_PARTS, dtype=wp.vec3)
        ellipsoids.camera = zeros(dtype=wp.vec4)
        components, directions = mixture_arrays(device_name, prior).means.shape
        likelihood = state.likelihood
        likelihood.directions = zeros(directions, dtype=wp.vec3)
        likelihood.slopes = zeros(components, directions, dtype=wp.vec3)
        likelihood.exponents = zeros(components)
        likelihood.shares = zeros(components)
        likelihood.log_density = zeros()
        state.pulls = zeros(len(LANDMARK_NAMES), dtype=Pull)
        state.drawn = zeros(NUM_PARTS, NUM_SUMS)
        state.drawn_cost = zeros()
        state.pushes = zeros(NUM_PARTS, dtype=wp.vec3)
        state.wrenches = zeros(NUM_PARTS, dtype=Wrench)
        state.costs = zeros(NUM_PARTS, dtype=Terms)
        state.loads = zeros(NUM_PARTS + 1, dtype=Load)
        return state

    def _make_problem(self, device_name: str, people: Batch, free: Collection[str]) -> Problem:
        """Collect the constants of the problem, among them the N observations, on a Warp device."""
        energy = self._energy
        problem = Problem()
        problem.bones = bone_arrays(device_name)
        problem.locked = sum(1 << part for part in LOCKED_PARTS)
        problem.half_size = energy.size / 2
        problem.lenses = warp_array(people.lenses, wp.vec3)
        points = warp_array(people.points, wp.vec2)
        weights = warp_array(people.weights)
        problem.landmarks = landmark_arrays(device_name, people.visible, points, weights)
        problem.rules = rule_arrays(
            device_name,
            energy.prior,
            lengths=warp_array(people.lengths),
            thicknesses=warp_array(people.thicknesses),
            depths=warp_array(people.depths),
            depth_scales=warp_array(people.depth_scales),
        )
        problem.mixture = mixture_arrays(device_name, energy.prior)
        problem.weights = _term_weights(energy)
        problem.step_rule = _step_rule(self._rates, free, self._device)
        return problem

    def iterate(self) -> None:
        """Launch one iteration on Warp's current stream: draw, compare, step.

        ``refine`` replays it as a graph. After all ``iterations`` its rate is 0, and the bodies stay.
        """
        # The prior reads poses alone, so it can run beside the renderer.
        launch_side_by_side(self._draw, partial(launch_compare, self._problem, self._state))
        launch_step(self._problem, self._state, self._drawn)

    def _draw(self) -> None:
        if self._renderer is not None:
            self._renderer.launch()

    @torch.no_grad()
    def take(self, people: Batch) -> None:
        """Replace the people by others; their ``graph_key`` must be the same."""
        torch._foreach_copy_(self._people.tensors(), people.tensors())

    @torch.no_grad()
    def _put(self, bodies: BodyParameters) -> None:
        """Write bodies into the rows of parameters."""
        rows = [tensor.reshape(-1, width) for tensor, width in zip(bodies.tensors().values(), _WIDTHS, strict=True)]
        torch.cat(rows, dim=1, out=self._parameters)

    def _replay(self, graph: wp.Graph, times: int = 1) -> None:
        with on_torch_stream(self._device):
            for _ in range(times):
                wp.capture_launch(graph)

    def _rewind(self) -> None:
        """Launch the start of a run: the first iteration begins at the parameters as they are."""
        launch_start(self._problem, self._state)

    def evaluate(self, bodies: BodyParameters) -> tuple[torch.Tensor, torch.Tensor]:
        """Evaluate the energy of bodies by a refinement of 0 steps.

        Returns:
            Energy of the bodies, shape (B,); and one row of numbers as ``LabelLoss`` takes it: the parameters of all
            bodies, then the gradient.
        """
        self._put(bodies)
        self._replay(self._rewind_graph)
        self._replay(self._graph)
        return self._history[-1].clone(), torch.cat([self._parameters.flatten(), self._gradient.flatten()])

    def refine(self, start: BodyParameters, *, on_iteration: Callable[[int], None] | None = None) -> Refined:
        """Refine B bodies.

        Args:
            start: B bodies from which the refinement starts.
            on_iteration: Function that is called with the number of steps that are launched; a CUDA device may not have
                finished them.

        Raises:
            ValueError: If a shape, dtype or device is wrong.
        """
        batch = self._parameters.shape[0]
        for name, tensor in start.tensors().items():
            like = ("energy", self._parameters)
            check_tensor(name, tensor, (batch, *ROW[name]), dtypes=(torch.float32,), like=like)
        self._put(start)
        if batch > 0:
            self._replay(self._rewind_graph)
            if on_iteration is None:
                self._replay(self._graph, len(self._rates))
            else:
                for step in range(1, len(self._rates)):
                    self._replay(self._graph)
                    on_iteration(step)
                self._replay(self._graph)
        terms = self._best_terms.clone()
        return Refined(
            BodyParameters(**{name: tensor.clone() for name, tensor in _split(self._best).items()}),
            self._best_energy.clone(),
            {term.name: terms[:, term.column] for term in TERMS if term.applies(self._energy)},
            self._history[:-1].clone(),
        )


def can_capture(energy: Energy) -> bool:
    """Return True if the kernels can evaluate an energy: it has labels, not probabilities, and exact ellipsoids."""
    drawn = energy.target is None or isinstance(energy.renderer, RendererEllipsoids)
    return not energy.with_probabilities and drawn


def refine_captured(
    start: BodyParameters,
    energy: Energy,
    descent: Descent,
    *,
    on_iteration: Callable[[int], None] | None = None,
) -> Refined:
    """Refine bodies by captured graphs. On the CPU, each thread refines a slice of the bodies with one graph.

    If each body has an observation of its own, the graphs are kept for the next batch with the same ``graph_key``.

    Args:
        start: B bodies from which the refinement starts.
        energy: Energy of one person, or of B people.
        descent: Number and size of the steps.
        on_iteration: Function that is called with the number of steps that the first slice has done.
    """
    device, count = start.shift.device, start.batch_size
    people = Batch.of(energy)
    one_each = len(people) == count
    if one_each and (size := _rounded(count)) > count:
        rows = torch.arange(size, device=device).clamp_max(count - 1)
        start, people = start.select(rows), people.select(rows)
    made: dict[int, tuple[CapturedRefinement, BodyParameters]] = {}
    done: dict[int, Refined] = {}
    slices = split_batch(start.batch_size, on_cpu=device.type == "cpu")
    for part in slices:
        bodies = start.select(torch.arange(part.start, part.stop, device=device))
        if one_each:
            captured = _find_captured(energy, people.select(part), descent, part.start)
        else:
            captured = _capture(energy, people, descent, bodies.batch_size)
        made[part.start] = captured, bodies

    def work(part: slice) -> None:
        captured, bodies = made[part.start]
        done[part.start] = captured.refine(bodies, on_iteration=on_iteration if part is slices[0] else None)

    run_slices(work, slices)
    return _join([done[part.start] for part in slices], count)


def _capture(energy: Energy, people: Batch, descent: Descent, batch_size: int) -> CapturedRefinement:
    return CapturedRefinement(
        energy,
        batch_size,
        iterations=descent.iterations,
        learning_rate=descent.learning_rate,
        frozen=descent.frozen,
        people=people,
    )


def _rounded(count: int) -> int:
    """Round the size of a batch up, by an eighth at most, so that few sizes of graphs occur."""
    step = 1 << max(count.bit_length() - 4, 0)
    return -(-count // step) * step


def _find_captured(energy: Energy, people: Batch, descent: Descent, start: int) -> CapturedRefinement:
    """Find the kept refinement of one body of each person, or capture one.

    Each slice of the bodies has a refinement of its own; ``start`` is the index of the slice's first body.
    """
    labels = energy.observations.label_set
    count = len(people)
    device = people.weights.device
    kind = (
        *(energy.size, energy.weights, energy.prior, energy.renderer, energy.observations.lens is None),
        None if labels is None else tuple(labels.part_groups.tolist()),
        tuple(term.applies(energy) for term in TERMS),
    )
    key = CapturedRefinement, start, kind, people.graph_key, descent
    num_bytes = count * (_BYTES_PER_BODY + (0 if people.targets is None else BYTES_PER_PIXEL * energy.size**2))

    def make() -> CapturedRefinement:
        one = energy.select(
            torch.zeros(1, dtype=torch.int64, device=device)
        )  # the kept graph keeps this energy alive, so it has no pictures
        return _capture(one, people.copied(), descent, count)

    captured = graphs.find(key, device, num_bytes, make, at_once=True)
    if captured is None:
        return _capture(energy, people, descent, count)
    captured.take(people)
    return captured


def _join(parts: Sequence[Refined], count: int) -> Refined:
    """Concatenate the results of a batch's slices, and keep the first ``count`` bodies."""
    names = parts[0].parameters.tensors()
    return Refined(
        BodyParameters(
            **{name: torch.cat([part.parameters.tensors()[name] for part in parts])[:count] for name in names}
        ),
        torch.cat([part.energy for part in parts])[:count],
        {name: torch.cat([part.terms[name] for part in parts])[:count] for name in parts[0].terms},
        torch.cat([part.history for part in parts], dim=1)[:, :count],
    )


def _split(rows: torch.Tensor) -> dict[str, torch.Tensor]:
    """Split rows into views by name, with the shapes of ``BodyParameters``."""
    columns = rows.split(_WIDTHS, dim=1)
    return {name: part.reshape(len(rows), *shape) for (name, shape), part in zip(ROW.items(), columns, strict=True)}


def _bodies(rows: torch.Tensor) -> Bodies:
    parts, bodies = _split(rows), Bodies()
    bodies.orientation = warp_array(parts["orientation"].unflatten(1, (2, 3)), wp.vec3)
    bodies.rotations = warp_array(parts["rotations"], wp.vec3)
    bodies.lengths, bodies.thicknesses = warp_array(parts["lengths"]), warp_array(parts["thicknesses"])
    bodies.log_scale, bodies.shift = warp_array(parts["log_scale"]), warp_array(parts["shift"], wp.vec2)
    return bodies


def _term_weights(energy: Energy) -> Any:
    weights = Terms()
    for term in TERMS:
        weights[term.column] = energy.weight(term) if term.applies(energy) else 0.0
    return weights


def _step_rule(rates: Sequence[float], free: Collection[str], device: torch.device) -> StepRule:
    width = sum(_WIDTHS)
    factors = torch.zeros(1, width)
    lower = torch.full((1, width), -math.inf)
    upper = torch.full((1, width), math.inf)
    for name in free:
        _split(factors)[name].fill_(SHAPE_RATE if name in SIZES else 1.0)
        if name in SIZES:
            smallest, largest = size_bounds(name, "cpu")
            _split(lower)[name].copy_(smallest)
            _split(upper)[name].copy_(largest)
    schedule = [
        (rate / (1 - BETAS[0] ** step), math.sqrt(1 - BETAS[1] ** step)) for step, rate in enumerate(rates, start=1)
    ]
    rule = StepRule()
    rule.schedule = warp_array(torch.tensor(schedule, device=device), wp.vec2)
    rule.rates = warp_array(factors[0].to(device))
    rule.lower = warp_array(lower[0].to(device))
    rule.upper = warp_array(upper[0].to(device))
    return rule
