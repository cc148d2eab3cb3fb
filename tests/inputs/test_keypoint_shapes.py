"""People in files of many shapes: by the names of their points, and those of one photo out of many."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from warp_partdr.body.skeletons import SKELETONS
from warp_partdr.errors import InputError
from warp_partdr.inputs.keypoint_categories import read_categories
from warp_partdr.inputs.keypoint_files import parse_keypoints, read_keypoints
from warp_partdr.inputs.keypoint_shapes import matching_names
from warp_partdr.inputs.keypoints import Keypoints2D

COCO = SKELETONS["coco17"].landmarks


def places(move: float = 0.0) -> dict[str, list[float]]:
    """A standing person's COCO landmarks, and crown, neck and pelvis [px]."""
    middle = {"nose": [100 + move, 40], "head_top": [100 + move, 15], "neck": [100 + move, 68]}
    limbs = {"shoulder": (25, 70), "elbow": (32, 105), "wrist": (35, 135), "hip": (14, 140), "knee": (15, 195)}
    sided = {"eye": (5, 35), "ear": (11, 38), **limbs, "ankle": (16, 250)}
    left = {f"left_{name}": [100 + move + x, y] for name, (x, y) in sided.items()}
    right = {f"right_{name}": [100 + move - x, y] for name, (x, y) in sided.items()}
    return {**middle, **left, **right, "mid_hip": [100 + move, 140]}


def flat(names: Any, move: float = 0.0, spellings: dict[str, str] | None = None) -> list[float]:
    """COCO's flat list of points in the order of ``names``, which may be spelled otherwise; unknown ones at 1, 1."""
    known = places(move)
    meant = [(spellings or {}).get(name, name) for name in names]
    return [value for name in meant for value in (*known.get(name, [1, 1]), 2)]


def coco(names: Any, *annotations: dict[str, Any], **category: Any) -> dict[str, Any]:
    """COCO's annotations of one picture, "street/7.jpg", or of those that they say."""
    entries = [{"id": n, "image_id": 3, "category_id": 1, **each} for n, each in enumerate(annotations)]
    return {
        "images": [{"id": 3, "file_name": "street/7.jpg"}],
        "categories": [{"id": 1, "name": "person", "keypoints": list(names), **category}],
        "annotations": entries,
    }


def at(person: Keypoints2D, landmark: str) -> list[float]:
    return person.points[person.format.landmarks.index(landmark)].tolist()


def assert_all_at_their_places(person: Keypoints2D, move: float = 0.0) -> None:
    known = places(move)
    for landmark, point, there in zip(person.format.landmarks, person.points, person.visible, strict=True):
        if there:
            assert point.tolist() == known[landmark], landmark


def test_cocos_names_tell_the_order() -> None:
    mixed = sorted(COCO, key=lambda name: name[::-1])
    upper = [" ".join(word.title() for word in reversed(name.split("_"))) for name in mixed]  # "Shoulder Left"
    right_first = [name.replace("left", "?").replace("right", "left").replace("?", "right") for name in COCO]
    spelled = dict(zip(upper, mixed, strict=True))
    for names in (COCO, mixed, right_first, upper):
        (person,) = parse_keypoints(coco(names, {"keypoints": flat(names, 0, spelled)}))
        assert person.skeleton == "coco17"
        assert person.visible.all()
        assert person.warnings == ()
        assert_all_at_their_places(person)


def test_points_of_other_data_sets_are_known_by_their_names() -> None:
    posetrack = ["nose", "head_bottom", "head_top", *COCO[3:]]
    (person,) = parse_keypoints(coco(posetrack, {"keypoints": flat(posetrack, 0, {"head_bottom": "neck"})}))
    assert (person.skeleton, at(person, "neck"), at(person, "head_top")) == ("posetrack17", [100, 68], [100, 15])
    crowdpose = [*COCO[5:], "head", "neck"]
    (person,) = parse_keypoints(coco(crowdpose, {"keypoints": flat(crowdpose, 0, {"head": "head_top"})}))
    assert (person.skeleton, at(person, "head_top")) == ("crowdpose14", [100, 15])
    more = [*COCO, "hat", "left hand", "pelvis"]
    (person,) = parse_keypoints(coco(more, {"keypoints": flat(more, 0, {"pelvis": "mid_hip"})}))
    assert person.format.name == "named"
    assert person.visible.sum() == 18
    assert person.warnings == ("keypoints: hat, left hand left out; expected names of landmarks of the body",)
    assert_all_at_their_places(person)


