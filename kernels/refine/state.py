"""Structs of the refinement's kernels: the problem, which is the same for all bodies, and the bodies' state.

An iteration of a body is a chain of stages (``iteration``); a stage is a number of independent tasks. Each task owns
what it writes and adds in a fixed order, so a run repeats bit for bit.
"""

from typing import Any

import warp as wp

# One module for all kernels, for the compilation of each more costs seconds.
MODULE = wp.get_module("warp_partdr.refine")
wp.set_module_options({"enable_backward": False, "fast_math": True}, module=MODULE)

# Columns of the energy's terms that are no rules of single parts (``rules``); one of ``NUM_TERMS`` is free.
PROJ = wp.constant(0)
SEG = wp.constant(1)
PRIOR = wp.constant(4)
NUM_TERMS = 8
Terms: Any = wp.types.vector(length=NUM_TERMS, dtype=wp.float32)


@wp.struct
class Bone:
    """One part of the template; it points along the first column of its rest axes. The root is one more bone."""

    parent: int  # -1 = none
    subtree: int  # bit j: part j moves with it
    shape: wp.vec3i  # indices of length, first and second thickness
    rest_axes: wp.mat33  # columns: bone, first thickness, second thickness


@wp.struct
class Landmark:
    """Weighted mean of a point of each of two parts."""

    parts: wp.vec2i
    shares: wp.vec2  # sum to 1
    first: wp.vec3  # in units of the semi-axes
    second: wp.vec3


@wp.struct
class LandmarkShare:
    """Point of a part that a landmark is made of, and its weight."""

    landmark: int
    weight: float
    normalised: wp.vec3  # in units of the semi-axes
    counts: int  # 1: the landmark's cost counts here; a landmark of two parts counts once


@wp.struct
class Landmarks:
    """All landmarks; ``points`` and ``votes`` hold their keypoints, N = 1 or one row a body."""

    landmarks: wp.array[Landmark]  # (L,)
    shares: wp.array[LandmarkShare]  # of part 0, of part 1, ...
    first_share: wp.array[int]  # (P + 1,) index of each part's first share
    points: wp.array2d[wp.vec2]  # (N, L) in the crop, -1 to 1
    votes: wp.array2d[float]  # (N, L) 0 = not seen


@wp.struct
class Rules:
    """Targets of the terms that need no picture: joint limits, and usual sizes and depths of N people."""

    lower_limits: wp.array[wp.vec3]  # (P,) [rad]
    upper_limits: wp.array[wp.vec3]  # (P,) [rad]
    usual_lengths: wp.array2d[float]  # (N, 12) [m]
    usual_thicknesses: wp.array2d[float]  # (N, 15) [m]
    depths: wp.array2d[float]  # (N, P) of the parts' centres [m]
    depth_scales: wp.array2d[float]  # (N, P) [1/m], by which deviations from these are multiplied


@wp.struct
class Mixture:
    """K Gaussians over S directions: the rotation vectors of parts, and up as the pelvis sees it. K = 0: no prior."""

    slots: wp.array[int]  # (P + 1,) index of a part's direction, -1 = none; the last entry is up's
    means: wp.array2d[wp.vec3]  # (K, S)
    precisions: wp.array3d[float]  # (S, 9, K S) [j, :, k S + i] is component k's matrix from direction j to slope i
    log_weights: wp.array[float]  # (K,)


@wp.struct
class StepRule:
    """Learning rates and bounds of the parameters."""

    schedule: wp.array[wp.vec2]  # (iterations + 1,) rate / (1 - beta1^t) and sqrt(1 - beta2^t); the last rate is 0
    rates: wp.array[float]  # (N,) factor of the rate
    lower: wp.array[float]  # (N,)
    upper: wp.array[float]  # (N,)


@wp.struct
class Problem:
    """Energy to be minimised, and the rule of the steps."""

    bones: wp.array[Bone]  # (P + 1,) of the template; the root comes last
    locked: int  # bit k: part k keeps its rest rotation
    half_size: float  # of the drawn crop [px]
    lenses: wp.array[wp.vec3]  # (N,) focal length and principal point in the crop, -1 to 1; length 0: weak perspective
    landmarks: Landmarks
    rules: Rules
    mixture: Mixture
    weights: Terms
    step_rule: StepRule


@wp.struct
class Drawn:
    """Output of the renderer: partial sums of L_seg, and its forces on surface points."""

    loss: wp.array2d[float]  # (B, T) [px]
    forces: wp.array4d[float]  # (B, P, S, 16)


