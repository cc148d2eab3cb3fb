"""Checks of tensor arguments at the border: once, with errors that name the argument."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import SupportsIndex

import torch

from ..errors import LARGEST, InputError, check_whole
from .quick_checks import FRAMES, POSITIVE, ROTATIONS, VALUES, are_good

FLOATS = (torch.float32, torch.float64, torch.float16, torch.bfloat16)  # taken, and converted to float32

MAX_PIXELS = 2**31  # of a batch: they are counted in 32 bits
MAX_PICTURE = 2**28  # [px]; Warp counts the bytes of one picture in 32 bits, and a z-buffer has eight a pixel
_MAX_RATE = 1e3
_MAX_ITERATIONS = 10**7  # each has a row in the history

# Of |R^T R - I| (Frobenius): bfloat16 rounds a rotation by up to 7e-3, float16 by 2e-3, products of ten thousand
# rotations in float32 by less than 1e-3. Beyond it, ellipsoids and bones are visibly sheared or scaled.
ROTATION_TOLERANCE = 1e-2


def check_tensor(
    name: str,
    tensor: torch.Tensor,
    shape: tuple[int | None, ...],
    *,
    dtypes: Sequence[torch.dtype],
    like: tuple[str, torch.Tensor] | None = None,
) -> None:
    """Raise unless ``tensor`` has this shape (None = any) and one of the dtypes.

    Args:
        name: The argument's name, for the message.
        tensor: What the user passed.
        shape: Expected size of each dimension; None takes any.
        dtypes: Accepted dtypes.
        like: Name and tensor whose device, and dtype where it is a floating one, must be the same.

    Raises:
        TypeError: If it is no tensor.
        ValueError: If shape, dtype or device differ, or it is sparse.
    """
    if not isinstance(tensor, torch.Tensor):
        raise TypeError(f"{name}: {type(tensor).__name__}; expected a torch.Tensor")
    if tensor.layout != torch.strided:
        raise ValueError(f"{name}: {tensor.layout}; expected a dense tensor")
    have = tensor.shape
    if have != shape and (
        len(have) != len(shape) or any(want not in (None, size) for want, size in zip(shape, have, strict=True))
    ):
        expected = ", ".join("*" if size is None else str(size) for size in shape)
        raise ValueError(f"{name}: shape {tuple(have)}; expected ({expected})")
    if tensor.dtype not in dtypes:
        raise ValueError(f"{name}: {tensor.dtype}; expected {' or '.join(map(str, dtypes))}")
    if like is not None:
        other_name, other = like
        if not isinstance(other, torch.Tensor):
            raise TypeError(f"{other_name}: {type(other).__name__}; expected a torch.Tensor")
        if tensor.device != other.device:
            raise ValueError(f"{name}: on {tensor.device}; expected {other.device}, as {other_name}")
        if tensor.dtype != other.dtype and tensor.is_floating_point() and other.is_floating_point():
            raise ValueError(f"{name}: {tensor.dtype}; expected {other.dtype}, as {other_name}")
    if tensor.is_meta:
        raise ValueError(f"{name}: on meta; expected a device that holds numbers")


def check_image_size(image_size: Sequence[SupportsIndex], batch: int = 1) -> tuple[int, int]:
    """``image_size`` as two ints: positive integers of any type, of which so many pictures can be counted.

    Raises:
        TypeError: If it is no sequence.
        ValueError: If it is another sequence, or the pictures are too large.
    """
    if not isinstance(image_size, Sequence):
        raise TypeError(f"image_size: {type(image_size).__name__}; expected two positive integers (H, W)")
    try:
        height, width = (check_whole("image_size", size, 1) for size in image_size)
    except ValueError:  # also if they are not two
        raise ValueError(f"image_size: {image_size}; expected two positive integers (H, W)") from None
    pixels = height * width
    if pixels >= MAX_PICTURE:
        raise ValueError(f"image_size: 1 pictures of {(height, width)}; expected fewer than 2**28 pixels each")
    if batch * pixels >= MAX_PIXELS:
        raise InputError(
            f"image_size: {batch} pictures of {(height, width)}; expected fewer than 2**31 pixels, split the batch"
        )
    return height, width


def check_finite(**tensors: torch.Tensor) -> None:
    """Raise ValueError if a tensor holds NaN, infinity or numbers that the kernels' float32 can't reckon with.

    Synchronises with the device, once for all of them.
    """
    check_numbers(tensors)


def check_numbers(
    tensors: Mapping[str, torch.Tensor],
    *,
    rotations: Collection[str] = (),
    frames: Collection[str] = (),
    positive: Collection[str] = (),
) -> None:
    """Raise ValueError if a tensor holds other numbers than it may; waits for the device once for all of them.

    Args:
        tensors: By name; finite, and not larger than the kernels' float32 can reckon with.
        rotations: Names of those that are rotations, shape (..., 3, 3).
        frames: Names of those with orthonormal columns: rotations or reflections.
        positive: Names of those that are greater than 0.
    """
    kinds = dict.fromkeys(tensors, VALUES) | dict.fromkeys(positive, POSITIVE)
    kinds |= dict.fromkeys(rotations, ROTATIONS) | dict.fromkeys(frames, FRAMES)
    with torch.no_grad():
        if are_good(list(tensors.values()), tuple(kinds.values()), ROTATION_TOLERANCE):
            return
        norms = [torch.linalg.vector_norm(tensor, dtype=torch.float64) for tensor in tensors.values()]
        wrong = [~(torch.stack(norms).sum() <= LARGEST)]
        for names, mirrored in ((rotations, False), (frames, True)):
            wrong += [~(rotation_error(tensors[n], mirrored=mirrored) <= ROTATION_TOLERANCE).all() for n in names]
        wrong += [~(tensors[name] > 0).all() for name in positive]
        if not torch.stack(wrong).any():
            return
        for name, tensor in tensors.items():  # which one, if any: many numbers may just add up to so much
            if not torch.isfinite(tensor).all():
                raise ValueError(f"{name}: holds NaN or infinity; expected finite numbers")
            if (tensor.abs() > LARGEST).any():
                raise ValueError(f"{name}: holds {tensor.abs().max():g}; expected numbers up to {LARGEST:g}")
        for name in (*rotations, *frames):
            if fault := rotation_fault(tensors[name], mirrored=name in frames):
                raise ValueError(f"{name}: {fault}")
        for name in positive:
            if not (tensors[name] > 0).all():
                raise ValueError(f"{name}: {float(tensors[name].min())}; expected positive numbers")


def rotation_error(matrices: torch.Tensor, *, mirrored: bool = False) -> torch.Tensor:
    """Error of matrices as rotations: the Frobenius norm of R^T R - I, shape (...).

    Args:
        matrices: Shape (..., 3, 3).
        mirrored: Accept reflections; else their error is infinite.
    """
    matrices = matrices.detach().to(torch.promote_types(matrices.dtype, torch.float32))
    # Not by a matrix product, which autocast and TF32 would round.
    gram = (matrices[..., :, :, None] * matrices[..., :, None, :]).sum(-3)
    error = torch.linalg.matrix_norm(gram - torch.eye(3, dtype=gram.dtype, device=gram.device))
    if mirrored:
        return error
    x, y, z = matrices.unbind(-1)
    return torch.where((torch.linalg.cross(x, y) * z).sum(-1) > 0, error, torch.inf)


def rotation_fault(matrices: torch.Tensor, *, mirrored: bool = False) -> str | None:
    """Message about the first matrix that is no rotation, None if all are; arguments as of ``rotation_error``."""
    errors = rotation_error(matrices, mirrored=mirrored)
    wrong = (~(errors <= ROTATION_TOLERANCE)).nonzero().tolist()
    if not wrong:
        return None
    error, where = float(errors[tuple(wrong[0])]), wrong[0] if errors.ndim else ""
    said = "mirrors or has no volume" if error == torch.inf else f"R^T R is off I by {error:.2g}"
    expected = "orthonormal columns" if mirrored else "rotation matrices, as rotation_from_6d makes them"
    return f"matrix {where} {said}; expected {expected}".replace("  ", " ")


def check_steps(iterations: int, learning_rate: float) -> int:
    """Number of steps as an ``int``; raises ValueError unless it is one, and the rate finite."""
    iterations = check_whole("iterations", iterations, 0, _MAX_ITERATIONS)
    if not 0 <= learning_rate <= _MAX_RATE:
        raise ValueError(f"learning_rate: {learning_rate}; expected 0 to {_MAX_RATE:g}")
    return iterations
