"""Pictures of a fitted scene: what was seen, the truth, the fit, and all of it from above."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw

from ....body.skeletons import MPJPE_JOINTS, MPJPE_SKELETON, skeleton
from ....body.template import NUM_PARTS
from ....results.overlays import draw_keypoints
from ....results.palette import group_colours
from ...synthetic.scene_people import LABELS, SceneSample
from ..scene_scoring import SceneBodies, draw_scene

_TRUE, _FITTED = (20, 70, 140), (200, 60, 20)
_FILL = 0.9  # of the side of the picture from above
_SHADES = 0.55  # of the colours of every other person


def draw_scene_case(sample: SceneSample, bodies: SceneBodies) -> Image.Image:
    """First and last picture, a row each: labels and keypoints as seen, true labels, the fit's, and from above.

    From above, the first camera is below, out of the picture, and looks up.
    """
    fitted = draw_scene(sample, bodies.vertices)
    joints = bodies.landmarks(MPJPE_JOINTS)
    last = len(sample.parts) - 1
    return Image.fromarray(np.vstack([_row(sample, fitted, joints, index) for index in sorted({0, last})]))


def _row(sample: SceneSample, fitted: np.ndarray, joints: np.ndarray, index: int) -> np.ndarray:
    frame, view = divmod(index, len(sample.scene.views))
    observations = [each for each in sample.scene.observations if (each.frame, each.view) == (frame, view)]
    colours = group_colours(LABELS.part_groups)
    groups = np.zeros(sample.parts.shape[1:], dtype=np.uint8)
    for observation in observations:
        if observation.parts is not None:
            groups = np.where(
                (observation.parts.groups > 0) & (observation.parts.groups < 255), observation.parts.groups, groups
            )
    seen = Image.fromarray(colours[groups])
    for observation in observations:
        draw_keypoints(seen, observation.keypoints)
    pictures = [np.asarray(seen), _coloured(sample.parts[index]), _coloured(fitted[index])]
    return np.hstack([*pictures, np.asarray(_from_above(sample, joints, frame, seen.height))])


def _coloured(parts: np.ndarray) -> np.ndarray:
    """Parts of several people in colours; every other person is darker."""
    person, part = np.divmod(np.maximum(parts.astype(np.int64), 1) - 1, NUM_PARTS)
    groups = LABELS.from_parts(np.where(parts > 0, part + 1, 0).astype(np.uint8))
    shown = group_colours(LABELS.part_groups)[groups]
    return np.where((person % 2 == 1)[..., None], (_SHADES * shown).astype(np.uint8), shown)


def _from_above(sample: SceneSample, joints: np.ndarray, frame: int, side: int) -> Image.Image:
    """True and fitted joints of a frame along the first camera's y axis."""
    camera = sample.scene.views[0]
    turn, move = (each.numpy() for each in (camera.rotation, camera.translation))
    both = [each[:, frame] @ turn.T + move for each in (sample.joints, joints)]
    picture = Image.new("RGB", (side, side), "white")
    draw = ImageDraw.Draw(picture)
    ground = np.concatenate(both, axis=1)[..., [0, 2]].reshape(-1, 2)
    low, high = ground.min(0), ground.max(0)
    scale = _FILL * side / float((high - low).max())
    for people, colour in zip(both, (_TRUE, _FITTED), strict=True):
        for each in people:
            points = side / 2 + scale * (each[:, [0, 2]] - (low + high) / 2) * [1, -1]
            for start, end in skeleton(MPJPE_SKELETON).edges:
                draw.line([*points[start].tolist(), *points[end].tolist()], fill=colour, width=3)
    return picture
