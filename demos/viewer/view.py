"""View of a body as six numbers that a person can set: scale, place, and three angles of the whole body."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from ..body.parameters import BodyParameters
from ..body.rotations import rotation_from_axis_angle, rotation_to_6d
from ..inputs.observation import REFERENCE_SIZE

_HALF = REFERENCE_SIZE / 2
_X, _Y, _Z = torch.eye(3)
_FACING = BodyParameters.mean(1).global_orient()[0]

# Name: unit, smallest, largest. Pixels are those of a picture of 256 a side.
VIEW: dict[str, tuple[str, float, float]] = {
    "scale": ("px/m", 40.0, 260.0),
    "shift x": ("px", -128.0, 128.0),
    "shift y": ("px", -128.0, 128.0),
    "tilt, x": ("deg", -90.0, 90.0),
    "turn, y": ("deg", -180.0, 180.0),
    "roll, z": ("deg", -180.0, 180.0),
}


@torch.no_grad()
def view_of(body: BodyParameters) -> dict[str, float]:
    """The numbers of ``VIEW``; all angles are 0 for a body that stands upright and faces the camera.

    The body turns about its own vertical, is tilted about the picture's x axis, then rolls in the picture:
    R = Rz(roll) Rx(tilt) Ry(turn) R_facing.
    """
    turned = (body.global_orient()[0] @ _FACING.mT).double()
    tilt = math.asin(min(max(float(turned[2, 1]), -1.0), 1.0))
    turn = math.atan2(-float(turned[2, 0]), float(turned[2, 2]))
    roll = math.atan2(-float(turned[0, 1]), float(turned[1, 1]))
    shift = (_HALF * body.shift[0]).tolist()
    values = (_HALF * float(body.log_scale.exp()), *shift, *map(math.degrees, (tilt, turn, roll)))
    return dict(zip(VIEW, values, strict=True))


@torch.no_grad()
def seen_as(body: BodyParameters, view: dict[str, float]) -> BodyParameters:
    """The body with these numbers of ``VIEW``; its bounds are for who sets them."""
    scale, x, y, *angles = (view[name] for name in VIEW)
    tilt, turn, roll = (
        rotation_from_axis_angle(math.radians(angle) * axis) for angle, axis in zip(angles, (_X, _Y, _Z), strict=True)
    )
    return replace(
        body.detach(),
        orientation=rotation_to_6d(roll @ tilt @ turn @ _FACING)[None],
        log_scale=torch.tensor([math.log(scale / _HALF)]),
        shift=torch.tensor([[x / _HALF, y / _HALF]]),
    )
