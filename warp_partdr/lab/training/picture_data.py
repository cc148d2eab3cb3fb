"""Examples for EllipBodyNet: people of the data sets' readers, each cut out of its picture and augmented."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import count, islice
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from ...body.labels import IGNORE, LabelSet, label_set
from ...body.skeletons import MPJPE_JOINTS
from ...body.template import NUM_PARTS
from ...errors import InputError
from ...inputs.keypoints import LARGEST_COORDINATE
from ...inputs.observation import crop_squares
from ...inputs.own_pixels import person_extents
from ...inputs.part_labels import check_sizes
from ...inputs.person import Box
from ...inputs.sample import Sample
from ...networks.regression.landmarks import LANDMARKS, network_keypoints
from ..evaluation.datasets import read_folder, read_human36m, read_lsp, read_pw3d
from ..synthetic.shaded import shaded_people
from .augment import Augmentation, Similarity

_AS_IT_IS = Similarity()
_LSP_TRAINING = 1000  # pictures of 2000, the first ones
_SMALLEST = 8.0  # [px], side of a crop; less shows nobody


@dataclass(frozen=True)
class Source:
    """A data set and where it is."""

    kind: str  # "human36m", "lsp" (also UP-3D's annotation arrays), "pw3d", "folder", or "shaded" (``shaded_people``)
    path: str = ""  # what the reader of ``warp_partdr.lab.evaluation.datasets`` takes; of "shaded", nothing
    pictures: str | None = None  # folder that annotation arrays name pictures in
    parts: str | None = None  # folder of part labels, for "lsp"
    labels: str | None = None  # their label set
    keypoints: str | None = None  # folder of 2D keypoints, for "human36m" and "pw3d"
    count: int = 256  # of "shaded": how many people
    seed: int = 1  # of "shaded": who they are
    first_phase: int = 0  # phase of the training, from 0, from which on it is used
    validation: bool = False  # its errors are measured; nothing is learnt from it

    def read(self, device: torch.device | str = "cpu") -> list[Sample]:
        """Read the people.

        Raises:
            InputError: If there is no such kind, a file is missing or wrong, or there is nobody.
        """
        labels = None if self.labels is None else label_set(self.labels)
        readers: dict[str, Callable[[], Iterable[Sample]]] = {
            "human36m": partial(read_human36m, self.path, pictures=self.pictures, keypoints=self.keypoints),
            "lsp": partial(self._read_lsp, labels),
            "pw3d": partial(read_pw3d, self.path, pictures=self.pictures, keypoints=self.keypoints),
            "folder": partial(read_folder, self.path, labels),
            "shaded": partial(shaded_people, self.count, seed=self.seed, device=device),
        }
        if self.kind not in readers:
            raise InputError(f"kind: {self.kind!r}; expected one of {', '.join(readers)}")
        found = list(readers[self.kind]())
        if not found:
            raise InputError(f"{self.path}: nobody in it; expected people to learn from")
        return found

    def _read_lsp(self, labels: LabelSet | None) -> Iterable[Sample]:
        """Read people of Leeds Sports Poses.

        The data set's own folder gives its test pictures, or those for training. Annotation arrays give everybody.
        """
        people = read_lsp(self.path, parts=self.parts, labels=labels, pictures=self.pictures, test_only=self.validation)
        return islice(people, _LSP_TRAINING) if Path(self.path).is_dir() and not self.validation else people


@dataclass(frozen=True)
class Examples:
    """B people as the network and its losses see them, in square crops of side 2."""

    pictures: torch.Tensor  # RGB, shape (B, 3, S, S), uint8
    groups: torch.Tensor  # group ids, 255 where nothing is known, shape (B, S, S), uint8
    part_groups: torch.Tensor  # group id of each part label in a person's label set, on the host, shape (B, 21), uint8
    keypoints: torch.Tensor  # ``LANDMARKS``: place and confidence, all 0 where unknown, shape (B, 24, 3)
    annotated: torch.Tensor  # whether they lie where COCO's annotators mark them, shape (B,), bool
    joints: torch.Tensor  # ``MPJPE_JOINTS``, camera frame [m], of any origin, 0 where unknown, shape (B, 14, 3)
    has_joints: torch.Tensor  # 1 where a joint is known, shape (B, 14)

    def to(self, device: torch.device | str) -> Examples:
        """Examples on another device."""
        moved = {name: value.to(device, non_blocking=True) for name, value in vars(self).items()}
        return Examples(**{**moved, "part_groups": self.part_groups})

    @classmethod
    def cat(cls, examples: Sequence[Examples]) -> Examples:
        """All in one batch."""
        return cls(**{name: torch.cat([vars(one)[name] for one in examples]) for name in vars(examples[0])})


def make_example(
    sample: Sample, size: int, augmentation: Augmentation | None = None, rng: np.random.Generator | None = None
) -> Examples:
    """One person's crop of ``size`` pixels a side, B = 1, changed by an augmentation that ``rng`` draws.

    Raises:
        InputError: If the picture is missing or can't be read, or nobody is to be seen in it.
    """
    if sample.picture is None:
        raise InputError(f"{sample.name}: no picture; expected the file that the annotations name")
    picture = sample.read_picture()
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise InputError(f"{sample.name}: picture: {picture.dtype} {picture.shape}; expected uint8 (H, W, 3)")
    check_sizes(picture=picture.shape[:2], labels=None if sample.target is None else sample.target.shape)
    box = _square_box(sample)
    similarity = _AS_IT_IS
    if augmentation is not None:
        assert rng is not None
        similarity = augmentation.draw(rng)
        picture = augmentation.recolour(picture, rng)

    half, middle = (box[2] - box[0]) / 2, (np.array(box[:2]) + box[2:]) / 2
    found = sample.keypoints
    known = network_keypoints(
        found.format.landmarks,
        torch.from_numpy((found.points - middle) / half).float(),
        torch.from_numpy(found.confidence).float(),
    )
    keypoints = similarity.points(known.numpy(), LANDMARKS)
    keypoints[keypoints[:, 2] == 0] = 0
    joints = similarity.joints(_joints(sample), MPJPE_JOINTS)
    has_joints = np.isfinite(joints).all(1)
    crop, part_groups = np.full((size, size), IGNORE, dtype=np.uint8), np.zeros(NUM_PARTS + 1, dtype=np.uint8)
    if sample.target is not None and (labels := sample.target_set) is not None:
        crop, part_groups = similarity.labels(sample.target, labels, box, size), labels.part_groups
    arrays = {
        "pictures": similarity.picture(picture, box, size).transpose(2, 0, 1),
        "groups": crop,
        "part_groups": part_groups,
        "keypoints": keypoints,
        "annotated": np.array(found.format.marks != found.format.landmarks),
        "joints": np.where(has_joints[:, None], joints, 0).astype(np.float32),
        "has_joints": has_joints.astype(np.float32),
    }
    return Examples(**{name: torch.from_numpy(np.array(values, order="C"))[None] for name, values in arrays.items()})


def _square_box(sample: Sample) -> Box:
    """Square box around labels and keypoints, as a fit crops them [px].

    Raises:
        InputError: If no keypoint is visible, or the box is too small or too large.
    """
    if not sample.keypoints.visible.any():
        raise InputError(f"{sample.name}: no keypoint is visible; expected one at least")
    middles, halves = crop_squares(*person_extents(sample.keypoints, sample.target))
    half, (u, v) = float(halves[0]), middles[0].tolist()
    if not _SMALLEST <= 2 * half <= LARGEST_COORDINATE:
        raise InputError(f"{sample.name}: a crop of {2 * half:g} px; expected {_SMALLEST:g} or more")
    return u - half, v - half, u + half, v + half


def _joints(sample: Sample) -> np.ndarray:
    """``MPJPE_JOINTS`` [m], NaN where unknown, shape (14, 3)."""
    known = {} if sample.joints is None else dict(zip(sample.joint_names, sample.joints, strict=True))
    return np.array([known.get(name, (np.nan,) * 3) for name in MPJPE_JOINTS], dtype=np.float64)


@dataclass(frozen=True)
class ExampleDataset(Dataset):
    """Augmented examples without end, every person once an epoch in random order.

    An item is the same whoever asks for it, also on resuming.
    """

    samples: Sequence[Sample]
    size: int  # [px], side of the crops
    augmentation: Augmentation
    seed: int = 0  # of order and augmentation

    def __getitem__(self, place: int) -> Examples | str:
        """One example, B = 1, or why it can't be made."""
        epoch, position = divmod(place, len(self.samples))
        index = int(_order(self.seed, epoch, len(self.samples))[position])
        sample = self.samples[index]
        try:
            rng = np.random.default_rng([self.seed, epoch, index])
            return make_example(sample, self.size, self.augmentation, rng)
        except InputError as error:
            return f"{sample.source} {sample.name}: {error}"