def test_keypoints_of_animals_are_refused_or_left_out() -> None:
    horse = {"id": 2, "name": "horse", "supercategory": "animal", "keypoints": list(COCO)}
    data = coco(COCO, {"keypoints": flat(COCO)}, {"keypoints": flat(COCO, 90), "category_id": 2})
    data["categories"].append(horse)
    (person,) = parse_keypoints(data)
    assert_all_at_their_places(person)
    assert person.warnings == ("keypoints: 1 of category 'horse' left out; expected keypoints of people",)
    for changes in ({"name": "antelope"}, {"name": "okapi", "supercategory": "Animal"}, {"name": "brown bear"}):
        alone = coco(COCO, {"keypoints": flat(COCO)}, **changes)
        for given in (None, "coco17"):
            with pytest.raises(InputError, match=r"^f: category '.*'; expected keypoints of people, not of animals$"):
                parse_keypoints(alone, given, name="f")
    paws = ["nose", "left_eye", "right_eye", "neck", "left_front_paw", "right_front_paw", "left_hip", "right_hip"]
    for given in (None, "coco17"):
        with pytest.raises(
            InputError, match=r"^f: category 'x': keypoint 'left_front_paw'; expected .* not of animals$"
        ):
            parse_keypoints(coco(paws, {"keypoints": flat(paws)}, name="x"), given, name="f")


def test_categories_say_which_points_they_have_and_who_is_refused() -> None:
    given = [
        {"id": 1, "name": "player", "keypoints": ["nose", "hat", "left_eye", "right_eye"]},
        {"id": 2, "name": "ball"},
        {"id": "3", "name": "goal", "keypoints": ["left_post", "right_post", "bar"]},
        {"id": 4, "name": "wolf"},
    ]
    player, ball, goal, wolf = read_categories(given, "f").values()
    assert player.skeleton is not None
    assert (player.refusal, player.warning) == (
        None, "keypoints: hat left out; expected names of landmarks of the body"
    )  # fmt: skip
    assert ball.refusal == "f: category 'ball' has no keypoint names; expected people"
    assert goal.refusal is not None
    assert "0 of 3 keypoint names are landmarks of a person" in goal.refusal
    assert (ball.animals, goal.animals, wolf.animals) == (False, False, True)
    assert read_categories(given[1:2], "f")[2].refusal is None  # nothing else is named: their number tells
    assert read_categories([{"id": 1, "name": "p", "keypoints": ["0", "1"]}], "f")[1].skeleton is None
    assert read_categories(None, "f") == {}
    for wrong, message in (
        ({}, "f: categories: dict; expected a list"),
        ([3], "f: categories: 3; expected objects with id and name"),
        ([{"name": "person"}], "f: categories: {'name': 'person'}; expected objects with id"),
        ([{"id": 1, "name": "x", "keypoints": "nose"}], "f: category 'x': keypoints: str; expected a list of names"),
    ):
        with pytest.raises(InputError) as raised:
            read_categories(wrong, "f")
        assert str(raised.value).startswith(message)


def test_a_format_goes_before_names() -> None:
    names = [f"点{n}" for n in range(17)]
    with pytest.raises(InputError, match=r"^f: category 'person': 0 of 17 keypoint names are landmarks"):
        parse_keypoints(coco(names, {"keypoints": flat(COCO)}), name="f")
    (person,) = parse_keypoints(coco(names, {"keypoints": flat(COCO)}), "coco17")
    assert_all_at_their_places(person)
    (person,) = parse_keypoints(coco(COCO[::-1], {"keypoints": flat(COCO)}), "coco17")
    assert person.warnings == ("keypoints: taken as coco17; their names in the file tell another order",)
    assert_all_at_their_places(person)
    (person,) = parse_keypoints(coco(COCO, {"keypoints": flat(COCO)}), "coco17")
    assert person.warnings == ()


