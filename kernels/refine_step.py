"""Adam (Kingma and Ba, 2015) on flat rows of parameters, and the best row seen."""

import warp as wp

from .refine_state import MODULE, launch

BETAS = (0.9, 0.999)  # torch's defaults, as is the next
_EPSILON = wp.constant(1.0e-8)
_BETA1 = wp.constant(BETAS[0])
_BETA2 = wp.constant(BETAS[1])


@wp.struct
class StepRule:
    """How far each parameter may go."""

    schedule: wp.array[wp.vec2]  # (iterations + 1,) rate / (1 - beta1^t) and sqrt(1 - beta2^t); the last rate is 0
    rates: wp.array[float]  # (N,) factor of the rate
    lower: wp.array[float]  # (N,)
    upper: wp.array[float]  # (N,)


@wp.kernel(module=MODULE)
def step_parameters(
    active: wp.array[int],  # (B,)
    better: wp.array[int],  # (B,) whether the parameters before this step are the best so far
    iteration: wp.array[int],  # (1,)
    rule: StepRule,
    gradient: wp.array2d[float],  # (B, N)
    parameters: wp.array2d[float],  # (B, N) MODIFIED
    first_moment: wp.array2d[float],  # (B, N) MODIFIED
    second_moment: wp.array2d[float],  # (B, N) MODIFIED
    best: wp.array2d[float],  # (B, N) MODIFIED
):
    """A thread a number."""
    b, i = wp.tid()
    value = parameters[b, i]
    if better[b] == 1:
        best[b, i] = value
    if active[b] == 0:
        return
    g = gradient[b, i]
    first = first_moment[b, i] + (1.0 - _BETA1) * (g - first_moment[b, i])
    second = _BETA2 * second_moment[b, i] + (1.0 - _BETA2) * g * g
    first_moment[b, i] = first
    second_moment[b, i] = second
    now = rule.schedule[iteration[0]]
    value -= now[0] * rule.rates[i] * first / (wp.sqrt(second) / now[1] + _EPSILON)
    parameters[b, i] = wp.clamp(value, rule.lower[i], rule.upper[i])


def launch_step(
    active: wp.array,
    better: wp.array,
    iteration: wp.array,
    rule: StepRule,
    gradient: wp.array,
    parameters: wp.array,
    first_moment: wp.array,
    second_moment: wp.array,
    best: wp.array,
) -> None:
    """Keep the best and take a step."""
    inputs = [active, better, iteration, rule, gradient, parameters, first_moment, second_moment, best]
    launch(step_parameters, parameters.shape, inputs, active.device)
