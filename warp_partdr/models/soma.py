"""SOMA (Apache-2.0) as a detailed model; needs the extra ``bodies``.

Read by the package ``body-models`` from a folder of SOMA's files, with SOMA's own shapes. Joints that only share out
an arm's or a leg's twist are left out, as are the pose correctives; shapes, to which SOMA fits its skeleton, are taken
to first order. At rest, the mean body is exact.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..errors import InputError, check_whole
from .model import DetailedModel
from .rigs import Rig, named_joints, read_rig, rig_model
from .smpl import DEFAULT_SHAPES

_JOINTS = named_joints(
    {"Hips": "pelvis", "Neck1": "neck", "Head": "head"},
    "Leg hip, Shin knee, Foot ankle, ToeBase foot, Shoulder collar, Arm shoulder, ForeArm elbow, Hand wrist, "
    "HandThumb3 thumb3, HandIndex2 index1, HandPinky2 pinky1",
    {"left": "Left", "right": "Right"},
)


def soma_model(
    folder: str | Path,
    *,
    num_shapes: int | None = None,
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.float32,
) -> DetailedModel:
    """SOMA from the folder of its files, ``SOMA_neutral.npz`` and ``correctives_model.pt``; no object is unpickled.

    Raises:
        InputError: If the package is missing, or a file is missing or damaged, or no SOMA.
        ValueError: If there are fewer shape values than asked for.
    """

    def build(own: Any) -> DetailedModel:
        rig = Rig(own)
        _, joints = rig.shown()
        left, right, head, hips = (joints[_place(own, name)] for name in ("LeftArm", "RightArm", "Head", "Hips"))
        if left[0] <= right[0] or head[1] <= hips[1]:
            raise InputError(f"{folder}: stands otherwise; expected SOMA's frame: x to the person's left, y up")
        moves = (rig.slope("shape", index) for index in range(count))
        weights = np.asarray(own.skin_weights, dtype=np.float64)
        return rig_model("soma", rig, _JOINTS, moves, weights, device=device, dtype=dtype)

    count = check_whole("num_shapes", DEFAULT_SHAPES if num_shapes is None else num_shapes, 1, 128)
    return read_rig("soma", folder, build)


def _place(own: Any, name: str) -> int:
    if name not in own.joint_names:
        raise InputError(f"SOMA: no joint {name}; expected those of SOMA")
    return list(own.joint_names).index(name)