def test_names_beside_the_keypoints_tell_their_order() -> None:
    order = COCO[::-1]
    rows = [[*places()[name], 0.9] for name in order]
    numbered = {str(n): name for n, name in enumerate(order)}
    for said in (
        {"keypoint_names": list(order)},
        {"meta_info": {"dataset_name": "mine", "keypoint_id2name": numbered}},
        {"meta_info": {"dataset_name": "coco", "keypoint_name2id": {name: int(n) for n, name in numbered.items()}}},
    ):
        for data in ({**said, "keypoints": rows}, {**said, "instance_info": [{"keypoints": rows}]}):
            (person,) = parse_keypoints(data)
            assert person.skeleton == "coco17"
            assert_all_at_their_places(person)
    with pytest.raises(InputError, match=r"^f: keypoint names: 'nose'; expected a list of names"):
        parse_keypoints({"keypoint_names": "nose", "keypoints": rows}, name="f")
    with pytest.raises(InputError, match=r"^f: 16 keypoints; expected 17 of coco17"):
        parse_keypoints({"keypoint_names": list(order), "keypoints": rows[1:]}, name="f")
    unnamed = {"keypoint_names": [f"kp_{n}" for n in range(17)], "keypoints": [[*places()[name], 1] for name in COCO]}
    assert_all_at_their_places(parse_keypoints(unnamed)[0])


def test_points_that_are_named_one_by_one_are_read() -> None:
    order = COCO[::-1][:12]
    by_name = {name.upper(): [*places()[name], 0.5] for name in order}
    objects = [{"name": name, "x": places()[name][0], "y": places()[name][1], "score": 0.5} for name in order]
    posenet = [
        {"part": name, "position": {"x": places()[name][0], "y": places()[name][1]}, "score": 0.5} for name in order
    ]
    for points in (by_name, objects, posenet):
        for data in ({"keypoints": points}, [{"keypoints": points}]):
            (person,) = parse_keypoints(data)
            assert person.visible.sum() == 12
            assert set(person.confidence[person.visible]) == {0.5}
            assert_all_at_their_places(person)
    (person,) = parse_keypoints({"keypoints": objects}, "lsp14")
    assert person.warnings == ("keypoints: taken by their names in the file, not as lsp14",)
    assert_all_at_their_places(person)


def write(path: Path, data: Any) -> Path:
    path.write_text(json.dumps(data))
    return path


def many(shape: str) -> Any:
    """A file of three pictures, in whose second, "b/street.png", two people are; elsewhere one."""
    people = {"a.png": [10.0], "b/street.png": [20.0, 30.0], "c.png": [40.0]}
    each = [(name, flat(COCO, move)) for name, moves in people.items() for move in moves]
    alphapose = [{"image_id": name, "category_id": 1, "keypoints": values, "score": 2.7} for name, values in each]
    if shape == "alphapose":
        return [{**person, "image_id": Path(person["image_id"]).name} for person in alphapose]
    if shape == "list by path":
        return [{"image_path": name, "keypoints": values} for name, values in each]
    if shape in ("open", "cmu"):
        key, points = {"open": ("people", "pose_keypoints_2d"), "cmu": ("bodies", "joints")}[shape]
        return {
            name: {"version": "AlphaPose v0.3", key: [{points: flat(COCO, move)} for move in moves]}
            for name, moves in people.items()
        }
    if shape == "lists by picture":
        return {name: [{"keypoints": flat(COCO, move)} for move in moves] for name, moves in people.items()}
    if shape == "frames":
        return [
            {"img_path": name, "instances": [{"keypoints": flat(COCO, move)} for move in moves]}
            for name, moves in people.items()
        ]
    images = [{"id": 70 + n, "file_name": name} for n, name in enumerate([*people, "empty.png"])]
    ids = {image["file_name"]: image["id"] for image in images}
    annotations = [{"image_id": ids[name], "keypoints": values} for name, values in each]
    return {"images": images, "annotations": annotations}


SHAPES = ["alphapose", "list by path", "open", "cmu", "lists by picture", "frames", "coco"]


