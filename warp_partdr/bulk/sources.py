"""Sources of pictures by the thousand, and what they give: a picture, its people and labels as far as they are known.

A source has names, in an order that is the same in each run, and reads one picture by its name, in any thread.
``opening.open_source`` opens one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch

from ..body.skeletons import Skeleton
from ..inputs.keypoints import Keypoints2D
from ..inputs.part_labels import PartLabels, PhotoFile, ScannedPhoto, read_photo
from ..inputs.person import Box

ANNOTATIONS = "annotations: "  # begins warnings about what was done to a picture's annotations
# Beginnings of warnings that a run counts at its end: those, and of keypoints beside a picture of another size.
COUNTED = (ANNOTATIONS, "keypoints: made at ", "keypoints: the photo is turned ")


@dataclass(frozen=True)
class KnownPerson:
    """A person of a picture, as annotated or as found.

    Attributes:
        keypoints: Keypoints in pixels of the picture.
        score: Confidence that there is a person.
        box: Box of the person: left, top, right, bottom [px].
        annotation: Number of the annotation. It is None for people who were found.
        warnings: Sentences about what was done to the annotation.
    """

    keypoints: Keypoints2D
    score: float
    box: Box
    annotation: int | None = None
    warnings: tuple[str, ...] = ()

    def warned(self, warning: str) -> KnownPerson:
        """Returns a copy with one more warning."""
        return replace(self, warnings=(*self.warnings, warning))


@dataclass(frozen=True)
class FaultyPerson:
    """A person whose annotation can't be used.

    Attributes:
        error: Why, in a sentence.
        annotation: Number of the annotation, if it has one.
    """

    error: str
    annotation: int | None = None


@dataclass(frozen=True)
class SourcePicture:
    """A picture, and its people if they are known.

    Attributes:
        picture: Picture, RGB, shape (H, W, 3), uint8, or a photo whose pixels are read when they are asked for.
        people: People of the picture. If it is None, they are to be found.
        owners: Number of the person that each pixel shows, 1 for the first of ``people`` and 0 for nobody, shape (H,
            W), int32. Larger numbers than there are people stand for others, such as people without keypoints. If it is
            None, this is unknown.
        parts: Part labels, which are preferred to ``owners``. If it is None, they are unknown.
        warnings: Sentences about the file.
        faults: People whose annotations can't be used, in addition to ``people``.
    """

    picture: np.ndarray | ScannedPhoto
    people: tuple[KnownPerson, ...] | None = None
    owners: torch.Tensor | None = None
    parts: PartLabels | None = None
    warnings: tuple[str, ...] = ()
    faults: tuple[FaultyPerson, ...] = ()

    @property
    def pixels(self) -> np.ndarray:
        """RGB, shape (H, W, 3), uint8."""
        return self.picture if isinstance(self.picture, np.ndarray) else read_photo(self.picture.file)

    @property
    def size(self) -> tuple[int, int]:
        """Size (H, W) of the picture [px]."""
        if isinstance(self.picture, np.ndarray):
            return self.picture.shape[0], self.picture.shape[1]
        return self.picture.size


class PictureSource(Protocol):
    """Pictures by name."""

    @property
    def names(self) -> Sequence[str]:
        """Names of all pictures, each once, in their order."""

    @property
    def skeleton(self) -> str | Skeleton:
        """Format of the keypoints that rows have: its name, or a skeleton of the files' own."""

    @property
    def warnings(self) -> Sequence[str]:
        """Sentences about the source as a whole, such as what was left out of it."""

    @property
    def digest(self) -> str | None:
        """SHA-256 of what people are known from; None where all are found."""

    @property
    def left_out(self) -> str:
        """A line that counts files which are no pictures; "" without any."""

    @property
    def finds(self) -> bool:
        """True if people may have to be found."""

    def photo(self, name: str) -> PhotoFile:
        """The file of a picture, for its EXIF data.

        Raises:
            InputError: If there is none.
        """

    def read(self, name: str) -> SourcePicture:
        """Read a picture.

        Raises:
            InputError: If it can't be read.
        """
