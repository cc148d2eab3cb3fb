"""Bodies that the label network predicts in one pass, without refinement: from one picture, or for a person in a film.

A film's ``NAME.personN.npz`` has a row for each frame in which the person was found, T in all. ``save_film`` adds
arrays of the detailed body, and rows in which the person is hidden; their scores and confidences are 0.

| key | shape | meaning |
|---|---|---|
| format | () | "warp-partdr film 1" |
| frames, times | (T,) | index of each frame, 0 = the film's first, and its time since then [s] |
| scores, boxes | (T,), (T, 4) | confidence that there is a person; left, top, right, bottom of their mask [px] |
| keypoints | (T, 33, 3) | "blazepose33": x, y [px] and confidence |
| joints | (T, 21, 3) | ``joint_names`` in the camera frame, as ``translation`` says where that is [m] |
| global_orient, translation, rotations, lengths, thicknesses | (T, ...) | as ``body.npz`` |
| camera_scale, camera_translation | (T), (T, 2) | as ``body.npz`` |
| image_size, camera_perspective, part_names, joint_names | | for all frames; the first three as ``body.npz`` |
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..body.lens import find_camera, turn_to_rays
from ..body.posing import pose
from ..body.template import BODY_SHAPES, JOINT_NAMES, PART_NAMES
from ..errors import InputError
from ..files.array_files import read_npz
from ..inputs.cut_people import CutPerson
from ..networks.detection.film_people import SEEN
from ..networks.regression.label_network import LabelNetwork
from ..networks.regression.predict import predict_bodies
from .body_file import BODY_ARRAYS, BodyFile
from .plausible import check_picture_size, check_plausible, order_of_parts
from .result_sets import check_result
from .save import body_file

FORMAT = "warp-partdr film 1"
_BODY = {**BODY_SHAPES, "camera_scale": (), "camera_translation": (2,)}
ROW = np.dtype([(name, *kind) for name, kind in SEEN.items()] + [(name, np.float32, _BODY[name]) for name in _BODY])


def predict_arrays(people: Sequence[CutPerson], network: LabelNetwork) -> dict[str, np.ndarray]:
    """Predict bodies of people in one pass of the network.

    Args:
        people: People, one or more, on the network's device.
        network: Label network in evaluation mode.

    Returns:
        Arrays of ``body.npz`` by their names, a row a person, without the sizes of the pictures.
    """
    bodies, files = predict_bodies([person.observation for person in people], network), []
    for row, person in enumerate(people):
        body, lens, crop = bodies.select(slice(row, row + 1)), person.observation.lens, person.crop
        if lens is not None:
            body = turn_to_rays(body, lens)
        camera, pelvis = find_camera(body, lens, crop.size[0])
        files.append(body_file(body, camera.in_full(crop), crop.size, None if pelvis is None else pelvis[0]))
    return {name: np.stack([getattr(file, name) for file in files]) for name in (*_BODY, "camera_perspective")}


@dataclass(frozen=True)
class FilmBodies:
    """Bodies of one person in a film.

    Attributes:
        rows: Rows of dtype ``ROW``, one a frame, in order.
        image_size: Size (H, W) of the film [px].
        perspective: True if the camera is a perspective one, False if it is weak perspective.
    """

    rows: np.ndarray
    image_size: tuple[int, int]
    perspective: bool

    def body(self, row: int) -> BodyFile:
        """Return the body of a row, as ``body.npz`` holds it."""
        arrays = {name: self.rows[name][row] for name in _BODY}
        return BodyFile(
            **arrays, image_size=np.array(self.image_size), camera_perspective=np.array(self.perspective * 1)
        )

    def joints(self) -> np.ndarray:
        """Compute the joints ``JOINT_NAMES`` in the camera frame [m], shape (T, 21, 3)."""
        posed = pose(*(torch.from_numpy(np.ascontiguousarray(self.rows[name])) for name in BODY_ARRAYS))
        return posed.joints.numpy()

    def save(self, path: str | Path, **more: np.ndarray) -> None:
        """Write the file, with further arrays by their names."""
        arrays: dict[str, Any] = {name: self.rows[name] for name in ROW.names or ()} | more
        np.savez_compressed(
            path,
            format=np.array(FORMAT),
            image_size=np.array(self.image_size),
            camera_perspective=np.array(int(self.perspective)),
            part_names=np.array(PART_NAMES),
            joint_names=np.array(JOINT_NAMES),
            joints=self.joints(),
            **arrays,
        )


def load_film_bodies(path: str | Path) -> FilmBodies:
    """Read a file that ``FilmBodies.save`` wrote. Nothing in it is ever unpickled.

    Raises:
        InputError: If the file is missing or is no such file, if an array has a wrong shape or holds NaN, infinity, a
            matrix that is no rotation or a number that no body can have, or if the report beside it is of another run.
    """
    names = ROW.names or ()
    whole = {"image_size": (2,), "camera_perspective": ()}
    expected = "a film's NAME.personN.npz of partdr predict"
    data = read_npz(path, (*names, *whole, "format"), ("part_names",), expected=expected)
    check_result(path)
    if str(data["format"]) != FORMAT:
        raise InputError(f"{path}: format {str(data['format'])[:40]!r}; expected {FORMAT!r}")
    if "part_names" in data and data["rotations"].shape[1:2] == (len(PART_NAMES),):
        data["rotations"] = data["rotations"][:, order_of_parts(data["part_names"], str(path))]
    rows = np.zeros(data["frames"].shape[:1], ROW)
    for name in (*names, *whole):
        values, shape = data[name], whole[name] if name in whole else rows[name].shape
        if values.shape != shape or values.dtype.kind not in "iuf" or not len(rows) or not np.isfinite(values).all():
            raise InputError(f"{path}: {name}: {values.dtype} {values.shape}; expected finite numbers {shape}")
        check_plausible(values, name, str(path))
        if name in names:
            rows[name] = values
    if (np.diff(rows["times"]) < 0).any():
        raise InputError(f"{path}: times: they go back; expected those of frames, one after another")
    perspective = int(data["camera_perspective"])
    if perspective not in (0, 1):
        raise InputError(f"{path}: camera_perspective: {perspective}; expected 0 or 1")
    size = check_picture_size(data["image_size"].tolist(), f"{path}: image_size")
    return FilmBodies(rows, size, perspective == 1)
