"""Colours of body parts and of directions in depth, equal in every picture and file.

Left limbs are warm, right limbs are cool, the middle of the trunk is violet and the head yellow, so sides can be told
apart by people who can't tell red from green. Along a limb, the colours grow lighter towards its end. Parts that touch
differ by more than 12 in CIE L*a*b*, also for colour-blind people (``tests/results/test_plot.py`` measures it).
"""

from __future__ import annotations

import numpy as np

from ..body.template import PART_NAMES

_COLOURS: dict[str, tuple[int, int, int]] = {
    "left_hip": (152, 107, 88),
    "right_hip": (121, 101, 168),
    "abdomen": (137, 136, 172),
    "chest": (174, 173, 227),
    "neck": (202, 198, 151),
    "left_shoulder": (192, 156, 164),
    "right_shoulder": (149, 214, 212),
    "head": (240, 210, 80),
    "left_upper_leg": (176, 58, 20),
    "right_upper_leg": (12, 72, 140),
    "left_lower_leg": (221, 102, 35),
    "right_lower_leg": (32, 112, 190),
    "left_foot": (250, 157, 88),
    "right_foot": (90, 160, 225),
    "left_upper_arm": (141, 29, 78),
    "right_upper_arm": (0, 100, 105),
    "left_forearm": (229, 63, 136),
    "right_forearm": (31, 135, 125),
    "left_hand": (240, 149, 145),
    "right_hand": (109, 220, 190),
}
PART_COLOURS: np.ndarray = np.array([(0, 0, 0), *(_COLOURS[name] for name in PART_NAMES)], dtype=np.uint8)
"""RGB of each part label 0 to 20, shape (21, 3); 0 = background.

Examples:
    >>> from warp_partdr import BodyParameters, draw_ellipsoids
    >>> from warp_partdr.plot import PART_COLOURS
    >>> body = BodyParameters.mean(1)
    >>> labels = draw_ellipsoids(body.posed(), body.camera(128), (128, 128)).labels[0]
    >>> PART_COLOURS[labels.numpy()].shape  # a picture, RGB
    (128, 128, 3)
"""

DEPTH_COLOURS = np.array([(220, 80, 20), (60, 60, 60), (0, 90, 181)], dtype=np.uint8)
"""RGB of a direction along z: toward the viewer, neither, away, shape (3, 3)."""

PEOPLE_COLOURS = np.array(
    [
        (20, 100, 180),
        (208, 90, 0),
        (0, 130, 100),
        (150, 60, 150),
        (165, 115, 0),
        (85, 90, 100),
        (190, 45, 85),
        (40, 135, 175),
    ],
    dtype=np.uint8,
)
"""RGB of people, dark enough for white letters; the ninth person has the first colour again."""

PALE_PEOPLE_COLOURS: np.ndarray = (PEOPLE_COLOURS * 0.5 + 255 * 0.5).astype(np.uint8)
"""The same colours of people, half white, for shaded bodies."""

IGNORE_COLOUR = np.array([70, 70, 70], dtype=np.uint8)


def group_colours(part_groups: np.ndarray) -> np.ndarray:
    """RGB of group ids by ``LabelSet.part_groups``: the mean colour of their parts, gray for 255; (256, 3), uint8."""
    table = np.zeros((256, 3), dtype=np.uint8)
    for group in np.unique(part_groups[1:]):
        table[group] = PART_COLOURS[1:][part_groups[1:] == group].mean(0)
    table[0] = 0
    table[255] = IGNORE_COLOUR
    return table
