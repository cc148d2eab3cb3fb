"""The label sets of common data sets and networks, as tables.

Ids are those of the data sets' own files. Left and right are the person's own: most sets say so or show it, CIHP and
Sapiens let it be read off their class names, ATR says nothing. Two rules hold in all tables:

* Clothes that may lie over several of a set's regions (a shirt over torso and arms, trousers over both legs) are
  ignored: a wrong pull is worse than none. The background around them still bounds the body.
* The shoulders' ellipsoids (the collar bones) are torso, and the neck is where the data set has it.
"""

from __future__ import annotations

from collections.abc import Mapping

from .labels import LabelSet
from .template import PART_NAMES

_TRUNK = ("left_hip", "right_hip", "abdomen", "chest", "left_shoulder", "right_shoulder")
_LIMBS = ("upper_arm", "forearm", "hand", "upper_leg", "lower_leg", "foot")


def _both(*parts: str) -> tuple[str, ...]:
    return tuple(f"{side}_{part}" for part in parts for side in ("left", "right"))


def _one_side(side: str, **groups: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    return {f"{side}_{group}": tuple(f"{side}_{part}" for part in parts) for group, parts in groups.items()}


# Head, torso and twelve limb parts, each on its own, with the neck on the head or on the torso.
_NECK_ON_HEAD = {"head": ("head", "neck"), "torso": _TRUNK}
_NECK_ON_TORSO = {"head": ("head",), "torso": (*_TRUNK, "neck")}
_LIMB_GROUPS = {limb: (limb,) for limb in _both(*_LIMBS)}


def _in_order(names: str, groups: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    return {name: groups[name] for name in names.split()}


def _label_set(name: str, of: str, groups: Mapping[str, tuple[str, ...]], classes: str) -> LabelSet:
    """From lines ``id class name = group``; without ``= group`` the class is called as its group."""
    ids: dict[int, str] = {}
    class_names: dict[int, str] = {}
    for line in filter(None, map(str.strip, classes.splitlines())):
        words, _, group = line.partition("=")
        number, _, class_name = words.strip().partition(" ")
        ids[int(number)] = group.strip() or class_name.strip()
        class_names[int(number)] = class_name.strip()
    return LabelSet(name, dict(groups), ids, class_names, of=of)


def _in_turn(classes: str) -> str:
    """The same lines with ids 0, 1, 2, ... before them."""
    return "\n".join(f"{number} {line.strip()}" for number, line in enumerate(classes.strip().splitlines()))


def _numbered(name: str, of: str, groups: Mapping[str, tuple[str, ...]]) -> LabelSet:
    """Ids are the group ids themselves."""
    return LabelSet(name, dict(groups), {0: "background", **dict(enumerate(groups, start=1))}, of=of)


# Sapiens (Goliath classes), in the order of their ids. A sock may be foot or lower leg.
_SAPIENS = """
    Background = background
    Apparel = ignore
    Face_Neck = head
    Hair = head
    Left_Foot = left_foot
    Left_Hand = left_hand
    Left_Lower_Arm = left_forearm
    Left_Lower_Leg = left_lower_leg
    Left_Shoe = left_foot
    Left_Sock = ignore
    Left_Upper_Arm = left_upper_arm
    Left_Upper_Leg = left_upper_leg
    Lower_Clothing = ignore
    Right_Foot = right_foot
    Right_Hand = right_hand
    Right_Lower_Arm = right_forearm
    Right_Lower_Leg = right_lower_leg
    Right_Shoe = right_foot
    Right_Sock = ignore
    Right_Upper_Arm = right_upper_arm
    Right_Upper_Leg = right_upper_leg
    Torso = torso
    Upper_Clothing = ignore
    Lower_Lip = head
    Upper_Lip = head
    Lower_Teeth = head
    Upper_Teeth = head
    Tongue = head
"""

_SETS = (
    # This project's own part labels.
    _numbered("ellipbody20", "this project", {part: (part,) for part in PART_NAMES}),
    # The paper's 14 parts of Human3.6M (section 4.1); it gives no order, this one is ours.
    _numbered("body14", "Human3.6M's parts in the paper", _NECK_ON_HEAD | _LIMB_GROUPS),
    # Silhouettes, also as pictures of 0 and 255.
    LabelSet("full1", {"person": PART_NAMES}, {0: "background", 1: "person", 255: "person"}, of="silhouettes"),
    # The six parts that UP-3D's LSP annotations are evaluated with, in the order of SPIN's evaluation.
    _numbered(
        "lsp6",
        "LSP's evaluation in UP-3D",
        {
            **_one_side("left", arm=("upper_arm", "forearm", "hand")),
            **_one_side("right", arm=("upper_arm", "forearm", "hand")),
            "head": ("head",),
            **_one_side("left", leg=("upper_leg", "lower_leg", "foot")),
            **_one_side("right", leg=("upper_leg", "lower_leg", "foot")),
            "torso": (*_TRUNK, "neck"),
        },
    ),
    # SURREAL's SMPL parts merged to 14, as its training code does.
    _numbered(
        "surreal14",
        "SURREAL",
        _in_order(
            "head torso right_upper_arm right_forearm right_hand left_upper_arm left_forearm left_hand "
            "right_upper_leg right_lower_leg right_foot left_upper_leg left_lower_leg left_foot",
            _NECK_ON_TORSO | _LIMB_GROUPS,
        ),
    ),
    _label_set(
        "cdcl14",
        "CDCL",
        _in_order(
            "head torso right_upper_arm left_upper_arm right_forearm left_forearm right_hand left_hand "
            "right_upper_leg left_upper_leg right_lower_leg left_lower_leg right_foot left_foot",
            _NECK_ON_HEAD | _LIMB_GROUPS,
        ),
        """
        0 background
        1 head
        2 torso
        3 r_upper_arm = right_upper_arm
        4 l_upper_arm = left_upper_arm
        5 r_forearm = right_forearm
        6 l_forearm = left_forearm
        7 r_hand = right_hand
        8 l_hand = left_hand
        9 r_thigh = right_upper_leg
        10 l_thigh = left_upper_leg
        11 r_shank = right_lower_leg
        12 l_shank = left_lower_leg
        13 r_foot = right_foot
        14 l_foot = left_foot
        """,
    ),
    # DensePose-COCO's 24 charts. Its maintainers once gave the feet the other way round in an issue (number 64); the
    # data set's documentation has them thus.
    _label_set(
        "densepose24",
        "DensePose-COCO",
        _in_order(
            "torso right_hand left_hand left_foot right_foot right_upper_leg left_upper_leg right_lower_leg "
            "left_lower_leg left_upper_arm right_upper_arm left_forearm right_forearm head",
            _NECK_ON_HEAD | _LIMB_GROUPS,
        ),
        """
        0 Background = background
        1 Torso = torso
        2 Torso = torso
        3 Right Hand = right_hand
        4 Left Hand = left_hand
        5 Left Foot = left_foot
        6 Right Foot = right_foot
        7 Upper Leg Right = right_upper_leg
        8 Upper Leg Left = left_upper_leg
        9 Upper Leg Right = right_upper_leg
        10 Upper Leg Left = left_upper_leg
        11 Lower Leg Right = right_lower_leg
        12 Lower Leg Left = left_lower_leg
        13 Lower Leg Right = right_lower_leg
        14 Lower Leg Left = left_lower_leg
        15 Upper Arm Left = left_upper_arm
        16 Upper Arm Right = right_upper_arm
        17 Upper Arm Left = left_upper_arm
        18 Upper Arm Right = right_upper_arm
        19 Lower Arm Left = left_forearm
        20 Lower Arm Right = right_forearm
        21 Lower Arm Left = left_forearm
        22 Lower Arm Right = right_forearm
        23 Head = head
        24 Head = head
        """,
    ),
    # LIP. An arm is its bare skin down to the fingertips; a glove or a sock does not tell its side.
    _label_set(
        "lip20",
        "LIP",
        _NECK_ON_HEAD
        | _one_side("left", arm=("upper_arm", "forearm", "hand"), leg=("upper_leg", "lower_leg"), foot=("foot",))
        | _one_side("right", arm=("upper_arm", "forearm", "hand"), leg=("upper_leg", "lower_leg"), foot=("foot",)),
        """
        0 Background = background
        1 Hat = head
        2 Hair = head
        3 Glove = ignore
        4 Sunglasses = head
        5 Upper-clothes = ignore
        6 Dress = ignore
        7 Coat = ignore
        8 Socks = ignore
        9 Pants = ignore
        10 Jumpsuits = ignore
        11 Scarf = ignore
        12 Skirt = ignore
        13 Face = head
        14 Left-arm = left_arm
        15 Right-arm = right_arm
        16 Left-leg = left_leg
        17 Right-leg = right_leg
        18 Left-shoe = left_foot
        19 Right-shoe = right_foot
        """,
    ),
    # CIHP is LIP but for id 10, the skin of torso and neck.
    _label_set(
        "cihp20",
        "CIHP",
        _NECK_ON_TORSO
        | _one_side("left", arm=("upper_arm", "forearm", "hand"), leg=("upper_leg", "lower_leg"), foot=("foot",))
        | _one_side("right", arm=("upper_arm", "forearm", "hand"), leg=("upper_leg", "lower_leg"), foot=("foot",)),
        """
        0 Background = background
        1 Hat = head
        2 Hair = head
        3 Glove = ignore
        4 Sunglasses = head
        5 Upper-clothes = ignore
        6 Dress = ignore
        7 Coat = ignore
        8 Socks = ignore
        9 Pants = ignore
        10 Torso-skin = torso
        11 Scarf = ignore
        12 Skirt = ignore
        13 Face = head
        14 Left-arm = left_arm
        15 Right-arm = right_arm
        16 Left-leg = left_leg
        17 Right-leg = right_leg
        18 Left-shoe = left_foot
        19 Right-shoe = right_foot
        """,
    ),
    _label_set(
        "atr18",
        "ATR",
        _NECK_ON_HEAD
        | _one_side("left", arm=("upper_arm", "forearm", "hand"), leg=("upper_leg", "lower_leg"), foot=("foot",))
        | _one_side("right", arm=("upper_arm", "forearm", "hand"), leg=("upper_leg", "lower_leg"), foot=("foot",)),
        """
        0 Background = background
        1 Hat = head
        2 Hair = head
        3 Sunglasses = head
        4 Upper-clothes = ignore
        5 Skirt = ignore
        6 Pants = ignore
        7 Dress = ignore
        8 Belt = torso
        9 Left-shoe = left_foot
        10 Right-shoe = right_foot
        11 Face = head
        12 Left-leg = left_leg
        13 Right-leg = right_leg
        14 Left-arm = left_arm
        15 Right-arm = right_arm
        16 Bag = ignore
        17 Scarf = ignore
        """,
    ),
    # Pascal-Person-Part: left and right are one class.
    _label_set(
        "pascal6",
        "Pascal-Person-Part",
        {
            **_NECK_ON_HEAD,
            "upper_arms": _both("upper_arm"),
            "lower_arms": _both("forearm", "hand"),
            "upper_legs": _both("upper_leg"),
            "lower_legs": _both("lower_leg", "foot"),
        },
        """
        0 Background = background
        1 Head = head
        2 Torso = torso
        3 Upper Arms = upper_arms
        4 Lower Arms = lower_arms
        5 Upper Legs = upper_legs
        6 Lower Legs = lower_legs
        """,
    ),
    _label_set("sapiens28", "Sapiens, version 1", _NECK_ON_HEAD | _LIMB_GROUPS, _in_turn(_SAPIENS)),
    # One class more, at id 2, so that all later ids are one higher.
    _label_set(
        "sapiens29",
        "Sapiens2",
        _NECK_ON_HEAD | _LIMB_GROUPS,
        _in_turn(_SAPIENS.replace("Face_Neck", "Eyeglass = head\n    Face_Neck")),
    ),
    # UP-3D ("Unite the People"), in the order of its published code (regions of up_tools/model.py). The ring around a
    # joint goes to the limb that ends there: an elbow to the upper arm, a wrist to the forearm.
    _label_set(
        "up3d31",
        "UP-3D",
        {"head": ("head",), "neck": ("neck",), "torso": _TRUNK} | _LIMB_GROUPS,
        """
        0 background
        1 rhand = right_hand
        2 rwrist = right_forearm
        3 rlarm = right_forearm
        4 relbow = right_upper_arm
        5 ruarm = right_upper_arm
        6 rshoulder = torso
        7 rubody = torso
        8 rlbody = torso
        9 ruleg = right_upper_leg
        10 rknee = right_upper_leg
        11 rlleg = right_lower_leg
        12 rankle = right_lower_leg
        13 rfoot = right_foot
        14 lhand = left_hand
        15 lwrist = left_forearm
        16 llarm = left_forearm
        17 lelbow = left_upper_arm
        18 luarm = left_upper_arm
        19 lshoulder = torso
        20 lubody = torso
        21 llbody = torso
        22 luleg = left_upper_leg
        23 lknee = left_upper_leg
        24 llleg = left_lower_leg
        25 lankle = left_lower_leg
        26 lfoot = left_foot
        27 luhead = head
        28 ruhead = head
        29 rlhead = head
        30 llhead = head
        31 neck
        """,
    ),
)

LABEL_SETS: dict[str, LabelSet] = {labels.name: labels for labels in _SETS}

# For helps: "cdcl14 (CDCL, 15 classes), ...", background counted.
DESCRIBED = ", ".join(f"{name} ({each.of}, {len(each.channel_ids)} classes)" for name, each in LABEL_SETS.items())
