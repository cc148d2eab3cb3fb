"""Refinement of bodies from given starts, by a captured graph if the energy has one, else by autograd."""

from __future__ import annotations

from collections.abc import Callable, Collection

from ...body.parameters import BodyParameters
from ...errors import check_type
from ...interop.gradient_mode import with_gradients
from .captured import can_capture, refine_captured
from .energy import Energy
from .stepper import LEARNING_RATE, Descent, EnergyFunction, Refined, Refinement


@with_gradients()
def refine(
    start: BodyParameters,
    energy: Energy | EnergyFunction,
    *,
    iterations: int = 50,
    learning_rate: float = LEARNING_RATE,
    frozen: Collection[str] = (),
    on_iteration: Callable[[int], None] | None = None,
) -> Refined:
    """Minimise an energy from B starts as a batch (paper, section 3.4).

    A captured graph (``CapturedRefinement``) minimises an ``Energy`` of keypoints, or of labels drawn as exact
    ellipsoids. On the CPU, bodies are shared among threads (``set_num_threads``), with the same result to the bit.
    Autograd (``Refinement``) minimises an energy with label probabilities or with a mesh, and any other function.

    Args:
        start: B bodies; they do not influence one another.
        energy: An ``Energy`` of one person, or of B people, or a function that returns terms by name, shape (B,) each;
            their sum is minimised.
        iterations: Number of steps of Adam.
        learning_rate: Learning rate of angles [rad] and of the camera [half-sides of the crop] at the first step. It
            falls along a cosine to a tenth. Lengths and thicknesses have 0.3 of it.
        frozen: Names of ``BodyParameters`` that stay as they start and get no gradient, such as ("lengths",
            "thicknesses") for a person who was measured before.
        on_iteration: Function that is called with the number of steps done, for a progress bar.

    Returns:
        Best state of each body, which may not be the last: PartDR's estimate of the gradient does not always lead
        downward. Lengths stay within 60 and 140 % of the mean adult's, thicknesses within 40 and 160 %.

    Raises:
        TypeError: If ``start`` is not ``BodyParameters``, or ``energy`` is not a function that returns terms.
        ValueError: If a term has another shape, or none has a gradient; if ``frozen`` has an unknown name, or the names
            of all parameters; if ``iterations`` or ``learning_rate`` is out of range; if ``start`` holds NaN or
            infinity; or if the energy is neither that of one person nor that of B people.

    Examples:
        >>> from warp_partdr import BodyParameters, Energy, observe, read_keypoints, read_parts, refine
        >>> observation, crop = observe(read_keypoints("keypoints.json")[0], read_parts("parts.png", "cdcl14"))
        >>> refined = refine(BodyParameters.mean(1), Energy(observation, size=128), iterations=30)
        >>> refined.history.shape, bool(refined.energy[0] < refined.history[0, 0])
        (torch.Size([30, 1]), True)
    """
    check_type("start", start, BodyParameters, "such as BodyParameters.mean(1)")
    if not callable(energy):
        raise TypeError(f"energy: {type(energy).__name__}; expected an Energy or a function of bodies")
    if isinstance(energy, Energy):
        people = len(energy.observations)
        if people not in (1, start.batch_size):
            expected = f"one, or {start.batch_size}, one for each body"
            raise ValueError(f"energy: observations of {people} people; expected {expected}")
    BodyParameters.free(frozen)
    start.check_finite()
    return refine_unchecked(start, energy, Descent(iterations, learning_rate, tuple(frozen)), on_iteration)


def refine_unchecked(
    start: BodyParameters,
    energy: Energy | EnergyFunction,
    descent: Descent,
    on_iteration: Callable[[int], None] | None = None,
) -> Refined:
    """Refine bodies as ``refine`` does, without its checks, which would wait for a GPU."""
    if isinstance(energy, Energy) and can_capture(energy):
        return refine_captured(start, energy, descent, on_iteration=on_iteration)
    stepper = Refinement(
        start, energy, iterations=descent.iterations, learning_rate=descent.learning_rate, frozen=descent.frozen
    )
    return stepper.run(on_iteration)
