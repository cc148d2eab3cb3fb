"""Fit of everyone in a photo that comes with nothing else: people are found by the packaged networks.

Their masks are not cut into parts: with a mask of the whole body, the label network and the mesh stage end nearer to
the truth than with parts guessed by the nearest bones. A user's networks may give parts, and keypoints, instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from ..body.labels import BACKGROUND, IGNORE
from ..cameras import Perspective, UsualLens, zoomed
from ..errors import InputError, check_type, check_whole, told_as
from ..inputs.evidence import MASK_LABELS, Evidence, weigh_evidence
from ..inputs.keypoints import Keypoints2D
from ..inputs.part_labels import PartLabels, exif_focal_length, read_photo
from ..inputs.person import PersonInputs
from ..models.model import DetailedModel
from ..networks.detection import MIN_SCORE, LandmarkNetwork
from ..networks.detection.crops import Pyramid
from ..networks.detection.given_boxes import BoxNetwork, find_people_in_boxes, same_keypoints
from ..networks.detection.masks import instance_map
from ..networks.detection.people import check_picture, find_people
from ..networks.detection.person import FoundPerson
from ..networks.predictors.keypoints import find_keypoints
from ..networks.predictors.networks import KeypointNetwork, PartNetwork
from ..networks.predictors.parts import PeopleParts
from ..solve.ellipsoids.fitting import fit_evidence
from ..solve.ellipsoids.options import FitOptions
from ..solve.ellipsoids.result import FitResult
from ..solve.ellipsoids.stages import Progress
from ..solve.mesh.mesh_stage import MeshFit
from ..solve.scene.overlapping import refine_people

PACKAGED = "packaged: BlazePose"  # name of the packaged network
_COMPARED = 1024  # [px], longer side of the picture in which it is looked for who hides whom
_HIDDEN = 0.02  # share of a body that shows somebody else, from which on that one hides it


@dataclass(frozen=True)
class PhotoFit:
    """Everyone in a photo, largest person first.

    Attributes:
        people: As they were found, with the keypoints that were fitted.
        fits: Bodies, by the place of their person in ``people``: of all, or of the one who was asked for.
        owners: Whom each pixel shows: 1 for the first of ``people``, 0 for nobody, shape (H, W), int32.
        sources: Names of the networks that each body's "keypoints" and "parts" are of, by the same places; ``PACKAGED``
            is that of the packaged one, whose parts are a mask, and None where no part was used.
    """

    people: tuple[FoundPerson, ...]
    fits: dict[int, MeshFit]
    owners: np.ndarray
    sources: dict[int, dict[str, str | None]]

    def hidden_by(self, place: int) -> list[int]:
        """Places of those whose masks lie before a person's body."""
        zoom = min(1.0, _COMPARED / max(self.owners.shape))
        rows, columns = (_nearest(side, zoom) for side in self.owners.shape)
        size, mesh = (len(rows), len(columns)), self.fits[place]
        drawn = mesh.draw(size, camera=zoomed(mesh.camera, zoom, size)).labels[0].cpu().numpy() > 0
        counts = np.bincount(self.owners[rows[:, None], columns][drawn], minlength=len(self.people) + 1)[1:]
        counts[place] = 0
        return np.flatnonzero(counts > _HIDDEN * max(drawn.sum(), 1)).tolist()


