"""Depth by which capsules stand in one another, within a body and between bodies that share a place.

A capsule is all within a radius of a line between two ends. Each thread has a capsule and looks at all others, so that
each writes its own gradient alone: a pair is met twice, and costs half each time. Before that, joints carry capsules.
"""

import warp as wp

from .joint_chain import turn_of

wp.set_module_options({"enable_backward": False})

CENTIMETRES = wp.constant(100.0)  # of a metre
NUMBERS = wp.constant(7)  # of a capsule: both ends [m], then the radius [m]
_SHORT = wp.constant(1.0e-8)  # [m^2], of what is a point, or has no direction
_PARALLEL = wp.constant(1.0e-5)  # squared sine of the angle between lines


@wp.struct
class Touching:
    """Places where two lines between ends are nearest to one another."""

    own: float  # share of the way along the first
    other: float  # and along the second
    apart: wp.vec3  # from the second to the first [m]


@wp.func
def end_of(capsules: wp.array[float], index: int, end: int) -> wp.vec3:
    k = index * NUMBERS + 3 * end
    return wp.vec3(capsules[k], capsules[k + 1], capsules[k + 2])


@wp.func
def nearest_of_lines(a: wp.vec3, along_a: wp.vec3, b: wp.vec3, along_b: wp.vec3) -> Touching:
    """Nearest points of a + s along_a and b + t along_b, s and t from 0 to 1."""
    found = Touching()
    between = a - b
    aa, bb, ab = wp.length_sq(along_a), wp.length_sq(along_b), wp.dot(along_a, along_b)
    on_a, on_b = wp.dot(along_a, between), wp.dot(along_b, between)
    s = float(0.0)
    room = aa * bb - ab * ab
    if room > _PARALLEL * aa * bb:
        s = wp.clamp((ab * on_b - on_a * bb) / room, 0.0, 1.0)
    elif aa > _SHORT:
        # Of parallel lines, the middle of where they lie side by side.
        first, last = -on_a / aa, (ab - on_a) / aa
        s = 0.5 * (wp.clamp(wp.min(first, last), 0.0, 1.0) + wp.clamp(wp.max(first, last), 0.0, 1.0))
    t = float(0.0)
    if bb > _SHORT:
        t = wp.clamp((ab * s + on_b) / bb, 0.0, 1.0)
    if aa > _SHORT:
        s = wp.clamp((ab * t - on_a) / aa, 0.0, 1.0)
    found.own = s
    found.other = t
    found.apart = between + s * along_a - t * along_b
    return found


@wp.kernel
def overlap_costs(
    capsules: wp.array[float],  # (B C 7,)
    allowed: wp.array[float],  # (C C,) depth that costs nothing within a body [m]; infinite: no depth does
    slack: float,  # the same between bodies [m]
    num_capsules: int,  # C
    num_people: int,  # P: body b shares its place with b + B / P, b + 2 B / P, ...
    first: int,  # number of the first thread
    costs: wp.array[float],  # (B C P,) half the squares of depths [cm^2]  OUTPUT
    gradients: wp.array[float],  # (B C P 7,) of the squares themselves: of both halves  OUTPUT
):
    """One thread a capsule and a person: all who meet in one thread's loop would take too few of a GPU's."""
    thread = first + wp.tid()
    i = thread // num_people
    person = thread - i * num_people
    places = costs.shape[0] // num_people // num_capsules // num_people
    own_body = i // num_capsules
    own = i - own_body * num_capsules
    a, radius = end_of(capsules, i, 0), capsules[i * NUMBERS + 6]
    along_a = end_of(capsules, i, 1) - a
    half_a = 0.5 * wp.length(along_a)
    cost, by_radius = float(0.0), float(0.0)
    by_start, by_end = wp.vec3(), wp.vec3()
    body = own_body % places + person * places
    for other in range(num_capsules):
        free = slack
        if body == own_body:
            free = allowed[own * num_capsules + other]
        j = body * num_capsules + other
        b, sum_of_radii = end_of(capsules, j, 0), radius + capsules[j * NUMBERS + 6]
        along_b = end_of(capsules, j, 1) - b
        # Balls around both: most pairs are far apart.
        reach = half_a + 0.5 * wp.length(along_b) + sum_of_radii - free
        far = reach <= 0.0 or wp.length_sq(a - b + 0.5 * (along_a - along_b)) >= reach * reach
        if not far:  # of NaN, too, which stays NaN
            near = nearest_of_lines(a, along_a, b, along_b)
            distance = wp.length(near.apart)
            depth = CENTIMETRES * (sum_of_radii - free - distance)
            if not depth <= 0.0:
                out = wp.normalize(near.apart)
                if distance * distance < _SHORT:
                    # Lines that cross: both ways out are as far, and each goes the opposite one.
                    out = wp.normalize(wp.cross(along_a, along_b))
                slope = 2.0 * CENTIMETRES * depth
                cost += 0.5 * depth * depth
                by_radius += slope
                by_start -= (1.0 - near.own) * slope * out
                by_end -= near.own * slope * out
    costs[thread] = cost
    for k in range(3):
        gradients[thread * NUMBERS + k] = by_start[k]
        gradients[thread * NUMBERS + 3 + k] = by_end[k]
    gradients[thread * NUMBERS + 6] = by_radius


