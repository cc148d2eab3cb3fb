"""Parameters of SMPL, SMPL-H and SMPL-X by the names and in the terms of the ``smplx`` package, and back.

There a pose is rotation vectors, and ``transl`` moves the body whose root joint stands where its shape has it. Hands
are whole turns from flat ones: ``use_pca=False, flat_hand_mean=True`` in ``smplx``.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch

from ..body.rotations import rotation_from_axis_angle, rotation_to_axis_angle
from ..errors import InputError
from .model import DetailedModel

_HANDS = {"left_hand_pose": 15, "right_hand_pose": 15}
# Model: joints of each of its poses, in their order.
POSES: dict[str, dict[str, int]] = {
    "smpl": {"global_orient": 1, "body_pose": 23},
    "smplh": {"global_orient": 1, "body_pose": 21, **_HANDS},
    "smplx": {"global_orient": 1, "body_pose": 21, "jaw_pose": 1, "leye_pose": 1, "reye_pose": 1, **_HANDS},
}


def to_smplx(
    model: DetailedModel, shape: torch.Tensor, rotations: torch.Tensor, translation: torch.Tensor
) -> dict[str, np.ndarray]:
    """Arguments of the ``smplx`` package's models for bodies, float32, with B rows each.

    Args:
        model: Model from a file of SMPL, SMPL-H or SMPL-X.
        shape: Shape values, as for ``model.pose``, shape (B, S).
        rotations: Local rotation of each joint, shape (B, J, 3, 3).
        translation: Position of the root joint [m], shape (B, 3).

    Raises:
        InputError: If the model is another one.

    Examples:
        >>> import torch
        >>> from warp_partdr import load_model, to_smplx
        >>> model = load_model("SMPL_NEUTRAL.npz")
        >>> rotations = torch.eye(3).repeat(1, model.num_joints, 1, 1)
        >>> arguments = to_smplx(model, torch.zeros(1, model.num_shapes), rotations, torch.zeros(1, 3))
        >>> {name: values.shape for name, values in arguments.items()}
        {'betas': (1, 10), 'global_orient': (1, 3), 'body_pose': (1, 69), 'transl': (1, 3)}
    """
    sizes = _sizes(model)
    shape, rotations, translation = (each.detach().cpu().double() for each in (shape, rotations, translation))
    vectors = rotation_to_axis_angle(rotations).split(list(sizes.values()), dim=1)
    poses = {name: each.flatten(1) for name, each in zip(sizes, vectors, strict=True)}
    found = {"betas": shape, **poses, "transl": translation - _roots(model, shape)}
    return {name: each.numpy().astype(np.float32) for name, each in found.items()}


def from_smplx(
    model: DetailedModel, arguments: Mapping[str, np.ndarray], where: str
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Shape, rotations and translation for ``model.pose``, of the ``smplx`` package's arguments with B rows.

    Poses that are missing are 0, poses may be rotation matrices, and ``betas`` may be fewer than the model's.

    Args:
        model: Model from a file of SMPL, SMPL-H or SMPL-X. The results have its dtype and device.
        arguments: Arguments that ``to_smplx`` returns. Others are left alone.
        where: Beginning of messages, such as the file's name.

    Raises:
        InputError: If ``betas`` or ``transl`` is missing, or an array has a wrong size or isn't finite.

    Examples:
        >>> import numpy as np
        >>> from warp_partdr import from_smplx, load_model
        >>> model = load_model("SMPL_NEUTRAL.npz")
        >>> arguments = {"betas": np.zeros((1, 10)), "body_pose": np.zeros((1, 69)), "transl": np.zeros((1, 3))}
        >>> body = model.pose(*from_smplx(model, arguments, "my arrays"))
        >>> body.joints.shape
        torch.Size([1, 24, 3])
    """
    like, sizes = model.rest_vertices, _sizes(model)
    for name in ("betas", "transl"):
        if name not in arguments:
            raise InputError(f"{where}: no {name!r}; expected betas, transl, {', '.join(sizes)}")
    rows = _rows(arguments["betas"])

    def numbers(name: str, sizes: tuple[int, ...]) -> torch.Tensor:
        array = np.asarray(arguments[name])
        if array.dtype.kind not in "fiu" or array.size not in [rows * size for size in sizes] or not array.size:
            expected = " or ".join(str(rows * size) for size in sizes)
            raise InputError(f"{where}: {name}: {array.dtype} {array.shape}; expected {expected} numbers")
        if not np.isfinite(array).all():
            raise InputError(f"{where}: {name}: holds NaN or infinity; expected finite numbers")
        return torch.from_numpy(array.reshape(rows, -1).astype(np.float64))

    betas = numbers("betas", tuple(range(1, model.num_shapes + 1)))
    shape = torch.nn.functional.pad(betas, (0, model.num_shapes - betas.shape[1]))
    turns: list[torch.Tensor] = []
    for name, joints in sizes.items():
        values = numbers(name, (3 * joints, 9 * joints)) if name in arguments else betas.new_zeros(rows, 3 * joints)
        whole = values.shape[1] == 9 * joints
        turns.append(values.view(rows, joints, 3, 3) if whole else rotation_from_axis_angle(values.view(rows, -1, 3)))
    translation = numbers("transl", (3,)) + _roots(model, shape)
    return shape.to(like), torch.cat(turns, dim=1).to(like), translation.to(like)


def _sizes(model: DetailedModel) -> dict[str, int]:
    if model.name not in POSES:
        raise InputError(f"model: {model.name}; expected one of {', '.join(POSES)}, of load_model")
    return POSES[model.name]


def _rows(betas: np.ndarray) -> int:
    return len(betas) if np.ndim(betas) == 2 else 1


def _roots(model: DetailedModel, shape: torch.Tensor) -> torch.Tensor:
    """Root joints at rest, shape (B, 3) [m], float64."""
    root, directions = (each.detach().cpu().double() for each in (model.rest_joints[0], model.joint_directions[:, 0]))
    return root + shape @ directions
