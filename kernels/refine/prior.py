"""Gaussian mixture of the pose prior in precision form, so that one product gives both value and gradient.

With d = x - mean and A the inverse covariance, a component's exponent is log weight - d.Ad / 2 and its slope Ad. The
product d.Ad of the packaged prior loses nothing in float32: its covariances have condition numbers below 200.
"""

import warp as wp

from ..lanes import sum_lanes
from .state import Likelihood, Mixture


@wp.func
def slope_component(mixture: Mixture, likelihood: Likelihood, b: int, k: int, slot: int):
    """Slope of component k along one direction, and its share of the squared deviation."""
    num_directions = mixture.means.shape[1]
    # One dimension, for addresses would be most of the work; neighbouring slots read neighbouring numbers.
    pitch = mixture.precisions.shape[2]
    numbers = wp.array(ptr=mixture.precisions.ptr, shape=(9 * num_directions * pitch,), dtype=float)
    at = k * num_directions + slot
    slope = wp.vec3(0.0)
    for other in range(num_directions):
        block = wp.mat33()
        for i in range(9):
            block[i // 3, i % 3] = numbers[at + i * pitch]
        slope += block * (likelihood.directions[b, other] - mixture.means[k, other])
        at += 9 * pitch
    likelihood.slopes[b, k, slot] = slope
    return wp.dot(likelihood.directions[b, slot] - mixture.means[k, slot], slope)


@wp.func
def compare_component(mixture: Mixture, likelihood: Likelihood, b: int, k: int, lane: int, lanes: int):
    """Log of component k's share of the density, and its slopes, by the threads of a warp."""
    square = float(0.0)
    for slot in range(lane, mixture.means.shape[1], lanes):
        square += slope_component(mixture, likelihood, b, k, slot)
    square = sum_lanes(square)
    if lane == 0:
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