@pytest.mark.parametrize("shape", SHAPES)
def test_the_photo_chooses_its_people_out_of_many_pictures(shape: str, tmp_path: Path) -> None:
    file = write(tmp_path / "k.json", many(shape))
    for photo in ("street.png", "somewhere/b/Street.PNG", "street.jpg", Path("b/street.png")):
        people = read_keypoints(file, photo=photo)
        assert len(people) == 2
        for person, move in zip(people, (20, 30), strict=True):
            assert_all_at_their_places(person, move)
            assert person.warnings == ()
    with pytest.raises(InputError, match=r"k\.json: people of [34] pictures \(a\.png, .*c\.png.*\); expected .*photo"):
        read_keypoints(file)
    with pytest.raises(InputError, match=r"k\.json: no keypoints of d\.png; expected one of its [34] pictures: a\.png"):
        read_keypoints(file, photo="d.png")


def test_a_photo_without_people_or_with_an_ambiguous_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^f: empty\.png: nobody in it; expected keypoints of at least one person"):
        parse_keypoints(many("coco"), name="f", photo=Path("empty.png"))
    twice = {"x/1.png": [{"keypoints": flat(COCO)}], "y/1.png": [{"keypoints": flat(COCO, 50)}]}
    with pytest.raises(InputError, match=r"^f: 2 pictures called 1\.png \(x/1\.png, y/1\.png\); expected one"):
        parse_keypoints(twice, name="f", photo=Path("z/1.png"))
    (person,) = parse_keypoints(twice, photo=Path("/data/y/1.png"))
    assert_all_at_their_places(person, 50)
    one = {"x/1.png": [{"keypoints": flat(COCO)}]}
    (person,) = parse_keypoints(one, photo=Path("2.png"))
    assert person.warnings == ("keypoints: of x/1.png, the file's only picture; taken for 2.png",)
    assert parse_keypoints(one, photo=Path("1.jpg"))[0].warnings == ()
    assert parse_keypoints([{"image_id": 8, "keypoints": flat(COCO)}], photo=Path("2.png"))[0].warnings == ()


@pytest.mark.parametrize(
    ("photo", "names", "found"),
    [
        ("a/b/7.png", ["7.png", "8.png"], ["7.png"]),
        ("a/b/7.png", ["b/7.png", "c/7.png"], ["b/7.png"]),
        ("7.png", ["b\\7.png", "./8.png"], ["b\\7.png"]),
        ("7.png", ["b/7.png", "c/7.png"], ["b/7.png", "c/7.png"]),
        ("7.jpg", ["7.png", "17.png"], ["7.png"]),
        ("shot.01.png", ["shot.01", "shot.02"], ["shot.01"]),
        ("000000397133.jpg", ["397133", "7133", "3"], ["397133"]),
        ("COCO_val_000000000036.jpg", ["36", "6"], ["36"]),
        ("me.png", ["1f2e3d-me.png", "1f2e3d-some.png"], ["1f2e3d-me.png"]),
        ("7.png", ["17.png", "77"], []),
        ("x.png", ["7"], []),
    ],
)
def test_pictures_match_by_name_folder_or_number(photo: str, names: list[str], found: list[str]) -> None:
    assert matching_names(Path(photo), names) == found


def shape(label: str, point: list[float], group: Any = None, kind: str = "point") -> dict[str, Any]:
    return {"label": label, "points": [point], "group_id": group, "shape_type": kind, "flags": {}}


def labelme(*people: float, **changes: Any) -> dict[str, Any]:
    """LabelMe's file of people that many pixels from the first place, each with other spellings."""
    shapes = [
        shape(name.upper() if group else name.replace("_", " "), places(move)[name], group)
        for group, move in enumerate(people)
        for name in ((*COCO[:11], "neck") if group == 0 else COCO[:11])
    ]
    box = {"label": "person", "points": [[1, 1], [9, 9]], "shape_type": "rectangle"}
    return {"version": "5.4.1", "shapes": [box, *shapes], "imagePath": "..\\p\\me.png", **changes}


