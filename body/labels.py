"""Label sets: groups of the 20 ellipsoids for the label ids of a data set or network.

A ``LabelSet`` has groups 1 to G, each a union of ellipsoids, and maps every source id (the numbers in a data set's or a
network's label images) to one of the groups, background, or ignore. There are three kinds of image:

* **source ids**: what the user brings, such as 14 for LIP's "Left-arm";
* **group ids**: uint8, 0 = background, 1 to G = groups, 255 = ignore, which neither attracts nor repels;
* **part labels**: what the body renders: uint8, 0 = background, k = ellipsoid ``PART_NAMES[k - 1]``.

Three rules:

* Source id 255 is ignored, as in most data sets, unless the set gives it a meaning.
* A group without source ids is no pixel's target, but is wrong on background: the torso under LIP's clothes.
* An ellipsoid that is in no group costs nothing where it shows, and hides what is behind: ``part_groups`` maps it to
  255. One that is left out (hands and feet, where nobody labelled any) isn't drawn at all and costs no time: 0. The
  sets that come with the project have every part in a group.

The sets that come with the project are in ``label_sets.json``, in the form that users write them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, check_whole, shown
from ..files.json_files import read_json
from .template import NUM_PARTS, PART_NAMES

BACKGROUND = 0
IGNORE = 255
MAX_SOURCE_ID = 65535  # What a 16-bit PNG can hold.
_NO_GROUP = 254  # each of at most 20 groups has a part of its own


@dataclass(frozen=True)
class LabelSet:
    """Grouping of the 20 ellipsoids, and the source ids of its groups.

    Attributes:
        name: Name of the set, such as "cdcl14".
        groups: Group name -> its ellipsoids, in the order of the group ids 1 to G.
        ids: Source id -> group name, "background" or "ignore".
        class_names: Source id -> the data set's own name of the class, where it differs from the group's.
        left_out: Ellipsoids that are not drawn.
        of: Data set or network of the ids, with its version where there are several.
        at_joints: Neck, arms and legs begin at their joints; else where a detailed model's skin follows them.

    Raises:
        ValueError: If a part is unknown, in two groups, or in one and left out, a group is empty, an id has no such
            group or is out of range, or no id is background.
    """

    name: str
    groups: Mapping[str, tuple[str, ...]]
    ids: Mapping[int, str]
    class_names: Mapping[int, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    of: str = ""
    at_joints: bool = False

    def __post_init__(self) -> None:
        if not self.groups:
            raise ValueError(f"{self.name}: groups: none; expected at least one")
        owner: dict[str, str] = {}
        for group, parts in (("left_out", self.left_out), *self.groups.items()):
            where = f"{self.name}: {group}" if group == "left_out" else f"{self.name}: group {group!r}"
            if group in ("background", "ignore"):
                raise ValueError(f"{self.name}: groups: {group!r}; expected a name other than background and ignore")
            if not parts and group != "left_out":
                raise ValueError(f"{where} has no parts; expected some of {', '.join(PART_NAMES)}")
            for part in parts:
                if part not in PART_NAMES:
                    raise ValueError(f"{where}: no part {part!r}; expected {', '.join(PART_NAMES)}")
                if part in owner:
                    raise ValueError(f"{self.name}: {part} is in {owner[part]!r} and {group!r}; expected one group")
                owner[part] = group
        for source, group in self.ids.items():
            check_whole(f"{self.name}: id", source, 0, MAX_SOURCE_ID)
            if group not in self.groups and group not in ("background", "ignore"):
                expected = ", ".join([*self.groups, "background", "ignore"])
                raise ValueError(f"{self.name}: id {source} is {group!r}; expected one of {expected}")
        if "background" not in self.ids.values():
            raise ValueError(f"{self.name}: ids: none is background; expected one at least")

    @property
    def group_names(self) -> tuple[str, ...]:
        """Names of the groups 1 to G."""
        return tuple(self.groups)

    @property
    def num_groups(self) -> int:
        """Number of groups, G."""
        return len(self.groups)

    @cached_property
    def part_groups(self) -> np.ndarray:
        """Group id of each part label 0 to 20, shape (21,), uint8; 255 for a part in no group, 0 for one left out."""
        table = np.full(NUM_PARTS + 1, IGNORE, dtype=np.uint8)
        table[0] = BACKGROUND
        for group, parts in enumerate(self.groups.values(), start=1):
            table[[PART_NAMES.index(part) + 1 for part in parts]] = group
        table[[PART_NAMES.index(part) + 1 for part in self.left_out]] = BACKGROUND
        return table

    @cached_property
    def id_groups(self) -> np.ndarray:
        """Group id of each source id 0 to 65535, shape (65536,), int16; -1 for an id that the set does not have."""
        table = np.full(MAX_SOURCE_ID + 1, -1, dtype=np.int16)
        table[IGNORE] = IGNORE
        for source, group in self.ids.items():
            table[source] = self._group_id(group)
        return table

    @cached_property
    def _byte_groups(self) -> bytes:
        """Groups of the ids 0 to 255, as a table; ``_NO_GROUP`` of those that the set does not have."""
        groups = self.id_groups[:256]
        return np.where(groups < 0, _NO_GROUP, groups).astype(np.uint8).tobytes()

    @cached_property
    def _num_own_ids(self) -> int:
        """Number of ids from 0 on that are the groups themselves, if all but 255 are such; else 0."""
        known = np.flatnonzero(self.id_groups >= 0)
        own = self.id_groups[known] == known
        return len(known) - 1 if own.all() and known[-2] == len(known) - 2 and known[-1] == IGNORE else 0

    def _group_id(self, group: str) -> int:
        if group == "background":
            return BACKGROUND
        return IGNORE if group == "ignore" else self.group_names.index(group) + 1

    def to_groups(self, image: np.ndarray) -> np.ndarray:
        """Group ids of an image of source ids, integers or booleans of any shape: uint8 of the same shape.

        Raises:
            ValueError: If ``image`` is not of integers, or holds ids that the set does not have.
        """
        image = np.asarray(image)
        if image.dtype.kind not in "iub":
            raise ValueError(f"labels: {image.dtype}; expected integers")
        image = image.astype(np.uint8) if image.dtype.kind == "b" else image
        if image.dtype == np.uint8:
            # In bytes 255 + 1 is 0: one look tells that there are no others.
            if image.size and self._num_own_ids and (image + np.uint8(1)).max() <= self._num_own_ids:
                return image.copy()
            # Bytes are translated, and looked through, in a tenth of the time of an index.
            found = bytearray(np.ascontiguousarray(image)).translate(self._byte_groups)
            if _NO_GROUP not in found:
                return np.frombuffer(found, dtype=np.uint8).reshape(image.shape)
        inside = (image >= 0) & (image <= MAX_SOURCE_ID)
        groups = self.id_groups[np.where(inside, image, 0)]
        unknown = np.unique(image[~inside | (groups < 0)])
        if unknown.size:
            strange = _ranges(int(value) for value in unknown)
            raise ValueError(f"labels: ids {strange} not in {self.name}; expected {_ranges(self.ids)} (255 = ignore)")
        return groups.astype(np.uint8)

    def to_ids(self, groups: np.ndarray) -> np.ndarray:
        """Source ids of an image of group ids, uint16: the group's first; an ignored id for 255 and groups without ids.

        Raises:
            ValueError: If ``groups`` holds what the set has no id for, such as 255 in a set where 255 is somebody.
        """
        table = np.full(256, -1, dtype=np.int32)
        ignored = [IGNORE] if IGNORE not in self.ids else [k for k, group in self.ids.items() if group == "ignore"]
        if ignored:
            table[[IGNORE, *range(1, self.num_groups + 1)]] = ignored[0]
        for source in sorted(self.ids, reverse=True):  # So that the lowest id wins.
            if self.ids[source] != "ignore":
                table[self._group_id(self.ids[source])] = source
        ids = table[np.asarray(groups, dtype=np.uint8)]
        if ids.size and ids.min() < 0:
            unknown = _ranges(int(group) for group in np.unique(np.asarray(groups)[ids < 0]))
            raise ValueError(f"groups: {self.name} has no id for group ids {unknown}")
        return ids.astype(np.uint16)

    def from_parts(self, parts: np.ndarray) -> np.ndarray:
        """Group ids of a rendered image of part labels (0 to 20, 255 = ignore), uint8 of the same shape."""
        table = np.full(256, IGNORE, dtype=np.uint8)
        table[: NUM_PARTS + 1] = self.part_groups
        return table[np.asarray(parts, dtype=np.uint8)]

    def to_group_maps(self, probabilities: np.ndarray) -> np.ndarray:
        """Sum the maps of ``channel_ids``, (K, H, W), into those of background and groups, (G + 1, H, W), float32.

        What is missing to a sum of 1 is ignored.

        Raises:
            ValueError: If K is not the number of the set's ids.
        """
        sources = self.channel_ids
        if probabilities.shape[0] != len(sources):
            raise ValueError(f"labels: {len(probabilities)} probability maps; expected {len(sources)} for {self.name}")
        maps = np.zeros((self.num_groups + 1, *probabilities.shape[1:]), dtype=np.float32)
        for source, channel in zip(sources, probabilities, strict=True):
            if (group := self.id_groups[source]) != IGNORE:
                maps[group] += channel
        return maps

    @property
    def channel_ids(self) -> tuple[int, ...]:
        """Source id of each channel of a network's probability maps: all ids but 255, ascending."""
        return tuple(sorted(source for source in self.ids if source != IGNORE))


