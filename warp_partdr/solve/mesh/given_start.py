"""Refinement of another method's body, such as a regressor's, against a person's part labels.

The mesh stage starts at the shape, pose and position of this body, and is held to them. The result is a body of the
same model.
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

_OWN_CONFIDENCE = 0.5  # confidence of keypoints that are taken from the given body
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
    """Refine a detailed body that is given, instead of one that starts at a result of ``fit_body``.

    Args:
        body: One body in the camera frame, from ``read_given`` or ``ungrown``.
        camera: Camera of the picture; a perspective one counts as known.
        parts: Part labels of the picture.
        keypoints: Keypoints of the person in the picture. None: the body's own keypoints hold it where it is; they
            count as keypoints with usual noise.
        others: Keypoints of other people, which keep their labels apart from the person's.
        options: Options of the mesh stage.
        progress: Function that is called with (stage name, iterations done, iterations in all).

    Returns:
        Refined body, in the same model.

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
    if keypoints is None:  # the body agrees with its own keypoints, which says nothing about their noise
        options = replace(options or MeshOptions(), noise="usual")
    return refine_meshes([result], body.model, options=options, starts=[body], progress=progress)[0]


def body_keypoints(body: Registered, camera: Camera) -> Keypoints2D:
    """Project a body's landmarks into the picture as COCO's keypoints; those that its model lacks have confidence 0."""
    names = skeleton("coco17").landmarks
    known = [name in body.model.landmark_names for name in names]
    points = torch.zeros(1, len(names), 3)
    landmarks = body.model.landmarks(body.detailed, [name for name in names if name in body.model.landmark_names])
    points[:, known] = camera.project(landmarks.detach()).cpu()
    return Keypoints2D("coco17", points[0, :, :2].numpy(), np.where(known, _OWN_CONFIDENCE, 0.0).astype(np.float32))


def begin_at(result: FitResult, body: Registered, camera: Camera) -> tuple[FitResult, Registered]:
    """Replace the body of a fit by a given one.

    Args:
        result: Result of ``fit_body``, of which the observation and the crop are used.
        body: One body in the camera frame.
        camera: Camera of the picture.

    Returns:
        Fit whose EllipBody is measured from the given body; and the given body, moved so that EllipBody's pelvis is at
        the origin.
    """
    pelvis = body.model.landmarks(body.detailed, ["pelvis"])[:, 0]
    body = body.moved(-pelvis)
    size = result.crop.size[0]
    in_crop = camera.to(pelvis.device).in_crop(result.crop)
    if isinstance(in_crop, Perspective):
        weak = in_crop.to_weak(pelvis)
    else:
        weak = replace(in_crop, translation=in_crop.translation + in_crop.scale[:, None] * pelvis[:, :2])
    origin = CropPositions((weak.scale / (size / 2)).log(), weak.translation / (size / 2) - 1, result.observation.lens)
    parameters, moves = measure_parameters(body, origin)
    result = replace(result, parameters=parameters, uncertainty=None, depth_order=None)
    return result, body.moved(-moves)
