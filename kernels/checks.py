"""Faults in numbers: NaN, infinity, what is too large or not positive, matrices that are no rotations.

What passes is good; what does not is looked at again, exactly, by ``interop.checks``. Steps of a training are watched
without waiting for the device, by ``interop.training_step``.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def check_values(
    values: wp.array[float],
    largest: float,
    above: float,  # each is greater than this
    faults: wp.array[int],  # set to 1 if there is one  OUTPUT
):
    """Look at every number."""
    value = values[wp.tid()]
    if not (wp.abs(value) <= largest and value > above):
        faults[0] = 1


@wp.kernel
def check_matrices(
    matrices: wp.array[wp.mat33],
    tolerance: float,  # of the Frobenius norm of R^T R - I
    mirrored: bool,  # reflections are good, too
    faults: wp.array[int],  # OUTPUT
):
    """Look at every matrix; NaN fails."""
    matrix = matrices[wp.tid()]
    error = wp.transpose(matrix) * matrix - wp.identity(n=3, dtype=float)
    if not wp.ddot(error, error) <= tolerance * tolerance:
        faults[0] = 1
    if not mirrored and not wp.determinant(matrix) > 0.0:
        faults[0] = 1


@wp.kernel
def watch_step(
    loss: wp.array[float],  # (1,)
    norm: wp.array[float],  # (1,) of the gradient
    steps: wp.array[int],  # (1,) number of steps done  MODIFIED
    first: wp.array[int],  # (1,) number of the first step that is wrong, counted from 1; 0 = none  MODIFIED
    wrong: wp.array[float],  # (2,) its loss and norm  OUTPUT
):
    """Count a step, and note the first one that is not finite; the note is in the host's memory, which is far away."""
    step = steps[0] + 1
    steps[0] = step
    if not (wp.isfinite(loss[0]) and wp.isfinite(norm[0])):
        if first[0] == 0:
            wrong[0] = loss[0]
            wrong[1] = norm[0]
            first[0] = step


def launch_check_values(values: wp.array, *, largest: float, above: float, faults: wp.array) -> None:
    """Set ``faults`` if a number is not finite, or outside its bounds."""
    wp.launch(check_values, values.size, [values, largest, above], [faults], device=faults.device)


def launch_check_matrices(matrices: wp.array, *, tolerance: float, mirrored: bool, faults: wp.array) -> None:
    """Set ``faults`` if a matrix is no rotation."""
    wp.launch(check_matrices, matrices.size, [matrices, tolerance, mirrored], [faults], device=faults.device)


def launch_watch_step(loss: wp.array, norm: wp.array, steps: wp.array, first: wp.array, wrong: wp.array) -> None:
    """Count a step on the device, and note the first one whose loss or gradient is not finite."""
    wp.launch(watch_step, 1, [loss, norm], [steps, first, wrong], device=steps.device)
