"""Names of keypoints, as data sets, annotation tools and networks spell them, and the landmarks that they mean.

``skeleton_of_names`` makes a skeleton of a file's own list of names: "left_shoulder", "Right Shoulder", "RShoulder",
"shoulder.l", "head_top" and "Top of head" are all understood. So the order of a file does not matter: two files with
the same points in another order give the same skeleton, but for ``places``.

Some words mean another point in another data set. These rules hold:

* "neck", "thorax", "head_bottom" (PoseTrack) and "lower neck" are the point between the shoulders; "upper neck" (MPII,
  OpenPose's BODY_25B) is the base of the skull, the landmark "head". Where "thorax" is named, "neck" is left out.
* "head" is the crown (CrowdPose, Halpe), but the base of the skull in lists of SMPL's joints. Beside a crown of its
  own, "head" is left out.
* "hip" without a side, "pelvis" and "root" are the middle of the hips.
* "hand" and "foot" are left out: some mean wrist and ankle by them, others the hand's middle and the toes.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

from ..errors import InputError, shown
from .landmarks import LANDMARKS, annotated, mirror_name, without_side
from .skeletons import SKELETONS, Skeleton, known_edges

_FEWEST = 2  # landmarks that tell anything
# Formats with the names of another one, in the same order: neither names nor numbers tell them.
TWINS = ("shelf14",)
_SURE = 8  # landmarks that make a person of a list of many other points, such as a face's and fingers'

# Words for landmarks without a side, written together.
_MIDDLE_WORDS: dict[str, tuple[str, ...]] = {
    "nose": ("nose", "nosetip", "tipnose"),
    "neck": ("neck", "thorax", "thrx", "headbottom", "bottomhead", "lowerneck", "necklower", "neckbase", "baseneck"),
    "head": ("upperneck", "neckupper", "skullbase", "baseskull"),
    "head_top": ("headtop", "tophead", "crown", "vertex", "headvertex"),
    "mid_hip": (
        *("midhip", "hipmid", "midhips", "middlehip", "middlehips", "pelvis", "pelv", "root", "hip", "hips"),
        *("hipcenter", "centerhip", "hipcentre", "centrehip", "pelviscenter", "pelviscentre", "midpelvis"),
    ),
    "spine": ("spine", "midspine", "spinemid"),
}
# The same of those with a side.
_SIDED_WORDS: dict[str, tuple[str, ...]] = {
    "eye_inner": ("eyeinner", "innereye"),
    "eye": ("eye", "eyecenter", "eyecentre"),
    "eye_outer": ("eyeouter", "outereye"),
    "ear": ("ear",),
    "mouth": ("mouth", "mouthcorner"),
    "shoulder": ("shoulder", "shldr", "sho", "shoulders"),
    "elbow": ("elbow", "elb", "elbows"),
    "wrist": ("wrist", "wri", "wrists"),
    "fingertip": ("fingertip",),
    "thumb": ("thumb",),
    "index": ("index",),
    "pinky": ("pinky",),
    "hip": ("hip", "hips"),
    "knee": ("knee", "kne", "knees"),
    "ankle": ("ankle", "ank", "ankles"),
    "toe": ("toe", "toes"),
    "foot_index": ("footindex",),
    "big_toe": ("bigtoe", "toebig", "greattoe", "hallux"),
    "small_toe": ("smalltoe", "toesmall", "littletoe", "toelittle", "pinkytoe", "babytoe"),
    "heel": ("heel", "heels"),
}
_MIDDLE_OF_WORD = {word: name for name, words in _MIDDLE_WORDS.items() for word in words}
_SIDED_OF_WORD = {word: name for name, words in _SIDED_WORDS.items() for word in words}
_SIDES = {word: side for side in ("left", "right") for word in (side, side[0], f"{side[0]}t")}
# Landmarks whose numbers tell other points: of fingers, of the spine, and of a face's outlines.
_COUNTED = ("thumb", "index", "pinky", "fingertip", "toe", "spine", "eye", "ear", "mouth", "neck", "head")
# Words that add nothing.
_FILLERS = {"joint", "point", "keypoint", "kpt", "kp", "landmark", "of", "the", "body", "human", "person", "coco", "op"}
_PEOPLE = {"p", "person", "people", "human", "subject", "player", "id"}  # before the number of one of several people
_NUMBERED = {*_FILLERS, "new", "p", "pt", "label", "class", "id", "node", "joints", "points", "keypoints"}
# Points that no person has.
_OF_ANIMALS = {
    *("paw", "paws", "tail", "tailbase", "withers", "hoof", "hooves", "beak", "wing", "snout", "muzzle", "fetlock"),
    *("hock", "antler", "horn", "fin", "claw", "mane", "stifle", "forepaw", "hindpaw", "earbase", "foreleg", "hindleg"),
}
_OF_SMPL = {"spine3", "leftcollar"}

# Whole lists of names of which some mean another point than elsewhere, in the order of the format: Human3.6M's.
_HUMAN36M_LIMBS = ("left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist")
_HUMAN36M_LEGS = ("right_hip", "right_knee", "right_foot", "left_hip", "left_knee", "left_foot")
_HUMAN36M_LISTS = (
    ("root", *_HUMAN36M_LEGS, "spine", "thorax", "neck_base", "head", *_HUMAN36M_LIMBS),
    ("hip", *_HUMAN36M_LEGS, "spine", "thorax", "neck_nose", "head", *_HUMAN36M_LIMBS),
)
# COCO-WholeBody's names of the points of face and hands that are landmarks, and BlazePose's of its knuckles.
_FACE_AND_HAND_NAMES: dict[str, str] = {
    "face36": "right_eye_outer",
    "face39": "right_eye_inner",
    "face42": "left_eye_inner",
    "face45": "left_eye_outer",
    "face48": "mouth_right",
    "face54": "mouth_left",
    **{f"{side}thumb{number}": f"{side}_thumb" for side in ("left", "right") for number in (2, 3)},
    **{f"{side}{word}1": f"{side}_index" for side in ("left", "right") for word in ("forefinger", "index")},
    **{f"{side}{word}1": f"{side}_pinky" for side in ("left", "right") for word in ("pinkyfinger", "pinky")},
}


def skeleton_of_names(names: Sequence[Any], where: str) -> Skeleton | None:
    """Make a skeleton of a file's list of keypoint names, in whatever order and spelling.

    Names that are no landmark are left out: ``left_out(names, skeleton)`` lists them, for a message. ``places`` of the
    skeleton are rows of this list, so a file's rows are taken by them; a landmark whose mirror image alone is named has
    the place -1, and its keypoint is missing. Such rows are read by ``inputs.keypoint_files.parse_keypoints(data,
    skeleton)``. If the landmarks are those of a known format, in any order, the skeleton has that format's name,
    landmarks and marks, in the format's own order. Otherwise it is called "named", and its marks are COCO's.

    Args:
        names: One name a row, such as COCO's ``categories[].keypoints``.
        where: Beginning of the messages, such as "FILE: categories: person".

    Returns:
        The skeleton; None if the names are numbers alone, such as "kp_3", and tell nothing.

    Raises:
        InputError: If a name is no text, or too few of them are landmarks of a person, as of an animal.
    """
    for row, name in enumerate(names):
        if not isinstance(name, str):
            raise InputError(f"{where}: keypoint name {row}: {shown(name)}; expected text")
    if all(word.isdigit() or word in _NUMBERED for name in names for word in _words(name)):
        return None
    rows = _rows(names)
    animal = animal_name(names)
    if animal is not None:
        raise InputError(f"{where}: keypoint {shown(animal)}; expected keypoints of people, not of animals")
    if len(rows) < _FEWEST or (2 * len(rows) < len(names) and len(rows) < _SURE):
        fault = f"{len(rows)} of {len(names)} keypoint names are landmarks of a person"
        raise InputError(f"{where}: {fault} ({_some(names)}); expected names such as left_shoulder")
    form = _known_format(rows)
    if form is None:
        rows |= {mirror_name(name): -1 for name in rows if mirror_name(name) not in rows}
        landmarks = tuple(name for name in LANDMARKS if name in rows)
        form = Skeleton("named", landmarks, annotated(landmarks), known_edges(landmarks), (), 0)
    places = tuple(rows[name] for name in form.landmarks)
    if places == form.places and form.count == len(names):
        return form
    return Skeleton(form.name, form.landmarks, form.marks, form.edges, places, len(names))


def animal_name(names: Sequence[Any]) -> str | None:
    """First name of a list that no person has, such as "left_front_paw"; None if there is none."""
    texts = (name for name in names if isinstance(name, str))
    return next((name for name in texts if _OF_ANIMALS & {*_words(name), "".join(_words(name))}), None)


def left_out(names: Sequence[str], form: Skeleton) -> list[str]:
    """Names of a list that a skeleton of it left out, in the list's order."""
    return [name for row, name in enumerate(names) if row not in form.places]


