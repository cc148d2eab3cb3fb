"""Fit of everyone in a photo without further inputs. The packaged networks find the people, and see their parts.

A person's mask says where the person is, and the part head which part each of its pixels shows. The user's own networks
may give parts and keypoints instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
import torch

from ..body.stature import tall_warning
from ..cameras import Perspective, UsualLens, zoomed
from ..errors import InputError, check_type, check_whole, told_as
from ..inputs.evidence import MASK_LABELS, Evidence, weigh_evidence
from ..inputs.keypoints import Keypoints2D
from ..inputs.own_pixels import Mask
from ..inputs.part_labels import PartLabels, exif_focal_length, read_photo
from ..inputs.person import PersonInputs
from ..interop.arrays import tensor_over
from ..interop.torch_threads import all_torch_threads, one_torch_thread
from ..models.measuring import heights
from ..models.model import DetailedModel
from ..networks.detection import MIN_SCORE, LandmarkNetwork, PackagedParts
from ..networks.detection.crops import Pyramid
from ..networks.detection.given_boxes import BoxNetwork, find_people_in_boxes, same_keypoints
from ..networks.detection.masks import instance_map
from ..networks.detection.people import check_picture, find_people
from ..networks.detection.person import FoundPerson
from ..networks.predictors.keypoints import find_keypoints
from ..networks.predictors.networks import KeypointNetwork, PartNetwork
from ..networks.predictors.parts import PeopleParts, seen_parts
from ..solve.confidence.judge import BodyConfidence, judge_fits
from ..solve.confidence.measures import detection_measures
from ..solve.ellipsoids.fitting import fit_evidence
from ..solve.ellipsoids.options import FitOptions
from ..solve.ellipsoids.result import FitResult
from ..solve.ellipsoids.stages import Progress
from ..solve.mesh.mesh_stage import MeshFit
from ..solve.scene.overlapping import refine_people

PACKAGED = "packaged: BlazePose"  # name of the packaged network for keypoints and masks
PACKAGED_PARTS = "packaged: part head"  # and of that for parts
_COMPARED = 1024  # [px], longer side of the picture in which masks and bodies are compared
_HIDDEN = 0.02  # share of a body covered by another person's mask, from which on that person hides it


@dataclass(frozen=True)
class PhotoFit:
    """Everyone in a photo, largest person first.

    Attributes:
        people: People that were found, with the keypoints that were fitted.
        fits: Bodies by the index of the person in ``people``, for all people or the one who was asked for.
        owners: Person at each pixel: 1 for the first of ``people``, 0 for nobody, shape (H, W), int32.
        sources: Names of the networks that gave the "keypoints" and "parts" of each body, by the index of the person.
            ``PACKAGED`` is the packaged network, whose parts are a mask, and ``PACKAGED_PARTS`` is the part head. None
            stands for parts that were not used.
        confidences: Confidence in each body, by the index of the person.
    """

    people: tuple[FoundPerson, ...]
    fits: dict[int, MeshFit]
    owners: np.ndarray
    sources: dict[int, dict[str, str | None]]
    confidences: dict[int, BodyConfidence]

    def hidden_by(self, index: int) -> list[int]:
        """Indices of the people whose masks cover a person's body."""
        if len(self.people) == 1:
            return []
        zoom = min(1.0, _COMPARED / max(self.owners.shape))
        height, width = self.owners.shape
        rows = _nearest(height, zoom)
        columns = _nearest(width, zoom)
        size = (len(rows), len(columns))
        mesh = self.fits[index]
        drawn = mesh.draw(size, camera=zoomed(mesh.camera, zoom, size)).labels[0].cpu().numpy() > 0
        counts = np.bincount(self.owners[rows[:, None], columns][drawn], minlength=len(self.people) + 1)[1:]
        counts[index] = 0
        return np.flatnonzero(counts > _HIDDEN * max(drawn.sum(), 1)).tolist()


