"""Everyone in a picture, or in several: from the detector's boxes to keypoints and masks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ...errors import InputError, check_each, check_type, check_whole, shown
from ...interop.torch_threads import one_torch_thread
from . import MIN_SCORE, LandmarkNetwork, check_landmark_network
from .asset import packaged_people_networks
from .crops import Pyramid
from .heavy import with_heavy_landmarks
from .person import FoundPerson
from .search import follow, search_people


def find_people(
    picture: np.ndarray | Pyramid,
    *,
    device: torch.device | str = "cpu",
    min_score: float = MIN_SCORE,
    levels: int | None = None,
    previous: Sequence[FoundPerson] = (),
    landmarks: LandmarkNetwork = "full",
) -> list[FoundPerson]:
    """Find everyone in a picture.

    Args:
        picture: RGB, shape (H, W, 3), uint8; or a ``Pyramid`` of it on the device, which others may go on with.
        device: Device to run on.
        min_score: Least confidence that there is a person (``FoundPerson.score``), 0 to 1.
        levels: Number of sizes at which the picture is looked at. With 1, the whole picture alone is, where people of a
            quarter of its longer side and more are found. Each further level, at overlapping tiles of half the size,
            finds people half as large. Tiles smaller than 192 pixels are left out. If it is None, there are 2, and
            more where people are so small that there may be smaller ones, or where nobody is found; then only those
            smaller tiles are looked at in which the detector has seen somebody, however faintly.
        previous: The people of a film's last frame. Where they are given, only they are followed, and the detector
            doesn't run; nobody new is found.
        landmarks: Network whose keypoints are taken. "heavy" is nearer to the truth, and takes five times as long as a
            look of "full" for each person who is found. The people and their masks are those of "full" with either.

    Returns:
        People, largest first; none if nobody is there.

    Raises:
        TypeError: If ``picture`` is neither, or ``previous`` are no people.
        InputError: If it is no picture.
        ValueError: If a number is out of range.
    """
    (people,) = find_people_in(
        [picture], device=device, min_score=min_score, levels=levels, previous=[previous], landmarks=landmarks
    )
    return people


@one_torch_thread()
@torch.no_grad()
def find_people_in(
    pictures: Sequence[np.ndarray | Pyramid],
    *,
    device: torch.device | str = "cpu",
    min_score: float = MIN_SCORE,
    levels: int | None = None,
    previous: Sequence[Sequence[FoundPerson]] | None = None,
    half: bool = False,
    landmarks: LandmarkNetwork = "full",
) -> list[list[FoundPerson]]:
    """Find everyone in several pictures of any sizes, in batches.

    Args:
        pictures: Pictures, each as in ``find_people``.
        device: Device to run on.
        min_score: Least confidence, as in ``find_people``.
        levels: Number of sizes of tiles, as in ``find_people``.
        previous: People of the frame before each picture. If it is None, no picture has any.
        half: True asks the networks in float16 on CUDA (``HalfGraph``).
        landmarks: Network whose keypoints are taken, as in ``find_people``.

    Returns:
        The people of each picture.
    """
    for index, picture in enumerate(pictures):
        if not isinstance(picture, Pyramid):
            check_picture("picture" if len(pictures) == 1 else f"pictures[{index}]", picture)
    fixed = None if levels is None else check_whole("levels", levels, 1)
    if not 0 <= min_score < 1:
        raise ValueError(f"min_score: {shown(min_score)}; expected a number from 0 to below 1")
    before = [()] * len(pictures) if previous is None else previous
    if len(before) != len(pictures):
        raise ValueError(f"previous: of {len(before)} pictures; expected {len(pictures)}, as pictures")
    for people in before:
        check_each("previous", people, FoundPerson, "of find_people")
    check_landmark_network(landmarks)
    half = half and torch.device(device).type == "cuda"
    networks = packaged_people_networks(str(device), half=half, landmarks=landmarks)
    made = iter(Pyramid.each([each for each in pictures if not isinstance(each, Pyramid)], networks.device))
    pyramids = [each if isinstance(each, Pyramid) else next(made) for each in pictures]
    if elsewhere := {pyramid.device for pyramid in pyramids} - {networks.device}:
        raise ValueError(f"picture: a pyramid on {elsewhere.pop()}; expected one on {networks.device}")
    new = [index for index, people in enumerate(before) if not people]
    found = follow(networks, pyramids, before, min_score)
    if new:
        found = found.with_those_of(search_people(networks, pyramids, new, min_score, fixed), new)
    everyone = found.people([pyramid.size for pyramid in pyramids])
    return everyone if networks.heavy is None else with_heavy_landmarks(networks.heavy, pyramids, everyone)


def check_picture(name: str, picture: np.ndarray) -> None:
    """Raise unless an argument is a picture."""
    check_type(name, picture, np.ndarray, "of read_photo")
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or not picture.size:
        raise InputError(f"{name}: {picture.dtype} {picture.shape}; expected uint8 (H, W, 3), RGB")