def test_shapes_of_labelme_are_read_and_their_faults_named() -> None:
    first, second = parse_keypoints(labelme(0, 60), photo=Path("me.png"))
    for person, move in ((first, 0), (second, 60)):
        assert person.warnings == ()
        assert set(person.confidence[person.visible]) == {1}
        assert person.visible.sum() == (12 if move == 0 else 11)
        assert_all_at_their_places(person, move)
    for changes, message in (
        (
            {"shapes": [shape("nose", [1, 1]), shape("nose", [5, 5])]},
            "f: 'nose' twice in one person; expected a group_id",
        ),
        ({"shapes": [shape("person", [1, 1], kind="circle")]}, "f: shapes: circle; expected points, each labelled"),
        ({"shapes": [shape("nose", [1])]}, "f: shapes: 0 (nose): [1]; expected [x, y]"),
        ({"shapes": [3]}, "f: shapes: 0: 3; expected a shape with its points"),
        ({"shapes": [shape(3, [1, 2])]}, "f: shapes: 0: {"),  # type: ignore[arg-type]
        ({"shapes": [shape("1", [1, 1]), shape("2", [5, 5])]}, "f: keypoint names: ['1', '2']; expected such as left"),
        (
            {"shapes": [shape("wing", [1, 1]), shape("nose", [5, 5])]},
            "f: keypoint 'wing'; expected keypoints of people",
        ),
        ({"shapes": []}, "f: nobody in it; expected keypoints"),
    ):
        with pytest.raises(InputError) as raised:
            parse_keypoints(labelme(0, **changes), name="f")
        assert str(raised.value).startswith(message)


def studio(move: float, picture: str, **changes: Any) -> dict[str, Any]:
    """One of Label Studio's tasks: a picture of 400 x 300 px with one person in it."""
    results = [
        {
            "type": "keypointlabels",
            "original_width": 400,
            "original_height": 300,
            "image_rotation": 0,
            "value": {"x": x / 4, "y": y / 3, "width": 0.4, "keypointlabels": [name]},
            **changes,
        }
        for name, (x, y) in places(move).items()
    ]
    box = {"type": "rectanglelabels", "value": {"x": 1, "y": 1, "rectanglelabels": ["person"]}}
    return {"id": 4, "data": {"image": picture}, "annotations": [{"result": [box, *results]}], "predictions": []}


def test_tasks_of_label_studio_are_read_and_their_faults_named(tmp_path: Path) -> None:
    tasks = [studio(0, "/data/upload/3/0a1b2c3d-me.png"), studio(50, "/data/local-files/?d=set/you.png")]
    (tmp_path / "set").mkdir()
    for photo, move in (("me.png", 0), ("set/you.png", 50)):
        Image.new("RGB", (400, 300)).save(tmp_path / photo)
        (person,) = parse_keypoints(tasks, photo=tmp_path / photo)
        assert person.warnings == ()
        assert person.visible.sum() == 20
        known = places(move)
        for landmark, point in zip(person.format.landmarks, person.points, strict=True):
            if landmark in known:
                np.testing.assert_allclose(point, known[landmark], rtol=1e-5)
    (person,) = parse_keypoints(tasks[0])
    values = [result["value"] for result in tasks[0]["annotations"][0]["result"][1:]]
    short = {"image": "/data/upload/3/a-me.png", "id": 4, "kp": [
        {**value, "original_width": 400, "original_height": 300} for value in values
    ]}  # fmt: skip
    (again,) = parse_keypoints([short])
    np.testing.assert_array_equal(again.points, person.points)
    two = studio(0, "a.png", parentID="r1")
    two["annotations"][0]["result"] += studio(70, "a.png", parentID="r2")["annotations"][0]["result"]
    assert len(parse_keypoints(two)) == 2
    again_annotated = studio(0, "a.png")
    again_annotated["annotations"] *= 2
    for task, message in (
        (studio(0, "a.png", original_width=None), "f: original_width: missing; expected the picture's size"),
        (studio(0, "a.png", image_rotation=90), "f: image_rotation: 90; expected an upright picture"),
        (
            studio(0, "a.png", value={"x": "1", "y": 2, "keypointlabels": ["nose"]}),
            "f: nose: ['1', 2]; expected [x, y]",
        ),
        (studio(0, "a.png", value={"x": 1, "y": 2, "keypointlabels": []}), "f: keypointlabels: []; expected one name"),
        (studio(0, "a.png", value={"x": 1, "y": 2, "keypointlabels": ["nose"]}), "f: 'nose' twice in one person"),
        (again_annotated, "f: 2 annotations of one picture; expected those of one annotator"),
    ):
        with pytest.raises(InputError) as raised:
            parse_keypoints([task], name="f")
        assert str(raised.value).startswith(message)


