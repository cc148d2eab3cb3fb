"""Keypoint files in all their formats, and faulty ones."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from warp_partdr.body.skeletons import SKELETONS, skeleton
from warp_partdr.errors import InputError
from warp_partdr.inputs.keypoint_files import keypoint_file, parse_keypoints, read_keypoints
from warp_partdr.inputs.keypoints import choose_person, person_height

NAN, INF = math.nan, math.inf
# Formats that a number of keypoints means where nothing else tells one.
BY_NUMBER = (
    *("lsp14", "mpii16", "coco17", "coco18", "body25", "halpe26", "blazepose33", "wholebody133"),
    *("body135", "halpe136"),
)


def rows(count: int, width: int = 3) -> list[list[float]]:
    """Distinct keypoints of confidence 0.5."""
    return [[10.0 + 3 * k, 20.0 + 5 * k, 0.5][:width] for k in range(count)]


def flat(values: list[list[float]]) -> list[float]:
    return [value for row in values for value in row]


def write(path: Path, data: Any) -> Path:
    path.write_text(data if isinstance(data, str) else json.dumps(data))
    return path


@pytest.mark.parametrize("name", list(SKELETONS))
@pytest.mark.parametrize("width", [2, 3])
@pytest.mark.parametrize("shape", ["object", "flat", "list", "bare", "bare and flat"])
def test_every_format_reads_back(name: str, width: int, shape: str, tmp_path: Path) -> None:
    form = SKELETONS[name]
    values = rows(form.count, width)
    data: Any = flat(values) if "flat" in shape else values
    if "bare" not in shape:
        data = {"format": name, "keypoints": data}
    path = write(tmp_path / "k.json", [data] if shape == "list" else data)
    # the number of keypoints tells the format, but for those that share it with a more frequent one
    (keypoints,) = read_keypoints(path, name if "bare" in shape and name not in BY_NUMBER else None)
    assert keypoints.skeleton == name
    assert keypoints.points.dtype == keypoints.confidence.dtype == np.float32
    np.testing.assert_allclose(keypoints.points, np.array(values)[list(form.places), :2])
    np.testing.assert_allclose(keypoints.confidence, 0.5 if width == 3 else 1.0)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("BlazePose33 x,y,visibility px", "blazepose33"),
        ("MediaPipe", "blazepose33"),
        ("BODY_25", "body25"),
        ("OpenPose BODY_25", "body25"),
        ("COCO-17", "coco17"),
        ("Human3.6M", "h36m17"),
        ("Human3.6M 17", "h36m17"),
        ("OpenPose COCO", "coco18"),
        ("Halpe 26", "halpe26"),
        ("coco_wholebody", "wholebody133"),
        ("COCO-WholeBody 133", "wholebody133"),
        ("LSP", "lsp14"),
        ("mpii", "mpii16"),
        ("BODY_25B", "body25b"),
        ("CrowdPose", "crowdpose14"),
        ("AIC", "aic14"),
        ("PoseTrack18", "posetrack17"),
        ("Halpe 136", "halpe136"),
    ],
)
def test_formats_are_known_by_any_spelling(text: str, name: str) -> None:
    values = rows(SKELETONS[name].count)
    assert parse_keypoints({"format": text, "keypoints": values})[0].skeleton == name
    assert parse_keypoints(values, text)[0].skeleton == name


def test_people_of_openpose_are_read() -> None:
    first, second = rows(25), [[x + 100, y, 0.9] for x, y, _ in rows(25)]
    second[3] = [0, 0, 0]
    data = {"version": 1.3, "people": [{"person_id": [-1], "pose_keypoints_2d": flat(p)} for p in (first, second)]}
    people = parse_keypoints(data)
    assert [person.skeleton for person in people] == ["body25", "body25"]
    np.testing.assert_allclose(people[1].points[2], second[2][:2])
    assert np.flatnonzero(~people[1].visible).tolist() == [3]


def test_annotations_of_coco_are_read() -> None:
    values = [[10 + k, 20 + 2 * k, k % 3] for k in range(17)]
    annotation = {"image_id": 5, "category_id": 1, "num_keypoints": 11, "keypoints": flat(values)}
    for data in (annotation, [annotation], {"images": [], "annotations": [annotation, annotation]}):
        keypoints = parse_keypoints(data)[0]
        assert keypoints.skeleton == "coco17"
        assert keypoints.confidence[:4].tolist() == [0.0, 0.5, 1.0, 0.0]
    with pytest.raises(InputError, match=r"people of 2 pictures \(5, 6\); expected those of one, or a photo"):
        parse_keypoints([annotation, annotation | {"image_id": 6}])


def test_instances_of_mmpose_are_read() -> None:
    instance = {"keypoints": rows(17, 2), "keypoint_scores": [0.25] * 16 + [1.2]}
    for data in ([instance, instance], {"instances": [instance, instance]}):
        people = parse_keypoints(data)
        assert len(people) == 2
        assert people[0].confidence[[0, 16]].tolist() == [0.25, 1.0]


def test_people_of_openpose_without_keypoints_are_left_out() -> None:
    """Empty and all missing people are left out, not an error of the others."""
    empty: list[dict[str, Any]] = [
        {"pose_keypoints_2d": []},
        {"pose_keypoints_2d": None},
        {"pose_keypoints_2d": [0.0] * 75},
    ]
    (person,) = parse_keypoints({"people": [*empty, {"pose_keypoints_2d": flat(rows(25))}]})
    assert person.visible.all()
    with pytest.raises(InputError, match=r"^f: person 0: no visible keypoint; expected some with confidence above 0"):
        parse_keypoints({"people": empty}, name="f")
    with pytest.raises(InputError, match=r"^f: no visible keypoint"):
        parse_keypoints({"people": empty[:1]}, name="f")


def test_scores_above_one_are_divided_by_the_largest() -> None:
    """Networks that classify coordinates have such scores; one wrong number is told instead."""
    scores = [4.0 + 0.2 * k for k in range(16)] + [8.0]
    shapes: list[Any] = [
        [{"keypoints": rows(17, 2), "keypoint_scores": scores}],
        {"keypoints": [[x, y, score] for (x, y), score in zip(rows(17, 2), scores, strict=True)]},
        {"people": [{"pose_keypoints_2d": flat([[*row, s] for row, s in zip(rows(17, 2), scores, strict=True)])}]},
        [ultralytics(visible=scores)],
    ]
    for data in shapes:
        (person,) = parse_keypoints(data)
        np.testing.assert_allclose(person.confidence, np.array(scores) / 8)
        assert person.warnings == ("keypoints: scores up to 8, not 1; divided by that",)
    small = {"keypoints": rows(17, 2), "keypoint_scores": [2.0] * 9 + [0.0] + [3.0] * 7}
    first, second = parse_keypoints([small, shapes[0][0]])
    assert (first.confidence[:10].tolist(), second.confidence[16]) == ([0.25] * 9 + [0.0], 1.0)
    assert first.warnings == second.warnings
    (person,) = parse_keypoints([{"keypoints": rows(17, 2), "keypoint_scores": [1.4] * 17}])
    assert (person.confidence.tolist(), person.warnings) == ([1.0] * 17, ())
    for wrong, message in (
        ([0.5] * 16 + [7.0], "keypoint 16 .*: confidence 7; expected 0 to 1"),
        ([*scores[:16], -0.5], "confidence -0.5"),
        ([*scores[:16], 101.0], "confidence 101"),
        ([*scores[:16], NAN], "expected finite numbers"),
    ):
        with pytest.raises(InputError, match=message):
            parse_keypoints([{"keypoints": rows(17, 2), "keypoint_scores": wrong}])
    flags = {"keypoints": [[*row, k % 3] for k, row in enumerate(rows(17, 2))]}
    assert parse_keypoints([flags])[0].warnings == ()


def test_openposes_18_points_are_read() -> None:
    """COCO's model has them, in files whose first versions call the list otherwise."""
    for key in ("pose_keypoints_2d", "pose_keypoints"):
        (person,) = parse_keypoints({"people": [{key: flat(rows(18))}]})
        assert person.skeleton == "coco18"
        assert person.points[1].tolist() == [13, 25]  # the neck


