"""Faults in numbers: NaN, infinity, what is too large or not positive, matrices that are no rotations.

What passes is good; what does not is looked at again, exactly, by ``interop.checks``.
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


def launch_check_values(values: wp.array, *, largest: float, above: float, faults: wp.array) -> None:
    """Set ``faults`` if a number is not finite, or outside its bounds."""
    wp.launch(check_values, values.size, [values, largest, above], [faults], device=faults.device)


def launch_check_matrices(matrices: wp.array, *, tolerance: float, mirrored: bool, faults: wp.array) -> None:
    """Set ``faults`` if a matrix is no rotation."""
    wp.launch(check_matrices, matrices.size, [matrices, tolerance, mirrored], [faults], device=faults.device)