def _ranges(values: Iterable[int]) -> str:
    """1, 2, 3, 7 as "1 to 3, 7"; at most a few."""
    runs: list[list[int]] = []
    for value in sorted(set(values)):
        if runs and value == runs[-1][1] + 1:
            runs[-1][1] = value
        else:
            runs.append([value, value])
    shown = [str(low) if low == high else f"{low} to {high}" for low, high in runs[:6]]
    return ", ".join(shown) + (", ..." if len(runs) > 6 else "")


def label_set(source: str | Path | Mapping[str, Any] | LabelSet) -> LabelSet:
    """Read a label set by name, from a JSON file, or from its content.

    A file of one's own::

        {
            "name": "mine",
            "groups": {"head": ["head", "neck"], "left_arm": ["left_upper_arm", "left_forearm", "left_hand"]},
            "ids": {"0": "background", "1": "head", "2": "left_arm", "7": "ignore"}
        }

    ``groups`` names the parts (``PART_NAMES``) that each group unites; ``ids`` gives for every number that may occur in
    the label images which group it is; several numbers may be one group. ``name`` may be missing. A list ``left_out``
    names parts that are not drawn, such as hands and feet that nobody labelled; ``"at_joints": true`` is as of
    ``LabelSet``. Ids with the class names of a known
    set, ``{"0": "Background", "1": "Hat", ...}``, mean that set.

    Raises:
        InputError: If there is no such set or file, or its content does not fit.

    Examples:
        >>> from warp_partdr import label_set
        >>> labels = label_set("lsp6")
        >>> labels.ids[1], labels.groups["left_leg"]
        ('left_arm', ('left_upper_leg', 'left_lower_leg', 'left_foot'))
        >>> mine = label_set({"groups": {"arm": ["left_forearm", "left_hand"]}, "ids": {"0": "background", "1": "arm"}})
        >>> mine.ids
        {0: 'background', 1: 'arm'}
    """
    if isinstance(source, LabelSet):
        return source
    if isinstance(source, Mapping):
        return _from_json(source, "labels")
    if str(source) in LABEL_SETS:
        return LABEL_SETS[str(source)]
    path = Path(source)
    if path.suffix != ".json" and not path.is_file():
        raise InputError(f"labels: {str(source)!r}; expected one of {', '.join(LABEL_SETS)}, or a JSON file")
    data = read_json(path, "a label set in JSON")
    if not isinstance(data, Mapping):
        raise InputError(f"{path}: {type(data).__name__}; expected an object with groups and ids")
    return _from_json(data, str(path))