def test_keypoints_are_scaled_by_the_size_that_their_file_states(tmp_path: Path) -> None:
    """They follow the picture that is read: smaller than annotated, or turned by its EXIF data."""
    photo, turned = tmp_path / "me.png", tmp_path / "turned.jpg"
    Image.new("RGB", (200, 150)).save(photo)
    data = labelme(0, imageWidth=400, imageHeight=300)
    (person,) = read_keypoints(write(tmp_path / "k.json", data), photo=photo)
    assert at(person, "left_wrist") == [135 / 2, 135 / 2]
    assert person.warnings == ("keypoints: made at 400 x 300 px, scaled to the picture's 200 x 150",)
    (person,) = parse_keypoints(data, size=(150, 200))
    assert at(person, "left_wrist") == [135 / 2, 135 / 2]
    exif = Image.Exif()
    exif[0x0112] = 6  # stored on its side
    Image.new("RGB", (400, 300)).save(turned, exif=exif)
    stored = coco(COCO, {"keypoints": flat(COCO)})
    stored["images"][0] |= {"width": 400, "height": 300, "file_name": "turned.jpg"}
    (person,) = read_keypoints(write(tmp_path / "k.json", stored), photo=turned)
    assert at(person, "nose") == [300 - 40, 100]
    assert person.warnings[0].startswith("keypoints: made at 400 x 300 px, as the photo is stored; turned")
    (person,) = parse_keypoints(flat(COCO), photo=turned)
    assert person.warnings[0].startswith("keypoints: the photo is turned by its EXIF orientation 6, and no size tells")
    assert at(person, "nose") == [100, 40]
    with pytest.raises(InputError, match=r"k\.json: annotated at 400 x 300 px, picture 300 x 300"):
        read_keypoints(tmp_path / "k.json", size=(300, 300))
    assert read_keypoints(tmp_path / "k.json")[0].warnings == ()


@pytest.mark.parametrize(
    "key",
    ["class", "class_name", "keypoint", "keypoint_name", "joint", "joint_name", "body_part", "type", "landmark", "q"],
)
def test_names_of_points_stand_under_any_key(key: str) -> None:
    """Points may be missing, and another text or number may stand beside the name."""
    known = places()
    names = [name for name in COCO if name not in ("left_ear", "nose")][::-1]
    points = [{"x": known[n][0], "y": known[n][1], "kind": "point", "class_id": 3, key: n} for n in names]
    box = {"x": 100, "y": 130, "width": 70, "height": 240, "class": "person", "confidence": 0.8}
    for data in ({"predictions": [{**box, "keypoints": points}]}, [{**box, "keypoints": points}]):
        (person,) = parse_keypoints(data)
        assert person.visible.sum() == 15
        assert_all_at_their_places(person)


@pytest.mark.parametrize("first", [0, 1])
def test_numbers_of_points_without_names_tell_their_places(first: int) -> None:
    known = places()
    rows = [{"class_id": n + first, "x": known[name][0], "y": known[name][1]} for n, name in enumerate(COCO)]
    (person,) = parse_keypoints({"keypoints": rows[::-1]})
    assert person.visible.all()
    assert_all_at_their_places(person)
    if first == 0:
        (person,) = parse_keypoints({"keypoints": [row for row in rows if row["class_id"] not in (3, 5, 7)]})
        assert (person.skeleton, person.visible.sum()) == ("coco17", 14)
        assert_all_at_their_places(person)
        with pytest.raises(InputError, match="keypoints numbered 1 to 16, without names; expected their names or"):
            parse_keypoints({"keypoints": rows[1:]})
        (person,) = parse_keypoints({"keypoints": rows[1:]}, "coco17")
        assert_all_at_their_places(person)


