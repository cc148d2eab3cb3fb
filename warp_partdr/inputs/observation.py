"""Observation of one person: a square crop with keypoints and labels, without all other people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import compress
from typing import NamedTuple

import numpy as np
import torch

from ..body.labels import IGNORE, LabelSet
from ..body.skeletons import Skeleton, skeleton
from ..cameras import Crop, Perspective, UsualLens
from ..interop.movable import Movable
from .evidence import Evidence, weigh_evidence
from .keypoints import Keypoints2D
from .own_pixels import Windows
from .part_labels import PartLabels
from .person import Box, crop_boxes, crop_nearest

REFERENCE_SIZE = 256  # [px], the paper's image size; losses are stated for it
CROP_MARGIN = 0.1  # share of the person's extent, on each side
# Side of the crop of labels [px]: more than twice the side at which bodies are drawn, and an odd multiple of the label
# network's 128, so that a pixel of the network's input lies at the centre of a pixel here.
LABEL_SIZE = 640


@dataclass(frozen=True)
class Observation(Movable):
    """Keypoints and labels of one person in a square crop of side 2 (coordinates -1 to 1).

    Attributes:
        landmarks: Names of the L visible keypoints.
        points: Positions of the keypoints, shape (L, 2).
        confidence: Weights of the keypoints, 0 to 1, shape (L,).
        labels: Group ids in the crop, 0 = background, 255 = ignore, shape (N, N), uint8; None without labels.
        label_set: Meaning of the group ids.
        maps: Probability of each group, shape (G, N, N), instead of ``labels``; None without probabilities.
        known: Weight of each pixel of ``maps``, shape (N, N); the rest to 1 is the share that is ignored.
        lengths: Expected ``LENGTH_NAMES`` of the person [m], shape (12,); None: the mean adult's.
        thicknesses: Expected ``THICKNESS_NAMES`` [m], shape (15,); None: the mean adult's.
        depths: Expected depths of the parts' centres, pelvis at 0 [m], shape (20,); None: unknown.
        depth_uncertainties: Uncertainty of these depths: half widths of intervals of 68 % [m], shape (20,); None: 1 mm.
        marks: Point of the body that each keypoint marks (``Skeleton.marks``); None: ``landmarks`` themselves.
        lens: Focal length and principal point of the picture's camera, in the crop's coordinates, shape (3,). None: it
            is not known, and weak perspective is assumed.
        lens_assumed: True if the lens is a usual one, because the picture's own is not known.
        stature: The person's height [m], if it is known.
    """

    landmarks: tuple[str, ...]
    points: torch.Tensor
    confidence: torch.Tensor
    labels: torch.Tensor | None
    label_set: LabelSet | None
    maps: torch.Tensor | None = None
    known: torch.Tensor | None = None
    lengths: torch.Tensor | None = None
    thicknesses: torch.Tensor | None = None
    depths: torch.Tensor | None = None
    depth_uncertainties: torch.Tensor | None = None
    marks: tuple[str, ...] | None = None
    lens: torch.Tensor | None = None
    lens_assumed: bool = False
    stature: float | None = None

    @property
    def body_points(self) -> tuple[str, ...]:
        """Landmark of the body that each keypoint shows."""
        return self.landmarks if self.marks is None else self.marks


CutOut = tuple[Evidence, Observation, Crop]  # one person, cut out of a picture


def observe(
    keypoints: Keypoints2D,
    parts: PartLabels | None,
    *,
    others: Sequence[Keypoints2D] = (),
    trust_background: bool = False,
    device: torch.device | str = "cpu",
    camera: Perspective | None = None,
) -> tuple[Observation, Crop]:
    """Cut one person out of a picture, as ``fit_body`` does before it fits.

    Other people's labels and missing limbs are ignored. If labels and keypoints disagree on left and right, the
    keypoints are believed, while ``fit_body`` tries both.

    Args:
        keypoints: The person's keypoints, in pixels of the picture.
        parts: Part labels of the picture; None: keypoints alone.
        others: Keypoints of the other people in the picture.
        trust_background: True: background is believed where confident keypoints say that a limb is. False: it is
            ignored there.
        device: Device of the observation.
        camera: Camera of the picture; None: a usual lens is assumed if the picture's size is known.

    Returns:
        The observation in a square crop, whose keypoints are from -1 to 1, and the crop's position in the picture.

    Raises:
        TypeError: If keypoints or labels have another type.
        InputError: If no keypoint is visible, all lie in one point, or labels and keypoints do not meet.

    Examples:
        >>> from warp_partdr import observe, read_keypoints, read_parts
        >>> parts = read_parts("parts.png", "cdcl14")
        >>> observation, crop = observe(read_keypoints("keypoints.json")[0], parts)
        >>> observation.points.shape
        torch.Size([17, 2])
        >>> crop.size
        (256, 256)
    """
    evidence = weigh_evidence(keypoints, parts, others)[0]
    camera = camera or usual_lens(evidence)
    return crop_evidence(evidence, trust_background=trust_background, device=device, camera=camera)


def usual_lens(evidence: Evidence) -> UsualLens | None:
    """Camera to assume for a picture whose own is not known; None if the picture's size is not known either."""
    return None if evidence.image_size is None else UsualLens.of_size(evidence.image_size)


