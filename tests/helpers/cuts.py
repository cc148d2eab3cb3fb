"""People cut out of pictures: odd ones, and what the formula book says of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch

from warp_partdr.body.labels import BACKGROUND, IGNORE, LabelSet, label_set
from warp_partdr.body.landmarks import mirror_name, without_side
from warp_partdr.body.skeletons import skeleton
from warp_partdr.body.template import JOINT_NAMES, PARENTS, PART_NAMES
from warp_partdr.cameras import Perspective
from warp_partdr.inputs.body_lines import LIMBS, limb_extent, segments_of_parts
from warp_partdr.inputs.cut_people import CutPerson
from warp_partdr.inputs.evidence import MASK_LABELS, Evidence, PicturePerson
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.keypoints import Keypoints2D, person_height
from warp_partdr.inputs.observation import LABEL_SIZE, crop_evidence
from warp_partdr.inputs.own_pixels import Mask
from warp_partdr.inputs.part_labels import PartLabels, read_parts
from warp_partdr.reference import own_pixels as book

from .files import EXAMPLE

LABELS = ("cdcl14", "pascal6", "full1")


@cache
def example(labels: str = "cdcl14") -> tuple[Keypoints2D, PartLabels]:
    """The example's person in the groups of a label set."""
    parts = read_parts(EXAMPLE / "parts.png", label_set("cdcl14"))
    own, known = label_set(labels), parts.label_set
    table = np.zeros(256, dtype=np.uint8)
    table[IGNORE] = IGNORE
    table[1 : known.num_groups + 1] = [
        own.part_groups[np.flatnonzero(known.part_groups == group)[0]] for group in range(1, known.num_groups + 1)
    ]
    return read_keypoints(EXAMPLE / "keypoints.json")[0], PartLabels(own, table[parts.groups])


def as_format(keypoints: Keypoints2D, form: str) -> Keypoints2D:
    """Keypoints in another format, as far as it has them; hips, knees and the like have the same names in all."""
    points, confidence = np.zeros((len(skeleton(form)), 2), np.float32), np.zeros(len(skeleton(form)), np.float32)
    for row, name in enumerate(skeleton(form).landmarks):
        if name in keypoints.format.landmarks:
            other = keypoints.format.landmarks.index(name)
            points[row], confidence[row] = keypoints.points[other], keypoints.confidence[other]
    return Keypoints2D(form, points, confidence)