@pytest.mark.parametrize(
    "key",
    [
        "joints_vis",
        "keypoints_visible",
        "visibility",
        "keypoints_visibility",
        "confidence",
        "keypoint_confidence",
        *("conf", "keypoints_conf", "vis", "keypoints_score", "kpt_scores", "scores"),
    ],
)
def test_scores_stand_in_lists_of_their_own(key: str) -> None:
    rows = [places()[name] for name in COCO]
    rows[4] = [-1, -1]
    values = [0.5] * 4 + [0.0] + [0.75] * 12
    (person,) = parse_keypoints({"joints": rows, key: values})
    assert person.confidence.tolist() == values
    people = parse_keypoints({"keypoints": [rows, rows], key: [values, [0.25] * 4 + [0] + [1] * 12]})
    assert people[1].confidence[[0, 4, 16]].tolist() == [0.25, 0, 1]
    (person,) = parse_keypoints({"keypoints": [[*row, 1] for row in rows[:4]] * 4 + [[9, 9, 1]], key: []})
    assert person.visible.all()


def test_negative_scores_of_many_people_are_of_points_that_are_missing() -> None:
    rows = [[*places()[name], 1] for name in COCO]
    logits = [8.0] * 13 + [-0.5, -3, -1, -2]
    (person,) = parse_keypoints({"scores": [0.9], "labels": [1], "keypoints": [rows], "keypoints_scores": [logits]})
    assert person.confidence.tolist() == [1.0] * 13 + [0.0] * 4


@pytest.mark.parametrize("row", [[-1, -1], [-1, -1, -1], [-1, -1, 0]])
def test_rows_of_minus_one_are_missing(row: list[float]) -> None:
    rows = [[*places()[name], 1][: len(row)] for name in COCO]
    rows[2] = row
    (person,) = parse_keypoints({"keypoints": rows})
    assert np.flatnonzero(~person.visible).tolist() == [2]
    assert_all_at_their_places(person)


@pytest.mark.parametrize(
    "stated",
    [
        *({"canvas_width": 400, "canvas_height": 600}, {"width": 400, "height": 600}, {"image_size": [400, 600]}),
        *({"image": {"width": 400, "height": 600}}, {"image_width": 400, "image_height": 600}),
        *({"image_size": [600, 400]}, {"img_shape": [600, 400, 3]}, {"imageWidth": 400, "imageHeight": 600}),
    ],
)
def test_sizes_are_stated_under_many_keys(stated: dict[str, Any]) -> None:
    people = [{"pose_keypoints_2d": [2 * v if k % 3 < 2 else 1 for k, v in enumerate(flat(COCO))]}]
    for data in ({"people": people, **stated}, [{"people": people, **stated}], {**people[0], **stated}):
        (person,) = parse_keypoints(data, size=(300, 200))
        assert_all_at_their_places(person)
        assert person.warnings == ("keypoints: made at 400 x 600 px, scaled to the picture's 200 x 300",)
        with pytest.raises(InputError, match=r"annotated at \d00 x \d00 px, picture 300 x 300"):
            parse_keypoints(data, size=(300, 300))


def test_keypoints_mostly_outside_the_picture_are_told() -> None:
    (person,) = parse_keypoints({"keypoints": flat(COCO, 150)}, size=(300, 200))
    told = "keypoints: 17 of 17 confident ones lie outside the picture, 200 x 300 px; expected keypoints of this"
    assert person.warnings[0].startswith(told)
    assert parse_keypoints({"keypoints": flat(COCO, 75)}, size=(300, 200))[0].warnings == ()  # an arm is outside


def test_a_box_s_width_is_no_picture_s() -> None:
    box = {"x": 90, "y": 100, "width": 33, "height": 44}
    assert_all_at_their_places(parse_keypoints({**box, "keypoints": flat(COCO)}, size=(300, 200))[0])


