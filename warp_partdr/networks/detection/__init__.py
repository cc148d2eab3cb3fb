"""Detection of people in pictures: keypoints and masks of everyone, by the packaged networks.

``find_people`` is the entry. A detector (BlazePose's, at 224 x 224) looks at the whole picture and at overlapping
tiles; its points place a turned square crop on each person. A second network (256 x 256) finds 33 landmarks and a mask
there, and two points more that place a better crop, for a second look. People found twice are merged. A larger network,
"heavy", may then give landmarks that are nearer to the truth. Weights are MediaPipe's (Apache-2.0, see
``assets/people_detector.md``), run by plain torch.
"""

from typing import Literal, get_args

from ...errors import shown

LandmarkNetwork = Literal["full", "heavy"]

MIN_SCORE = 0.5  # least confidence that there is a person, where nobody says else


def check_landmark_network(name: str) -> None:
    """Raise a ValueError unless there is a packaged landmark network of this name."""
    if name not in get_args(LandmarkNetwork):
        raise ValueError(f"landmarks: {shown(name)}; expected {' or '.join(get_args(LandmarkNetwork))}")