def _from_json(data: Mapping[str, Any], where: str) -> LabelSet:
    """Check types; ``LabelSet`` checks the meaning."""
    if (names := _class_names(data)) is not None:
        if len(known := label_sets_of(names)) == 1:
            return known[0]
        raise InputError(
            f"{where}: the ids and names of no known label set; expected those of {', '.join(LABEL_SETS)}, or groups "
            "and ids (docs/reference/inputs.md)"
        )
    try:
        groups, ids, left_out = data.get("groups"), data.get("ids"), data.get("left_out", ())
        at_joints = data.get("at_joints", False)
        if not isinstance(at_joints, bool):
            raise ValueError(f"at_joints: {shown(at_joints)}; expected true or false")
        if not isinstance(groups, Mapping) or not isinstance(ids, Mapping):
            raise ValueError('no "groups" and "ids"; expected {"groups": {name: [parts]}, "ids": {id: name}}')
        lists = {f"group {group!r}": parts for group, parts in groups.items()} | {"left_out": left_out}
        for name, parts in lists.items():
            if not isinstance(parts, list | tuple) or not all(isinstance(part, str) for part in parts):
                raise ValueError(f"{name}: {shown(parts)}; expected a list of part names")
        sources: dict[int, str] = {}
        for key, group in ids.items():
            source = int(key) if isinstance(key, str) and re.fullmatch("-?[0-9]{1,9}", key) else key
            source = check_whole("id", source, 0, MAX_SOURCE_ID)
            if source in sources:
                raise ValueError(f"id {source} twice; expected one group for it")
            sources[source] = str(group)
        return LabelSet(
            name=str(data.get("name", Path(where).stem)),
            groups={str(group): tuple(parts) for group, parts in groups.items()},
            ids=sources,
            left_out=tuple(left_out),
            at_joints=at_joints,
        )
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error