@pytest.mark.parametrize("number", [None, 7])
def test_categories_that_agree_name_the_points_of_annotations_without_one(number: int | None) -> None:
    names = COCO[::-1]
    data = coco(names, {"category_id": number, "keypoints": flat(names)})
    data["categories"] += [{"id": 2, "name": "woman", "keypoints": list(names)}, {"id": 5, "name": "ball"}]
    (person,) = parse_keypoints(data)
    assert_all_at_their_places(person)
    assert person.warnings == ()
    data["categories"][1]["keypoints"] = list(COCO)
    (person,) = parse_keypoints(data)
    assert "of none of the categories 'person', 'woman', whose orders differ" in person.warnings[0]


@pytest.mark.parametrize(
    "key", "joint_names joints_name kpt_names keypoint_labels body_parts names labels markers".split()
)
def test_names_at_the_top_of_a_file_tell_the_order(key: str) -> None:
    names = COCO[::-1]
    listed = {key: list(names), "others": ["left_hip", "right_hip"]}
    for data in ({**listed, "people": [{"keypoints": flat(names)}]}, {**listed, "keypoints": flat(names)}):
        assert_all_at_their_places(parse_keypoints(data)[0])
    data = {**listed, "images": [], "annotations": [{"keypoints": flat(names)}]}
    assert_all_at_their_places(parse_keypoints(data)[0])


def test_names_in_mmposes_metadata_tell_the_order() -> None:
    names = COCO[::-1]
    tables = {str(n): name for n, name in enumerate(names)}
    for said in (
        {"dataset_meta": {"keypoint_id2name": tables}},
        {"dataset_info": {"keypoint_info": {n: {"name": name, "id": int(n)} for n, name in tables.items()}}},
    ):
        assert_all_at_their_places(parse_keypoints({**said, "instances": [{"keypoints": flat(names)}]})[0])


def test_visibilities_of_ochuman_become_confidences() -> None:
    rows = [[*places()[name], (1, 2, 3, 0)[n % 4]] for n, name in enumerate(COCO)]
    (person,) = parse_keypoints({"keypoints": rows})
    assert person.confidence[:4].tolist() == [1.0, 0.5, 0.5, 0.0]
    assert person.warnings == ()
    (person,) = parse_keypoints({"keypoints": [[x, y, max(v, 2)] for x, y, v in rows]})
    assert person.confidence[:3].tolist() == [1.0, 1.0, 0.5]


def test_coco_wholebodys_parts_are_joined() -> None:
    parts = {"foot_kpts": 6, "face_kpts": 68, "lefthand_kpts": 21, "righthand_kpts": 21}
    numbers, first, entry = [], 17, {"keypoints": flat(COCO)}
    for key, count in parts.items():
        entry[key] = [v for n in range(first, first + count) for v in (n, 2 * n, 2 if key == "foot_kpts" else 1)]
        numbers += entry[key]
        first += count
    (expected,) = parse_keypoints([[*flat(COCO), *numbers]])
    (person,) = parse_keypoints(coco(COCO, entry))
    assert person.skeleton == "wholebody133"
    np.testing.assert_array_equal(person.points, expected.points)
    assert person.visible.all()
    del entry["righthand_kpts"]
    assert not parse_keypoints(coco(COCO, entry))[0].visible.all()
    assert parse_keypoints(coco(COCO, entry), "coco17")[0].skeleton == "coco17"
    entry["foot_kpts"] = entry["foot_kpts"][:-1]
    with pytest.raises(InputError, match=r"foot_kpts: .*; expected 18 numbers"):
        parse_keypoints(coco(COCO, entry))


@pytest.mark.parametrize("image_id", [3.0, "03", "3"])
def test_ids_are_compared_as_numbers(image_id: Any) -> None:
    names = COCO[::-1]
    data = coco(names, {"image_id": image_id, "category_id": 1.0, "keypoints": flat(names)})
    data["categories"] = [{**data["categories"][0], "id": "01"}, {"id": 2.0, "name": "w", "keypoints": list(COCO)}]
    data["images"].append({"id": 4.0, "file_name": "street/8.jpg"})
    (person,) = parse_keypoints(data, photo=Path("7.jpg"))
    assert_all_at_their_places(person)
