"""Launches of forward kinematics and of its adjoint, in fixed buffers, so that a graph can capture them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
import warp as wp

from ..interop.arrays import warp_array, warp_arrays
from ..interop.graph_cache import Launch
from ..kernels import kinematics
from ..kernels.turns import Numbers, TurnRule, Turns, launch_turn, launch_turn_adjoint
from .ellipbody import bone_tree
from .template import NUM_PARTS

DTYPES = {
    torch.float32: {"s": wp.float32, "v": wp.vec3f, "m": wp.mat33f},
    torch.float64: {"s": wp.float64, "v": wp.vec3d, "m": wp.mat33d},
}


def kinematic_arrays(tensors: Sequence[torch.Tensor], kinds: str) -> list[wp.array]:
    """Warp arrays over tensors of one dtype: of scalars ("s"), vectors ("v") or matrices ("m")."""
    types = DTYPES[tensors[0].dtype]
    return warp_arrays(tensors, [types[kind] for kind in kinds])


def camera_array(cameras: torch.Tensor) -> wp.array:
    """Array (B, M) over f_x, f_y, c_x, c_y, shape (B, 4) or (B, M, 4)."""
    return warp_array(cameras.unflatten(-1, (1, 4)) if cameras.dim() == 2 else cameras, wp.vec4)


class BoneLaunches:
    """Launches for B bodies; in float64 of matrices alone.

    Args:
        parameters: Arguments of ``pose``. The numbers of a body lie side by side in memory.
        locked: Parts that keep their rest rotation, as bits.
        camera: Three tensors, if there is a camera: focal lengths (B,) or (B, 2), centres (B, 2), and the tensor (B, 4)
            that ``launch`` fills with f_x, f_y, c_x, c_y [px].
        half_size: Half of the crop's side, if the camera's numbers are relative to a crop (see ``kernels.turns``) [px].
            If it is 0, they are in pixels.
    """

    def __init__(
        self,
        parameters: Sequence[torch.Tensor],
        locked: int = 0,
        camera: Sequence[torch.Tensor] = (),
        half_size: float = 0.0,
    ) -> None:
        orientation, translation, rotations, lengths, thicknesses = parameters
        self._like = lengths
        self._turns: Any = None
        turned = (orientation, rotations)
        if orientation.dim() != 3 or rotations.dim() != 4 or camera or locked:
            turned = self._empty_turned()
            self._numbers, self._turns, self._rule = _numbers(orientation, rotations, camera[:2]), Turns(), TurnRule()
            self._rule.locked, self._rule.half_size = locked, half_size
            self._turns.cameras = camera_array(camera[2] if camera else lengths.new_empty(0, 4))
        first, *others = kinematic_arrays((*turned, translation, lengths, thicknesses), "mmvss")
        self._parameters = [first, others[1], others[0], *others[2:]]
        if self._turns is not None:
            self._turns.orientations, self._turns.rotations = first, others[0]
        self._tree = bone_tree(first.device.alias, DTYPES[lengths.dtype]["s"])

    def launch(self, posed: Sequence[wp.array]) -> None:
        """Fill the fields of ``Posed``."""
        if self._turns is not None:
            launch_turn(self._numbers, self._rule, self._turns)
        kinematics.launch_pose(self._tree, self._parameters, posed)

    def prepare_adjoint(
        self,
        rotations: wp.array,
        adjoints: Sequence[wp.array],
        gradients: Sequence[torch.Tensor],
        adj_cameras: torch.Tensor | None = None,
        camera_gradients: Sequence[torch.Tensor] = (),
    ) -> Launch:
        """Launches that fill gradients, after ``launch``.

        Args:
            rotations: Field ``rotations`` of ``Posed``, which ``launch`` filled.
            adjoints: Adjoints of the fields of ``Posed``.
            gradients: Gradients of the parameters. They are filled.
            adj_cameras: Adjoint of the filled camera, shape (B, 4), or M shares of it, shape (B, M, 4).
            camera_gradients: Gradients of the camera's numbers. They are filled.
        """
        orientation, translation, turns, lengths, thicknesses = gradients
        turned = (orientation, turns) if self._turns is None else self._empty_turned()
        arrays = kinematic_arrays((turned[0], translation, turned[1], lengths, thicknesses), "mvmss")
        saved = [self._parameters[0], *self._parameters[2:4], rotations]
        scratch = kinematics.PoseScratch.empty(self._tree, len(self._like))
        adj_turns, numbers = Turns(), None
        if self._turns is not None:
            numbers = _numbers(orientation, turns, camera_gradients)
            adj_turns.orientations, adj_turns.rotations = arrays[0], arrays[2]
            adj_turns.cameras = self._turns.cameras if adj_cameras is None else camera_array(adj_cameras)

        def launch() -> None:
            kinematics.launch_pose_adjoint(self._tree, saved, adjoints, arrays, scratch)
            if numbers is not None:
                launch_turn_adjoint(self._numbers, self._rule, self._turns, adj_turns, numbers)

        return launch

    def _empty_turned(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Matrices to be made of the rotations' numbers, or their adjoints."""
        batch = len(self._like)
        return self._like.new_empty(batch, 3, 3), self._like.new_empty(batch, NUM_PARTS, 3, 3)


def _numbers(orientation: torch.Tensor, rotations: torch.Tensor, camera: Sequence[torch.Tensor]) -> Any:
    numbers = Numbers()
    numbers.orientation, numbers.rotations = warp_array(orientation.flatten(1)), warp_array(rotations.flatten(2))
    focal, centre = camera or [orientation.new_empty(0, 0)] * 2
    numbers.focal = warp_array(focal[:, None] if focal.dim() == 1 else focal)
    numbers.centre = warp_array(centre)
    return numbers
