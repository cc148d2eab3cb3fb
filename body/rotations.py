"""Rotation matrices from axis-angle and 6D numbers and back, on torch tensors, with finite gradients everywhere."""

from __future__ import annotations

import torch

from ..interop.captured_call import call_as_graph

_TINY_ANGLE = 1e-4  # [rad]; below it Taylor's series are exact to float32 and need no division
_TINY_LENGTH = 1e-6  # shorter columns have no direction


def skew(vector: torch.Tensor) -> torch.Tensor:
    """Cross-product matrix of vectors (..., 3), shape (..., 3, 3)."""
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))


def _check(name: str, tensor: torch.Tensor, shape: tuple[int, ...]) -> None:
    """Raise unless it is a dense floating tensor (..., *shape)."""
    if not isinstance(tensor, torch.Tensor):
        raise TypeError(f"{name}: {type(tensor).__name__}; expected a torch.Tensor")
    if tensor.shape[-len(shape) :] != shape or not tensor.is_floating_point() or tensor.layout != torch.strided:
        expected = ", ".join(["...", *map(str, shape)])
        raise ValueError(
            f"{name}: {tensor.dtype}, {tensor.layout}, shape {tuple(tensor.shape)}; expected dense floats ({expected})"
        )


def rotation_from_axis_angle(axis_angle: torch.Tensor) -> torch.Tensor:
    """Rotation matrices from axis times angle, by Rodrigues' formula.

    Args:
        axis_angle: Axis times angle [rad], shape (..., 3). Any length; zero is the identity.

    Returns:
        Rotation matrices, shape (..., 3, 3).

    Raises:
        ValueError: If the shape or dtype is wrong.

    Examples:
        >>> import torch
        >>> from warp_partdr import rotation_from_axis_angle
        >>> quarter = rotation_from_axis_angle(torch.tensor([0.0, torch.pi / 2, 0.0]))
        >>> torch.allclose(quarter @ torch.tensor([0.0, 0.0, 1.0]), torch.tensor([1.0, 0.0, 0.0]), atol=1e-6)
        True
    """
    _check("axis_angle", axis_angle, (3,))
    if torch.finfo(axis_angle.dtype).bits == 16:  # whose squares of small angles are 0
        return rotation_from_axis_angle(axis_angle.float()).to(axis_angle.dtype)
    square = (axis_angle * axis_angle).sum(-1)[..., None, None]
    small = square < _TINY_ANGLE**2
    # where() alone would still differentiate the branch not taken, through sqrt(0)
    angle = torch.where(small, torch.ones_like(square), square).sqrt()
    first = torch.where(small, 1 - square / 6, angle.sin() / angle)
    second = torch.where(small, 0.5 - square / 24, 2 * (angle / 2).sin().square() / angle.square())
    cross = skew(axis_angle)
    identity = torch.eye(3, dtype=axis_angle.dtype, device=axis_angle.device)
    return identity + first * cross + second * (cross @ cross)


def rotation_from_6d(columns: torch.Tensor) -> torch.Tensor:
    """Rotation matrices from two columns, by Gram-Schmidt (Zhou et al., 2019; paper, section 3.4).

    Args:
        columns: First and second column, one after the other, shape (..., 6).

    Returns:
        Rotation matrices, shape (..., 3, 3). A column without direction, or a second one along the first, is replaced
        by a fixed other direction, so that the result is a rotation always.

    Raises:
        ValueError: If the shape or dtype is wrong.

    Examples:
        >>> import torch
        >>> from warp_partdr import rotation_from_6d
        >>> rotation_from_6d(torch.tensor([2.0, 0.0, 0.0, 1.0, 1.0, 0.0]))
        tensor([[1., 0., 0.],
                [0., 1., 0.],
                [0., 0., 1.]])
    """
    _check("columns", columns, (6,))
    first, second = columns[..., :3], columns[..., 3:]
    axes = torch.eye(3, dtype=columns.dtype, device=columns.device)
    first = _normalise_or(first, axes[0])
    # The coordinate axis that the first column points along least. Not by an index of no dimension, which torch reads.
    least = axes[first.detach().abs().argmin(-1, keepdim=True)].squeeze(-2)
    rest = second - (first * second).sum(-1, keepdim=True) * first
    fallback = least - (first * least).sum(-1, keepdim=True) * first
    # What is left after the projection is rounding where the columns were collinear: measure it against the column.
    collinear = rest.norm(dim=-1, keepdim=True) <= _TINY_LENGTH * second.norm(dim=-1, keepdim=True)
    second = _normalise_or(torch.where(collinear, fallback, rest), fallback)
    second = _normalise_or(second - (first * second).sum(-1, keepdim=True) * first, fallback)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


def rotation_to_6d(rotation: torch.Tensor) -> torch.Tensor:
    """First two columns of rotation matrices; ``rotation_from_6d`` is the way back.

    Args:
        rotation: Rotation matrices, shape (..., 3, 3). It is not checked that they are rotations.

    Returns:
        First and second column, one after the other, shape (..., 6).

    Raises:
        TypeError: If ``rotation`` is no tensor.
        ValueError: If the shape or dtype is wrong.

    Examples:
        >>> import torch
        >>> from warp_partdr import rotation_to_6d
        >>> rotation_to_6d(torch.eye(3))
        tensor([1., 0., 0., 0., 1., 0.])
    """
    _check("rotation", rotation, (3, 3))
    return torch.cat([rotation[..., 0], rotation[..., 1]], dim=-1)