def scaled(person: PicturePerson, step: int, zoom: int = 1) -> PicturePerson:
    """A person in a picture of every so many-th pixel, each of which is then repeated."""
    factor = np.float32(zoom / step)

    def resized(image: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(image[::step, ::step].repeat(zoom, axis=0).repeat(zoom, axis=1))

    def moved(keypoints: Keypoints2D) -> Keypoints2D:
        return Keypoints2D(keypoints.skeleton, keypoints.points * factor, keypoints.confidence)

    pixels = person.pixels
    if isinstance(pixels, Mask):
        pixels = Mask(torch.from_numpy(resized(pixels.owners.numpy())), pixels.number)
    elif pixels is not None:
        pixels = PartLabels(pixels.label_set, resized(pixels.groups))
    return person._replace(keypoints=moved(person.keypoints), pixels=pixels, others=[*map(moved, person.others)])


def disturbed(keypoints: Keypoints2D, rng: np.random.Generator, *, spread: float) -> Keypoints2D:
    """Keypoints are moved, and some are missing."""
    points = keypoints.points + rng.normal(0, spread, keypoints.points.shape).astype(np.float32)
    confidence = keypoints.confidence * (rng.random(len(points)) > rng.choice([0.0, 0.0, 0.1, 0.4])).astype(np.float32)
    seen = np.flatnonzero(keypoints.confidence)[:2]
    confidence[seen] = np.maximum(confidence[seen], np.float32(0.1))
    points[(confidence == 0) & (rng.random(len(points)) < 0.5)] = 0
    return Keypoints2D(keypoints.skeleton, points, confidence)


def odd_person(rng: np.random.Generator, *, masked: bool = False) -> PicturePerson:
    """The example's person with others beside, holes, blobs, ignored pixels, exchanged sides and ids.

    In a picture of any label set, a quarter as large, or, of a mask, with strangers in it.
    """
    known, parts = example("full1" if masked else str(rng.choice(LABELS)))
    groups, labels = parts.groups.copy(), parts.label_set
    form = str(rng.choice(["coco17", "blazepose33", "lsp14"]))
    keypoints = disturbed(as_format(known, form), rng, spread=rng.choice([0, 3, 30]))
    others = [disturbed(known, rng, spread=20.0) for _ in range(0 if masked else rng.choice([0, 0, 1, 3]))]
    others = [
        Keypoints2D(each.skeleton, each.points + rng.choice([25, 60, 900], 2).astype(np.float32), each.confidence)
        for each in others
    ]
    if others and rng.random() < 0.5:
        groups = np.maximum(groups, np.roll(groups, 40, axis=1))
    if rng.random() < 0.2:
        groups = mirrored(labels)[groups]
    if rng.random() < 0.2:  # something far from the part whose label it has
        groups[groups == rng.integers(1, labels.num_groups + 1)] = rng.integers(1, labels.num_groups + 1)
    if rng.random() < 0.1:  # ids of another set
        table = np.arange(256, dtype=np.uint8)
        table[1 : labels.num_groups + 1] = 1 + rng.permutation(labels.num_groups)
        groups = table[groups]
    for _ in range(rng.integers(0, 5)):
        row, column = rng.integers(0, groups.shape)
        height, width = rng.integers(5, 120, 2)
        groups[row : row + height, column : column + width] = rng.choice([0, 0, IGNORE, 1, labels.num_groups])
    groups[rng.random(groups.shape) < rng.choice([0.0, 0.05, 0.9], p=[0.7, 0.2, 0.1])] = 0
    groups = np.ascontiguousarray(groups[: -int(rng.integers(1, len(groups) // 3))])
    if not masked:
        return scaled(PicturePerson(keypoints, PartLabels(labels, groups), others), 4)
    owners = np.select([groups == IGNORE, groups > 0], [2, 3], 0).astype(np.int32)
    return scaled(PicturePerson(keypoints, Mask(torch.from_numpy(owners), 3)), 4)


def mirrored(labels: LabelSet) -> np.ndarray:
    """The group of the mirror image of each group, shape (256,), uint8."""
    table, names = np.arange(256, dtype=np.uint8), labels.group_names
    for number, name in enumerate(names, start=1):
        if mirror_name(name) in names:
            table[number] = names.index(mirror_name(name)) + 1
    return table


@dataclass(frozen=True)
class Twin:
    """A person cut out by the formula book.

    Attributes:
        groups: In the window.
        warnings: Sentences about labels.
        labels: In the crop.
        points: Visible keypoints in the crop, from -1 to 1.
    """

    groups: np.ndarray
    warnings: tuple[str, ...]
    labels: np.ndarray
    points: np.ndarray


def seen_body(keypoints: Keypoints2D, labels: LabelSet, others: list[Keypoints2D]) -> book.KeypointBody:
    """The body that keypoints in pixels of the label image tell."""
    sure = {keypoints.format.landmarks[row]: keypoints.points[row].astype(float) for row in _sure(keypoints)}
    flesh, segments = {}, segments_of_parts(sure)
    names = labels.group_names
    for number, (name, parts) in enumerate(labels.groups.items(), start=1):
        both = [*parts, *(labels.groups[mirror_name(name)] if mirror_name(name) in names else ())]
        if all(segments[part] for part in both):
            every = [each for part in both for each in segments[part]]
            ends = np.array([(start, end) for start, end, _ in every])
            flesh[number] = ends, np.array([radius for *_, radius in every])
    limbs = []
    for part, name in enumerate(PART_NAMES):
        start, end = JOINT_NAMES[PARENTS[part] + 1], JOINT_NAMES[part + 1]
        for pair, kinds in enumerate(LIMBS.values()):
            if without_side(name) in kinds and {start, end} <= set(sure):
                own, other = (labels.part_groups[PART_NAMES.index(each) + 1] for each in (name, mirror_name(name)))
                half, further = map(float, limb_extent(name))
                limbs.append(book.Limb(np.array([sure[start], sure[end]]), half, further, int(own), int(other), pair))
    theirs = [bone for other in others for bone in _bones(other)]
    return book.KeypointBody(
        height=person_height(keypoints),
        bones=np.array(_bones(keypoints)).reshape(-1, 2, 2),
        loose=np.array(_loose(keypoints)).reshape(-1, 2, 2),
        theirs=np.array(theirs).reshape(-1, 2, 2),
        flesh=flesh,
        limbs=limbs,
        points=np.array([*sure.values()]),
    )


def _sure(keypoints: Keypoints2D) -> list[int]:
    return np.flatnonzero(keypoints.confident).tolist()


def _bones(keypoints: Keypoints2D) -> list[np.ndarray]:
    sure, points = _sure(keypoints), keypoints.points.astype(float)
    edges = [edge for edge in keypoints.format.edges if edge[0] in sure and edge[1] in sure]
    alone = [joint for joint in sure if not any(joint in edge for edge in edges)]
    return [points[list(edge)] for edge in edges] + [points[[joint, joint]] for joint in alone]


def _loose(keypoints: Keypoints2D) -> list[np.ndarray]:
    """Confident joints whose next joint, an elbow, wrist, knee or ankle, is not."""
    sure, names, found = _sure(keypoints), keypoints.format.landmarks, set()
    for edge in keypoints.format.edges:
        for joint, following in (edge, edge[::-1]):
            ends = names[following].partition("_")[2] or names[following]
            if joint in sure and following not in sure and ends in ("elbow", "wrist", "knee", "ankle"):
                found.add(joint)
    return [keypoints.points[[joint, joint]].astype(float) for joint in sorted(found)]


def twin(
    person: PicturePerson, size: int = 128, window: tuple[float, float, float, tuple[int, int]] | None = None
) -> Twin | None:
    """The person by the formula book, in a window of the picture (left, top, zoom, size); None without own labels.

    Of exchanged sides, the keypoints' are believed.
    """
    if isinstance(person.pixels, Mask):
        owners, labels = person.pixels.owners.cpu().numpy(), MASK_LABELS
        picture = np.select([owners == person.pixels.number, owners == 0], [1, BACKGROUND], IGNORE).astype(np.uint8)
    else:
        assert person.pixels is not None
        picture, labels = person.pixels.groups, person.pixels.label_set
    left, top, zoom, shape = window or (0.0, 0.0, 1.0, picture.shape)

    def inside(keypoints: Keypoints2D) -> Keypoints2D:
        places = (keypoints.points.astype(float) - [left, top]) * zoom
        places[~keypoints.visible] = 0
        return Keypoints2D(keypoints.skeleton, places.astype(np.float32), keypoints.confidence)

    source = np.pad(picture, 1, constant_values=IGNORE)
    rows, columns = (
        np.floor(start + (np.arange(count) + 0.5) / zoom).astype(int) + 1
        for start, count in ((top, shape[0]), (left, shape[1]))
    )
    keypoints = inside(person.keypoints)
    body = seen_body(keypoints, labels, [*map(inside, person.others)])
    groups, along = book.own_pixels(source[np.ix_(rows, columns)], body)
    if not along:
        return None
    stray = book.stray_groups(groups, body)
    groups = book.without_stray(groups, body, stray)
    warnings, names = [], labels.group_names
    if stray:
        warnings.append("also far from any such bone")
    if len(stray) >= 3 or book.disagreement(groups, body) > 1:
        warnings.append(f"are these ids of {labels.name}?")
    counts = book.side_counts(groups, body)
    exchanged = book.exchanged(counts)
    if exchanged.any():
        every = exchanged.sum() == counts.any(axis=1).sum()
        kinds = {kind for limb, swapped in zip(LIMBS.values(), exchanged, strict=True) if swapped for kind in limb}
        table = np.arange(256, dtype=np.uint8)
        for number, (name, parts) in enumerate(labels.groups.items(), start=1):
            if mirror_name(name) in names and (every or {without_side(part) for part in parts} <= kinds):
                table[number] = names.index(mirror_name(name)) + 1
        groups = table[groups]
        warnings.append("exchanged, say the keypoints")
    middle, half = book.crop_square(groups, body)
    start, side = np.array([left, top]) + (middle - half) / zoom, 2 * half / zoom
    box = np.concatenate([start, start + side])
    drawn = book.without_missing_limbs(groups, body)
    shown = book.draw_target(picture, drawn, (left, top, zoom), box, (size, size))
    points = (keypoints.points[keypoints.visible].astype(float) - middle) / half
    return Twin(groups, tuple(warnings), shown, points)


def assert_twin(cut: CutPerson, person: PicturePerson, size: int = 128) -> None:
    """A person cut out at so many pixels a side is what the formula book says."""
    window = cut.evidence.window
    expected = twin(person, size, (window.left, window.top, window.zoom, window.size))
    assert expected is not None
    labels = cut.observation.labels
    assert labels is not None
    np.testing.assert_array_equal(labels.cpu().numpy(), expected.labels)
    np.testing.assert_allclose(cut.observation.points.cpu().numpy(), expected.points, atol=1e-5)
    told = [text for text in cut.evidence.warnings if text.startswith("labels:")]
    assert len(told) == len(expected.warnings)
    assert all(said in text for text, said in zip(told, expected.warnings, strict=True))


def assert_cut_as_alone(
    cut: CutPerson, alone: Evidence, camera: Perspective | None, device: str = "cpu", size: int = LABEL_SIZE
) -> None:
    """Each part of a cut is, to the bit, what ``crop_evidence`` makes of the person's own evidence."""
    evidence, observation = cut.evidence, cut.observation
    seen, expected_crop = crop_evidence(alone, camera=camera, label_size=size)
    assert cut.crop == expected_crop
    assert (evidence.keypoints, evidence.window) == (alone.keypoints, alone.window)
    assert evidence.warnings == alone.warnings
    assert (observation.landmarks, observation.marks) == (seen.landmarks, seen.marks)
    assert observation.label_set == seen.label_set
    for name in ("points", "confidence", "labels", "lens", "maps", "known"):
        ours, theirs = getattr(observation, name), getattr(seen, name)
        assert (ours is None) == (theirs is None), name
        if ours is not None:
            assert ours.device.type == device
            torch.testing.assert_close(ours.cpu(), theirs, rtol=0, atol=0, msg=name)