@one_torch_thread()
def fit_photo(
    photo: np.ndarray | str | Path,
    *,
    parts_from: PartNetwork | PackagedParts = "packaged",
    keypoints_from: KeypointNetwork | None = None,
    person: int | None = None,
    min_score: float = MIN_SCORE,
    options: FitOptions | None = None,
    model: DetailedModel | None = None,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
    camera: Perspective | None = None,
) -> PhotoFit:
    """Finds everyone in a photo, and fits a body to each person.

    The meshes of people who overlap are fitted as one scene. All other meshes are fitted side by side.

    Args:
        photo: RGB pixels that ``read_photo`` returns, shape (H, W, 3), uint8, or the photo's file.
        parts_from: Source of part labels: "packaged" is the packaged part head, which sees the parts if the landmark
            network is "heavy" (``FitOptions.landmarks``); "mask" takes the mask of the whole body instead; "none" takes
            keypoints alone; or a network that ``load_part_network`` returns or you make.
        keypoints_from: Network for keypoints instead of the packaged one, which ``load_keypoint_network`` returns or
            you make. If it has ``boxes``, they find the people.
        person: Index of the only person to fit, 0 is the largest. Pixels of the other people are still left out. If it
            is None, everyone is fitted.
        min_score: Least confidence that there is a person, 0 to 1.
        options: Options such as ``FitOptions.at("fast")``. The outline stage is left out, because the mesh stage
            continues from before it.
        model: Detailed model on the device, float32. The default is Anny.
        device: Device to run on, "cpu" or a CUDA device.
        progress: Function that is called with (stage name, iterations done, all iterations).
        camera: Camera of the photo. If it is None, it is read from the EXIF data of the file. If there are none, all
            people get a usual lens (``FitOptions.guess_camera``).

    Raises:
        InputError: If the file can't be read, nobody is found, ``person`` is not among the people found, a network's
            output is not as it says, or ``options.stature`` is given for several people.
        TypeError: If a network has another type.

    Examples:
        >>> from warp_partdr import fit_photo
        >>> everyone = fit_photo("photo.png")
        >>> len(everyone.people), everyone.fits[0].vertices.shape
        (1, (13718, 3))
        >>> everyone.fits[0].landmarks(["nose", "left_wrist"]).shape  # in the camera frame [m]
        (2, 3)
    """
    if parts_from not in get_args(PackagedParts):
        check_type("parts_from", parts_from, PartNetwork, "of load_part_network, 'packaged', 'mask' or 'none'")
    check_type("keypoints_from", keypoints_from, KeypointNetwork | None, "of load_keypoint_network")
    report = progress or (lambda name, done, total: None)
    report("people", 0, 1)
    pixels = read_photo(photo) if isinstance(photo, str | Path) else photo
    check_picture("photo", pixels)
    if camera is None and isinstance(photo, str | Path) and (focal := exif_focal_length(photo)) is not None:
        camera = Perspective.of_picture(pixels.shape[:2], focal=focal)
    picture = Pyramid(pixels, device)
    options = options or FitOptions.at("balanced")
    with told_as("photo", "photo" if pixels is photo else photo):
        found, owners = _everyone(picture, min_score, keypoints_from, options.landmarks)
    chosen = range(len(found)) if person is None else [person_index(person, len(found))]
    check_stature_owner(options.stature, len(chosen))
    if camera is None and options.guess_camera:
        camera = UsualLens.of_size(pixels.shape[:2])  # one for all, even for people without a mask
    evidence = _PeopleEvidence(found, owners, picture, parts_from, keypoints_from, len(chosen))
    results: list[FitResult] = []
    sources: dict[int, dict[str, str | None]] = {}
    for done, index in enumerate(chosen):
        report("bodies", done, len(chosen))
        readings, warnings, sources[index] = evidence.of(index)
        found[index] = replace(found[index], keypoints=readings[0].keypoints)
        result = fit_evidence(readings, options, device=device, camera=camera)
        results.append(replace(result, warnings=(*warnings, *result.warnings)))
    fits = refine_people(results, model, options=options.mesh, progress=progress)
    confidences = judge_fits([fit.ellipbody for fit in fits], [detection_measures(found[index]) for index in chosen])
    judged = [fit.with_warnings(each.warnings) for fit, each in zip(fits, confidences, strict=True)]
    if options.stature is None:
        judged = [fit.with_warnings(_tall(fit)) for fit in judged]
    return PhotoFit(
        tuple(found),
        dict(zip(chosen, judged, strict=True)),
        owners,
        sources,
        dict(zip(chosen, confidences, strict=True)),
    )


