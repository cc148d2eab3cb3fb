"""Checks of tensor arguments at the border: once, with errors that name the argument."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import SupportsIndex

import torch

from ..errors import LARGEST, InputError, check_whole
from .quick_checks import FRAMES, POSITIVE, ROTATIONS, VALUES, are_good

FLOATS = (torch.float32, torch.float64, torch.float16, torch.bfloat16)  # taken, and converted to float32

MAX_PIXELS = 2**31  # in a batch; they are counted in 32 bits
MAX_PICTURE = 2**28  # [px]; Warp counts the bytes of one picture in 32 bits, and a z-buffer has eight a pixel
_MAX_RATE = 1e3
_MAX_ITERATIONS = 10**7  # each has a row in the history

# Largest |R^T R - I| (Frobenius norm). bfloat16 rounds a rotation by up to 7e-3, float16 by 2e-3, and products of ten
# thousand rotations in float32 are off by less than 1e-3. Beyond it, ellipsoids and bones are visibly sheared.
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
        tensor: Argument that the user passed.
        shape: Expected size of each dimension; None takes any.
        dtypes: Accepted dtypes.
        like: Name and tensor with which device and floating dtype must agree.

    Raises:
        TypeError: If it is no tensor.
        ValueError: If shape, dtype or device are wrong, or it is sparse.
    """
    if not isinstance(tensor, torch.Tensor):
        raise TypeError(f"{name}: {type(tensor).__name__}; expected a torch.Tensor")
    if tensor.layout != torch.strided:
        raise ValueError(f"{name}: {tensor.layout}; expected a dense tensor")
    have = tensor.shape
    if have != shape and not _agree(shape, have):
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


def _agree(wanted: Sequence[int | None], sizes: Sequence[int]) -> bool:
    """True if sizes are as wanted; None takes any."""
    if len(wanted) != len(sizes):
        return False
    for want, size in zip(wanted, sizes, strict=True):  # noqa: SIM110  all() takes twice as long
        if want is not None and want != size:
            return False
    return True


def check_image_size(image_size: Sequence[SupportsIndex], batch: int = 1) -> tuple[int, int]:
    """Return ``image_size`` as two ints; raise unless it is two positive integers, and a batch is not too large.

    Args:
        image_size: Size (H, W) of a picture [px]: integers of any type.
        batch: Number of pictures.

    Raises:
        TypeError: If it is no sequence.
        ValueError: If it is another sequence, or a picture is too large.
        InputError: If the batch has too many pixels.
    """
    if not isinstance(image_size, Sequence):
        raise TypeError(f"image_size: {type(image_size).__name__}; expected two positive integers (H, W)")
    try:
        first, second = image_size
        height = check_whole("image_size", first, 1)
        width = check_whole("image_size", second, 1)
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
    """Raise ValueError if a tensor holds NaN, infinity or numbers that are too large for the kernels' float32.

    It waits for the device once for all tensors.
    """
    check_numbers(tensors)


def check_numbers(
    tensors: Mapping[str, torch.Tensor],
    *,
    rotations: Collection[str] = (),
    frames: Collection[str] = (),
    positive: Collection[str] = (),
) -> None:
    """Raise ValueError if a tensor holds numbers that it must not hold. It waits for the device once for all tensors.

    Args:
        tensors: Tensors by name. All must be finite, and not too large for the kernels' float32.
        rotations: Names of tensors that must be rotations, shape (..., 3, 3).
        frames: Names of tensors that must have orthonormal columns: rotations or reflections, shape (..., 3, 3).
        positive: Names of tensors that must be greater than 0.
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
        for name, tensor in tensors.items():  # find the wrong one, if any: many large numbers may only add up to it
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
        matrices: Matrices, shape (..., 3, 3).
        mirrored: True: reflections are accepted. False: their error is infinite.
    """
    matrices = matrices.detach().to(torch.promote_types(matrices.dtype, torch.float32))
    # A matrix product would be rounded by autocast and TF32.
    gram = (matrices[..., :, :, None] * matrices[..., :, None, :]).sum(-3)
    error = torch.linalg.matrix_norm(gram - torch.eye(3, dtype=gram.dtype, device=gram.device))
    if mirrored:
        return error
    x, y, z = matrices.unbind(-1)
    return torch.where((torch.linalg.cross(x, y) * z).sum(-1) > 0, error, torch.inf)


def rotation_fault(matrices: torch.Tensor, *, mirrored: bool = False) -> str | None:
    """Message about the first matrix that is no rotation; None if all are. It takes arguments as ``rotation_error``."""
    errors = rotation_error(matrices, mirrored=mirrored)
    wrong = (~(errors <= ROTATION_TOLERANCE)).nonzero().tolist()
    if not wrong:
        return None
    error, where = float(errors[tuple(wrong[0])]), wrong[0] if errors.ndim else ""
    fault = "mirrors or has no volume" if error == torch.inf else f"R^T R is off I by {error:.2g}"
    expected = "orthonormal columns" if mirrored else "rotation matrices, as rotation_from_6d makes them"
    return f"matrix {where} {fault}; expected {expected}".replace("  ", " ")


def check_steps(iterations: int, learning_rate: float) -> int:
    """Return the number of steps as an ``int``; raise ValueError if it or the rate is out of range."""
    iterations = check_whole("iterations", iterations, 0, _MAX_ITERATIONS)
    if not 0 <= learning_rate <= _MAX_RATE:
        raise ValueError(f"learning_rate: {learning_rate}; expected 0 to {_MAX_RATE:g}")
    return iterations
