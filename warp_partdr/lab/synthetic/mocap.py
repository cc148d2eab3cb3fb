"""Motion capture as EllipBody poses, to train networks and priors on and for benchmarks; ``mocap_files`` reads it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ...body.landmarks import mirror_order
from ...body.rotations import rotation_from_axis_angle, rotation_to_axis_angle
from ...body.template import PART_NAMES
from .poses import mean_body

# Clips that nothing may learn from: the expmap data set's own test split, and some clips of each other source.
HELD_OUT_PREFIX = "expmap.test."
HELD_OUT = "asf.01_05 asf.01_14 asf.02_07 asf.02_10 asf.03_03 deepmimic.dance_a deepmimic.kick".split()

_LARGEST_TURN = {"foot": 1.3, "hand": 2.5}  # [rad], of a joint; others:
_LARGEST_TURN_ELSEWHERE = 2.9
_ENDS = np.array([name.endswith(("hand", "foot")) for name in PART_NAMES])
_MEAN_ACCELERATION, _MOST_ACCELERATION = 0.02, 0.1  # [m/frame²], over the joints


@dataclass(frozen=True)
class Clip:
    """Poses of one person, F frames, in a world frame with y up."""

    name: str  # source and clip, like ``asf.01_05``
    global_orient: np.ndarray  # rotation of the pelvis, shape (F, 3, 3)
    rotations: np.ndarray  # local rotations of the bones, shape (F, 20, 3, 3)
    directions: np.ndarray  # of the mocap's own bones in the world, NaN where it has none, shape (F, 20, 3)
    positions: np.ndarray | None = None  # of the pelvis over a ground at y = 0 [m], shape (F, 3); None: not known

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.global_orient)

    def __getitem__(self, frames: slice | np.ndarray) -> Clip:
        """The frames asked for."""
        positions = None if self.positions is None else self.positions[frames]
        return Clip(self.name, self.global_orient[frames], self.rotations[frames], self.directions[frames], positions)

    def rotation_vectors(self) -> np.ndarray:
        """Local rotations as axis times angle [rad], shape (F, 20, 3)."""
        return rotation_vectors(self.rotations)

    def up_directions(self) -> np.ndarray:
        """Directions of the vertical, upward, seen from the pelvis, unit vectors, shape (F, 3)."""
        return self.global_orient[:, 1, :].copy()

    def mirrored(self) -> Clip:
        """Clip with left and right exchanged."""
        swap, flip = mirror_order(PART_NAMES), np.array([-1.0, 1.0, 1.0])
        turn = np.outer(flip, flip)
        return Clip(
            self.name,
            self.global_orient * turn,
            self.rotations[:, swap] * turn,
            self.directions[:, swap] * flip,
            None if self.positions is None else self.positions * flip,
        )


def is_held_out(clip: Clip) -> bool:
    """True for clips that no prior and no network may learn from."""
    return clip.name.startswith(HELD_OUT_PREFIX) or clip.name in HELD_OUT


def without_errors(clip: Clip) -> Clip:
    """The frames in which no ankle or wrist is turned around, as markers that were swapped do."""
    return clip[np.flatnonzero(~_turned_around(clip).any(axis=1))]


def straightened(clip: Clip) -> Clip:
    """The clip with hands and feet that are turned around put straight: all else of such frames is sound."""
    rotations = clip.rotations.copy()
    rotations[_turned_around(clip) & _ENDS] = np.eye(3)
    return replace(clip, rotations=rotations)


def _turned_around(clip: Clip) -> np.ndarray:
    """True for joints that are turned farther than any joint turns, shape (F, 20), bool."""
    allowed = [_LARGEST_TURN.get(name.partition("_")[2], _LARGEST_TURN_ELSEWHERE) for name in PART_NAMES]
    return np.linalg.norm(clip.rotation_vectors(), axis=-1) >= allowed


def smooth_windows(clip: Clip, frames: int) -> list[Clip]:
    """Windows of ``frames`` frames, one after another, in which no limb turns around as swapped markers do.

    From frame to frame, joints of the mean body accelerate by less than 20 mm/frame² on average, and none by 100: at 30
    frames a second wrists and ankles of people who walk reach 50.
    """
    joints = joint_positions(clip.global_orient, clip.rotations)
    accelerations = np.linalg.norm(np.diff(joints, 2, axis=0), axis=-1)
    smooth = (accelerations.mean(1) < _MEAN_ACCELERATION) & (accelerations.max(1) < _MOST_ACCELERATION)
    windows = []
    start = 0
    while start + frames <= len(clip):
        rough = np.flatnonzero(~smooth[start : start + frames - 2])
        if len(rough):
            start += int(rough[-1]) + 1
        else:
            windows.append(clip[start : start + frames])
            start += frames
    return windows


def concatenate(clips: Sequence[Clip], name: str) -> Clip:
    """One clip with the frames of all; places are dropped, for clips do not share a world."""
    frames = ((clip.global_orient, clip.rotations, clip.directions) for clip in clips)
    return Clip(name, *map(np.concatenate, zip(*frames, strict=True)))


def joint_positions(global_orient: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Joints of mean bodies relative to the pelvis [m], shape (F, 21, 3), in the frame of the pelvis' orientation."""
    return mean_body(torch.tensor(rotations), torch.tensor(global_orient)).joints.numpy()


def rotation_matrices(vectors: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad] to matrices (..., 3, 3)."""
    return rotation_from_axis_angle(torch.tensor(vectors)).numpy()


def rotation_vectors(matrices: np.ndarray) -> np.ndarray:
    """Matrices (..., 3, 3) to rotation vectors (..., 3) with angles in [0, pi]."""
    return rotation_to_axis_angle(torch.tensor(matrices)).numpy()