def left_out_warning(names: Sequence[str], form: Skeleton) -> str | None:
    """Sentence about the names that were left out; None if all are landmarks."""
    others = left_out(names, form)
    if not others:
        return None
    return f"keypoints: {_some(others)} left out; expected names of landmarks of the body"


def landmark_of_name(name: str, names: Iterable[str] = ()) -> str | None:
    """Landmark that a name means among others of its list, such as "left_ankle" of "LAnkle"; None if it is none.

    A number behind a name is left out, "left_knee_12", where it numbers the list or does not tell another point.
    """
    words = _words(name)
    others = [_words(other) for other in names]
    landmark = _landmark_of_words(words, others)
    if landmark is not None or len(words) < 2 or not words[-1].isdigit():
        return landmark
    unnumbered = [other[:-1] if other and other[-1].isdigit() else other for other in others]
    landmark = _landmark_of_words(words[:-1], unnumbered)
    every = len(others) > 1 and all(other and other[-1].isdigit() for other in others)
    numbered = every and len({tuple(other) for other in unnumbered}) == len(others)
    return landmark if landmark is not None and (numbered or without_side(landmark) not in _COUNTED) else None


def _landmark_of_words(words: list[str], others: list[list[str]]) -> str | None:
    """Landmark that a name's words mean beside the other names of a list, or None if they mean none."""
    together = "".join(words)
    plain = "_".join(words)
    if plain in LANDMARKS and plain not in ("pelvis", "head"):
        return plain
    if together in _FACE_AND_HAND_NAMES:
        return _FACE_AND_HAND_NAMES[together]
    sides = [_SIDES[word] for word in words if word in _SIDES]
    rest = "".join(word for word in words if word not in _SIDES)
    if not sides and together in _MIDDLE_OF_WORD:
        return _MIDDLE_OF_WORD[together]
    if len(sides) == 1 and rest in _SIDED_OF_WORD:
        return _sided(_SIDED_OF_WORD[rest], sides[0])
    return None if sides else _glued(together, {"".join(other) for other in others})


