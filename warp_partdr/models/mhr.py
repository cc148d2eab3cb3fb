"""MHR (Momentum Human Rig, Apache-2.0), which SAM 3D Body gives out, as a detailed model; needs the extra ``bodies``.

Read by the package ``body-models`` from a folder of MHR's files. Two things are not MHR's own: its pose correctives, a
small network over all joints, are left out, and the 18 controls that scale head and body, which act by powers of two on
joints, are taken to first order. At rest, all else is exact.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from .model import DetailedModel
from .rigs import Rig, named_joints, read_rig, rig_model

_SHAPES = 45  # of identity, of unit variance
# Controls of skeleton and scale are the last of these poses; of hands' there are 50 more, which stay 0.
_SCALES = {"body_pose": 15, "head_pose": 3}
_SCALE_SPREAD = 0.1  # taken for their standard deviation: their own is not in MHR's files
_JOINTS = named_joints(
    {"root": "pelvis", "c_neck": "neck", "c_head": "head"},
    "upleg hip, lowleg knee, foot ankle, ball foot, clavicle collar, uparm shoulder, lowarm elbow, wrist wrist, "
    "thumb3 thumb3, index1 index1, pinky1 pinky1",
    {"left": "l_", "right": "r_"},
)


def mhr_model(
    folder: str | Path, *, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float32
) -> DetailedModel:
    """MHR from the folder of its files: ``mhr_model.pt``, ``corrective_activation.npz`` and so on; none is unpickled.

    63 shape values: 45 of identity, which leave the joints, and 18 of skeleton and scale, of body and head.

    Raises:
        InputError: If the package is missing, or a file is missing or damaged, or no MHR.
    """

    def build(own: Any) -> DetailedModel:
        rig = Rig(own, first=1)  # body_world is no joint of the body
        vertices, joints = rig.shown()
        # Identity is linear, and leaves the joints.
        moves = [(rig.shown(shape=unit)[0] - vertices, np.zeros_like(joints)) for unit in np.eye(_SHAPES)]
        for name, count in _SCALES.items():
            last = len(rig.rest()[name])
            slopes = (rig.slope(name, index) for index in range(last - count, last))
            moves += [(_SCALE_SPREAD * points, _SCALE_SPREAD * ends) for points, ends in slopes]
        weights = np.asarray(own.skin_weights, dtype=np.float64)
        weights = np.column_stack([weights[:, 0] + weights[:, 1], weights[:, 2:]])
        return rig_model("mhr", rig, _JOINTS, moves, weights, device=device, dtype=dtype)

    return read_rig("mhr", folder, build)