@wp.struct
class Bodies:
    """Views of parameters, or of their gradients, that lie side by side in one row a body."""

    orientation: wp.array2d[wp.vec3]  # (B, 2) columns of the 6D orientation
    rotations: wp.array2d[wp.vec3]  # (B, P) axis times angle [rad]
    lengths: wp.array2d[float]  # (B, number of lengths) [m]
    thicknesses: wp.array2d[float]  # (B, number of thicknesses) [m]
    log_scale: wp.array[float]  # (B,) logarithm of the crop's half-sides a metre, at the pelvis
    shift: wp.array[wp.vec2]  # (B,) the root in the crop, -1 to 1


@wp.struct
class Rows:
    """Parameters and Adam's moments, one row a body."""

    parameters: wp.array2d[float]  # (B, N)
    gradient: wp.array2d[float]  # (B, N)
    first_moment: wp.array2d[float]  # (B, N)
    second_moment: wp.array2d[float]  # (B, N)
    best: wp.array2d[float]  # (B, N) parameters of the least energy


@wp.struct
class EllipsoidArrays:
    """Posed parts, and the camera that sees them."""

    centres: wp.array2d[wp.vec3]  # (B, P) [m]
    axes: wp.array2d[wp.mat33]  # (B, P) columns
    semi_axes: wp.array2d[wp.vec3]  # (B, P) [m]
    camera: wp.array[wp.vec4]  # (B,) f_x, f_y, c_x, c_y of the drawn crop [px]


@wp.struct
class Likelihood:
    """Log density of each body under the mixture, with its intermediate values."""

    directions: wp.array2d[wp.vec3]  # (B, S) the mixture's variables
    slopes: wp.array3d[wp.vec3]  # (B, K, S) precision times deviation
    exponents: wp.array2d[float]  # (B, K) log of each component's share of the density
    shares: wp.array2d[float]  # (B, K) of the density; they sum to 1
    log_density: wp.array[float]  # (B,)


@wp.struct
class Pull:
    """Cost of a landmark's distance from its keypoint, and the force that follows."""

    cost: float
    force: wp.vec3  # on the landmark
    camera: wp.vec3  # gradient of log scale and shift


@wp.struct
class Wrench:
    """Forces on one part."""

    force: wp.vec3
    torque: wp.vec3  # about the part's centre
    semi_axes: wp.vec3  # gradient of the semi-axes
    camera: wp.vec3  # gradient of log scale and shift


@wp.struct
class Load:
    """Sum of the forces on a bone's subtree."""

    force: wp.vec3
    torque: wp.vec3  # about the bone's start


@wp.struct
class Records:
    """Energies of each body: the best, and the history."""

    better: wp.array[int]  # (B,) 1 if this iteration's state is the best so far
    energy: wp.array[float]  # (B,) the best
    terms: wp.array[Terms]  # (B,) of the best
    history: wp.array2d[float]  # (iterations + 1, B)


@wp.struct
class State:
    """State of B bodies during their refinement."""

    iteration: wp.array[int]  # (B,) the one that comes next; the last one may be repeated
    bodies: Bodies
    gradient: Bodies
    rows: Rows
    turns: wp.array2d[wp.mat33]  # (B, P) local rotations
    orientations: wp.array[wp.mat33]  # (B,)
    roots: wp.array[wp.vec3]  # (B,) pelvis in the camera frame [m]; 0 in weak perspective
    ellipsoids: EllipsoidArrays
    likelihood: Likelihood
    drawn: wp.array3d[float]  # (B, P, 16) all shares of the renderer's forces, weighted
    drawn_cost: wp.array[float]  # (B,) L_seg, weighted
    pulls: wp.array2d[Pull]  # (B, L)
    wrenches: wp.array2d[Wrench]  # (B, P)
    loads: wp.array2d[Load]  # (B, P + 1) the last one is the root's
    pushes: wp.array2d[wp.vec3]  # (B, P) forces of rules on the parts' centres
    costs: wp.array2d[Terms]  # (B, P) shares of the terms, weighted
    records: Records


@wp.func
def lens_of(problem: Problem, b: int):
    """Focal length and principal point of body b's picture."""
    return problem.lenses[b % problem.lenses.shape[0]]


@wp.func
def has_bit(mask: int, bit: int):
    return (mask >> bit) & 1 == 1
