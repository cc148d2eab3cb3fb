"""One step of Adam (Kingma and Ba, 2015), the energy's history and the best parameters so far."""

import warp as wp

from .state import NUM_TERMS, PRIOR, SEG, Problem, State, Terms

BETAS = (0.9, 0.999)  # torch's defaults, as is the next
_EPSILON = wp.constant(1.0e-8)
_BETA1 = wp.constant(BETAS[0])
_BETA2 = wp.constant(BETAS[1])
_NUM_TERMS = wp.constant(NUM_TERMS)


@wp.func
def record_energy(problem: Problem, state: State, b: int):
    """Sum the energy's terms, record them, and mark the body if they are its best."""
    records = state.records
    terms = Terms()
    for part in range(state.costs.shape[1]):
        terms += state.costs[b, part]
    terms[SEG] = state.drawn_cost[b]
    if problem.mixture.log_weights.shape[0] > 0:
        terms[PRIOR] = -problem.weights[PRIOR] * state.likelihood.log_density[b]
    energy = float(0.0)
    for i in range(_NUM_TERMS):
        energy += terms[i]
    iteration = state.iteration[b]
    records.history[iteration, b] = energy
    better = iteration == 0 or energy < records.energy[b]
    records.better[b] = wp.where(better, 1, 0)
    if better:
        records.energy[b] = energy
        records.terms[b] = terms


@wp.func
def step_number(problem: Problem, state: State, b: int, i: int):
    """Keep parameter i if this body is the best so far, and move it."""
    rows, rule = state.rows, problem.step_rule
    value = rows.parameters[b, i]
    if state.records.better[b] == 1:
        rows.best[b, i] = value
    g = rows.gradient[b, i]
    first = rows.first_moment[b, i] + (1.0 - _BETA1) * (g - rows.first_moment[b, i])
    second = _BETA2 * rows.second_moment[b, i] + (1.0 - _BETA2) * g * g
    rows.first_moment[b, i] = first
    rows.second_moment[b, i] = second
    now = rule.schedule[state.iteration[b]]
    value -= now[0] * rule.rates[i] * first / (wp.sqrt(second) / now[1] + _EPSILON)
    if value < rule.lower[i]:  # not ``wp.clamp``, which would make a bound of NaN
        value = rule.lower[i]
    if value > rule.upper[i]:
        value = rule.upper[i]
    rows.parameters[b, i] = value