def test_files_of_mmpose_are_read_in_all_their_shapes() -> None:
    """A file is of a picture, or of a film with one frame or several. The data set's name tells the format."""
    instance = {"keypoints": rows(17, 2), "keypoint_scores": [0.5] * 17, "bbox": [[0, 0, 9, 9]], "bbox_score": 0.9}
    frame = {"frame_id": 3, "instances": [instance, instance]}
    for data in ([instance, instance], [frame]):
        assert len(parse_keypoints({"meta_info": {"dataset_name": "coco"}, "instance_info": data})) == 2
        assert len(parse_keypoints(data)) == 2
        (person, _) = parse_keypoints({"meta_info": {"dataset_name": "h36m"}, "instance_info": data})
        assert person.skeleton == "h36m17"
        (person, _) = parse_keypoints({"meta_info": {"dataset_name": "ap10k"}, "instance_info": data}, "coco")
        assert person.skeleton == "coco17"
    assert len(parse_keypoints({"predictions": [[instance]], "visualization": []})) == 1
    with pytest.raises(InputError, match=r"^f: person 0: format: 'ap10k'; expected one of coco17"):
        parse_keypoints({"meta_info": {"dataset_name": "ap10k"}, "instance_info": [instance] * 2}, name="f")
    for data in ([frame, frame], {"instance_info": [frame, {"frame_id": 4, "instances": []}]}, [[instance], []]):
        with pytest.raises(InputError, match=r"^f: people of 2 pictures; expected those of one"):
            parse_keypoints(data, name="f")
    with pytest.raises(InputError, match=r"^f: instances: int; expected a list of people"):
        parse_keypoints([{"frame_id": 3, "instances": 3}], name="f")


