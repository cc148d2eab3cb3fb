"""Keypoints and part labels of a film's people by networks of others: a few people at a time, in bounded memory."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ...body.skeletons import skeleton
from ...errors import InputError, check_type
from ...inputs.films import Frame
from ...inputs.keypoints import Keypoints2D
from ...inputs.part_labels import PartLabels
from ...interop.torch_threads import all_torch_threads
from ..detection import MIN_SCORE, LandmarkNetwork
from ..detection.crops import Pyramid
from ..detection.film_people import FilmPeople, find_film_people, frame_places, kept_size
from ..detection.masks import instance_map
from ..detection.person import FoundPerson
from .keypoints import ask_keypoints
from .networks import KeypointNetwork, PartNetwork, cut_upright
from .parts import PlacedParts, ask_parts

_TOGETHER = {"cpu": 8, "cuda": 64}  # people of whom a network is asked at a time, of one frame or several


@dataclass(frozen=True)
class GivenNetworks:
    """Networks of others for films; None: the packaged one's keypoints, or its masks, serve.

    Attributes:
        parts_from: Network for part labels instead of masks, which ``load_part_network`` returns or you make.
        keypoints_from: Network for keypoints, which ``load_keypoint_network`` returns or you make.

    Examples:
        With a checkpoint of SegFormer in the folder ``segformer``, and the extra ``photo``:

        >>> from warp_partdr import GivenNetworks, load_part_network
        >>> networks = GivenNetworks(parts_from=load_part_network("segformer"))
        >>> networks.keypoints_from is None  # the packaged network finds the keypoints
        True
    """

    parts_from: PartNetwork | None = None
    keypoints_from: KeypointNetwork | None = None

    def __post_init__(self) -> None:
        check_type("parts_from", self.parts_from, PartNetwork | None, "of load_part_network")
        check_type("keypoints_from", self.keypoints_from, KeypointNetwork | None, "of load_keypoint_network")
        if self.keypoints_from is not None and self.keypoints_from.boxes is not None:
            raise InputError(
                f"keypoints_from: with boxes of {self.keypoints_from.boxes.name}, for a film, whose people the "
                "packaged detector follows; expected keypoints alone"
            )


@dataclass(frozen=True)
class FilmPredictions:
    """Predictions by networks of others about a film's people, for N rows of ``FilmPeople``.

    Attributes:
        networks: The networks.
        frames: Frame of each row, shape (N,), int64.
        places: Index of the person in the frame's ``owners``, for each row, shape (N,), int64.
        keypoints: Points x, y [px] and confidence, shape (N, K, 3), float32. They are 0 where the network sees nobody.
            K may be 0.
        size: Height and width (H, W) of the labels: ``kept_size`` of the film.
        packed: Compressed labels of groups, uint8. They are empty where the network sees no part.
    """

    networks: GivenNetworks
    frames: np.ndarray
    places: np.ndarray
    keypoints: np.ndarray
    size: tuple[int, int]
    packed: tuple[bytes, ...]

    def keypoints_of(self, frame: int, index: int) -> Keypoints2D | None:
        """Keypoints of somebody in a frame; None: the packaged ones are to be taken."""
        values = self.keypoints[self._rows[frame, index]]
        network = self.networks.keypoints_from
        if network is None or not (values[:, 2] > 0).any():
            return None
        return Keypoints2D(network.skeleton, values[:, :2].copy(), values[:, 2].copy())

    def parts_of(self, frame: int, index: int) -> PartLabels | None:
        """Labels of somebody in a frame, others' pixels ignored; None if there are none."""
        groups = self.groups(self._rows[frame, index])
        network = self.networks.parts_from
        return None if network is None or groups is None else PartLabels(network.labels, groups)

    def groups(self, row: int) -> np.ndarray | None:
        """Group at each pixel of a row's labels, shape ``size``, uint8."""
        packed = self.packed[row]
        return np.frombuffer(zlib.decompress(packed), np.uint8).reshape(self.size).copy() if packed else None

    def taken(self, numbers: np.ndarray) -> FilmPredictions:
        """Returns a copy with the frames of these numbers alone, as ``FilmPeople.taken`` does."""
        kept = np.flatnonzero(np.isin(self.frames, numbers))
        packed = tuple(self.packed[row] for row in kept)
        frames = frame_places(self.frames[kept], numbers)
        return FilmPredictions(self.networks, frames, self.places[kept], self.keypoints[kept], self.size, packed)

    @property
    def warnings(self) -> list[str]:
        """Warnings about networks that found nothing on a person in some frames, a sentence each."""
        total, warnings = len(self.frames), []
        blank = total - int((self.keypoints[..., 2] > 0).any(1).sum())
        if self.networks.keypoints_from is not None and blank:
            warnings.append(
                f"the given network found no keypoints in {blank} of {total} observations; those of the packaged "
                "network are used"
            )
        bare = total - sum(map(bool, self.packed))
        if self.networks.parts_from is not None and bare:
            warnings.append(
                f"the given network found no labels in {bare} of {total} observations; only the keypoints are used"
            )
        return warnings

    def arrays(self) -> dict[str, np.ndarray]:
        """All but the networks, for files."""
        return {
            "given_frames": self.frames,
            "given_places": self.places,
            "given_keypoints": self.keypoints,
            "given_size": np.array(self.size),
            "given_packed": np.frombuffer(b"".join(self.packed), np.uint8),
            "given_sizes": np.array([len(each) for each in self.packed], np.int64),
        }

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, np.ndarray], networks: GivenNetworks) -> FilmPredictions:
        """Returns the predictions in ``arrays``, by these networks."""
        values: dict[str, Any] = {name: arrays[f"given_{name}"] for name in ("frames", "places", "keypoints")}
        height, width = arrays["given_size"].tolist()
        stops = np.cumsum(arrays["given_sizes"]).tolist()
        whole = arrays["given_packed"].tobytes()
        packed = tuple(whole[start:stop] for start, stop in zip([0, *stops], stops, strict=False))
        return cls(networks, **values, size=(height, width), packed=packed)

    @cached_property
    def _rows(self) -> dict[tuple[int, int], int]:
        keys = zip(self.frames.tolist(), self.places.tolist(), strict=True)
        return {key: row for row, key in enumerate(keys)}