def crop_evidence(
    evidence: Evidence,
    *,
    trust_background: bool = False,
    device: torch.device | str = "cpu",
    camera: Perspective | None = None,
    label_size: int = LABEL_SIZE,
) -> tuple[Observation, Crop]:
    """Cut out a person whose evidence was weighed (``weigh_evidence``).

    Args:
        evidence: The person's evidence.
        trust_background: True: background is believed where confident keypoints say that a limb is.
        device: Device of the observation.
        camera: Camera of the picture; None: weak perspective.
        label_size: Side of the labels' crop [px], of which ``LABEL_SIZE`` is an odd multiple. The labels are the same,
            to the bit, as those at ``LABEL_SIZE`` after ``resize_nearest``.
    """
    middles, halves = crop_squares(*evidence.extents())
    low, high = boxes_in_picture(evidence.windows, middles, halves)
    labels = None
    if evidence.picture is not None:
        (x0, y0), (x1, y1) = low[0].tolist(), high[0].tolist()
        size, every = (LABEL_SIZE, LABEL_SIZE), LABEL_SIZE // label_size
        target = evidence.target(size, (x0, y0, x1, y1), every=every, trust_background=trust_background)
        labels = torch.from_numpy(target).to(device)
    weighed = WeighedPerson(
        keypoints=evidence.keypoints,
        points=evidence.windows.points[0, evidence.keypoints.visible],
        window=evidence.window,
        labels=labels,
        label_set=None if evidence.picture is None else evidence.picture.label_set,
        warnings=evidence.warnings,
        camera=camera,
    )
    ((_, observation, crop),) = observe_batch([weighed], middles, halves, device)
    if evidence.picture is not None and evidence.picture.maps is not None:
        observation = with_probabilities(observation, evidence.picture.maps, (*low[0].tolist(), *high[0].tolist()))
    return observation, crop


def with_probabilities(observation: Observation, maps: np.ndarray, box: Box) -> Observation:
    """Return a copy with the groups' probabilities from a picture's maps (G + 1, H, W), in a box of the picture."""
    assert observation.labels is not None
    step = LABEL_SIZE // observation.labels.shape[-1]
    cropped = crop_nearest(maps, box, (LABEL_SIZE, LABEL_SIZE), step=step, fill=0.0)
    target, device = observation.labels.cpu().numpy(), observation.labels.device
    known = np.where(target == IGNORE, 0.0, cropped.sum(0)).astype(np.float32)
    return replace(
        observation,
        maps=torch.from_numpy(np.ascontiguousarray(cropped[1:])).to(device),
        known=torch.from_numpy(known).to(device),
    )