@wp.func
def three_of(numbers: wp.array3d[float], b: int, c: int, first: int):
    return wp.vec3(numbers[b, c, first], numbers[b, c, first + 1], numbers[b, c, first + 2])


@wp.kernel
def place_capsules(
    rest: wp.array3d[float],  # (B, C, 7) ends from their joints, and radii [m]
    frames: wp.array2d[wp.mat44],  # (B, J) of joints
    moves: wp.array[wp.vec3],  # (B,) of bodies [m]
    joints: wp.array[wp.int64],  # (C,)
    placed: wp.array3d[float],  # (B, C, 7)  OUTPUT
):
    """One thread a capsule."""
    b, c = wp.tid()
    frame = frames[b, int(joints[c])]
    start = wp.vec3(frame[0, 3], frame[1, 3], frame[2, 3]) + moves[b]
    for end in range(2):
        point = turn_of(frame, wp.mat33()) * three_of(rest, b, c, 3 * end) + start
        for k in range(3):
            placed[b, c, 3 * end + k] = point[k]
    placed[b, c, 6] = rest[b, c, 6]


@wp.kernel
def place_capsules_adjoint(
    rest: wp.array3d[float],
    frames: wp.array2d[wp.mat44],
    joints: wp.array[wp.int64],
    adj_placed: wp.array3d[float],  # (B, C, 7)
    grad_rest: wp.array3d[float],  # (B, C, 7)  OUTPUT
):
    """One thread a capsule."""
    b, c = wp.tid()
    back = wp.transpose(turn_of(frames[b, int(joints[c])], wp.mat33()))
    for end in range(2):
        point = back * three_of(adj_placed, b, c, 3 * end)
        for k in range(3):
            grad_rest[b, c, 3 * end + k] = point[k]
    grad_rest[b, c, 6] = adj_placed[b, c, 6]


@wp.kernel
def turn_joints_adjoint(
    rest: wp.array3d[float],
    joints: wp.array[wp.int64],
    adj_placed: wp.array3d[float],
    grad_frames: wp.array2d[wp.mat44],  # (B, J); the last column is that of the places  OUTPUT
):
    """One thread a joint, which adds the capsules that it carries."""
    b, j = wp.tid()
    turn, move = wp.mat33(), wp.vec3()
    for c in range(joints.shape[0]):
        if int(joints[c]) == j:
            for end in range(2):
                pull = three_of(adj_placed, b, c, 3 * end)
                turn += wp.outer(pull, three_of(rest, b, c, 3 * end))
                move += pull
    grad_frames[b, j] = wp.mat44(
        turn[0, 0], turn[0, 1], turn[0, 2], move[0],
        turn[1, 0], turn[1, 1], turn[1, 2], move[1],
        turn[2, 0], turn[2, 1], turn[2, 2], move[2],
        0.0, 0.0, 0.0, 0.0,
    )  # fmt: skip


def launch_place_capsules(
    rest: wp.array, frames: wp.array, moves: wp.array, joints: wp.array, placed: wp.array
) -> None:
    """Fill ``placed``."""
    wp.launch(place_capsules, placed.shape[:2], [rest, frames, moves, joints, placed], device=placed.device)


def launch_place_capsules_adjoint(
    rest: wp.array, frames: wp.array, joints: wp.array, adjoint: wp.array, gradients: tuple[wp.array, wp.array]
) -> None:
    """Fill ``gradients`` with respect to rest and frames from the ``adjoint`` of what ``place_capsules`` filled."""
    by_rest, by_frames = gradients
    shape, device = rest.shape[:2], rest.device
    wp.launch(place_capsules_adjoint, shape, [rest, frames, joints, adjoint, by_rest], device=device)
    wp.launch(turn_joints_adjoint, by_frames.shape, [rest, joints, adjoint, by_frames], device=device)
