"""Detection of people in pictures: keypoints and masks of everyone, by the packaged networks.

``find_people`` is the entry. A detector (MoveNet MultiPose, at 256 x 256) looks at the whole picture, upright and
turned by quarters of a circle, and at overlapping tiles. Its 17 keypoints place a turned square crop on each person. A
second network (BlazePose, 256 x 256) finds 33 landmarks and a mask there. Two further points place a better crop, in
which the second network looks again. A detection is a person if both networks see it alike. People who are found twice
are merged. A larger network, "heavy", may then give landmarks that are nearer to the truth, and a head on its features
parts and joints (``assets/part_head.md``). The other weights are Google's (Apache-2.0, see
``assets/people_detector.md``). Plain torch runs the networks.
"""

from typing import Literal, get_args

from ...errors import shown

LandmarkNetwork = Literal["full", "heavy"]
PackagedParts = Literal["packaged", "mask", "none"]  # what is seen of a person: parts, the mask, or keypoints alone

MIN_SCORE = 0.5  # least confidence that there is a person, by default


def check_landmark_network(name: str) -> None:
    """Raise a ValueError unless there is a packaged landmark network of this name."""
    if name not in get_args(LandmarkNetwork):
        raise ValueError(f"landmarks: {shown(name)}; expected {' or '.join(get_args(LandmarkNetwork))}")