def test_points_of_wholebody_that_are_no_landmarks_are_left_out() -> None:
    values: list[Any] = rows(133)
    values[30] = [-1, "cheek", None]
    (person,) = parse_keypoints({"keypoints": values})
    assert person.skeleton == "wholebody133"
    assert person.points.shape == (35, 2)
    thumb = person.format.landmarks.index("left_thumb")
    assert person.points[thumb].tolist() == values[94][:2]
    values[94] = [1, 2, 7]
    with pytest.raises(InputError, match=r"^f: keypoint 94 \(left_thumb\): confidence 7; expected 0 to 1"):
        parse_keypoints(values, name="f")


def ultralytics(count: int = 17, **changes: Any) -> dict[str, Any]:
    """One person as ``to_json`` writes them."""
    x, y, visible = (list(column) for column in zip(*rows(count), strict=True))
    points = {"x": x, "y": y, "visible": visible, **changes}
    box = {"x1": 1.0, "y1": 2.0, "x2": 300.0, "y2": 400.0}
    return {"name": "person", "class": 0, "confidence": 0.9, "box": box, "keypoints": points}


def test_people_of_ultralytics_are_read() -> None:
    person = ultralytics()
    for name, value in (("x", 0.0), ("y", 0.0), ("visible", 0.41)):
        person["keypoints"][name][3] = value
    people = parse_keypoints([person, ultralytics()])
    assert [each.skeleton for each in people] == ["coco17", "coco17"]
    np.testing.assert_allclose(people[1].points, np.array(rows(17))[:, :2])
    np.testing.assert_allclose(people[1].confidence, 0.5)
    assert np.flatnonzero(~people[0].visible).tolist() == [3]
    del person["keypoints"]["visible"]
    (alone,) = parse_keypoints(person)
    assert alone.confidence[:5].tolist() == [1, 1, 1, 0, 1]
    assert len(parse_keypoints([[person]])) == 1  # a list of pictures, of which there is one
    with pytest.raises(InputError, match="people of 2 pictures"):
        parse_keypoints([[person], [person]])
    for changes in ({"x": [1.0]}, {"y": None}, {"visible": 1}):
        with pytest.raises(InputError, match=r"^f: keypoints: no lists x and y, and visible, of one length"):
            parse_keypoints([ultralytics(**changes)], name="f")
    with pytest.raises(InputError, match="all keypoints between 0 and 1; expected pixels, not shares"):
        parse_keypoints([ultralytics(x=[0.01 * k for k in range(17)], y=[0.5] * 17)])


def test_keypoints_are_read_by_a_custom_skeleton(tmp_path: Path) -> None:
    """The skeleton may lack all bones that tell a height."""
    names = ["nose", None, "left_wrist", "right_wrist", "left_ear", "right_ear"]
    own = write(tmp_path / "mine.json", {"landmarks": names})
    values = rows(6)
    for given_format in (own, str(own), skeleton(own)):
        person, other = read_keypoints(write(tmp_path / "k.json", [values, rows(6)]), given_format)
        assert person.format.name == "mine"
        np.testing.assert_allclose(person.points, np.array(values)[[0, 2, 3, 4, 5], :2])
        assert person_height(person) == pytest.approx(25.0)  # of its extent
        assert choose_person([person, other]) is person
    with pytest.raises(InputError, match=r"k\.json: person 0: 5 keypoints; expected 6 of mine"):
        read_keypoints(write(tmp_path / "k.json", [rows(5), rows(5)]), own)
    with pytest.raises(InputError, match=r"k\.json: no list of \"landmarks\""):
        read_keypoints(tmp_path / "k.json", tmp_path / "k.json")


