"""Refinement of a body that another method found, of a regressor for example, against a person's part labels.

Its shape, pose and place are where the mesh stage starts, and what it is held to; it comes back in the same model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ...body.skeletons import skeleton
from ...cameras import Camera, Perspective
from ...errors import check_type
from ...inputs.keypoints import Keypoints2D
from ...inputs.part_labels import PartLabels
from ...models.registration import Registered
from ..ellipsoids.fitting import fit_body
from ..ellipsoids.options import FitOptions
from ..ellipsoids.result import FitResult
from ..ellipsoids.stages import Progress
from .mesh_options import MeshOptions
from .mesh_stage import CropPositions, MeshFit, measure_parameters, refine_meshes

_SURE = 0.5  # confidence of a given body's own keypoints, where nobody has seen others
_NO_STAGES = FitOptions(guess_camera=False, stages=(), search=())


def refine_given(
    body: Registered,
    camera: Camera,
    parts: PartLabels,
    keypoints: Keypoints2D | None = None,
    *,
    others: Sequence[Keypoints2D] = (),
    options: MeshOptions | None = None,
    progress: Progress | None = None,
) -> MeshFit:
    """Refine a detailed body that is given, instead of one that ``fit_body`` starts.

    Args:
        body: One body in the camera frame, of ``read_given`` or ``ungrown``.
        camera: Of the picture; a perspective one counts as known.
        parts: The picture's part labels.
        keypoints: The person's in the picture; None: where the body has them, which hold it there, and count as if
            they had usual noise.
        others: Other people's keypoints, which keep their labels apart from the person's.
        options: Of the mesh stage.
        progress: As of ``refine_mesh``.

    Raises:
        InputError: If labels and keypoints do not meet.
        TypeError: If an argument is of another type.
    """
    check_type("body", body, Registered, "of read_given, or ungrown")
    check_type("parts", parts, PartLabels, "of read_parts")
    known = camera if isinstance(camera, Perspective) else None
    device = body.model.faces.device
    result = fit_body(
        keypoints or body_keypoints(body, camera), parts, others=others, options=_NO_STAGES, device=device, camera=known
    )
    result, body = begin_at(result, body, camera)
    if keypoints is None:  # its own agree with it, whoever is right
        options = replace(options or MeshOptions(), noise="usual")
    return refine_meshes([result], body.model, options=options, starts=[body], progress=progress)[0]


def body_keypoints(body: Registered, camera: Camera) -> Keypoints2D:
    """COCO's keypoints where a body has them in the picture."""
    names = skeleton("coco17").landmarks
    there = [name in body.model.landmark_names for name in names]
    points = torch.zeros(1, len(names), 3)
    known = body.model.landmarks(body.detailed, [name for name, has in zip(names, there, strict=True) if has])
    points[:, there] = camera.project(known.detach()).cpu()
    return Keypoints2D("coco17", points[0, :, :2].numpy(), np.where(there, _SURE, 0.0).astype(np.float32))


def begin_at(result: FitResult, body: Registered, camera: Camera) -> tuple[FitResult, Registered]:
    """A fit whose body is a given one, and that body with EllipBody's pelvis at the origin.

    Args:
        result: Of ``fit_body``, for what was seen and the crop.
        body: One body in the camera frame.
        camera: Of the picture.
    """
    pelvis = body.model.landmarks(body.detailed, ["pelvis"])[:, 0]
    body = body.moved(-pelvis)
    size, seen = result.crop.size[0], camera.to(pelvis.device).in_crop(result.crop)
    if isinstance(seen, Perspective):
        weak = seen.to_weak(pelvis)
    else:
        weak = replace(seen, translation=seen.translation + seen.scale[:, None] * pelvis[:, :2])
    origin = CropPositions((weak.scale / (size / 2)).log(), weak.translation / (size / 2) - 1, result.observation.lens)
    parameters, moves = measure_parameters(body, origin)
    result = replace(result, parameters=parameters, uncertainty=None, depth_order=None)
    return result, body.moved(-moves)