def fit_photo(
    photo: np.ndarray | str | Path,
    *,
    parts_from: PartNetwork | None = None,
    keypoints_from: KeypointNetwork | None = None,
    person: int | None = None,
    min_score: float = MIN_SCORE,
    options: FitOptions | None = None,
    model: DetailedModel | None = None,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
    camera: Perspective | None = None,
) -> PhotoFit:
    """Find everyone in a photo, and fit a body to each; the mesh stages run side by side, of those who overlap as one.

    Args:
        photo: RGB, shape (H, W, 3), uint8, of ``read_photo``; or its file.
        parts_from: Network for part labels instead of masks, of ``load_part_network`` or of your own.
        keypoints_from: Network for keypoints instead of the packaged one's, likewise; its ``boxes`` find the people.
        person: Fit this one alone, 0 = largest; the others' pixels are still known to be theirs.
        min_score: Least confidence that there is a person, 0 to 1.
        options: Such as ``FitOptions.at("fast")``; the outline stage, from before which the mesh stage goes on, is left
            out.
        model: On the device, float32; default Anny.
        device: "cpu" or a CUDA device.
        progress: Called with (stage name, iterations done, iterations in all).
        camera: The photo's; if None, of a file, as its EXIF data tell it, if they do, or else a usual lens for all
            (``FitOptions.guess_camera``).

    Raises:
        InputError: If the file can't be read, nobody is found, or not so many people, a network gives something else
            than it says, or ``options.stature`` is of several people.
        TypeError: If a network is of another type.
    """
    check_type("parts_from", parts_from, PartNetwork | None, "of load_part_network")
    check_type("keypoints_from", keypoints_from, KeypointNetwork | None, "of load_keypoint_network")
    tell = progress or (lambda name, done, total: None)
    tell("people", 0, 1)
    pixels = read_photo(photo) if isinstance(photo, str | Path) else photo
    check_picture("photo", pixels)
    if camera is None and isinstance(photo, str | Path) and (focal := exif_focal_length(photo)) is not None:
        camera = Perspective.of_picture(pixels.shape[:2], focal=focal)
    picture = Pyramid(pixels, device)
    options = (options or FitOptions.at("balanced")).without_outline()
    with told_as("photo", "photo" if pixels is photo else photo):
        found, owners = _everyone(picture, min_score, keypoints_from, options.landmarks)
    chosen = range(len(found)) if person is None else [person_place(person, len(found))]
    check_whose(options.stature, len(chosen))
    if camera is None and options.guess_camera:
        camera = UsualLens.of_size(pixels.shape[:2])  # of everybody, also of who has no mask
    evidence = _PeopleEvidence(found, owners, picture, parts_from, keypoints_from, len(chosen))
    results: list[FitResult] = []
    sources: dict[int, dict[str, str | None]] = {}
    for done, index in enumerate(chosen):
        tell("bodies", done, len(chosen))
        readings, warnings, sources[index] = evidence.of(index)
        found[index] = replace(found[index], keypoints=readings[0].keypoints)
        result = fit_evidence(readings, options, device=device, camera=camera)
        results.append(replace(result, warnings=(*warnings, *result.warnings)))
    fits = refine_people(results, model, options=options.mesh, progress=progress)
    return PhotoFit(tuple(found), dict(zip(chosen, fits, strict=True)), owners, sources)


class _PeopleEvidence:
    """Evidence of people: of the given networks, or, where they see nothing, of the packaged ones."""

    def __init__(
        self,
        people: Sequence[FoundPerson],
        owners: np.ndarray,
        picture: Pyramid,
        parts_from: PartNetwork | None,
        keypoints_from: KeypointNetwork | None,
        count: int,
    ) -> None:
        self._people, self._owners, self._picture, self._keypoints_from = people, owners, picture, keypoints_from
        self._parts = None if parts_from is None else PeopleParts(parts_from, picture, people, owners, count)

    def of(self, place: int) -> tuple[list[Evidence], list[str], dict[str, str | None]]:
        """Readings of one of them (``weigh_evidence``), a sentence for each network of no use, and ``sources``."""
        warnings: list[str] = []
        names: dict[str, str | None] = {"keypoints": PACKAGED, "parts": PACKAGED}
        person = self._people[place]
        readings = [person_evidence(person.keypoints, self._owners, place)] if person.seen else []
        if self._keypoints_from is not None:
            given = find_keypoints(self._keypoints_from, self._picture, person)
            weighed = [] if given is None else _weighed(given, readings[0].picture if readings else None)
            if not weighed:
                warnings.append("keypoints: none of the given network on this person; the packaged one's taken")
            else:
                readings, names["keypoints"] = weighed, self._keypoints_from.name
        if self._parts is not None:
            parts = self._parts.of(place)
            weighed = [] if parts is None else _weighed(readings[0].keypoints, parts)
            if not weighed:
                warnings.append("labels: none of the given network along the bones; the mask taken")
            else:
                readings, names["parts"] = weighed, self._parts.network.name
        if readings[0].picture is None:
            names["parts"] = None
        return readings, warnings, names