def test_a_photo_finds_its_file_in_a_folder_of_keypoints(tmp_path: Path) -> None:
    photo = Path("pictures/a.b.jpg")
    assert keypoint_file(tmp_path / "k.json", photo) == tmp_path / "k.json"
    with pytest.raises(InputError, match=r": 0 \*_keypoints\.json there; expected one, or a photo"):
        keypoint_file(tmp_path, None)
    write(tmp_path / "c_keypoints.json", [])
    assert keypoint_file(tmp_path, None) == tmp_path / "c_keypoints.json"
    says = r": no keypoints of a\.b\.jpg; expected a\.b_keypoints\.json or a\.b\.keypoints\.json or a\.b\.json there"
    with pytest.raises(InputError, match=says):
        keypoint_file(tmp_path, photo)
    for name in ("a.b.json", "a.b.keypoints.json", "a.b_keypoints.json"):
        write(tmp_path / name, [])
        assert keypoint_file(tmp_path, photo) == tmp_path / name
    with pytest.raises(InputError, match=r": 2 \*_keypoints\.json there"):
        keypoint_file(tmp_path, None)


def test_lists_of_several_people_are_read() -> None:
    assert len(parse_keypoints([rows(17), rows(17)])) == 2
    assert len(parse_keypoints([flat(rows(17)), flat(rows(17)), flat(rows(17))])) == 3
    assert len(parse_keypoints({"format": "h36m17", "keypoints": [rows(17), rows(17)]})) == 2
    people = parse_keypoints([rows(17), [[0, 0, 0]] * 17])
    assert len(people) == 1  # Who has no visible keypoint is left out.


def test_missing_keypoints_are_known_in_each_notation() -> None:
    values: list[Any] = rows(17)
    values[1:6] = [[NAN, NAN, 0], [5, 5, 0], [None, None, None], [NAN, NAN, NAN], None]
    (keypoints,) = parse_keypoints(values)
    assert np.flatnonzero(~keypoints.visible).tolist() == [1, 2, 3, 4, 5]
    assert not keypoints.points[1:6].any()
    pairs: list[Any] = rows(17, 2)  # without confidences, (0, 0) alone says that a keypoint is missing
    pairs[1:6] = [[0, 0], [None, None], [NAN, NAN], [0, 50], [50, 0]]
    (keypoints,) = parse_keypoints(pairs)
    assert np.flatnonzero(~keypoints.visible).tolist() == [1, 2, 3]
    assert keypoints.points[4:6].tolist() == [[0, 50], [50, 0]]