def _class_names(data: Mapping[str, Any]) -> dict[int, str] | None:
    """Class name of each id, if that is what was given; None if it is something else."""
    if not data or not all(isinstance(name, str) and str(key).isdecimal() for key, name in data.items()):
        return None
    return {int(key): name for key, name in data.items()}


def label_sets_of(names: Mapping[int, str]) -> list[LabelSet]:
    """Known label sets whose ids have these class names, whatever their case, blanks and punctuation."""

    def plain(given: Mapping[int, str]) -> dict[int, str]:
        return {source: re.sub("[^a-z0-9]", "", name.lower()) for source, name in given.items() if source != IGNORE}

    found = plain(names)
    return [
        labels
        for labels in LABEL_SETS.values()
        if found == plain({source: labels.class_names.get(source, group) for source, group in labels.ids.items()})
    ]


def regroup(source: LabelSet, target: LabelSet) -> np.ndarray:
    """Table from group ids of one set to those of a coarser one, shape (256,), uint8; 0 and 255 stay.

    The neck goes with its group: data sets count it to the head or to the torso, which must not keep, say, ``cdcl14``
    from becoming ``lsp6``. To compare a rendering with labels after such a step, take it through the same source set:
    ``regroup(source, target)[source.part_groups]`` is the table from part labels.

    Raises:
        ValueError: If a group of ``source`` is not within one group of ``target``.
    """
    table = np.full(256, IGNORE, dtype=np.uint8)
    table[BACKGROUND] = BACKGROUND
    for index, (name, parts) in enumerate(source.groups.items(), start=1):
        deciding = [part for part in parts if part != "neck"] or list(parts)
        found = {int(target.part_groups[PART_NAMES.index(part) + 1]) for part in deciding}
        if len(found) != 1:
            within = ", ".join("none" if g == IGNORE else target.group_names[g - 1] for g in sorted(found))
            raise ValueError(
                f"{source.name} to {target.name}: group {name!r} lies in {within}; expected one group of {target.name}"
            )
        table[index] = found.pop()
    return table


def _packaged() -> dict[str, LabelSet]:
    data = json.loads(resources.files(__package__).joinpath("label_sets.json").read_text(encoding="utf-8"))
    names = [{int(source): name for source, name in each.get("class_names", {}).items()} for each in data["sets"]]
    return {
        each["name"]: replace(_from_json(each, "label_sets.json"), class_names=classes, of=each["of"])
        for each, classes in zip(data["sets"], names, strict=True)
    }


LABEL_SETS = _packaged()