def _weighed(keypoints: Keypoints2D, parts: PartLabels | None) -> list[Evidence]:
    """Readings of keypoints and labels; none if labels, where there are any, do not lie along the bones."""
    try:
        return weigh_evidence(keypoints, parts)
    except InputError:
        return []


def person_in_photo(photo: np.ndarray, person: int = 0, landmarks: LandmarkNetwork = "heavy") -> PersonInputs:
    """The input of one person's fit as ``fit_photo`` finds it; 0 = largest.

    Raises:
        InputError: If nobody is found, or not so many people.
    """
    check_picture("photo", photo)
    found, owners = _everyone(Pyramid(photo, "cpu"), MIN_SCORE, None, landmarks)
    index = person_place(person, len(found))
    seen = person_evidence(found[index].keypoints, owners, index)
    return PersonInputs(seen.keypoints, (), seen.picture, photo)


def _everyone(
    photo: Pyramid, min_score: float, keypoints_from: KeypointNetwork | None, landmarks: LandmarkNetwork
) -> tuple[list[FoundPerson], np.ndarray]:
    """The people in a photo, and whom each pixel shows; without those of whom nothing but a box is known."""
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
    """The people in boxes; whose box alone is known, only with keypoints of the network that nobody else has."""
    people = find_people_in_boxes(boxes, photo, min_score, landmarks=landmarks)
    if all(person.seen for person in people):
        return people
    given = [find_keypoints(network, photo, person) for person in people]
    kept = [place for place, person in enumerate(people) if person.seen]
    for place, own in enumerate(given):
        if place in kept or own is None or not _weighed(own, None):
            continue
        side = float(people[place].crop.sides[0])
        others = [(given[other], (side, float(people[other].crop.sides[0]))) for other in kept]
        if not any(other is not None and same_keypoints(own, other, sides) for other, sides in others):
            kept.append(place)
    return [people[place] for place in sorted(kept)]


def mask_labels(owners: np.ndarray, index: int) -> PartLabels | None:
    """Labels of the set "full1" of one of the owners, others' pixels ignored; None if no pixel shows the person."""
    groups = np.where(owners == BACKGROUND, BACKGROUND, IGNORE).astype(np.uint8)
    groups[owners == index + 1] = 1
    return PartLabels(MASK_LABELS, groups) if (groups == 1).any() else None


def person_evidence(keypoints: Keypoints2D, owners: np.ndarray, index: int) -> Evidence:
    """Evidence of one of the people of a photo, with labels of ``mask_labels``; of nearly hidden ones, without.

    A mask knows no sides, so that there is one reading of it.

    Raises:
        InputError: If the keypoints can't be used.
    """
    # Others' masks may have left pixels far from the bones alone.
    return (_weighed(keypoints, mask_labels(owners, index)) or weigh_evidence(keypoints))[0]


def _nearest(side: int, zoom: float) -> np.ndarray:
    """Pixels of a picture's side that lie under those of the same side made smaller."""
    return np.minimum((np.arange(max(round(side * zoom), 1)) + 0.5) / zoom, side - 1).astype(np.int64)


def check_whose(stature: float | None, count: int) -> None:
    """Check that a known stature is of one person, of so many who are found and to be fitted.

    Raises:
        InputError: If it is of several.
    """
    if stature is not None and count > 1:
        raise InputError(f"stature: {stature:g} m, of {count} people; expected one of them, person 0 to {count - 1}")


def person_place(person: int, count: int) -> int:
    """The place of the person who was asked for among those found.

    Raises:
        InputError: If there are not so many.
    """
    try:
        index = check_whole("person", person, 0)
    except ValueError as error:
        raise InputError(str(error)) from None
    if index >= count:
        raise InputError(f"person: {index}; expected 0 to {count - 1}, of the people found")
    return index