def changed(joint: int, row: Any) -> list[Any]:
    values: list[Any] = rows(17)
    values[joint] = row
    return values


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("", "not JSON"),
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("3", "int; expected an object or a list of keypoints"),
        ("[]", "nobody in it; expected keypoints of at least one person"),
        ({"people": []}, "nobody in it; expected keypoints of at least one person"),
        ({"people": [3]}, "person 0: int; expected an object or a list"),
        ({}, "no list of keypoints; expected one under keypoints or pose_keypoints_2d"),
        ({"keypoints": "abc"}, "no list of keypoints; expected one under"),
        ({"format": "dance", "keypoints": rows(17)}, "format: 'dance'; expected one of coco17, body25"),
        ({"format": "lsp14", "keypoints": rows(17)}, "17 keypoints; expected 14 of lsp14"),
        ({"format": "lsp14", "keypoints": flat(rows(17))}, "51 numbers; expected 3 (x, y, confidence) or 2 a keypoint"),
        (
            rows(19),
            "19 keypoints; expected 14 (lsp14), 16 (mpii16), 17 (coco17), 18 (coco18), 25 (body25), 26 (halpe26)",
        ),
        (
            {"people": [{"pose_keypoints_2d": flat(rows(19))}]},
            "57 numbers; expected 3 (x, y, confidence) or 2 a keypoint",
        ),
        ([[1, 2, 3, 4]] * 17, "4 numbers; expected 3 (x, y, confidence) or 2"),
        ({"keypoints": [[1], *rows(16)]}, "rows of 1 or 3 numbers; expected [x, y] or [x, y, confidence] each"),
        ({"keypoints": [*rows(16), 5]}, "rows of 3 numbers; expected [x, y]"),
        ({"keypoints": rows(17, 2), "keypoint_scores": [1.0]}, "keypoint_scores: not one a keypoint; expected 17"),
        (changed(4, [1, NAN, 0.5]), "keypoint 4 (right_ear): [1, nan, 0.5]; expected finite numbers"),
        (changed(4, [INF, 1, 0.5]), "keypoint 4 (right_ear): [inf, 1, 0.5]; expected finite numbers"),
        (changed(4, [3, 1, NAN]), "keypoint 4 (right_ear): [3, 1, nan]; expected finite numbers"),
        (changed(4, [10**400, 1, 1]), "keypoint 4 (right_ear): [inf, 1, 1]; expected finite numbers"),
        (changed(4, [1e300, 1, 1]), "keypoint 4 (right_ear): [1e+300, 1]; expected pixels, up to 1e+06"),
        ([rows(17), changed(4, [1, -1e30, 1])], "person 1: keypoint 4 (right_ear): [1, -1e+30]; expected pixels"),
        (changed(4, ["1", 1, 1]), "keypoint 4 (right_ear): '1'; expected numbers"),
        (changed(4, [True, 1, 1]), "keypoint 4 (right_ear): True; expected numbers"),
        (changed(0, [1, 1, 37.5]), "keypoint 0 (nose): confidence 37.5; expected 0 to 1"),
        (changed(0, [1, 1, -1]), "keypoint 0 (nose): confidence -1; expected 0 to 1"),
        ([[5, 6, 0]] * 17, "no visible keypoint; expected some with confidence above 0"),
        ([[0, 0]] * 17, "no visible keypoint; expected some with confidence above 0"),
        ([[[5, 6, 0]] * 17] * 2, "person 0: no visible keypoint"),
        ([[5, 6, 1]] * 17, "all visible keypoints in one point (5, 6); expected a person"),
        ([[5, 6, 1]] + [[0, 0, 0]] * 16, "all visible keypoints in one point (5, 6); expected a person"),
        ([[k / 17, 0.5, 1] for k in range(17)], "all keypoints between 0 and 1; expected pixels, not shares"),
    ],
)
def test_bad_keypoints_are_refused_in_a_line(data: Any, message: str, tmp_path: Path) -> None:
    path = write(tmp_path / "bad.json", data)
    with pytest.raises(InputError) as raised:
        read_keypoints(path)
    error = str(raised.value)
    assert error.startswith(str(path))
    assert message in error
    assert "\n" not in error


def test_unreadable_keypoint_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.json: No such file or directory; expected keypoints in JSON"):
        read_keypoints(tmp_path / "none.json")
    with pytest.raises(InputError, match=r"Is a directory; expected keypoints in JSON"):
        read_keypoints(tmp_path)
    (tmp_path / "binary.json").write_bytes(bytes(range(128, 256)))
    with pytest.raises(InputError, match=r"binary\.json: not JSON"):
        read_keypoints(tmp_path / "binary.json")
    with pytest.raises(InputError, match=r"keypoint format: 'dance'; expected one of coco17"):
        read_keypoints(write(tmp_path / "k.json", rows(17)), "dance")


KEYS = [
    "people",
    "keypoints",
    "format",
    "annotations",
    "keypoint_scores",
    "instances",
    "x",
    "y",
    "visible",
    "meta_info",
    "keypoint_names",
    "images",
    "image_id",
    "file_name",
    "categories",
    "id",
    "shapes",
    "label",
    "points",
    "result",
    "value",
    "keypointlabels",
    "original_width",
    "original_height",
]
JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(KEYS), inner),
    max_leaves=20,
)


@given(JSON_VALUES)
def test_any_json_is_read_or_refused(data: Any) -> None:
    try:
        people = parse_keypoints(data)
    except InputError:
        return
    assert all(np.isfinite(person.points).all() for person in people)


def test_keypoints_know_the_size_that_their_file_states(tmp_path: Path) -> None:
    """A fit of them stands before a usual lens."""
    path = tmp_path / "k.json"
    for stated, size in (({"image_width": 640, "image_height": 480}, (480, 640)), ({}, None)):
        path.write_text(json.dumps({"format": "coco17", "keypoints": rows(17), **stated}))
        (person,) = read_keypoints(path)
        assert person.image_size == size
    (person,) = read_keypoints(path, size=(300, 400))
    assert person.image_size == (300, 400)
