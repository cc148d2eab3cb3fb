"""A plain folder of pictures, each with its keypoints and perhaps its part labels."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ...body.labels import LabelSet, label_set
from ...errors import InputError
from ...inputs.keypoint_files import read_keypoints
from ...inputs.keypoints import choose_person
from ...inputs.part_labels import check_sizes, read_parts, read_photo
from ...inputs.sample import Sample
from ...inputs.selection import select_person
from .pictures import existing

_LAYOUT = "pictures N.jpg or N.png, each with N.keypoints.json and perhaps N.parts.png"


def read_folder(path: str | Path, labels: LabelSet | None = None) -> Iterator[Sample]:
    """The person of each picture: the largest, if there are several.

    Labels that are fitted are scored against too, since there are no others: other people's pixels and stray blobs are
    left out.

    Args:
        path: Folder of ``N.jpg`` or ``N.png``, ``N.keypoints.json`` and, for all or none, ``N.parts.png``.
        labels: The label set; by default the one that ``labels.json`` in the folder describes.

    Raises:
        InputError: If there are no pictures, or a file is missing or wrong.
    """
    folder = Path(path)
    pictures = sorted(
        file
        for file in (folder.iterdir() if folder.is_dir() else ())
        if file.suffix.lower() in (".jpg", ".jpeg", ".png") and not file.name.endswith(".parts.png")
    )
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
            name=picture.stem,
            keypoints=chosen,
            others=others,
            parts=parts,
            target=None if parts is None else select_person(parts.groups, chosen, others),
            picture=picture,
        )