PREDICTION_ARRAYS = tuple(f"given_{name}" for name in ("frames", "places", "keypoints", "size", "packed", "sizes"))


def pack_groups(groups: np.ndarray | None) -> bytes:
    """Compress labels, uint8, as ``FilmPredictions.packed`` has them."""
    return b"" if groups is None else zlib.compress(groups.tobytes(), 1)


def find_film_predictions(
    path: str | Path,
    networks: GivenNetworks,
    *,
    min_score: float = MIN_SCORE,
    device: torch.device | str = "cpu",
    progress: Callable[[int, int], None] | None = None,
    landmarks: LandmarkNetwork = "heavy",
) -> tuple[FilmPeople, FilmPredictions]:
    """Find and follow the people of a film, and ask networks of others about each in each frame.

    Args:
        path: The film.
        networks: The networks, on the device.
        min_score: Least confidence, as in ``find_film_people``.
        device: Device to run on.
        progress: Function that is told the frames done and their total number.
        landmarks: Network whose keypoints are taken, as in ``find_film_people``. If the given networks find keypoints,
            these serve where they see nobody.

    Raises:
        InputError: If ``find_film_people`` raises it, or if a network gives something else than it says.

    Examples:
        With a checkpoint of ViTPose in the folder ``vitpose``, and the extra ``photo``:

        >>> from warp_partdr import GivenNetworks, ObservedFilm, find_film_predictions, load_keypoint_network
        >>> networks = GivenNetworks(keypoints_from=load_keypoint_network("vitpose"))
        >>> people, predictions = find_film_predictions("walk.mp4", networks)
        >>> film = ObservedFilm.of(people, given=predictions)  # for fit_film
        >>> people.num_people
        1
    """
    check_type("networks", networks, GivenNetworks, "such as GivenNetworks(keypoints_from=network)")
    asked = _Asked(networks, torch.device(device))

    def watch(frame: Frame, picture: Pyramid, people: Sequence[FoundPerson]) -> None:
        try:
            asked.watch(frame.index, picture, people)
        except InputError as error:
            raise _NetworkError(error) from error

    try:
        people = find_film_people(
            path, min_score=min_score, device=device, progress=progress, watch=watch, landmarks=landmarks
        )
    except _NetworkError as fault:
        raise fault.error from None
    return people, asked.predictions(people)