def _tall(fit: MeshFit) -> tuple[str, ...]:
    """Warning about a height that hardly anybody has: a photo alone does not show how tall somebody is."""
    return tall_warning("the person", float(heights(fit.body.rest())))


class _PeopleEvidence:
    """Evidence of people, from the given networks, or from the packaged ones where the given ones see nothing."""

    def __init__(
        self,
        people: Sequence[FoundPerson],
        owners: np.ndarray,
        picture: Pyramid,
        parts_from: PartNetwork | PackagedParts,
        keypoints_from: KeypointNetwork | None,
        count: int,
    ) -> None:
        self._people = people
        self._owners = owners
        self._picture = picture
        self._keypoints_from = keypoints_from
        self._parts_from = parts_from
        self._parts = (
            PeopleParts(parts_from, picture, people, owners, count) if isinstance(parts_from, PartNetwork) else None
        )

    def of(self, index: int) -> tuple[list[Evidence], list[str], dict[str, str | None]]:
        """Weighs the evidence of one person.

        Returns:
            Readings (``weigh_evidence``), a warning for each network that was of no use, and the person's ``sources``.
        """
        warnings: list[str] = []
        names: dict[str, str | None] = {"keypoints": PACKAGED, "parts": PACKAGED}
        person = self._people[index]
        readings = _packaged_readings(person, self._owners, index, self._parts_from) if person.seen else []
        if self._keypoints_from is not None:
            with all_torch_threads():
                given = find_keypoints(self._keypoints_from, self._picture, person)
            weighed = [] if given is None else _weighed(given, readings[0].picture if readings else None)
            if not weighed:
                warnings.append(
                    "keypoints: the given network found none on this person; those of the packaged network are used"
                )
            else:
                readings, names["keypoints"] = weighed, self._keypoints_from.name
        if self._parts is not None:
            with all_torch_threads():
                parts = self._parts.of(index)
            weighed = [] if parts is None else _weighed(readings[0].keypoints, parts)
            if not weighed:
                warnings.append("labels: the given network found none along the bones; the mask is used")
            else:
                readings, names["parts"] = weighed, self._parts.network.name
        picture = readings[0].picture
        if picture is None:
            names["parts"] = None
        elif names["parts"] == PACKAGED and picture.label_set.num_groups > 1:
            names["parts"] = PACKAGED_PARTS
        return readings, warnings, names


def _weighed(keypoints: Keypoints2D, parts: PartLabels | None) -> list[Evidence]:
    """Readings of keypoints and labels. The list is empty if there are labels that lie along no bone."""
    try:
        return weigh_evidence(keypoints, parts)
    except InputError:
        return []


def person_in_photo(
    photo: np.ndarray,
    person: int = 0,
    landmarks: LandmarkNetwork = "heavy",
    parts_from: PackagedParts = "packaged",
) -> PersonInputs:
    """Inputs of one person's fit, as ``fit_photo`` finds them.

    Args:
        photo: RGB pixels, shape (H, W, 3), uint8.
        person: Index of the person, 0 is the largest.
        landmarks: Network for keypoints.
        parts_from: Source of part labels.

    Raises:
        InputError: If nobody is found, or ``person`` is not among the people found.
    """
    check_picture("photo", photo)
    found, owners = _everyone(Pyramid(photo, "cpu"), MIN_SCORE, None, landmarks)
    index = person_index(person, len(found))
    evidence = _packaged_readings(found[index], owners, index, parts_from)[0]
    return PersonInputs(evidence.keypoints, (), evidence.picture, photo)


def _everyone(
    photo: Pyramid, min_score: float, keypoints_from: KeypointNetwork | None, landmarks: LandmarkNetwork
) -> tuple[list[FoundPerson], np.ndarray]:
    """People in a photo, and the person at each pixel. People are left out if only their box is known."""
    if keypoints_from is None or keypoints_from.boxes is None:
        found = find_people(photo, device=photo.device, min_score=min_score, landmarks=landmarks)
    else:
        found = _boxed_people(keypoints_from, keypoints_from.boxes, photo, min_score, landmarks)
    if not found:
        raise InputError("photo: nobody found in it; expected a person, or keypoints of one")
    return found, instance_map(found, photo.size)


