"""The pose prior's mixture of Gaussians in its precision form: one product says value and gradient alike.

With d = x - mean and A the inverse covariance, a component's exponent is log weight - d.Ad / 2 and its slope Ad. The
product d.Ad of the packaged prior loses nothing in float32: its covariances have condition numbers below 200.
"""

import warp as wp

from .refine_state import MODULE, launch


@wp.struct
class Mixture:
    """K Gaussians over S directions: the rotation vectors of parts, and up as the pelvis sees it. K = 0: no prior."""

    slots: wp.array[int]  # (P + 1,) which direction a part's rotation is, -1 = none; the last entry is up's
    means: wp.array2d[wp.vec3]  # (K, S)
    precisions: wp.array3d[wp.mat33]  # (K, S, S) [k, j, i] is the block that takes direction j to slope i
    log_weights: wp.array[float]  # (K,)


@wp.kernel(module=MODULE)
def slope_components(
    active: wp.array[int],  # (B,)
    directions: wp.array2d[wp.vec3],  # (B, S)
    mixture: Mixture,
    slopes: wp.array3d[wp.vec3],  # (B, K, S) A d, of each component and direction  OUTPUT
    squares: wp.array3d[float],  # (B, K, S) shares of d.Ad  OUTPUT
):
    """A thread a direction; bodies run faster than components, so that a component stays in the cache."""
    k, b, slot = wp.tid()
    if active[b] == 0:
        return
    slope = wp.vec3(0.0)
    for other in range(directions.shape[1]):
        slope += mixture.precisions[k, other, slot] * (directions[b, other] - mixture.means[k, other])
    slopes[b, k, slot] = slope
    squares[b, k, slot] = wp.dot(directions[b, slot] - mixture.means[k, slot], slope)


@wp.func
def exponent(mixture: Mixture, squares: wp.array3d[float], b: int, k: int):
    """Log of a component's share of the density."""
    square = float(0.0)
    for slot in range(squares.shape[2]):
        square += squares[b, k, slot]
    return mixture.log_weights[k] - 0.5 * square


@wp.func
def log_density(exponents: wp.array2d[float], b: int):
    """Log-sum-exp over the components."""
    top = exponents[b, 0]
    for k in range(1, exponents.shape[1]):
        top = wp.max(top, exponents[b, k])
    total = float(0.0)
    for k in range(exponents.shape[1]):
        total += wp.exp(exponents[b, k] - top)
    return top + wp.log(total)


@wp.func
def mixture_gradient(exponents: wp.array2d[float], slopes: wp.array3d[wp.vec3], log_total: float, b: int, slot: int):
    """Gradient of minus the log density with respect to one direction."""
    gradient = wp.vec3(0.0)
    for k in range(exponents.shape[1]):
        gradient += wp.exp(exponents[b, k] - log_total) * slopes[b, k, slot]
    return gradient


def launch_mixture(
    active: wp.array, directions: wp.array, mixture: Mixture, slopes: wp.array, squares: wp.array
) -> None:
    """Fill ``slopes`` and ``squares``."""
    batch, components, count = slopes.shape
    launch(slope_components, (components, batch, count), [active, directions, mixture, slopes, squares], active.device)
