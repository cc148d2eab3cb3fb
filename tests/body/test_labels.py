"""Label sets: every table holds together, and images go through them and back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from warp_partdr.body.labels import IGNORE, LABEL_SETS, LabelSet, label_set, regroup
from warp_partdr.body.landmarks import mirror_name
from warp_partdr.body.template import PART_NAMES
from warp_partdr.errors import InputError

NAMES = list(LABEL_SETS)
EXPECTED_CLASSES = {"full1": 1, "lip20": 19, "cihp20": 19, "atr18": 17, "sapiens28": 27, "sapiens29": 28}


@pytest.mark.parametrize("name", NAMES)
def test_each_part_is_in_one_group_of_a_set(name: str) -> None:
    labels = LABEL_SETS[name]
    assert label_set(name) is labels
    assert labels.name == name
    assert labels.ids[0] == "background"
    number = int("".join(filter(str.isdigit, name.removeprefix("up3d"))))
    assert len(labels.channel_ids) - 1 == EXPECTED_CLASSES.get(name, number)
    assert labels.channel_ids == tuple(range(len(labels.channel_ids)))
    # Every ellipsoid is in one group, and the table from parts to groups has exactly each group's parts.
    for group, parts in enumerate(labels.groups.values(), start=1):
        assert parts
        assert {PART_NAMES[k - 1] for k in np.flatnonzero(labels.part_groups == group)} == set(parts)
    assert labels.part_groups[0] == 0
    assert set(labels.part_groups[1:]) == set(range(1, labels.num_groups + 1))


@pytest.mark.parametrize("name", NAMES)
def test_left_and_right_mirror_each_other(name: str) -> None:
    labels = LABEL_SETS[name]
    for group, parts in labels.groups.items():
        assert set(labels.groups[mirror_name(group)]) == {mirror_name(part) for part in parts}
    # As many source ids on either side, of mirrored meaning.
    count = {group: list(labels.ids.values()).count(group) for group in labels.groups}
    assert all(count[group] == count[mirror_name(group)] for group in count)


@pytest.mark.parametrize("name", NAMES)
def test_ids_of_a_part_image_come_back_as_its_groups(name: str, rng: np.random.Generator) -> None:
    labels = LABEL_SETS[name]
    parts = rng.integers(0, 21, size=(40, 50)).astype(np.uint8)
    if name != "full1":  # Its 255 is a person.
        parts[0, :3] = IGNORE
    groups = labels.from_parts(parts)
    assert groups.dtype == np.uint8
    back = labels.to_groups(labels.to_ids(groups))
    with_ids = {k for k, group in enumerate(labels.groups, start=1) if group in labels.ids.values()} | {0}
    np.testing.assert_array_equal(back, np.where(np.isin(groups, list(with_ids)), groups, IGNORE))
    # In LIP, clothes hide the torso; every other set labels each of its groups.
    assert len(with_ids) == labels.num_groups + (0 if name == "lip20" else 1)
    assert name == "full1" or groups[0, :3].tolist() == [IGNORE] * 3


@pytest.mark.parametrize("name", NAMES)
def test_each_id_becomes_the_group_that_it_means(name: str) -> None:
    labels = LABEL_SETS[name]
    for source, meaning in labels.ids.items():
        group = labels.to_groups(np.array([source]))[0]
        expected = {"background": 0, "ignore": IGNORE}.get(meaning)
        assert group == (labels.group_names.index(meaning) + 1 if expected is None else expected)
    assert labels.to_groups(np.array([255]))[0] == (1 if name == "full1" else IGNORE)
    with pytest.raises(ValueError, match=rf"labels: ids 99 not in {name}; expected 0 to"):
        labels.to_groups(np.array([[0, 1], [99, 99]]))


@pytest.mark.parametrize(
    ("name", "meanings"),
    [  # Against the data sets' documentation: id, what it is.
        ("cdcl14", {1: "head", 3: "right_upper_arm", 8: "left_hand", 12: "left_lower_leg", 13: "right_foot"}),
        ("surreal14", {2: "torso", 3: "right_upper_arm", 8: "left_hand", 9: "right_upper_leg", 14: "left_foot"}),
        ("densepose24", {2: "torso", 3: "right_hand", 5: "left_foot", 9: "right_upper_leg", 21: "left_forearm"}),
        ("lip20", {5: "ignore", 13: "head", 14: "left_arm", 17: "right_leg", 18: "left_foot"}),
        ("cihp20", {10: "torso", 15: "right_arm"}),
        ("atr18", {9: "left_foot", 11: "head", 13: "right_leg", 14: "left_arm", 16: "ignore"}),
        ("pascal6", {1: "head", 2: "torso", 3: "upper_arms", 6: "lower_legs"}),
        ("sapiens28", {2: "head", 5: "left_hand", 9: "ignore", 17: "right_foot", 21: "torso", 27: "head"}),
        ("sapiens29", {2: "head", 6: "left_hand", 10: "ignore", 18: "right_foot", 22: "torso", 28: "head"}),
        ("up3d31", {1: "right_hand", 8: "torso", 14: "left_hand", 22: "left_upper_leg", 28: "head", 31: "neck"}),
        ("lsp6", {1: "left_arm", 2: "right_arm", 3: "head", 4: "left_leg", 5: "right_leg", 6: "torso"}),
        ("ellipbody20", {1: "left_hip", 8: "head", 20: "right_hand"}),
    ],
)
def test_ids_mean_what_their_data_sets_say(name: str, meanings: dict[int, str]) -> None:
    assert {source: LABEL_SETS[name].ids[source] for source in meanings} == meanings


def test_sapiens2_has_one_class_more() -> None:
    first, second = LABEL_SETS["sapiens28"], LABEL_SETS["sapiens29"]
    assert second.class_names[2] == "Eyeglass"
    later = {source - (source > 2): name for source, name in second.class_names.items() if source != 2}
    assert later == first.class_names
    assert {source - (source > 2): group for source, group in second.ids.items() if source != 2} == first.ids
    assert second.groups == first.groups


def test_the_docs_list_each_set_with_its_ids() -> None:
    """Name, data set, classes, ids and what is ignored."""
    page = (Path(__file__).resolve().parents[2] / "docs/reference/inputs.md").read_text()
    rows = [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in page.splitlines() if "| `" in line]
    told = {row[0]: (row[1], row[2], row[3], row[5]) for row in rows if row[0] in LABEL_SETS}
    for name, labels in LABEL_SETS.items():
        ignored = [
            f"{source} {labels.class_names[source]}" for source, group in labels.ids.items() if group == "ignore"
        ]
        ids = f"0 to {max(labels.channel_ids)}" + (", 255" if 255 in labels.ids else "")
        assert told[name] == (labels.of, str(len(labels.channel_ids)), ids, ", ".join(ignored))


def test_cdcl_has_the_ids_of_the_shared_photos(shared: Path) -> None:
    theirs = json.loads((shared / "data/people/labels.json").read_text())
    assert LABEL_SETS["cdcl14"].class_names == {int(source): name for source, name in theirs.items()}


def test_masks_and_empty_images_are_converted_and_other_types_refused() -> None:
    full, lsp6 = LABEL_SETS["full1"], LABEL_SETS["lsp6"]
    assert full.to_groups(np.array([[True, False]])).tolist() == [[1, 0]]
    assert full.to_groups(np.zeros((0, 3), dtype=np.uint8)).shape == (0, 3)
    assert full.to_groups(np.array([[0, 255]], dtype=np.uint8)).tolist() == [[0, 1]]
    for convert, image, message in (
        (full.to_groups, np.zeros((2, 2)), "labels: float64; expected integers"),
        (
            full.to_groups,
            np.array([0, 70000, -1, 2**32]),
            "ids -1, 70000, 4294967296 not in full1; expected 0 to 1, 255",
        ),
        (full.to_ids, np.array([0, 1, 255]), "groups: full1 has no id for group ids 255"),
        (lsp6.to_ids, np.array([0, 7, 8]), "groups: lsp6 has no id for group ids 7 to 8"),
    ):
        with pytest.raises(ValueError, match=message):
            convert(image)


def test_probabilities_become_group_maps() -> None:
    labels = LABEL_SETS["lip20"]
    probabilities = np.zeros((20, 1, 3), dtype=np.float32)
    probabilities[[1, 2, 13], 0, 0] = [0.5, 0.25, 0.25]  # hat, hair, face: head
    probabilities[[5, 0], 0, 1] = [0.75, 0.25]  # clothes, background
    probabilities[[14, 18], 0, 2] = [0.5, 0.5]
    maps = labels.to_group_maps(probabilities)
    assert maps.shape == (labels.num_groups + 1, 1, 3)
    assert maps[labels.group_names.index("head") + 1, 0, 0] == 1
    assert maps[:, 0, 1].tolist() == [0.25] + [0.0] * labels.num_groups
    assert maps[labels.group_names.index("left_foot") + 1, 0, 2] == 0.5
    with pytest.raises(ValueError, match=r"labels: 7 probability maps; expected 20 for lip20"):
        labels.to_group_maps(probabilities[:7])
    assert LABEL_SETS["full1"].to_group_maps(np.ones((2, 1, 1), dtype=np.float32)).shape == (2, 1, 1)


@pytest.mark.parametrize("name", [name for name in NAMES if name not in {"full1", "pascal6"}])
def test_regrouping_to_lsp_keeps_each_part_in_its_group_except_necks(name: str) -> None:
    source, target = LABEL_SETS[name], LABEL_SETS["lsp6"]
    table = regroup(source, target)
    assert table[0] == 0
    assert table[IGNORE] == IGNORE
    direct = target.part_groups
    through = table[source.part_groups]
    differing = {PART_NAMES[k - 1] for k in np.flatnonzero(direct != through)}
    assert differing <= {"neck"}
    for group, parts in enumerate(source.groups.values(), start=1):
        assert table[group] in {direct[PART_NAMES.index(part) + 1] for part in parts}


@pytest.mark.parametrize("name", NAMES)
def test_regrouping_to_itself_changes_nothing_and_to_a_silhouette_makes_all_one(name: str) -> None:
    labels = LABEL_SETS[name]
    groups = np.arange(labels.num_groups + 1)
    np.testing.assert_array_equal(regroup(labels, labels)[groups], groups)
    np.testing.assert_array_equal(regroup(labels, LABEL_SETS["full1"])[groups], np.minimum(groups, 1))


@pytest.mark.parametrize("name", ["full1", "pascal6"])
def test_a_group_that_straddles_several_cannot_be_regrouped(name: str) -> None:
    with pytest.raises(
        ValueError, match=rf"{name} to lsp6: group .* lies in left_arm, right_arm.*; expected one group"
    ):
        regroup(LABEL_SETS[name], LABEL_SETS["lsp6"])


def test_parts_in_no_group_cost_nothing() -> None:
    only_head = label_set({"groups": {"head": ["head"]}, "ids": {"0": "background", "4": "head"}})
    assert only_head.part_groups.tolist() == [0] + [IGNORE] * 7 + [1] + [IGNORE] * 12
    assert regroup(LABEL_SETS["ellipbody20"], only_head)[[8, 1]].tolist() == [1, IGNORE]
    with pytest.raises(ValueError, match="lies in head, none"):
        regroup(LABEL_SETS["full1"], only_head)


OWN: dict[str, Any] = {
    "name": "mine",
    "groups": {"head": ["head", "neck"], "left_arm": ["left_upper_arm", "left_forearm", "left_hand"]},
    "ids": {"0": "background", "1": "head", "2": "left_arm", "300": "left_arm", "7": "ignore"},
}


def test_a_custom_label_set_is_read_from_a_file_or_a_table(tmp_path: Path) -> None:
    path = tmp_path / "own.json"
    path.write_text(json.dumps(OWN))
    for labels in (label_set(path), label_set(str(path)), label_set(OWN), label_set(label_set(OWN))):
        assert labels.name == "mine"
        assert labels.group_names == ("head", "left_arm")
        assert labels.to_groups(np.array([0, 1, 2, 300, 7, 255])).tolist() == [0, 1, 2, 2, IGNORE, IGNORE]
        assert labels.to_ids(np.array([0, 1, 2])).tolist() == [0, 1, 2]
    del OWN["name"]
    path.write_text(json.dumps(OWN))
    assert label_set(path).name == "own"
    OWN["name"] = "mine"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"groups": {}}, r"groups: none; expected at least one"),
        ({"groups": []}, r'no "groups" and "ids"; expected'),
        ({"ids": None}, r'no "groups" and "ids"; expected'),
        ({"groups": {"head": []}}, r"group 'head' has no parts; expected some of left_hip"),
        ({"groups": {"head": "head"}}, r"group 'head': 'head'; expected a list of part names"),
        ({"groups": {"head": ["skull"]}}, r"group 'head': no part 'skull'; expected left_hip"),
        ({"groups": {"head": ["head"], "face": ["head"]}}, r"head is in 'head' and 'face'; expected one group"),
        ({"groups": {"ignore": ["head"]}}, r"groups: 'ignore'; expected a name other than background and ignore"),
        (
            {"ids": {"0": "background", "1": "hand"}},
            r"id 1 is 'hand'; expected one of head, left_arm, background, ignore",
        ),
        ({"ids": {"zero": "background"}}, r"id: 'zero'; expected an integer from 0 to 65535"),
        ({"ids": {"1.9": "background"}}, r"id: '1.9'; expected an integer from 0 to 65535"),
        ({"ids": {"0": "background", "00": "head"}}, r"id 0 twice; expected one group for it"),
        ({"ids": {"-1": "background"}}, r"id: -1; expected an integer from 0 to 65535"),
        ({"ids": {"1": "head"}}, r"ids: none is background; expected one at least"),
        ({"left_out": ["tail"]}, "left_out: no part 'tail'"),
        ({"left_out": ["head"]}, "head is in 'left_out' and 'head'"),
        ({"left_out": "left_hand"}, "left_out: 'left_hand'; expected a list"),
        ({"at_joints": "yes"}, "at_joints: 'yes'; expected true or false"),
    ],
)
def test_a_faulty_custom_label_set_is_refused_in_a_line(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = tmp_path / "own.json"
    path.write_text(json.dumps(OWN | change))
    with pytest.raises(InputError, match=message) as raised:
        label_set(path)
    assert str(raised.value).startswith(str(path))
    assert "\n" not in str(raised.value)


def test_ids_with_class_names_mean_a_known_set(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    lip = LABEL_SETS["lip20"]
    path.write_text(json.dumps({str(number): lip.class_names.get(number, group) for number, group in lip.ids.items()}))
    assert label_set(path) is lip
    path.write_text('{"1": "head"}')
    with pytest.raises(InputError, match=r"labels\.json: the ids and names of no known label set; expected .*cdcl14"):
        label_set(path)


def test_an_unknown_label_set_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "bad.json").write_text("{")
    (tmp_path / "list.json").write_text("[]")
    for source, message in (
        ("cdcl", r"labels: 'cdcl'; expected one of ellipbody20, .*, or a JSON file"),
        (tmp_path / "none.json", r"none\.json: No such file or directory; expected a label set in JSON"),
        (tmp_path / "bad.json", r"bad\.json: not JSON"),
        (tmp_path / "list.json", r"list\.json: list; expected an object with groups and ids"),
    ):
        with pytest.raises(InputError, match=message):
            label_set(source)


def test_ids_may_be_any_integers_and_nothing_else() -> None:
    assert label_set(OWN | {"ids": {0: "background", np.int64(3): "head"}}).ids == {0: "background", 3: "head"}
    for make in (lambda ids: label_set(OWN | {"ids": ids}), lambda ids: LabelSet("mine", {"head": ("head",)}, ids)):
        with pytest.raises(ValueError, match="mine: id 1 is 'arm'"):
            make({0: "background", 1: "arm"})
        for key in (1.9, True, None):
            with pytest.raises(ValueError, match="expected an integer from 0 to 65535"):
                make({0: "background", key: "head"})


def test_what_is_left_out_is_not_drawn_and_what_is_in_no_group_hides() -> None:
    labels = label_set({**OWN, "left_out": ["right_foot", "right_hand"], "at_joints": True})
    assert labels.at_joints
    groups = dict(zip(PART_NAMES, labels.part_groups[1:].tolist(), strict=True))
    assert [groups[name] for name in ("right_foot", "right_hand", "head", "left_hand")] == [0, 0, 1, 2]
    assert groups["chest"] == IGNORE
