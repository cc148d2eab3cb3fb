"""``body.npz``: a fitted body and its camera, and back, exactly.

| key | shape | what |
|---|---|---|
| format | () | "warp-partdr body 1" |
| global_orient | (3, 3) | rotation of the body in the camera frame |
| translation | (3,) | position of the pelvis in the camera frame [m]; 0: a weak-perspective camera has no depth |
| rotations | (20, 3, 3) | local rotation of each bone, order of ``part_names`` |
| lengths | (12,) | ``LENGTH_NAMES`` [m] |
| thicknesses | (15,) | ``THICKNESS_NAMES``, full widths [m] |
| camera_scale | () | weak perspective: u = scale X + camera_translation[0] [px/m] |
| camera_translation | (2,) | where the frame's origin is seen [px] |
| image_size | (2,) | (H, W) of the picture [px] |
| part_names | (20,) | names of the ellipsoids |
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from .body.ellipbody import EllipBody
from .body.template import LENGTH_NAMES, NUM_PARTS, PART_NAMES, THICKNESS_NAMES
from .cameras import WeakPerspective
from .errors import InputError

FORMAT = "warp-partdr body 1"
_SHAPES: dict[str, tuple[int, ...]] = {
    "global_orient": (3, 3),
    "translation": (3,),
    "rotations": (NUM_PARTS, 3, 3),
    "lengths": (len(LENGTH_NAMES),),
    "thicknesses": (len(THICKNESS_NAMES),),
    "camera_scale": (),
    "camera_translation": (2,),
    "image_size": (2,),
}


@dataclass(frozen=True)
class BodyFile:
    """What ``body.npz`` holds, as float32 arrays of the shapes above."""

    global_orient: np.ndarray
    translation: np.ndarray
    rotations: np.ndarray
    lengths: np.ndarray
    thicknesses: np.ndarray
    camera_scale: np.ndarray
    camera_translation: np.ndarray
    image_size: np.ndarray

    def body(self, device: str | None = None) -> EllipBody:
        """The body as Warp arrays, B = 1."""
        return EllipBody.from_numpy(
            global_orient=self.global_orient[None],
            translation=self.translation[None],
            rotations=self.rotations[None],
            lengths=self.lengths[None],
            thicknesses=self.thicknesses[None],
            device=device,
        )

    def camera(self) -> WeakPerspective:
        """The camera of the picture."""
        return WeakPerspective(
            torch.from_numpy(self.camera_scale.reshape(1)), torch.from_numpy(self.camera_translation.reshape(1, 2))
        )

    def save(self, path: str | Path) -> None:
        """Write the file."""
        arrays = {name: getattr(self, name) for name in _SHAPES}
        np.savez(path, format=np.array(FORMAT), part_names=np.array(PART_NAMES), **arrays)


def load_body(path: str | Path) -> BodyFile:
    """Read a ``body.npz``; nothing in it is ever unpickled.

    Raises:
        InputError: If the file is missing, no such file, or holds wrong shapes, NaN or infinity.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            data = {name: archive[name] for name in (*_SHAPES, "format")}
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; expected a body.npz") from error
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not a body file ({error}); expected a body.npz of partdr fit") from error
    if str(data.pop("format")) != FORMAT:
        raise InputError(f"{path}: unknown format; expected {FORMAT!r}")
    for name, shape in _SHAPES.items():
        if data[name].shape != shape or data[name].dtype.kind not in "fi" or not np.isfinite(data[name]).all():
            raise InputError(f"{path}: {name}: {data[name].dtype} {data[name].shape}; expected finite numbers {shape}")
    return BodyFile(**{name: value if name == "image_size" else value.astype(np.float32) for name, value in data.items()})