def _glued(together: str, others: set[str]) -> str | None:
    """Landmark of a name without a gap: "leftankle", or "lankle" if its list has "rankle", too."""
    for side, opposite in (("left", "right"), ("right", "left"), ("l", "r"), ("r", "l")):
        for rest, mirrored in (
            (together.removeprefix(side), opposite + together.removeprefix(side)),
            (together.removesuffix(side), together.removesuffix(side) + opposite),
        ):
            if rest != together and rest in _SIDED_OF_WORD and (len(side) > 1 or mirrored in others):
                return _sided(_SIDED_OF_WORD[rest], _SIDES[side])
    return None


def _sided(name: str, side: str) -> str:
    return f"{name}_{side}" if f"{name}_{side}" in LANDMARKS else f"{side}_{name}"


def _words(name: str) -> list[str]:
    """Words of a name in lower case, without fillers and what counts points or people before them.

    "03_RBigToe" is r, big, toe, and "p1_left_hip" is left, hip.
    """
    found = re.findall(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|[0-9]+|[^\W_0-9A-Za-z]+", name)
    words = [word.lower() for word in found]
    while words and (words[0].isdigit() or (words[0] in _PEOPLE and words[1:] and words[1].isdigit())):
        words = words[1:]
    return [word for word in words if word not in _FILLERS]


def _plain(name: str) -> str:
    """A name's words joined by underscores, its side first: "Foot.L" is left_foot."""
    words = _words(name)
    sides = [_SIDES[word] for word in words if word in _SIDES]
    return "_".join([*sides, *(word for word in words if word not in _SIDES)])


def _rows(names: Sequence[str]) -> dict[str, int]:
    """Row of each landmark in a list of names."""
    plain = [_plain(name) for name in names]
    for listed in _HUMAN36M_LISTS:
        if set(plain) == set(listed):
            landmarks = SKELETONS["h36m17"].landmarks
            return {landmark: plain.index(name) for landmark, name in zip(landmarks, listed, strict=True)}
    if any("head" in form.landmarks and set(plain) == set(form.landmarks) for form in SKELETONS.values()):
        return {word: row for row, word in enumerate(plain)}
    meant = [landmark_of_name(name, names) for name in names]
    together = [word.replace("_", "") for word in plain]
    if "head" in together and "head_top" not in meant:
        meant[together.index("head")] = "head" if _OF_SMPL & set(together) else "head_top"
    if "neck" in together and {"thorax", "thrx"} & set(together):
        meant[together.index("neck")] = None
    rows: dict[str, int] = {}
    for row, landmark in enumerate(meant):
        if landmark is not None and (landmark not in rows or plain[row] == landmark):
            rows[landmark] = row
    return rows


def _known_format(rows: dict[str, int]) -> Skeleton | None:
    """Format with the same landmarks: of several, the one in this order, or else one that annotators marked."""
    order = tuple(sorted(rows, key=rows.__getitem__))
    alike = [form for form in SKELETONS.values() if set(form.landmarks) == set(rows) and form.name not in TWINS]
    return min(alike, key=lambda form: (form.landmarks != order, form.marks == form.landmarks), default=None)


def _some(names: Sequence[str]) -> str:
    """A few names for a message."""
    few = ", ".join(shown(name)[1:-1] for name in names[:4])
    return few if len(names) <= 4 else f"{few} and {len(names) - 4} more"
