"""A plain folder of pictures, each with its keypoints and perhaps its part labels."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ....body.labels import LabelSet, label_set
from ....errors import InputError, printable
from ....inputs.keypoint_files import read_keypoints
from ....inputs.keypoints import choose_person
from ....inputs.own_pixels import select_person
from ....inputs.part_labels import check_sizes, read_parts, read_photo
from ....inputs.photo_files import LeftOut, photos_among
from ....inputs.sample import Sample
from .pictures import existing

_LAYOUT = "pictures N.jpg, N.png or the like, each with N.keypoints.json and perhaps N.parts.png"


def read_folder(path: str | Path, labels: LabelSet | None = None, left_out: LeftOut | None = None) -> Iterator[Sample]:
    """The person of each picture: the largest, if there are several.

    Labels that are fitted are scored against too, since there are no others: other people's pixels and stray blobs are
    left out.

    Args:
        path: Folder of ``N.jpg``, ``N.png`` or the like, ``N.keypoints.json`` and, for all or none, ``N.parts.png``.
        labels: The label set; by default the one that ``labels.json`` in the folder describes.
        left_out: Counts files that are neither, before the first person comes.

    Raises:
        InputError: If there are no pictures, or a file is missing or wrong.
    """
    folder = Path(path)
    names = [file.name for file in (folder.iterdir() if folder.is_dir() else ())]
    pictures = [folder / name for name in sorted(photos_among(names, LeftOut() if left_out is None else left_out))]
    if not pictures:
        raise InputError(f"{folder}: no pictures; expected a folder of {_LAYOUT}")
    labelled = any(picture.with_suffix(".parts.png").is_file() for picture in pictures)
    if labelled and labels is None:
        labels = label_set(existing(folder, "labels.json", "the label set of the *.parts.png (or --labels)"))
    for picture in pictures:
        keypoints = folder / f"{picture.stem}.keypoints.json"
        if not keypoints.is_file():
            instead = "partdr dataset and partdr report show bodies of photos alone"
            raise InputError(f"{keypoints}: no such file; expected {_LAYOUT}, to compare bodies with; {instead}")
        people = read_keypoints(keypoints, photo=picture)
        parts = None
        if labelled and labels is not None:
            file = existing(folder, f"{picture.stem}.parts.png", "part labels as of the other pictures")
            parts = read_parts(file, labels)
            check_sizes(**{picture.name: read_photo(picture).shape[:2], file.name: parts.groups.shape})
        chosen = choose_person(people, None if parts is None else parts.groups)
        others = tuple(other for other in people if other is not chosen)
        yield Sample(
            source=folder.resolve().name,
            name=printable(picture.stem),
            keypoints=chosen,
            others=others,
            parts=parts,
            target=None if parts is None else select_person(parts.groups, chosen, others),
            picture=picture,
        )
