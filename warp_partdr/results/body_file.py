"""``body.npz``: a fitted body and its camera, written and read without loss.

| key | shape | meaning |
|---|---|---|
| format | () | "warp-partdr body 1" |
| global_orient | (3, 3) | rotation of the body in the camera frame |
| translation | (3,) | position of the pelvis in the camera frame [m]; 0 with weak perspective, which has no depth |
| rotations | (20, 3, 3) | local rotation of each bone, order of ``part_names`` |
| lengths | (12,) | ``LENGTH_NAMES`` [m] |
| thicknesses | (15,) | ``THICKNESS_NAMES``, full widths [m] |
| camera_scale | () | weak perspective: u = scale X + camera_translation[0] [px/m]; perspective: the focal length [px] |
| camera_translation | (2,) | image of the frame's origin, or the principal point [px] |
| image_size | (2,) | (H, W) of the picture [px] |
| camera_perspective | () | 1: u = scale X / Z + camera_translation[0]; 0: weak perspective |
| part_names | (20,) | names of the ellipsoids, in the order of ``rotations``, which may be any |
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from ..body.ellipbody import EllipBody
from ..body.parameters import BodyParameters
from ..body.rotations import rotation_to_6d, rotation_to_axis_angle
from ..body.template import BODY_SHAPES, PART_NAMES
from ..cameras import Camera, Perspective, WeakPerspective
from ..errors import InputError
from ..files.array_files import read_npz
from .plausible import check_picture_size, check_plausible, order_of_parts
from .result_sets import check_not_in_set, check_result

FORMAT = "warp-partdr body 1"
_SHAPES: dict[str, tuple[int, ...]] = {
    **BODY_SHAPES,
    "camera_scale": (),
    "camera_translation": (2,),
    "image_size": (2,),
    "camera_perspective": (),
}
BODY_ARRAYS = tuple(_SHAPES)[:5]  # arrays of the body, in the order of ``pose``
_MAX_BYTES = 1_000_000  # limit for all arrays when unpacked; a body has 2 kB
_POSITIVE = ("lengths", "thicknesses", "camera_scale", "image_size")


@dataclass(frozen=True)
class BodyFile:
    """Contents of ``body.npz``: float32 arrays with the shapes above; the last two hold integers."""

    global_orient: np.ndarray
    translation: np.ndarray
    rotations: np.ndarray
    lengths: np.ndarray
    thicknesses: np.ndarray
    camera_scale: np.ndarray
    camera_translation: np.ndarray
    image_size: np.ndarray
    camera_perspective: np.ndarray = field(default_factory=lambda: np.array(0))

    @classmethod
    def read(cls, data: Mapping[str, np.ndarray], where: str) -> BodyFile:
        """Check arrays that were read from a file, and return the body.

        Args:
            data: Arrays by their names. Parts may have any order if ``part_names`` gives it.
            where: Beginning of messages.

        Raises:
            InputError: If an array has a wrong shape, or holds NaN, infinity, a matrix that is no rotation, or a number
                that no body can have.
        """
        arrays = {name: _checked(data[name], name, where) for name in _SHAPES}
        if "part_names" in data:
            arrays["rotations"] = arrays["rotations"][order_of_parts(data["part_names"], where)]
        body = cls(**arrays)
        if body.camera_perspective and not body.translation[2] > 0:
            raise InputError(f"{where}: translation: {body.translation[2]:g} m away; expected a body before the camera")
        return body

    def body(self, device: str | None = None) -> EllipBody:
        """Return the body as Warp arrays, B = 1."""
        return EllipBody.from_numpy(**{name: getattr(self, name)[None] for name in BODY_ARRAYS}, device=device)

    def camera(self) -> Camera:
        """Return the camera of the picture."""
        scale = torch.from_numpy(self.camera_scale[None])
        translation = torch.from_numpy(self.camera_translation[None])
        if self.camera_perspective:
            return Perspective(scale[:, None].expand(-1, 2), translation)
        return WeakPerspective(scale, translation)

    def parameters(self) -> BodyParameters:
        """Return the body's parameters, B = 1, in a square crop whose side is the longer side of the picture."""
        height, width = self.image_size.tolist()
        half, camera = max(height, width) / 2, self.camera()
        if isinstance(camera, Perspective):
            camera = camera.to_weak(torch.from_numpy(self.translation)[None])
        shift = (camera.translation - torch.tensor([width / 2, height / 2])) / half
        return BodyParameters(
            orientation=rotation_to_6d(torch.from_numpy(self.global_orient))[None],
            rotations=rotation_to_axis_angle(torch.from_numpy(self.rotations))[None],
            lengths=torch.from_numpy(self.lengths)[None],
            thicknesses=torch.from_numpy(self.thicknesses)[None],
            log_scale=(camera.scale / half).log(),
            shift=shift,
        )

    def save(self, path: str | Path) -> None:
        """Write the file.

        Raises:
            InputError: If a report beside it names this file as a fit's result. The report would be wrong afterwards.
        """
        check_not_in_set(Path(path))
        arrays = {name: getattr(self, name) for name in _SHAPES}
        np.savez(path, format=np.array(FORMAT), part_names=np.array(PART_NAMES), **arrays)


def load_body(path: str | Path) -> BodyFile:
    """Read a ``body.npz``. Nothing in it is ever unpickled.

    Raises:
        InputError: If the file is missing or is no body file, if an array has a wrong shape or holds NaN, infinity, a
            matrix that is no rotation or a number that no body can have, or if the report beside it is of another fit.

    Examples:
        After ``save_fit(result, "fitted")``:

        >>> from warp_partdr import load_body
        >>> saved = load_body("fitted/body.npz")
        >>> saved.body("cpu").pose().joints.shape
        (1, 21)
        >>> saved.image_size
        array([512, 384])
    """
    names = (*_SHAPES, "format")
    data = read_npz(path, names, ("part_names",), expected="a body.npz of partdr fit", most=_MAX_BYTES)
    check_result(path)
    if str(found := data.pop("format")) != FORMAT:
        raise InputError(f"{path}: format {str(found)[:40]!r}; expected {FORMAT!r}")
    return BodyFile.read(data, str(path))


def _checked(values: np.ndarray, name: str, where: str) -> np.ndarray:
    shape = _SHAPES[name]
    whole = name in ("camera_perspective", "image_size")
    if values.shape != shape or values.dtype.kind not in ("iu" if whole else "fiu"):
        expected = "integers" if whole else "numbers"
        raise InputError(f"{where}: {name}: {values.dtype} {values.shape}; expected {expected} {shape}")
    with np.errstate(over="ignore"):  # a number that is too large becomes infinity, which is refused next
        values = values.astype(np.int64 if whole else np.float32)
    if name == "camera_perspective" and values not in (0, 1):
        raise InputError(f"{where}: {name}: {values}; expected 0 or 1")
    if name in _POSITIVE and values.min() <= 0:
        raise InputError(f"{where}: {name}: {values.min():g}; expected positive numbers")
    if name == "image_size":
        check_picture_size(values.tolist(), f"{where}: {name}")
    check_plausible(values, name, where)
    return values
