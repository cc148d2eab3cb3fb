"""Products of rigid motions along a tree of joints, and their adjoint: a joint gathers, so nothing is added atomically.

``R_k = R_parent r_k``, ``p_k = p_parent + R_parent t_k``. That holds of any matrices, rotations or not. Both kernels
exist in float32 and float64.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import warp as wp

from .lanes import num_lanes, wait_for_block

wp.set_module_options({"enable_backward": False})


@wp.struct
class JointTree:
    """Joints level by level from the root on: those of a level hang on joints of the level before."""

    parents: wp.array[int]  # (J,) parent of each joint, -1 = root
    joints: wp.array[int]  # (J,) in the order of levels
    levels: wp.array[int]  # (L + 1,) where each level begins
    children: wp.array[int]  # (J,) joints in the order of their parents
    first_child: wp.array[int]  # (J + 1,) where the children of each begin


@wp.kernel(grid_stride=False)
def chain_body(
    tree: JointTree,
    one: Any,
    rotations: wp.array2d[Any],  # (B, J) mat33, local
    bones: wp.array2d[Any],  # (B, J) vec3, from the parent in its axes; of the root, its place
    transforms: wp.array2d[Any],  # (B, J) mat44  OUTPUT
):
    """Chain a body: a warp on CUDA, whose threads share the joints of a level."""
    thread = wp.tid()
    b = thread // wp.block_dim()
    lane = thread - b * wp.block_dim()
    zero = one - one
    for level in range(tree.levels.shape[0] - 1):
        for i in range(tree.levels[level] + lane, tree.levels[level + 1], wp.block_dim()):
            k = tree.joints[i]
            turn = rotations[b, k]
            place = bones[b, k]
            above = tree.parents[k]
            if above >= 0:
                t = transforms[b, above]
                turn = turn_of(t, turn) * turn
                place = turn_of(t, turn) * place + last_column(t, place)
            transforms[b, k] = transforms.dtype(
                turn[0, 0], turn[0, 1], turn[0, 2], place[0],
                turn[1, 0], turn[1, 1], turn[1, 2], place[1],
                turn[2, 0], turn[2, 1], turn[2, 2], place[2],
                zero, zero, zero, one,
            )  # fmt: skip
        wait_for_block()


@wp.func
def turn_of(transform: Any, like: Any):
    """Upper left 3 x 3 of a 4 x 4, of the type of ``like``."""
    return type(like)(
        transform[0, 0], transform[0, 1], transform[0, 2],
        transform[1, 0], transform[1, 1], transform[1, 2],
        transform[2, 0], transform[2, 1], transform[2, 2],
    )  # fmt: skip


@wp.func
def last_column(transform: Any, like: Any):
    """Upper right column of a 4 x 4, of the type of ``like``."""
    return type(like)(transform[0, 3], transform[1, 3], transform[2, 3])


@wp.kernel(grid_stride=False)
def chain_body_adjoint(
    tree: JointTree,
    rotations: wp.array2d[Any],
    bones: wp.array2d[Any],
    transforms: wp.array2d[Any],  # from the forward pass
    adj_transforms: wp.array2d[Any],  # (B, J) mat44
    turn_sums: wp.array2d[Any],  # (B, J) mat33  SCRATCH adjoint of a joint's turn, of all that hangs on it
    place_sums: wp.array2d[Any],  # (B, J) vec3  SCRATCH and of its place
    grad_rotations: wp.array2d[Any],  # (B, J) mat33  OUTPUT
    grad_bones: wp.array2d[Any],  # (B, J) vec3  OUTPUT
):
    """Push a body, from the last level to the root."""
    thread = wp.tid()
    b = thread // wp.block_dim()
    lane = thread - b * wp.block_dim()
    last = tree.levels.shape[0] - 2
    for down in range(last + 1):
        level = last - down
        for i in range(tree.levels[level] + lane, tree.levels[level + 1], wp.block_dim()):
            k = tree.joints[i]
            turn = turn_of(adj_transforms[b, k], rotations[b, k])
            place = last_column(adj_transforms[b, k], bones[b, k])
            for c in range(tree.first_child[k], tree.first_child[k + 1]):
                child = tree.children[c]
                pull = place_sums[b, child]
                turn = turn + turn_sums[b, child] * wp.transpose(rotations[b, child]) + wp.outer(pull, bones[b, child])
                place = place + pull
            turn_sums[b, k] = turn
            place_sums[b, k] = place
            above = tree.parents[k]
            if above >= 0:
                back = wp.transpose(turn_of(transforms[b, above], turn))
                turn = back * turn
                place = back * place
            grad_rotations[b, k] = turn
            grad_bones[b, k] = place
        wait_for_block()


def _register(scalar: type, vec: type, mat: type, frame: type) -> None:
    """Register one precision up front: an overload that appears later would compile the module again."""
    v, m, f = wp.array2d[vec], wp.array2d[mat], wp.array2d[frame]
    wp.overload(chain_body, [JointTree, scalar, m, v, f])
    wp.overload(chain_body_adjoint, [JointTree, m, v, f, f, m, v, m, v])


_register(wp.float32, wp.vec3f, wp.mat33f, wp.mat44f)
_register(wp.float64, wp.vec3d, wp.mat33d, wp.mat44d)


class JointTypes(NamedTuple):
    """Types of one precision."""

    scalar: type
    vec: type
    mat: type
    frame: type


SINGLE = JointTypes(wp.float32, wp.vec3f, wp.mat33f, wp.mat44f)
DOUBLE = JointTypes(wp.float64, wp.vec3d, wp.mat33d, wp.mat44d)


def make_joint_tree(parents: Sequence[int], device: str) -> Any:
    """A tree of joints, each of which comes after its parent."""
    above: list[int] = []
    for parent in parents:
        above.append(0 if parent < 0 else above[parent] + 1)
    order = sorted(range(len(parents)), key=above.__getitem__)
    children = sorted((joint for joint, parent in enumerate(parents) if parent >= 0), key=parents.__getitem__)
    counts = [sum(parent < joint for parent in parents if parent >= 0) for joint in range(len(parents) + 1)]
    starts = [sum(each < level for each in above) for level in range(max(above) + 2)]
    tree = JointTree()
    for name, values in (
        ("parents", parents),
        ("joints", order),
        ("levels", starts),
        ("children", children),
        ("first_child", counts),
    ):
        setattr(tree, name, wp.array(list(values), dtype=int, device=device))
    return tree


def launch_chain(tree: Any, one: Any, inputs: Sequence[wp.array], transforms: wp.array) -> None:
    """Fill ``transforms`` from local rotations and bones."""
    _launch(chain_body, transforms, [tree, one, *inputs, transforms])


def launch_chain_adjoint(tree: Any, saved: Sequence[wp.array], adjoint: wp.array, found: Sequence[wp.array]) -> None:
    """Fill ``found``, which is scratch and then gradients, from the adjoint of the transforms.

    ``saved`` are rotations, bones and transforms.
    """
    _launch(chain_body_adjoint, adjoint, [tree, *saved, adjoint, *found])


def _launch(kernel: wp.Kernel, frames: wp.array, inputs: Sequence[Any]) -> None:
    lanes = num_lanes(frames.device)
    wp.launch(kernel, frames.shape[0] * lanes, inputs, device=frames.device, block_dim=lanes)