@lru_cache(maxsize=2)
def _order(seed: int, epoch: int, size: int) -> np.ndarray:
    return np.random.default_rng([seed, epoch]).permutation(size)


def _collate(found: list[Examples | str]) -> tuple[Examples | None, list[str]]:
    """One batch, for a worker hands each tensor over by itself, which takes longer than making it."""
    read, failed = [one for one in found if isinstance(one, Examples)], [one for one in found if isinstance(one, str)]
    # Where a sample can't be read, another one of the batch takes its place.
    filled = [read[index % len(read)] for index in range(len(found))] if read else []
    return Examples.cat(filled) if read else None, failed


class Feed:
    """Batches without end, made by a number of ``workers``. With 0, they are made here.

    Attributes:
        consumed: Number of samples that process ``rank`` of ``processes`` has had by now.
        skipped: Sentences about what could not be read, and why.
    """

    def __init__(
        self,
        people: ExampleDataset,
        batch_size: int,
        *,
        workers: int = 0,
        rank: int = 0,
        processes: int = 1,
        consumed: int = 0,
    ) -> None:
        self.consumed, self.skipped = consumed, dict[str, None]()
        self._batch_size, self._count = batch_size, len(people.samples)
        loader = DataLoader(
            people,
            batch_size=batch_size,
            sampler=count(consumed * processes + rank, processes),
            num_workers=workers,
            collate_fn=_collate,
            generator=torch.Generator(),  # or a loader draws from the global one, which a resumed run must not
        )
        self._batches: Iterator[tuple[Examples | None, list[str]]] = iter(loader)

    def __next__(self) -> Examples:
        """The next batch, on the host.

        Raises:
            InputError: If none of the samples can be read.
        """
        for _ in range(0, self._count, self._batch_size):
            read, failed = next(self._batches)
            self.consumed += self._batch_size
            self.skipped.update(dict.fromkeys(failed))
            if read is not None:
                return read
        raise InputError(f"none of {self._count} samples can be read; the first: {failed[0]}")
