"""What a fit reads: a photo, 2D keypoints and part labels; which person they are of, and the crop around that person.

Every fault in a file or option raises ``InputError``.
"""

from __future__ import annotations

from .errors import InputError
from .keypoint_files import parse_keypoints, read_keypoints
from .keypoints import Keypoints2D, choose_person, person_height
from .part_files import PartLabels, check_sizes, label_set_of, read_label_set, read_parts, read_photo
from .person import check_inside, crop_keypoints, crop_nearest, crop_size, person_crop, select_person

__all__ = [
    "InputError",
    "Keypoints2D",
    "PartLabels",
    "check_inside",
    "check_sizes",
    "choose_person",
    "crop_keypoints",
    "crop_nearest",
    "crop_size",
    "label_set_of",
    "parse_keypoints",
    "person_crop",
    "person_height",
    "read_keypoints",
    "read_label_set",
    "read_parts",
    "read_photo",
    "select_person",
]