class _NetworkError(Exception):
    """Fault of a network, which must not be taken for the film's, that ends a film but not the run."""

    def __init__(self, error: InputError) -> None:
        super().__init__(str(error))
        self.error = error


@dataclass
class _Waiting:
    """Person that the networks are still to be asked about.

    Attributes:
        key: Frame, and index in the frame's ``owners``.
        person: Person in the film's pixels.
        parts: Object that places the labels in the frame.
        pictures: Pictures of the person, by the network's name, each of shape (1, 3, H, W).
    """

    key: tuple[int, int]
    person: FoundPerson
    parts: PlacedParts | None
    pictures: dict[str, torch.Tensor]


@dataclass
class _Asked:
    """Networks that are asked as the film goes on.

    Attributes:
        networks: The networks.
        device: Device of the networks.
        waiting: People who wait until there are enough of them.
        keypoints: Keypoints that were found, by frame and index.
        packed: Labels that were found, by frame and index.
    """

    networks: GivenNetworks
    device: torch.device
    waiting: list[_Waiting] = field(default_factory=list)
    keypoints: dict[tuple[int, int], Keypoints2D] = field(default_factory=dict)
    packed: dict[tuple[int, int], bytes] = field(default_factory=dict)

    def watch(self, frame: int, picture: Pyramid, people: Sequence[FoundPerson]) -> None:
        """Take the people of a frame; of its picture, only their crops are kept."""
        if not people:
            return
        parts = None
        if (network := self.networks.parts_from) is not None:
            size = kept_size(picture.size)
            small = [_smaller(person, size[1] / picture.size[1]) for person in people]
            parts = PlacedParts(network, small, instance_map(small, size), keeps_maps=False)
        for index, person in enumerate(people):
            pictures: dict[str, torch.Tensor] = {}
            if network is not None:
                pictures["parts"] = cut_upright(picture, person, network.size, stretch=network.stretch)
            if (other := self.networks.keypoints_from) is not None:
                pictures["keypoints"] = cut_upright(picture, person, other.size)
            self.waiting.append(_Waiting((frame, index), person, parts, pictures))
        while len(self.waiting) >= _TOGETHER[self.device.type]:
            self._ask(_TOGETHER[self.device.type])

    def predictions(self, people: FilmPeople) -> FilmPredictions:
        """Returns the predictions for the film's rows, at its end."""
        self._ask(len(self.waiting))
        network, rows = self.networks.keypoints_from, people.rows
        count = 0 if network is None else len(skeleton(network.skeleton))
        keypoints = np.zeros((len(rows), count, 3), np.float32)
        keys = list(zip(rows["frames"].tolist(), rows["places"].tolist(), strict=True))
        for row, key in enumerate(keys):
            if (seen := self.keypoints.get(key)) is not None:
                keypoints[row] = np.column_stack([seen.points, seen.confidence])
        packed = tuple(self.packed.get(key, b"") for key in keys)
        size = kept_size(people.image_size)
        return FilmPredictions(self.networks, rows["frames"].copy(), rows["places"].copy(), keypoints, size, packed)

    def _ask(self, count: int) -> None:
        """Ask about the first of those who wait."""
        some, self.waiting = self.waiting[:count], self.waiting[count:]
        if not some:
            return
        with all_torch_threads():
            self._ask_about(some)

    def _ask_about(self, some: Sequence[_Waiting]) -> None:
        if (network := self.networks.keypoints_from) is not None:
            pictures = torch.cat([each.pictures["keypoints"] for each in some])
            found = ask_keypoints(network, pictures, [each.person for each in some])
            self.keypoints |= {each.key: seen for each, seen in zip(some, found, strict=True) if seen is not None}
        if (parts := self.networks.parts_from) is not None:
            said = ask_parts(parts, torch.cat([each.pictures["parts"] for each in some]))
            for each, answer in zip(some, said, strict=True):
                assert each.parts is not None
                seen = each.parts.of(each.key[1], answer)
                self.packed[each.key] = pack_groups(None if seen is None else seen.groups)


def _smaller(person: FoundPerson, zoom: float) -> FoundPerson:
    """A person of a picture drawn at ``zoom``."""
    keypoints = replace(person.keypoints, points=person.keypoints.points * np.float32(zoom))
    return replace(person, crop=person.crop.zoomed(zoom), keypoints=keypoints)
