"""Categories of COCO's annotations. They say whose keypoints are annotated, and in which order."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from ..body.keypoint_names import animal_name, left_out_warning, skeleton_of_names
from ..body.skeletons import Skeleton
from ..errors import InputError, shown

# Keys of lists of keypoint names.
NAME_KEYS = (
    *("keypoint_names", "keypoints_names", "keypoint_name", "keypoints_name", "joint_names", "joints_names"),
    *("joints_name", "joint_name", "landmark_names", "bodyparts", "kpt_names", "kpts_names", "keypoint_labels"),
    *("keypoints_labels", "body_parts", "body_part_names", "marker_names", "point_names", "keypoint_id2name"),
)
_PEOPLE = {"person", "persons", "people", "human", "humans", "pedestrian", "man", "woman", "child", "player"}
# Last words of the names of AP-10K's, Animal Pose's and COCO's animals, and others that are annotated.
_ANIMALS = set(
    "animal animals quadruped mammal primate canine feline equine bovine "
    "alouatta antelope ape bat bear beaver bee bird bison boar bobcat buffalo bug bull camel cat cats "
    "cattle cheetah chicken chimp chimpanzee cow cows crab deer dog dogs dolphin donkey duck elephant fish fly fox "
    "frog giraffe goat goose gorilla hamster hare hippo hippopotamus horse horses insect jaguar kangaroo koala lamb "
    "leopard lion lizard lynx macaque marmot meerkat mice monkey moose mouse mule orangutan otter owl ox panda panther "
    "pig pigeon pony pup puma puppy rabbit raccoon rat reindeer rhino rhinoceros rodent seal sheep skunk sloth snake "
    "spider squirrel swan tiger turtle uakari weasel whale wolf yak zebra".split()
)


@dataclass(frozen=True)
class KeypointCategory:
    """Category of a file.

    Attributes:
        name: Name in the file.
        skeleton: Skeleton of its keypoint names; None if the file gives it none, or only numbers.
        warning: Sentence about names that are no landmarks and were left out; None if there are none.
        refusal: Sentence about why its annotations can't be read as those of people; None if they can.
        animals: True for animals; their annotations can't be read as people, not even with ``--format``.
    """

    name: str
    skeleton: Skeleton | None = None
    warning: str | None = None
    refusal: str | None = None
    animals: bool = False


def read_categories(given: Any, where: str) -> dict[int | str, KeypointCategory]:
    """Read COCO's list ``categories``.

    The caller leaves out annotations of a category with a ``refusal``, and warns with that sentence. Annotations of a
    category with a ``skeleton`` are read with it, whatever their number of points.

    Args:
        given: List such as ``[{"id": 1, "name": "person", "keypoints": ["nose", ...]}]``; None if there is none.
        where: Beginning of messages, such as the file's name.

    Returns:
        The categories by their ``id``.

    Raises:
        InputError: If it is no list of objects with an ``id`` each, or a category of people has faulty names.
    """
    if given is None:
        return {}
    if not isinstance(given, list):
        raise InputError(f"{where}: categories: {type(given).__name__}; expected a list")
    categories: dict[int | str, KeypointCategory] = {}
    for entry in given:
        if not isinstance(entry, Mapping) or number_of(entry.get("id")) is None:
            raise InputError(f"{where}: categories: {shown(entry)}; expected objects with id and name")
        categories[entry["id"]] = _category(entry, where)
    if any(category.skeleton is not None and _is_people(category.name) for category in categories.values()):
        for number, category in categories.items():
            if category.skeleton is None and category.refusal is None and not _is_people(category.name):
                refusal = f"{where}: category {shown(category.name)} has no keypoint names; expected people"
                categories[number] = KeypointCategory(category.name, refusal=refusal)
    return categories


def number_of(given: Any) -> int | str | None:
    """Id in the form in which ids are compared: 17, 17.0, "17" and "000017" are the same; None if it is no id."""
    if isinstance(given, str):
        text = given.strip()
        return int(text) if text.isdecimal() and len(text) < 20 else text
    if isinstance(given, bool) or not isinstance(given, int | float) or not math.isfinite(given) or given % 1:
        return None
    return int(given)


def common_category(categories: Collection[KeypointCategory]) -> KeypointCategory | None:
    """Category for annotations that name none; None if the file has no category that could be meant.

    It is the file's only category, or any category of people if all have the same skeleton. If their skeletons differ,
    it is a category without a skeleton, with a warning.
    """
    if len(categories) == 1:
        return next(iter(categories))
    named = [each for each in categories if each.refusal is None and each.skeleton is not None]
    if not named:
        return None
    if all(each.skeleton == named[0].skeleton for each in named):
        return named[0]
    listed = ", ".join(shown(each.name) for each in named)
    return KeypointCategory(
        "unknown",
        warning=f"keypoints: of none of the categories {listed}, whose orders differ; their number tells the order",
    )


def listed_names(names: Any, where: str) -> tuple[Any, ...]:
    """Names of keypoints in the order of their rows.

    Args:
        names: List of names, list of objects with a "name", or table from numbers to names or from names to numbers.
        where: Beginning of messages.

    Raises:
        InputError: If it is none of these.
    """
    if isinstance(names, list):
        return tuple(name.get("name") if isinstance(name, Mapping) else name for name in names)
    if isinstance(names, Mapping):
        numbered = names if all(str(key).isdecimal() for key in names) else {str(n): name for name, n in names.items()}
        if all(str(key).isdecimal() for key in numbered):
            return listed_names([numbered[key] for key in sorted(numbered, key=int)], where)
    raise InputError(f"{where}: keypoint names: {shown(names)}; expected a list of names")


def _category(entry: Mapping[str, Any], where: str) -> KeypointCategory:
    name = str(entry.get("name", entry["id"]))
    subject = f"{where}: category {shown(name)}"
    both = name, str(entry.get("supercategory", ""))
    if any(words and words[-1] in _ANIMALS for words in map(_words, both)) and not _is_people(name):
        return KeypointCategory(name, refusal=f"{subject}; expected keypoints of people, not of animals", animals=True)
    given = next((entry[key] for key in ("keypoints", *NAME_KEYS) if entry.get(key)), None)
    if given is None:
        return KeypointCategory(name)
    if not isinstance(given, list | Mapping):
        raise InputError(f"{subject}: keypoints: {type(given).__name__}; expected a list of names")
    names = listed_names(given, subject)
    try:
        form = skeleton_of_names(names, subject)
    except InputError as error:
        return KeypointCategory(name, refusal=str(error), animals=animal_name(names) is not None)
    return KeypointCategory(name, form, None if form is None else left_out_warning(names, form))


def _is_people(name: str) -> bool:
    return not _PEOPLE.isdisjoint(_words(name))


def _words(name: str) -> list[str]:
    return re.findall(r"[a-z]+", name.lower())
