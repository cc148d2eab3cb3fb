"""Bodies of other methods, read from their files: parameters of SMPL, SMPL-H or SMPL-X, with the camera.

The files are ``.npz``, or ``.json`` with lists. These formats are read:

* 4D-Humans, and methods with the names of ``smplx``: ``global_orient``, ``body_pose``, ``betas``, ``transl`` or
  ``pred_cam_t``, ``focal_length``.
* Multi-HMR: ``rotvec``, ``shape``, ``transl_pelvis``, ``K``.
* This package's ``detailed.smplx.npz``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from ...cameras import Camera, Perspective, WeakPerspective
from ...errors import InputError
from ...files.array_files import read_npz
from ...files.json_files import read_json
from ...models.model import DetailedModel
from ...models.registration import Registered, ungrown
from ...models.smpl_parameters import POSES, from_smplx

_POSES = tuple(dict.fromkeys(name for poses in POSES.values() for name in poses))
# Translations of the whole body from where its shape puts it. If 4D-Humans gives one for the full picture and one for
# its crop, the one for the full picture is taken.
_MOVES = ("transl", "pred_cam_t_full", "cam_t_full", "pred_cam_t", "cam_t")
_PELVIS = "transl_pelvis"
_SHAPES = ("betas", "shape")
_FOCALS = ("focal_length", "scaled_focal_length", "focal")
_CENTRES = ("camera_center", "principal_point")
_OWN = ("camera_scale", "camera_translation", "camera_perspective")
_MHR = ("mhr_model_params", "shape_params")
_NAMES = (*_POSES, "rotvec", *_MOVES, _PELVIS, *_SHAPES, *_FOCALS, *_CENTRES, "K", *_OWN, *_MHR)
# Numbers of Multi-HMR's rotation vectors in their order: root, body, both hands, jaw.
_ROTVEC = {"global_orient": 1, "body_pose": 21, "left_hand_pose": 15, "right_hand_pose": 15, "jaw_pose": 1}
_EXPECTED = "another method's body, .npz or .json: betas, global_orient, body_pose, transl, focal_length"
_MOST = 10_000_000  # largest size of a file [bytes]


def is_given(path: Path) -> bool:
    """Return True if a file holds another method's body, and False for a ``body.npz`` of this package."""
    if path.suffix == ".json":
        return True
    found = read_npz(path, (), (*_NAMES, "format"), expected=_EXPECTED, most=_MOST)
    return "format" not in found and bool(found)


def read_given(path: Path, model: DetailedModel, size: tuple[int, int]) -> tuple[Registered, Camera]:
    """Read one person's body and its camera.

    Args:
        path: File with another method's body.
        model: Detailed model to which the parameters belong.
        size: Height and width (H, W) of the picture [px].

    Returns:
        Body in the camera frame [m], and the camera of the picture.

    Raises:
        InputError: If the file holds no body, a body of another model, or several people.
    """
    arrays = _read_json(path) if path.suffix == ".json" else None
    if arrays is None:
        arrays = read_npz(path, (), _NAMES, expected=_EXPECTED, most=_MOST)
    if any(name in arrays for name in _MHR):
        raise InputError(f"{path}: parameters of MHR; expected those of SMPL, SMPL-H or SMPL-X")
    if "rotvec" in arrays:
        arrays |= _of_multi_hmr(arrays["rotvec"], path)
    arrays["betas"] = _one_of(arrays, _SHAPES, path)
    of_pelvis = _PELVIS in arrays  # the "transl" of Multi-HMR is that of the head, so it is not read
    arrays["transl"] = _one_of(arrays, (_PELVIS, *_MOVES), path)
    if np.ndim(arrays["betas"]) > 1 and len(arrays["betas"]) != 1:
        raise InputError(f"{path}: betas: shape {arrays['betas'].shape}; expected one person's")
    shape, rotations, translation = from_smplx(model, arrays, str(path))
    if of_pelvis:
        translation = torch.from_numpy(arrays[_PELVIS].reshape(1, 3)).to(translation)
    body = ungrown(model, shape, rotations, translation, {})
    camera = _camera(arrays, size, path)
    if isinstance(camera, Perspective) and not bool((body.detailed.vertices[..., 2] > 0).all()):
        raise InputError(f"{path}: {float(translation[0, 2]):g} m away; expected a body before the camera")
    return body, camera


def _read_json(path: Path) -> dict[str, np.ndarray]:
    content = read_json(path, _EXPECTED)
    if not isinstance(content, dict):
        raise InputError(f"{path}: a list; expected {_EXPECTED}")
    content = {**content, **_nested(content.get("pred_smpl_params"))}
    arrays: dict[str, np.ndarray] = {}
    for name in _NAMES:
        if name in content:
            try:
                arrays[name] = np.asarray(content[name], dtype=np.float64)
            except (TypeError, ValueError):
                raise InputError(f"{path}: {name}: expected numbers, in lists of one length") from None
    return arrays


def _nested(values: Any) -> dict[str, Any]:
    return values if isinstance(values, dict) else {}


def _of_multi_hmr(rotvec: np.ndarray, path: Path) -> dict[str, np.ndarray]:
    count = sum(_ROTVEC.values())
    if rotvec.size != 3 * count:
        raise InputError(f"{path}: rotvec: shape {rotvec.shape}; expected ({count}, 3), as of Multi-HMR")
    parts = np.split(rotvec.reshape(count, 3), np.cumsum([*_ROTVEC.values()])[:-1])
    return dict(zip(_ROTVEC, parts, strict=True))


def _one_of(arrays: dict[str, np.ndarray], names: tuple[str, ...], path: Path) -> np.ndarray:
    for name in names:
        if name in arrays:
            return arrays[name]
    raise InputError(f"{path}: no {' or '.join(names)}; expected {_EXPECTED}")


def _camera(arrays: dict[str, np.ndarray], size: tuple[int, int], path: Path) -> Camera:
    def numbers(name: str, *counts: int) -> torch.Tensor:
        values = arrays[name]
        if values.dtype.kind not in "fiu" or values.size not in counts or not np.isfinite(values).all():
            raise InputError(f"{path}: {name}: shape {values.shape}; expected {counts[0]} finite numbers")
        return torch.from_numpy(values.astype(np.float32).reshape(-1))

    middle = torch.tensor([[size[1] / 2, size[0] / 2]])
    if all(name in arrays for name in _OWN):
        scale, centre = numbers(_OWN[0], 1), numbers(_OWN[1], 2)[None]
        perspective = bool(numbers(_OWN[2], 1)[0])
    elif "K" in arrays:
        matrix = numbers("K", 9).view(3, 3)
        scale = matrix[[0], [0]]
        centre = matrix[None, :2, 2]
        perspective = True
    else:
        names = [name for name in _FOCALS if name in arrays]
        if not names:
            raise InputError(f"{path}: no {' or '.join(_FOCALS)}; expected {_EXPECTED}")
        scale, perspective = numbers(names[0], 1, 2)[:1], True
        centres = [name for name in _CENTRES if name in arrays]
        centre = numbers(centres[0], 2)[None] if centres else middle
    if not float(scale[0]) > 0:
        raise InputError(f"{path}: focal length {float(scale[0]):g}; expected a positive number of pixels")
    return Perspective(scale[:, None].expand(-1, 2), centre) if perspective else WeakPerspective(scale, centre)