def boxes_in_picture(windows: Windows, middles: np.ndarray, halves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Convert squares in windows (``crop_squares``) to left and top, right and bottom in the pictures, (N, 2) each."""
    low = windows.starts + (middles - halves[:, None]) / windows.zooms[:, None]
    return low, low + (2 * halves / windows.zooms)[:, None]


def _square_crop(window: Crop, middle: tuple[float, float], half: float) -> Crop:
    """Square crop of the picture around a middle (x, y); ``half`` is half its side; both in pixels of the window."""
    return Crop(
        left=window.left + (middle[0] - half) / window.zoom,
        top=window.top + (middle[1] - half) / window.zoom,
        zoom=window.zoom * REFERENCE_SIZE / (2 * half),
        size=(REFERENCE_SIZE, REFERENCE_SIZE),
    )


def crop_squares(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles and half sides of N people's square crops.

    Args:
        low: Lowest (x, y) of the people's keypoints and labels [px], shape (N, 2).
        high: Highest (x, y) of the same, shape (N, 2).

    Returns:
        Middles, shape (N, 2), and half sides, shape (N,), with a margin around the people.
    """
    low, high = crop_boxes(low, high, CROP_MARGIN)
    return (low + high) / 2, (high - low).max(axis=1) / 2


class WeighedPerson(NamedTuple):
    """Person whose evidence was weighed, and who can now be cut out."""

    keypoints: Keypoints2D
    points: np.ndarray  # visible keypoints in pixels of the window, shape (L, 2)
    window: Crop
    labels: torch.Tensor | None  # in the crop, shape (N, N), uint8
    label_set: LabelSet | None
    warnings: tuple[str, ...]
    camera: Perspective | None


def observe_batch(
    people: Sequence[WeighedPerson], middles: np.ndarray, halves: np.ndarray, device: torch.device | str
) -> list[CutOut]:
    """Cut out people by their squares (``crop_squares``). The evidence that is returned has no labels."""
    counts = [len(person.points) for person in people]
    middle = np.repeat(middles, counts, axis=0)
    half = np.repeat(halves[:, None], counts, axis=0)
    in_crops = (np.concatenate([person.points for person in people]) - middle) / half
    visible = np.concatenate([person.keypoints.confidence[person.keypoints.visible] for person in people])
    points = torch.from_numpy(in_crops.astype(np.float32)).to(device).split(counts)
    confidence = torch.from_numpy(visible.astype(np.float32)).to(device).split(counts)
    crops = [
        _square_crop(person.window, middle, half)
        for person, middle, half in zip(people, middles.tolist(), halves.tolist(), strict=True)
    ]
    lenses = _crop_lenses([person.camera for person in people], crops, device)
    found: list[CutOut] = []
    for n, (person, crop, lens) in enumerate(zip(people, crops, lenses, strict=True)):
        names, marks = visible_names(person.keypoints.skeleton, person.keypoints.visible.tobytes())
        observation = Observation(
            names,
            points[n],
            confidence[n],
            person.labels,
            person.label_set,
            marks=marks,
            lens=lens,
            lens_assumed=isinstance(person.camera, UsualLens),
        )
        evidence = Evidence(person.keypoints, None, person.window, None, person.warnings)
        found.append((evidence, observation, crop))
    return found


@lru_cache(maxsize=1024)
def visible_names(form: str | Skeleton, visible: bytes) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Landmarks and marks of the visible keypoints; ``visible`` is their mask as bytes, which can be a cache's key."""
    mask = np.frombuffer(visible, dtype=bool).tolist()
    known = skeleton(form)
    return tuple(compress(known.landmarks, mask)), tuple(compress(known.marks, mask))


def crop_lens(camera: Perspective, crop: Crop) -> torch.Tensor:
    """Focal length and principal point of a picture's camera in a square crop's coordinates, shape (3,)."""
    (lens,) = _crop_lenses([camera], [crop], "cpu")
    assert lens is not None
    return lens


def _crop_lenses(
    cameras: Sequence[Perspective | None], crops: Sequence[Crop], device: torch.device | str
) -> list[torch.Tensor | None]:
    """``crop_lens`` for each camera and its crop, on a device; None without a camera.

    Many are computed at once, as ``Perspective.in_crop`` does it for one: its checks take longer than its numbers.
    """
    known = [n for n, camera in enumerate(cameras) if camera is not None]
    found: list[torch.Tensor | None] = [None] * len(cameras)
    if not known:
        return found
    intrinsics = torch.cat([camera.intrinsics.cpu() for camera in cameras if camera is not None])
    starts = torch.tensor([[crops[n].left, crops[n].top] for n in known])
    zooms = torch.tensor([[crops[n].zoom] for n in known])
    halves = np.array([[crops[n].size[0] / 2] for n in known])
    focal = (intrinsics[:, :1] * zooms).numpy() / halves
    centre = ((intrinsics[:, 2:] - starts) * zooms).numpy() / halves - 1
    lenses = torch.from_numpy(np.concatenate([focal, centre], axis=1).astype(np.float32)).to(device)
    for n, lens in zip(known, lenses.unbind(), strict=True):
        found[n] = lens
    return found


def resize_nearest(labels: torch.Tensor, size: int) -> torch.Tensor:
    """Resample square images (..., N, N) to ``size`` pixels a side: each takes the pixel under its centre."""
    old = labels.shape[-1]
    index = ((torch.arange(size, device=labels.device) + 0.5) * old / size).long().clamp_max(old - 1)
    return labels[..., index[:, None], index].contiguous()
