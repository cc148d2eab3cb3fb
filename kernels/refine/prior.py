"""Gaussian mixture of the pose prior in precision form, so that one product gives both value and gradient.

With d = x - mean and A the inverse covariance, a component's exponent is log weight - d.Ad / 2 and its slope Ad. The
product d.Ad of the packaged prior loses nothing in float32: its covariances have condition numbers below 200.
"""

import warp as wp

from .state import Likelihood, Mixture


@wp.func
def slope_component(mixture: Mixture, likelihood: Likelihood, b: int, task: int):
    """Slope of a component along one direction; neighbouring tasks read neighbouring numbers."""
    num_directions = mixture.means.shape[1]
    k = task // num_directions
    slot = task - k * num_directions
    slope = wp.vec3(0.0)
    for other in range(num_directions):
        m = mixture.precisions[other]
        block = wp.mat33(
            m[0, task], m[1, task], m[2, task], m[3, task], m[4, task], m[5, task], m[6, task], m[7, task], m[8, task]
        )
        slope += block * (likelihood.directions[b, other] - mixture.means[k, other])
    likelihood.slopes[b, k, slot] = slope
    likelihood.squares[b, k, slot] = wp.dot(likelihood.directions[b, slot] - mixture.means[k, slot], slope)


@wp.func
def sum_exponent(mixture: Mixture, likelihood: Likelihood, b: int, k: int):
    """Log of component k's share of the density."""
    square = float(0.0)
    for slot in range(mixture.means.shape[1]):
        square += likelihood.squares[b, k, slot]
    likelihood.exponents[b, k] = mixture.log_weights[k] - 0.5 * square


@wp.func
def share_component(likelihood: Likelihood, b: int, k: int):
    """Component k's share of the density, by log-sum-exp over all."""
    exponents = likelihood.exponents[b]
    top = exponents[0]
    for other in range(1, exponents.shape[0]):
        top = wp.max(top, exponents[other])
    total = float(0.0)
    for other in range(exponents.shape[0]):
        total += wp.exp(exponents[other] - top)
    log_density = top + wp.log(total)
    likelihood.shares[b, k] = wp.exp(exponents[k] - log_density)
    if k == 0:
        likelihood.log_density[b] = log_density


@wp.func
def mixture_gradient(likelihood: Likelihood, b: int, slot: int):
    """Gradient of minus the log density with respect to one direction."""
    gradient = wp.vec3(0.0)
    for k in range(likelihood.shares.shape[1]):
        gradient += likelihood.shares[b, k] * likelihood.slopes[b, k, slot]
    return gradient
