"""Landmarks as the packaged detector finds them: with errors and confidences that it had on people who look alike.

``scripts/learn_detector_errors.py`` learns ``assets/detector_errors.npz`` from shaded people whom the detector found.
"""

from __future__ import annotations

from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

import numpy as np
import torch

from ...body.landmarks import mirror_order
from ...body.template import JOINT_NAMES
from ...errors import InputError
from ...files.array_files import read_npz
from ...interop.device_cache import device_cache
from ...networks.regression.landmarks import LANDMARKS
from .rng import TorchRng

SEEN, HIDDEN, BEYOND = range(3)  # states of a landmark: there, behind something, and outside the picture
_ALIKE = 8  # people of whom one is drawn
# Unlikeness of two people by a landmark that one has in such a state and the other not, as if it were so far off.
_HIDDEN_APART, _BEYOND_APART = 0.1, 0.3  # [statures]
_AT_ONCE = 4096  # people who are compared with all rows at a time
_SHAPES = {"points": (2,), "errors": (2,), "confidence": (), "states": ()}  # of each landmark
_NUMBERS = ("points", "errors", "confidence")
_EXPECTED = "a file of scripts/learn_detector_errors.py"
# Landmarks whose mean error a joint's is that is none of them.
_AS: dict[str, tuple[str, ...]] = {
    "pelvis": ("left_hip", "right_hip"),
    "spine": ("left_hip", "right_hip", "left_shoulder", "right_shoulder"),
    "neck": ("left_shoulder", "right_shoulder"),
    "head": ("left_ear", "right_ear"),
    "head_top": ("left_eye", "right_eye", "left_ear", "right_ear"),
    **{f"{side}_toe": (f"{side}_big_toe",) for side in ("left", "right")},
    **{f"{side}_fingertip": (f"{side}_wrist",) for side in ("left", "right")},
}


class DetectorErrors:
    """Rows of people whom the detector found, each mirrored, too; nothing waits for the device.

    Args:
        rng: Source of chance, on the device of all that is drawn.
        path: A file of ``scripts/learn_detector_errors.py``; the packaged one if None.

    Raises:
        InputError: If the file isn't one.
    """

    def __init__(self, rng: TorchRng, path: Path | str | None = None) -> None:
        packaged = resources.files("warp_partdr").joinpath("assets", "detector_errors.npz")
        data = _read(packaged if path is None else Path(path))
        states = torch.from_numpy(data["states"]).to(rng.device)
        points, errors, confidence = (torch.from_numpy(data[name]).to(rng.device).float() for name in _NUMBERS)
        order = torch.from_numpy(mirror_order(LANDMARKS)).to(rng.device)
        flip = torch.tensor([-1.0, 1.0], device=rng.device)
        points, errors = (torch.cat([each, each[:, order] * flip]) for each in (points, errors))
        confidence, states = (torch.cat([each, each[:, order]]) for each in (confidence, states))
        self.rng, self._errors, self._confidence = rng, errors, confidence
        self._features = _features(points, states)
        self.known = (self._confidence > 0).any(0)  # landmarks that the detector gives, shape (24,), bool

    def __len__(self) -> int:
        return len(self._errors)

    def keypoints(
        self, points: torch.Tensor, states: torch.Tensor, stature: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Keypoints as the detector gives them, with the errors of one of the rows that are most alike.

        Args:
            points: True places of ``LANDMARKS``, shape (B, 24, 2).
            states: ``SEEN``, ``HIDDEN`` or ``BEYOND``, shape (B, 24).
            stature: Stature of the people as they are seen, in the unit of ``points``, shape (B,).

        Returns:
            Places and confidence, all 0 where missing, shape (B, 24, 3), and the errors, shape (B, 24, 2). Nothing that
            it knows is missing: what it can't see, it guesses.
        """
        features = _features(points / stature[:, None, None], states)
        nearest = torch.cat(
            [torch.cdist(some, self._features).topk(_ALIKE, largest=False)[1] for some in features.split(_AT_ONCE)]
        )
        row = nearest.gather(1, self.rng.integers(_ALIKE, len(points), 1))[:, 0]
        errors, confidence = self._errors[row] * stature[:, None, None], self._confidence[row, :, None]
        return torch.cat([points + errors, confidence], dim=2) * (confidence > 0), errors


def _features(points: torch.Tensor, states: torch.Tensor) -> torch.Tensor:
    """Numbers whose distances say how unlike people are: of points [statures] (N, 24, 2) and states, shape (N, 96)."""
    apart = [_HIDDEN_APART * (states == HIDDEN), _BEYOND_APART * (states == BEYOND)]
    return torch.cat([(points - points.mean(1, keepdim=True)).flatten(1), *apart], dim=1)


def move_joints(joints: torch.Tensor, errors: torch.Tensor) -> torch.Tensor:
    """Places of ``JOINT_NAMES`` (B, 21, 2) for a detector with these errors of ``LANDMARKS`` (B, 24, 2)."""
    return joints + _shares(joints.device) @ errors


@device_cache(8)
def _shares(device: torch.device) -> torch.Tensor:
    """Share of each landmark's error in that of each joint, shape (21, 24)."""
    rows = [_AS.get(name, (name,)) for name in JOINT_NAMES]
    return torch.tensor([[(name in row) / len(row) for name in LANDMARKS] for row in rows], device=device)


def _read(path: Path | Traversable) -> dict[str, np.ndarray]:
    data = read_npz(path, tuple(_SHAPES), expected=_EXPECTED)
    count = len(data["points"])
    for name, shape in _SHAPES.items():
        values, expected = data[name], (count, len(LANDMARKS), *shape)
        if values.shape != expected or not np.isfinite(values).all() or count < _ALIKE:
            raise InputError(f"{path}: {name} of shape {values.shape}; expected {_EXPECTED}")
    return data