def _boxed_people(
    network: KeypointNetwork, boxes: BoxNetwork, photo: Pyramid, min_score: float, landmarks: LandmarkNetwork
) -> list[FoundPerson]:
    """People in boxes.

    A person without packaged keypoints is kept only if the network finds keypoints that differ from everyone else's.
    """
    people = find_people_in_boxes(boxes, photo, min_score, landmarks=landmarks)
    if all(person.seen for person in people):
        return people
    given = [find_keypoints(network, photo, person) for person in people]
    kept = [index for index, person in enumerate(people) if person.seen]
    for index, own in enumerate(given):
        if index in kept or own is None or not _weighed(own, None):
            continue
        side = float(people[index].crop.sides[0])
        others = [(given[other], (side, float(people[other].crop.sides[0]))) for other in kept]
        if not any(other is not None and same_keypoints(own, other, sides) for other, sides in others):
            kept.append(index)
    return [people[index] for index in sorted(kept)]


def mask_labels(owners: np.ndarray, index: int) -> PartLabels | None:
    """Labels of one person, from the label set "full1". None if no pixel shows the person.

    Args:
        owners: Person at each pixel, from 1 on, 0 for nobody, shape (H, W), int32.
        index: Index of the person, from 0. Pixels of other people become 255 (ignored).
    """
    groups = Mask(tensor_over(owners.astype(np.int32, copy=False)), index + 1).groups()
    return PartLabels(MASK_LABELS, groups) if (groups == 1).any() else None


def _packaged_readings(
    person: FoundPerson, owners: np.ndarray, index: int, parts_from: PartNetwork | PackagedParts
) -> list[Evidence]:
    """Readings of what the packaged networks found of a person: with parts or the mask, if they are wanted."""
    if parts_from == "none":
        return weigh_evidence(person.keypoints)
    if parts_from == "packaged" and (mask := mask_labels(owners, index)) is not None:
        parts = seen_parts(person, mask)
        if parts is not None and (weighed := _weighed(person.keypoints, parts)):
            return weighed
    return [person_evidence(person.keypoints, owners, index)]


def person_evidence(keypoints: Keypoints2D, owners: np.ndarray, index: int) -> Evidence:
    """Weighs the evidence of one person in a photo, with labels from ``mask_labels``.

    There is only one reading, because a mask has no left and right.

    Args:
        keypoints: Keypoints of the person.
        owners: Person at each pixel, from 1 on, 0 for nobody, shape (H, W), int32.
        index: Index of the person, from 0.

    Raises:
        InputError: If the keypoints can't be used.
    """
    # Of a person who is nearly hidden, only pixels far from the bones may be left. Then only keypoints are used.
    return (_weighed(keypoints, mask_labels(owners, index)) or weigh_evidence(keypoints))[0]


def _nearest(side: int, zoom: float) -> np.ndarray:
    """Indices of the pixels on a picture's side that lie under the pixels of the side made smaller by ``zoom``."""
    return np.minimum((np.arange(max(round(side * zoom), 1)) + 0.5) / zoom, side - 1).astype(np.int64)


def check_stature_owner(stature: float | None, count: int) -> None:
    """Checks that a known stature is given for only one person.

    Args:
        stature: Height of a person [m], or None.
        count: Number of people that were found and are to be fitted.

    Raises:
        InputError: If there are several people.
    """
    if stature is not None and count > 1:
        raise InputError(f"stature: {stature:g} m, for {count} people; expected one of them, person 0 to {count - 1}")


def person_index(person: int, count: int) -> int:
    """Index of the person who was asked for, among the people found.

    Args:
        person: Index that the user gave.
        count: Number of people found.

    Raises:
        InputError: If it is out of range.
    """
    try:
        index = check_whole("person", person, 0)
    except ValueError as error:
        raise InputError(str(error)) from None
    if index >= count:
        raise InputError(f"person: {index}; expected 0 to {count - 1}, of the people found")
    return index
