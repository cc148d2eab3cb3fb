"""Refinement of bodies from given starts: by one captured graph where it serves, else by autograd."""

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
    """Minimise an energy from every start side by side (paper, section 3.4).

    An ``Energy`` of keypoints, or of labels drawn as exact ellipsoids, takes a captured graph (``CapturedRefinement``);
    on the CPU, bodies are shared among threads (``set_num_threads``), with the same result to the bit. Against
    probabilities, of a mesh, and any other function take autograd (``Refinement``).

    Args:
        start: B bodies; they do not influence one another.
        energy: An ``Energy`` of one person, or of B people, or a function that returns terms by name, shape (B,) each;
            their sum is minimised.
        iterations: Steps of Adam.
        learning_rate: Of angles [rad] and of the camera [half-sides of the crop]; shape moves at 0.3 of it. It falls
            along a cosine to a tenth.
        frozen: Names of ``BodyParameters`` that stay as they start and get no gradient, such as ("lengths",
            "thicknesses") of a person who was measured before.
        on_iteration: Called with the number of steps done, for a progress bar.

    Returns:
        The best state of each body, not the last: PartDR's estimate does not promise descent. Lengths stay within 60
        and 140 % of the mean adult's, thicknesses within 40 and 160 %.

    Raises:
        TypeError: If ``start`` are no bodies, or ``energy`` is no function that returns terms.
        ValueError: If a term has another shape, or none has a gradient; if ``frozen`` names what is no parameter, or
            all of them; if ``iterations`` or ``learning_rate`` is out of range, if ``start`` holds NaN or infinity, or
            if the energy is of neither one person nor B people.
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
    """Refine as ``refine`` does, without its checks, for which a GPU would be waited for."""
    if isinstance(energy, Energy) and can_capture(energy):
        return refine_captured(start, energy, descent, on_iteration=on_iteration)
    stepper = Refinement(
        start, energy, iterations=descent.iterations, learning_rate=descent.learning_rate, frozen=descent.frozen
    )
    return stepper.run(on_iteration)
