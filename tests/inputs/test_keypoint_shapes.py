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


def test_points_of_other_data_sets_by_their_names() -> None:
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


def test_animals_are_nobody() -> None:
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


def test_categories() -> None:
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


def test_names_beside_the_keypoints() -> None:
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


def test_points_that_are_named_one_by_one() -> None:
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
def test_people_of_one_photo_out_of_many(shape: str, tmp_path: Path) -> None:
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


def test_photos_without_people_and_of_one_name(tmp_path: Path) -> None:
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
def test_names_of_pictures(photo: str, names: list[str], found: list[str]) -> None:
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


def test_labelme() -> None:
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


def test_label_studio(tmp_path: Path) -> None:
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


def test_sizes_that_files_state(tmp_path: Path) -> None:
    """Keypoints follow the picture that is read: smaller than annotated, or turned by its EXIF data."""
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