def rotation_to_quaternion(rotation: torch.Tensor) -> torch.Tensor:
    """Unit quaternions (w, x, y, z), w >= 0, of rotation matrices (..., 3, 3), shape (..., 4).

    Through the largest component (Shepperd, 1978), so that it holds at half a turn.
    """
    _check("rotation", rotation, (3, 3))
    m = rotation
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    # Rows of the matrix 4 q qᵀ.
    off = lambda i, j, sign: m[..., i, j] + sign * m[..., j, i]  # noqa: E731
    rows = [
        torch.stack([1 + trace, off(2, 1, -1), off(0, 2, -1), off(1, 0, -1)], -1),
        torch.stack([off(2, 1, -1), 1 - trace + 2 * m[..., 0, 0], off(0, 1, 1), off(0, 2, 1)], -1),
        torch.stack([off(0, 2, -1), off(0, 1, 1), 1 - trace + 2 * m[..., 1, 1], off(1, 2, 1)], -1),
        torch.stack([off(1, 0, -1), off(0, 2, 1), off(1, 2, 1), 1 - trace + 2 * m[..., 2, 2]], -1),
    ]
    products = torch.stack(rows, dim=-2)
    largest = torch.diagonal(products, dim1=-2, dim2=-1).argmax(-1)
    quaternion = products.gather(-2, largest[..., None, None].expand(*largest.shape, 1, 4)).squeeze(-2)
    quaternion = torch.nn.functional.normalize(quaternion, dim=-1)
    return torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)


def rotation_to_axis_angle(rotation: torch.Tensor) -> torch.Tensor:
    """Axis times angle of rotation matrices; ``rotation_from_axis_angle`` is the way back.

    The angle is from 0 to pi. So a rotation that was made of a larger angle comes back as an equal one of a smaller
    angle: 4 rad about z become -2.28 rad.

    Args:
        rotation: Rotation matrices, shape (..., 3, 3). It is not checked that they are rotations.

    Returns:
        Unit axis times angle [rad], shape (..., 3).

    Raises:
        TypeError: If ``rotation`` is no tensor.
        ValueError: If the shape or dtype is wrong.

    Examples:
        >>> import torch
        >>> from warp_partdr import rotation_from_axis_angle, rotation_to_axis_angle
        >>> turned = rotation_from_axis_angle(torch.tensor([0.0, 0.0, 4.0]))
        >>> f"{rotation_to_axis_angle(turned)[2]:.2f}"
        '-2.28'
    """
    quaternion = rotation_to_quaternion(rotation)
    w, xyz = quaternion[..., 0], quaternion[..., 1:]
    square = (xyz * xyz).sum(-1)
    small = square < _TINY_ANGLE**2
    sine = torch.where(small, torch.ones_like(square), square).sqrt()
    factor = torch.where(small, 2 / w.clamp_min(0.5), 2 * torch.atan2(sine, w) / sine)
    return xyz * factor[..., None]


def replayed_axis_angles(rotations: torch.Tensor) -> torch.Tensor:
    """``rotation_to_axis_angle`` of many rotations, whose operators a CUDA graph replays from the second call on."""
    return call_as_graph(_axis_angles, (rotations,))[0]


def _axis_angles(rotations: torch.Tensor) -> tuple[torch.Tensor]:
    return (rotation_to_axis_angle(rotations),)


def nearest_rotation(matrices: torch.Tensor) -> torch.Tensor:
    """Rotations nearest to matrices (..., 3, 3) by the squares of their entries; to a sum of rotations, their mean."""
    u, _, v = torch.linalg.svd(matrices)
    signs = torch.ones_like(u[..., 0])
    signs[..., 2] = torch.linalg.det(u @ v)
    return u * signs[..., None, :] @ v


def _normalise_or(vector: torch.Tensor, fallback: torch.Tensor) -> torch.Tensor:
    """Unit vectors; ``fallback``'s direction where there is none."""
    # Scale by the largest entry first: squares of 1e-30 or 1e30 would leave float32.
    scale = vector.detach().abs().amax(-1, keepdim=True)
    lost = scale <= 0
    vector = torch.where(lost, fallback.expand_as(vector), vector / torch.where(lost, torch.ones_like(scale), scale))
    return vector / vector.norm(dim=-1, keepdim=True)


def rotation_between(source: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """The smallest rotation that takes one direction to another, of any length, (..., 3) each, shape (..., 3, 3).

    Of opposite ones, where there is no smallest, it is a half turn at most, and finite.
    """
    cross = torch.linalg.cross(source, target)
    sine = cross.norm(dim=-1, keepdim=True)
    angle = torch.atan2(sine, (source * target).sum(-1, keepdim=True))
    return rotation_from_axis_angle(cross / sine.clamp(min=1e-9) * angle)
